"""A comparison's folder on another machine: copies of the files that its plan names, their hashes,
where it ran, and whether a second flight agrees with the first.
"""

from __future__ import annotations

import ast
import hashlib
import logging
import os
import platform
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Any, NamedTuple

import polars as pl

from vstestbed.core.errors import ParameterError, RunFolderError, VstestbedError
from vstestbed.core.files import make_folder, read_json, write_json, write_whole
from vstestbed.core.foreign import plain_file
from vstestbed.core.named_files import ENDINGS, FILE_FIELDS, folder, is_there
from vstestbed.core.provenance import versions
from vstestbed.scenario.dump import as_yaml
from vstestbed.scenario.plugins import is_file_name
from vstestbed.scenario.yaml_marks import plain_mapping, text_of
from vstestbed.tasks.metrics import EVERY_RUN, Metric

__all__ = [
    "FILES",
    "LEAST",
    "PLAN",
    "RECORD",
    "SCENARIOS",
    "TOLERANCE",
    "Agreement",
    "agreement",
    "copied_plan",
    "environment",
    "files_in",
    "is_bundled",
    "keep",
    "moved_plugins",
    "must_be_comparison",
    "must_be_unchanged",
    "needed_files",
]

PLAN, RECORD, FILES, SCENARIOS = "comparison.yaml", "record.json", "files", "scenarios"
TOLERANCE, LEAST = 0.02, 0.05
"""Two numbers of a run agree within this share of the larger one and this much in their display
unit: one frame of 40 ms of 2 s, 0.05 px. Another processor or version of a library changes the last
digits of pixels, and with them the frame in which a run converges.
"""
_COMMIT = re.compile("[0-9a-f]{40}|[0-9a-f]{64}")
_MOST_REFS = 16 << 20  # bytes of a file of git: names of a hundred thousand branches and tags
_MOST_NAME = 4 << 10  # of one that holds a name, or a commit
_MOST_SOURCE = 4 << 20  # of a Python file


def keep(place: Path) -> None:
    """Copy each file that the plan in a comparison's folder names, with those that it needs, into
    `files/`, and write `record.json`.

    Needed are the meshes and textures of a robot's model, and of a Python file the modules and data
    that it names, each where it is below the file's folder; the record names those elsewhere, which
    are not copied: a model of others must not bring files of this machine along. What belongs to
    vstestbed, and modules of installed packages, are not copied either: the record has their
    versions.
    """
    files, elsewhere = dict[str, Any](), set[str]()
    for source in dict.fromkeys(path for path in _named(place) if not is_bundled(path)):
        copies, others = _closure(source)
        elsewhere.update(map(str, others))
        for path, copy in copies.items():
            content = path.read_bytes()
            write_whole(make_folder((place / copy).parent) / Path(copy).name, content)
            # by git's own name of the content, `git ls-tree -r COMMIT` says whether the commit has
            # it
            blob = hashlib.sha1(
                b"blob %d\0%b" % (len(content), content), usedforsecurity=False
            ).hexdigest()
            files[copy] = {
                "from": str(path),
                "sha256": _hash(path),
                "blob": blob,
                "commit": _commit(path),
            }
    if elsewhere:
        logging.getLogger("vstestbed").warning(
            "not copied, since they are not below the folder of what names them: %s",
            sorted(elsewhere),
        )
    # how each law was tuned
    tuned = plain_mapping(text_of(place / PLAN), PLAN, "")[0].get("tuned", {})
    write_json(
        place / RECORD,
        {
            "environment": environment(),
            "files": files,
            "not_copied": sorted(elsewhere),
            "tuned": tuned,
        },
    )


