"""The house: its rooms, how few places ask what kind a thing is, and how small its pieces are.

A count of one kind of test is no style rule for its own sake: each `isinstance` on a kind outside
its room is a place where a plugin's kind behaves in another way than the bundled ones.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
from collections.abc import Collection, Iterable, Iterator
from functools import cache
from pathlib import Path

import pytest

import vstestbed
from vstestbed.robots import ROBOTS
from vstestbed.targets import TARGETS
from vstestbed.targets.markers import MARKERS, Stripe
from vstestbed.targets.motion import MOTIONS
from vstestbed.tasks import GOALS

pytestmark = pytest.mark.app()
PACKAGE = Path(vstestbed.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
ROOMS = {
    "tasks": set(GOALS.members.values()),
    "robots": set(ROBOTS.members.values()),
    "targets": {
        *TARGETS.members.values(),
        *MARKERS.members.values(),
        *MOTIONS.members.values(),
        Stripe,
    },
}


@cache
def nodes(file: Path) -> tuple[ast.AST, ...]:
    """Nodes of a file's syntax tree that these tests look at, the root first."""
    return tuple(
        node for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, LOOKED_AT)
    )


LOOKED_AT = (ast.Module, ast.Call, ast.MatchClass, ast.Compare, ast.FunctionDef, ast.Assign)
"""Kinds of nodes that these tests look at."""


def asked(within: Iterable[ast.AST], names: set[str], kinds: set[str]) -> Iterator[ast.AST]:
    """Nodes that ask of what kind something is: isinstance, a class pattern, a comparison of
    `.kind` with one of the words.
    """
    for node in within:
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in ("isinstance", "issubclass")
        ):
            if names & {getattr(n, "id", getattr(n, "attr", "")) for n in ast.walk(node.args[1])}:
                yield node
        elif (
            isinstance(node, ast.MatchClass)
            and isinstance(node.cls, ast.Name)
            and node.cls.id in names
        ):
            yield node
        elif isinstance(node, ast.Compare) and any(
            isinstance(n, ast.Attribute) and n.attr == "kind" for n in ast.walk(node)
        ):
            yield from (
                [node]
                if kinds & {n.value for n in ast.walk(node) if isinstance(n, ast.Constant)}
                else []
            )


def places(room: str) -> list[str]:
    """FILE:LINE of each such test outside the room."""
    names, kinds = {cls.__name__ for cls in ROOMS[room]}, {cls.kind for cls in ROOMS[room]}
    found = []
    for file in FILES:
        if file.relative_to(PACKAGE).parts[0] != room:
            found += [
                f"{file.relative_to(PACKAGE)}:{node.lineno}"
                for node in asked(nodes(file), names, kinds)
            ]
    return found


@pytest.mark.parametrize("room", ROOMS)
def test_few_ask_of_what_kind_a_thing_is(room):
    found = places(room)
    assert len(found) <= 4, found
    for place in found:  # each says why, on its line or on the one above
        file, line = place.split(":")
        lines = (PACKAGE / file).read_text().splitlines()
        assert "#" in lines[int(line) - 1] or lines[int(line) - 2].lstrip().startswith("#"), (
            f"{place} gives no reason"
        )


def test_the_counter_counts():
    tree = ast.parse(
        "isinstance(x, Car | Omni)\n"
        "match y:\n"
        "    case Car(start=s):\n"
        "        pass\n"
        "z.kind == 'car'\n"
        "q.kind in ('a', 'omni')\n"
    )
    assert len(list(asked(ast.walk(tree), {"Car"}, {"car", "omni"}))) == 4


def test_the_top_of_the_package_is_a_table_of_contents():
    rooms = {p.name for p in PACKAGE.iterdir() if p.is_dir() and any(p.glob("*.py"))}
    loose = {p.name for p in PACKAGE.glob("*.py")}
    assert len(rooms) <= 21, rooms
    assert loose == {"__init__.py", "__main__.py"}
    for room in rooms:
        assert inspect.getdoc(importlib.import_module(f"vstestbed.{room}")), (
            f"{room}/ does not say what is in it"
        )


def test_functions_are_small():
    """By their statements, whatever lines a formatter makes of them; and none is longer than a
    page.
    """
    for file in FILES:
        for node in nodes(file):
            if isinstance(node, ast.FunctionDef):
                body = node.body[1:] if ast.get_docstring(node, clean=False) else node.body
                statements = sum(isinstance(n, ast.stmt) for one in body for n in ast.walk(one))
                assert statements <= 41, (
                    f"{file.relative_to(PACKAGE)}: {node.name} has too many statements"
                )
                assert not body or node.end_lineno - body[0].lineno < 80, (
                    f"{file.relative_to(PACKAGE)}: {node.name} is too long"
                )


def test_every_public_method_says_what_it_does_here_or_in_the_class_it_comes_from():
    classes = {
        node.name: node
        for file in FILES
        for node in nodes(file)[0].body
        if isinstance(node, ast.ClassDef)
    }

    def said(cls: ast.ClassDef, name: str) -> bool:
        own = [node for node in cls.body if isinstance(node, ast.FunctionDef) and node.name == name]
        bases = [
            classes[base]
            for node in cls.bases
            if (base := ast.unparse(node).split("[")[0].split(".")[-1]) in classes
        ]
        return any(map(ast.get_docstring, own)) or any(
            said(base, name) for base in bases if base is not cls
        )

    for cls in classes.values():
        for node in cls.body if not cls.name.startswith("_") else ():
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_"):
                assert said(cls, node.name), (
                    f"{cls.name}.{node.name} has no docstring, and no base class has one"
                )


