"""Every call of a library that reads what others wrote stands inside `with foreign(...)`, or is
listed here with its reason.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

import vstestbed
from tests.shortcuts import is_here

PACKAGE = Path(vstestbed.__file__).parent
CALLS = {
    *("cv2.imread", "cv2.imdecode", "cv2.FileStorage", "cv2.VideoCapture"),
    *(
        "mujoco.MjSpec.from_file",
        "mujoco.MjSpec.from_string",
        "mujoco.MjModel.from_xml_path",
        "mujoco.MjModel.from_xml_string",
    ),
    *("zipfile.ZipFile", "tarfile.open", "ElementTree.parse", "ElementTree.fromstring"),
    *("pl.read_csv", "pl.read_parquet", "pl.scan_parquet", "pl.scan_csv", "np.load", "np.loadtxt"),
    *(
        "yaml.load",
        "yaml.safe_load",
        "yaml.load_all",
        "yaml.safe_load_all",
        "yaml.compose",
        "yaml.parse",
    ),
    *(
        "json.load",
        "json.loads",
        "onnxruntime.InferenceSession",
        "av.open",
        "Image.open",
        "AnyReader",
        "make_reader",
    ),
    *("read_protobuf_messages", "csv.DictReader", "csv.reader"),
}
"""Calls that read files, or the content of files."""

ELSEWHERE = {
    "raises within a `with foreign(...)` of its only callers": {
        ("camera/intrinsics.py", "_documents"),
        ("camera/intrinsics.py", "_from_opencv"),
        ("core/plain_yaml.py", "plain_documents"),
        ("scenario/yaml_marks.py", "_tree"),
    },
    "its callers turn MuJoCo's errors into a line and a remedy (`cannot_compile`)": {
        ("sim/scene/model_files.py", "_parsed"),
        ("sim/scene/model_files.py", "_ends_at"),
    },
    "tells more than the library does, by exceptions of its own": {
        ("loop/isolated.py", "_received"),
        ("loop/log_file.py", "_of_parquet"),
        ("loop/recording.py", "read_summary"),
        ("apps/ros/bag.py", ""),
        ("studies/comparison/plan.py", "_read_lists"),
        ("apps/tune/search_space.py", "read_record"),
        ("apps/suite/submission.py", ""),
        ("targets/picture.py", "decoded"),
    },
    "reads what this program has just written, or its own installation": {
        ("cli/comparing.py", ""),
        ("cli/complete.py", ""),
        ("imaging/stream.py", ""),
        ("loop/columns.py", ""),
        ("report/comparison/baseline.py", ""),
        ("report/comparison/results.py", ""),
        ("report/comparison/tables.py", ""),
        ("report/video/gif.py", ""),
        ("report/video/side_by_side.py", ""),
        ("report/video/writer.py", ""),
        ("sim/plant.py", ""),
        ("sim/scene/compose.py", ""),
        ("studies/comparison/__init__.py", ""),
        ("studies/run_folder.py", ""),
        ("apps/suite/suite.py", ""),
    },
}
"""File and function ("" for all of a file) by the reason for
which the guard does not stand there.
"""


def name_of(call: ast.expr) -> str:
    """`cv2.imdecode` of such a call's function; "" where it is no name."""
    if isinstance(call, ast.Attribute):
        return f"{name_of(call.value)}.{call.attr}".lstrip(".")
    return call.id if isinstance(call, ast.Name) else ""


def unguarded(source: str) -> dict[str, set[str]]:
    """The calls without a guard, by the function that they are in."""
    found: dict[str, set[str]] = {}

    def visit(node: ast.AST, function: str, guarded: bool) -> None:
        if isinstance(node, ast.FunctionDef):
            function = node.name
        if isinstance(node, ast.With):
            guarded |= any(
                isinstance(i.context_expr, ast.Call) and name_of(i.context_expr.func) == "foreign"
                for i in node.items
            )
        if isinstance(node, ast.Call) and not guarded and name_of(node.func) in CALLS:
            found.setdefault(function, set()).add(name_of(node.func))
        for child in ast.iter_child_nodes(node):
            visit(child, function, guarded)

    visit(ast.parse(source), "", False)
    return found


@pytest.mark.app()
def test_every_foreign_call_is_guarded():
    listed = {place for places in ELSEWHERE.values() for place in places if is_here(place[0])}
    used, new = set(), []
    for path in sorted(PACKAGE.rglob("*.py")):
        file = path.relative_to(PACKAGE).as_posix()
        for function, calls in unguarded(path.read_text(encoding="utf-8")).items():
            place = next((p for p in ((file, function), (file, "")) if p in listed), None)
            if place is None:
                new.append(f"{file}: {function or 'the module'} calls {', '.join(sorted(calls))}")
            else:
                used.add(place)
    assert not new, "put these into `with foreign(...)`:\n" + "\n".join(new)
    assert used == listed, f"guarded, or gone: {sorted(listed - used)}"


def test_a_new_call_is_found():
    source = (
        "def a():\n"
        '    with foreign("x", "y"):\n'
        '        yaml.safe_load("")\n'
        "\n"
        "\n"
        "def b():\n"
        '    return json.loads("")\n'
    )
    assert unguarded(source) == {"b": {"json.loads"}}