def must_be_unchanged(place: Path, plugins: Sequence[str] = ()) -> None:
    """Refuse to go on in a folder whose files are not those of its stored runs; where one is gone,
    the plan names the copy from now on. plugins: given beside those of the plan, one of which may
    be a file of the plan in its new place.
    Raises RunFolderError: which files have changed.
    """
    new = {Path(name).name: Path(name) for name in plugins}
    now = {
        copy: new.get(Path(said["from"]).name, Path(said["from"]))
        for copy, said in _files(place).items()
    }
    changed = [
        f"{now[copy]} has changed since"
        for copy, said in _files(place).items()
        if is_there(now[copy]) and _differs(said, now[copy])
    ]
    if changed:
        works = (
            "bring it back (its copy is in files/), or compare the new version in a new folder:"
            " runs of two versions are never mixed"
        )
        raise RunFolderError(place, "; ".join(changed), works)
    gone = {
        said["from"]: str((place / copy).absolute())
        for copy, said in _files(place).items()
        if not is_there(now[copy])
    }
    if gone:
        _rewrite(place, place, gone)


def moved_plugins(place: Path, given: Sequence[str]) -> tuple[str, ...]:
    """The copies of the plugins of a comparison's folder that are not where they were, which its
    runs name; without those given.
    """
    there = {Path(name).name for name in given}
    gone = (
        copy
        for copy, said in _files(place).items()
        if copy.endswith(".py") and not is_there(Path(said["from"]))
    )
    return tuple(str((place / copy).absolute()) for copy in gone if Path(copy).name not in there)


def copied_plan(place: Path, out: Path) -> None:
    """Write the plan of a comparison's folder into another one, to be flown there from the copies
    of its files.
    Raises RunFolderError: a copy is not there, or is not what flew.
    """
    for copy, said in _files(place).items():
        if not is_there(place / copy):
            raise RunFolderError(place / copy, "is not there", "copy the comparison's whole folder")
        if _differs(said, place / copy):
            raise RunFolderError(
                place / copy,
                "is not the file with which the stored runs flew",
                "bring that one back",
            )
    _rewrite(
        place,
        out,
        {said["from"]: str((place / copy).absolute()) for copy, said in _files(place).items()},
    )


class Agreement(NamedTuple):
    """How many rows of two flights have the same numbers to the last digit, how many agree within
    the tolerance, and what does not.
    """

    same: int
    near: int
    differ: tuple[str, ...]

    def lines(self) -> list[str]:
        """In words."""
        total = self.same + self.near + len(self.differ)
        first = (
            f"{self.same + self.near} of {total} runs agree"
            f" ({self.same} to the last digit, {self.near} within"
        )
        first += f" {100 * TOLERANCE:g} % and {LEAST:g} of the unit)"
        more = [f"and {len(self.differ) - 20} more"] if len(self.differ) > 20 else []
        return [first, *(f"differs: {words}" for words in self.differ[:20]), *more]


def agreement(before: pl.DataFrame, now: pl.DataFrame) -> Agreement:
    """Compare two tables run by run, by their folders: the outcome, and every metric that each run
    has.
    """
    metrics = [m for m in EVERY_RUN if m.name in before.columns and m.name in now.columns]
    by_folder = {row["folder"]: row for row in now.rows(named=True)}
    same = near = 0
    differ = list[str]()
    for row in before.rows(named=True):
        other = by_folder.get(row["folder"])
        far = _difference(row, other, metrics)
        if other is None or far:
            differ.append(f"{row['folder']}: {far}")
        elif any(row[m.name] != other[m.name] for m in metrics):
            near += 1
        else:
            same += 1
    return Agreement(same, near, tuple(differ))


def _difference(
    row: Mapping[str, Any], other: Mapping[str, Any] | None, metrics: Sequence[Metric]
) -> str:
    """The first thing in which two runs differ beyond the tolerance, in words; "" where none is."""
    if other is None or other["outcome"] != row["outcome"]:
        return f"{row['outcome']}, now {'not there' if other is None else other['outcome']}"
    for m in metrics:
        a, b = row[m.name], other[m.name]
        if a != b and not _agree(a, b, m.scale):
            return f"{m.name} {a}, now {b}"
    return ""


def _agree(a: Any, b: Any, scale: float) -> bool:
    if a is None or b is None:
        return a is b
    return abs(a - b) <= TOLERANCE * max(abs(a), abs(b)) + LEAST / scale