def test_no_two_classes_of_one_name():
    names = [
        node.name
        for file in FILES
        for node in nodes(file)[0].body
        if isinstance(node, ast.ClassDef)
    ]
    assert sorted({name for name in names if names.count(name) > 1}) == []


def test_what_the_loop_passes_on_is_small():
    from vstestbed.features.observation import Goal, Observation
    from vstestbed.laws import Command
    from vstestbed.robots import Allocation, Reading
    from vstestbed.robots.allocation import Order
    from vstestbed.sim.base import Truth
    from vstestbed.tasks.frame import Cycle, Frame

    def size(cls: type) -> int:
        # some are named tuples
        return len(getattr(cls, "_fields", None) or dataclasses.fields(cls))

    for cls in (Frame, Goal, Observation, Command, Allocation, Order, Reading, Truth):
        # an observation's are what laws may name
        assert size(cls) <= {Observation: 18, Goal: 15}.get(cls, 14), cls
    assert size(Cycle) <= 8 and size(Frame) <= 14


def test_a_robot_has_at_most_25_members():
    from vstestbed.robots import Robot

    members = {name for name in (*vars(Robot), *Robot.__annotations__) if not name.startswith("_")}
    assert len(members) <= 25, "what only some robots have is a capability (robots/base.py)"


WRITES = {  # names of calls that write a file, of all libraries that the package uses
    *(
        "write_text",
        "write_bytes",
        "touch",
        "symlink_to",
        "hardlink_to",
        "mkstemp",
        "NamedTemporaryFile",
        "tofile",
        "savetxt",
        "savez",
    ),
    *(
        "write_csv",
        "write_parquet",
        "write_json",
        "write_ndjson",
        "write_ipc",
        "to_csv",
        "to_parquet",
        "to_file",
        "to_zip",
        "dump",
        "save",
    ),
    *(
        "savefig",
        "imwrite",
        "imwritemulti",
        "mj_saveLastXML",
        "mj_saveModel",
        "copy2",
        "copyfile",
        "copytree",
        "move",
        "extractall",
    ),
}
LOOKED_UP = {*WRITES, "open", "VideoWriter"}
WRITERS = {  # beside core/files.py: where, which call, and why it may
    ("loop/log_file.py", "open"): "log.part has a fixed name and grows; opened with x",
    ("report/video/writer.py", "open"): "the encoder writes into the open file of a PartFile",
    ("cli/ending.py", "open"): "opens the null device in place of a closed pipe",
    ("testing/child.py", "os.open"): "names folders to the system, without rights to them",
}


def writes(within: Collection[ast.AST]) -> Iterator[tuple[str, int]]:
    """Name and line of each call that writes a file; those into a buffer of io, or that return
    text, are none.
    """
    in_memory: set[str] | None = None  # few files have a call whose arguments matter
    for node in within:
        if (
            not isinstance(node, ast.Call)
            or getattr(node.func, "id", getattr(node.func, "attr", "")) not in LOOKED_UP
        ):
            continue
        called, given = ast.unparse(node.func), [*node.args, *(k.value for k in node.keywords)]
        name = called.rpartition(".")[2]
        if called in ("os.open", "cv2.VideoWriter"):
            yield called, node.lineno
        elif name == "open":
            modes = [
                a.value
                for a in given
                if isinstance(a, ast.Constant) and isinstance(a.value, str) and len(a.value) <= 3
            ]
            named = any(
                not isinstance(k.value, ast.Constant) for k in node.keywords if k.arg == "mode"
            )
            if named or any(set(mode) & set("wax+") for mode in modes):
                yield name, node.lineno
        elif name in WRITES and "." in called and given:
            in_memory = buffers(within) if in_memory is None else in_memory
            if not in_memory & {ast.unparse(a) for a in given}:
                yield name, node.lineno


def buffers(within: Iterable[ast.AST]) -> set[str]:
    """Names that hold a buffer of io."""
    found = {
        n.targets[0] for n in within if isinstance(n, ast.Assign) and "io." in ast.unparse(n.value)
    }
    found |= {t for n in found if isinstance(n, ast.Tuple) for t in n.elts}
    return {ast.unparse(n) for n in found}


def test_files_are_written_in_one_place():
    """`core.files` writes under a temporary name and renames; every other writer could leave half a
    file.
    """
    found = {}
    for file in FILES:
        place = file.relative_to(PACKAGE).as_posix()
        if place != "core/files.py":
            found |= {(place, name): line for name, line in writes(nodes(file))}
    assert {key: line for key, line in found.items() if key not in WRITERS} == {}
    assert set(WRITERS) == set(found), "an exception that is not needed any more"


def test_the_finder_of_writers_finds():
    text = """
p.open("w"); open(p, "ab"); open(p, mode=m); p.open(); open(p, "rb")
p.write_text(t); df.write_csv(p); df.write_csv(); fig.savefig(p)
b = io.BytesIO(); df.write_parquet(b); json.dump(x, f); json.dumps(x)
np.save(p, x); cv2.imwrite(p, i); cv2.VideoWriter(p); os.open(p, 0)
"""
    names = [name for name, _ in writes([*ast.walk(ast.parse(text))])]
    assert sorted(names) == sorted(
        [
            "open",
            "open",
            "open",
            "write_text",
            "write_csv",
            "savefig",
            "dump",
            "save",
            "imwrite",
            "cv2.VideoWriter",
            "os.open",
        ]
    )
