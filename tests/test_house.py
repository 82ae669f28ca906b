"""The house: its rooms, how few places ask what kind a thing is, and how small its pieces are.

A count of one kind of test is no style rule for its own sake: each `isinstance` on a kind outside its room is a place where a plugin's
kind behaves in another way than the bundled ones.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
from collections.abc import Iterator
from pathlib import Path

import pytest

import vstestbed
from vstestbed.robots import ROBOTS
from vstestbed.targets import TARGETS
from vstestbed.targets.attached import MOTIONS
from vstestbed.targets.markers import MARKERS, Stripe
from vstestbed.tasks import GOALS

PACKAGE = Path(vstestbed.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
ROOMS = {
    "tasks": set(GOALS.members.values()),
    "robots": set(ROBOTS.members.values()),
    "targets": {*TARGETS.members.values(), *MARKERS.members.values(), *MOTIONS.members.values(), Stripe},
}


def asked(tree: ast.AST, names: set[str], kinds: set[str]) -> Iterator[ast.AST]:
    """Nodes that ask of what kind something is: isinstance, a class pattern, a comparison of `.kind` with one of the words."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("isinstance", "issubclass"):
            if names & {getattr(n, "id", getattr(n, "attr", "")) for n in ast.walk(node.args[1])}:
                yield node
        elif isinstance(node, ast.MatchClass) and isinstance(node.cls, ast.Name) and node.cls.id in names:
            yield node
        elif isinstance(node, ast.Compare) and any(isinstance(n, ast.Attribute) and n.attr == "kind" for n in ast.walk(node)):
            yield from [node] if kinds & {n.value for n in ast.walk(node) if isinstance(n, ast.Constant)} else []


def places(room: str) -> list[str]:
    """FILE:LINE of each such test outside the room."""
    names, kinds = {cls.__name__ for cls in ROOMS[room]}, {cls.kind for cls in ROOMS[room]}
    found = []
    for file in FILES:
        if file.relative_to(PACKAGE).parts[0] != room:
            found += [f"{file.relative_to(PACKAGE)}:{node.lineno}" for node in asked(ast.parse(file.read_text()), names, kinds)]
    return found


@pytest.mark.parametrize("room", ROOMS)
def test_few_ask_of_what_kind_a_thing_is(room):
    found = places(room)
    assert len(found) <= 4, found
    for place in found:  # each says why, on its line or on the one above
        file, line = place.split(":")
        lines = (PACKAGE / file).read_text().splitlines()
        assert "#" in lines[int(line) - 1] or lines[int(line) - 2].lstrip().startswith("#"), f"{place} gives no reason"


def test_the_counter_counts():
    tree = ast.parse(
        "isinstance(x, Car | Omni)\nmatch y:\n    case Car(start=s):\n        pass\nz.kind == 'car'\nq.kind in ('a', 'omni')\n"
    )
    assert len(list(asked(tree, {"Car"}, {"car", "omni"}))) == 4


def test_the_top_of_the_package_is_a_table_of_contents():
    rooms = {p.name for p in PACKAGE.iterdir() if p.is_dir() and any(p.glob("*.py"))}
    loose = {p.name for p in PACKAGE.glob("*.py")}
    assert len(rooms) <= 17, rooms
    assert loose == {"__init__.py", "__main__.py"}
    for room in rooms:
        assert inspect.getdoc(importlib.import_module(f"vstestbed.{room}")), f"{room}/ does not say what is in it"


@pytest.mark.parametrize("file", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_files_and_functions_are_small(file):
    text = file.read_text()
    assert text.count("\n") <= 300
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.FunctionDef):
            body = node.body[1:] if ast.get_docstring(node) else node.body
            assert not body or node.end_lineno - body[0].lineno < 45, f"{node.name} is too long"


def test_no_two_classes_of_one_name():
    names = [node.name for file in FILES for node in ast.parse(file.read_text()).body if isinstance(node, ast.ClassDef)]
    assert sorted({name for name in names if names.count(name) > 1}) == []


def test_what_the_loop_passes_on_is_small():
    from vstestbed.features.observation import Goal, Observation
    from vstestbed.laws import Command
    from vstestbed.robots import Allocation, Reading
    from vstestbed.sim.base import Truth
    from vstestbed.tasks.frame import Frame

    for cls in (Frame, Goal, Observation, Command, Allocation, Reading, Truth):
        assert len(dataclasses.fields(cls)) <= 12, cls
    assert len(dataclasses.fields(Frame)) < 10