def environment() -> dict[str, Any]:
    """Machine and software: system, processor, cores, versions of all packages that vstestbed
    requires, how OpenGL was chosen.
    """
    found = dict(versions())
    for requirement in requires("vstestbed") or ():
        name = re.split(r"[^\w.-]", requirement, maxsplit=1)[0]
        try:
            found.setdefault(name, version(name))
        except PackageNotFoundError:  # of an extra that is not installed
            continue
    processor = platform.processor() or platform.machine()
    if (info := Path("/proc/cpuinfo")).is_file():
        processor = next(
            (
                line.partition(":")[2].strip()
                for line in info.read_text().splitlines()
                if line.startswith("model name")
            ),
            processor,
        )
    return {
        "system": platform.platform(),
        "processor": processor,
        "cores": os.cpu_count(),
        "MUJOCO_GL": os.environ.get("MUJOCO_GL", ""),
        "versions": found,
    }


def _named(place: Path) -> Iterator[Path]:
    """The files that the plan and its copies of scenarios name, absolutely."""
    for document in (place / PLAN, *sorted((place / SCENARIOS).glob("*.yaml"))):
        yield from files_in(plain_mapping(text_of(document), str(document), "")[0])


def files_in(value: Any, key: str = "") -> Iterator[Path]:
    """The files that are there of those that plain values of a scenario name absolutely."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from files_in(inner, str(name).rpartition(".")[2])
    elif isinstance(value, list):
        for inner in value:
            yield from files_in(inner, key)
    elif isinstance(value, str) and _names_file(value, key):
        path = Path(re.sub(r"(\.py):\w+$", r"\1", value))
        if path.is_absolute() and is_there(path):
            yield path


def _names_file(text: str, key: str) -> bool:
    """Whether a text under a field's name is that of a file."""
    if key == "plugins":
        return is_file_name(text)
    return key in FILE_FIELDS and ENDINGS.search(text) is not None


def is_bundled(path: Path) -> bool:
    """Whether a file belongs to vstestbed."""
    return any(
        path.resolve().is_relative_to(folder(name).resolve()) for name in ("models", "scenarios")
    )


def needed_files(sources: Iterable[Path], values: Any = ()) -> tuple[list[Path], list[Path]]:
    """Files, those that plain values of a scenario name absolutely, and those that they need (see
    `keep`); and those that they need and that are not below their folder. Of vstestbed's own none.
    """
    waiting = [path.absolute() for path in (*sources, *files_in(values)) if not is_bundled(path)]
    found, elsewhere = dict.fromkeys(waiting), dict[Path, None]()
    while waiting:
        needing = waiting.pop()
        inside = _folder_of(needing)
        for path in filter(is_there, _needed(needing)):
            if not path.resolve().is_relative_to(inside):
                elsewhere[path] = None
            elif path not in found:
                found[path] = None
                waiting.append(path)
    return list(found), list(elsewhere)


def _folder_of(path: Path) -> Path:
    """The folder whose files may be copied with a file:
    its own, or the ROS package that it is in.
    """
    package = (place for place in path.resolve().parents if is_there(place / "package.xml"))
    return next(package, path.parent.resolve())


def _closure(source: Path) -> tuple[dict[Path, str], list[Path]]:
    """A file and those that it needs, each with the place of its copy: in a folder of the source's
    own, with the layout that they have; and those that are not copied.
    """
    found, elsewhere = needed_files([source])
    root = Path(os.path.commonpath([path.parent for path in found]))
    word = f"{source.stem}_{hashlib.sha256(str(source).encode()).hexdigest()[:6]}"
    return {
        path: (Path(FILES) / word / path.relative_to(root)).as_posix() for path in found
    }, elsewhere


def _needed(path: Path) -> Iterator[Path]:
    """The files that MuJoCo reads with a model; of a Python file the modules, and the files named
    in texts, that are beside it.
    """
    if path.suffix.lower() in (".xml", ".mjcf", ".urdf"):
        from vstestbed.sim.scene.model_files import files_read

        yield from (Path(os.path.normpath(name)) for name in files_read(path))
    elif path.suffix == ".py":
        for node in ast.walk(_parsed(path)):
            yield from _named_by(node, path.parent)


def _named_by(node: ast.AST, folder: Path) -> Iterator[Path]:
    """The files beside a Python file that a node of it imports, or names in a text."""
    modules: list[str] = []
    if isinstance(node, ast.Import):
        modules = [alias.name for alias in node.names]
    elif isinstance(node, ast.ImportFrom) and node.module:
        modules = [node.module]
    for name in modules:
        beside = folder.joinpath(*name.split("."))
        yield from (beside.with_suffix(".py"), beside / "__init__.py")
    text = node.value if isinstance(node, ast.Constant) else None
    if isinstance(text, str) and re.fullmatch(r"[\w./-]{1,100}\.\w{1,8}", text):
        yield folder / text


def _parsed(path: Path) -> ast.AST:
    """The syntax tree of a Python file; an empty one of what is none, too: files that others name
    are of any kind.
    """
    try:
        return ast.parse(
            plain_file(path, "a Python file", _MOST_SOURCE).read_text(
                encoding="utf-8", errors="replace"
            )
        )
    except (SyntaxError, ValueError, RecursionError, MemoryError, OSError, VstestbedError):
        return ast.Module([], [])


def _files(place: Path) -> dict[str, dict[str, str]]:
    """The files of a record, by the places of their copies; none of a folder of before, which has
    no record.
    """
    return read_json(place / RECORD)["files"] if is_there(place / RECORD) else {}


def _differs(said: Mapping[str, str], path: str | Path) -> bool:
    return _hash(Path(path)) != said["sha256"]


def _hash(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _commit(path: Path) -> str:
    """The commit of the checkout in which a file is; "" outside of any.

    Git itself is not run: the settings of a foreign folder name programs, which it would run. Its
    layout is in gitrepository-layout(5).
    """
    for place in path.resolve().parents:
        git = place / ".git"
        if is_there(git):  # of a worktree, or of a submodule
            git = place / _text(git).removeprefix("gitdir:").strip()
        if is_there(git / "HEAD"):
            return _head(git)
    return ""


def _head(git: Path) -> str:
    """The commit at which a folder of git stands, whose branches may be in the one that it shares
    with others; "" where none is found.
    """
    head = _text(git / "HEAD").strip()
    if head.startswith("ref: "):
        name, shared = head.removeprefix("ref: "), git / (_text(git / "commondir").strip() or ".")
        lines = _text(shared / "packed-refs", _MOST_REFS).splitlines()
        packed = next(
            (line.removesuffix(f" {name}") for line in lines if line.endswith(f" {name}")), ""
        )
        head = (_text(shared / name) or packed).strip()
    return head if _COMMIT.fullmatch(head) else ""


def _text(path: Path, most: int = _MOST_NAME) -> str:
    """The text of a file of git; "" where it is none, or too large."""
    try:
        return plain_file(path, "a file of git", most).read_text(encoding="utf-8", errors="replace")
    except (OSError, ParameterError):
        return ""


def _rewrite(place: Path, out: Path, names: Mapping[str, str]) -> None:
    """Write plan and scenarios of one folder into another, or the same,
    with other names of files.
    """

    def renamed(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: renamed(inner) for key, inner in value.items()}
        if isinstance(value, list):
            return [renamed(inner) for inner in value]
        if not isinstance(value, str):
            return value
        file, colon, function = value.partition(".py:")  # a policy: FILE.py:NAME
        return (
            f"{names[f'{file}.py']}:{function}"
            if colon and f"{file}.py" in names
            else names.get(value, value)
        )

    for document in (place / PLAN, *(place / SCENARIOS).glob("*.yaml")):
        plain = renamed(plain_mapping(text_of(document), str(document), "")[0])
        target = out / document.relative_to(place)
        write_whole(make_folder(target.parent) / target.name, as_yaml(plain))


def must_be_comparison(place: Path) -> None:
    """Refuse a folder without the plan and the table of a comparison."""
    for name in (PLAN, "comparison.parquet"):
        if not is_there(place / name):
            raise ParameterError.needs("--again", f"a comparison's folder with {name}", str(place))
