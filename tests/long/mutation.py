"""Would a test notice?

    python tests/long/mutation.py [--rooms laws tasks vision] [--tests DIR ...] [--sample N]
        [--seed N] [--jobs N]

A mutant is the package with one operator, comparison, sign, truth value or number of one file
changed. The tests that run the changed line should fail; a mutant under which they all pass has
survived. Printed are the survivors and the share of mutants that were noticed (mutation score;
DeMillo, Lipton & Sayward 1978, doi:10.1109/C-M.1978.218136). Which test runs which line is measured
once by `coverage` and kept in the file `--map`; measure again (delete it) after tests have changed.
A part of a room is files with a plus between: `vision/pnp.py+vision/homography.py`.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import copy
import importlib.abc
import importlib.util
import json
import os
import random
import resource
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

REPOSITORY = Path(__file__).resolve().parents[2]
TESTS = (
    "laws",
    "tasks",
    "vision",
    "features",
    "catalogue",
    "loop",
    "robots/test_failsafe.py",
    "apps/maps/basin",
)
"""Tests that may notice; the longest runs and the studies are left out."""
LONGEST_S = 6.0
CPU_S = 90
"""Processor time of a mutant: one that hangs has been noticed, too [s]."""
TINY = 1e-5
"""Numbers up to this are tolerances: they become a million times larger, since no test should
depend on half of one.
"""
SWAPS: dict[type, type] = {
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.MatMult: ast.Add,
    ast.Pow: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}


class Mutant(NamedTuple):
    """One change: of the `index`-th place of a file."""

    file: str
    index: int
    line: int
    words: str


def number(value: complex) -> complex:
    """Another number."""
    if isinstance(value, int):
        return value + 1
    return 1.0 if value == 0 else value * 1e6 if abs(value) <= TINY else value * 1.5


def mutated(node: ast.AST) -> ast.AST | None:
    """The node changed, or None where there is nothing to change."""
    new = copy.deepcopy(node)
    if isinstance(new, ast.BinOp | ast.BoolOp | ast.AugAssign) and type(new.op) in SWAPS:
        new.op = SWAPS[type(new.op)]()
    elif isinstance(new, ast.Compare) and type(new.ops[0]) in SWAPS:
        new.ops[0] = SWAPS[type(new.ops[0])]()
    elif isinstance(new, ast.UnaryOp) and isinstance(new.op, ast.Not | ast.USub):
        return new.operand
    elif isinstance(new, ast.Constant) and isinstance(new.value, bool):
        new.value = not new.value
    elif isinstance(new, ast.Constant) and isinstance(new.value, int | float):
        new.value = number(new.value)
    else:
        return None
    return new


def walk(node: ast.AST) -> Iterator[tuple[ast.AST, str, int | None, ast.AST]]:
    """Every node below with its parent, the parent's field and the place there; not strings, nor
    what is only for type checkers.
    """
    for field, value in ast.iter_fields(node):
        for i, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if not isinstance(child, ast.AST) or isinstance(child, ast.JoinedStr):
                continue
            if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
                continue
            yield node, field, i, child
            yield from walk(child)


def change(tree: ast.Module, index: int | None) -> list[Mutant]:
    """All mutants of a file; with an index, that one is made in the tree."""
    found: list[Mutant] = []
    for parent, field, i, child in list(walk(tree)):
        new = mutated(child)
        if new is None:
            continue
        if len(found) == index:
            value = getattr(parent, field)
            if i is None:
                setattr(parent, field, new)
            else:
                value[i] = new
            ast.fix_missing_locations(tree)
        found.append(
            Mutant("", len(found), child.lineno, f"{ast.unparse(child)}  ->  {ast.unparse(new)}")
        )
    return found


def mutants_of(room: str) -> list[Mutant]:
    places = [REPOSITORY / "vstestbed" / place for place in room.split("+")]
    files = [
        file
        for place in places
        for file in ([place] if place.is_file() else sorted(place.rglob("*.py")))
    ]
    return [
        m._replace(file=str(f.relative_to(REPOSITORY)))
        for f in files
        for m in change(ast.parse(f.read_text()), None)
    ]


class MutatingFinder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module from its changed tree."""

    def __init__(self, mutant: Mutant):
        self.mutant, self.name = (
            mutant,
            mutant.file.removesuffix(".py").replace("/", ".").removesuffix(".__init__"),
        )

    def find_spec(self, name: str, path: object = None, target: object = None) -> Any:
        if name != self.name:
            return None
        file = REPOSITORY / self.mutant.file
        inside = [str(file.parent)] if file.name == "__init__.py" else None
        return importlib.util.spec_from_file_location(
            name, file, loader=self, submodule_search_locations=inside
        )

    def exec_module(self, module: Any) -> None:
        tree = ast.parse((REPOSITORY / self.mutant.file).read_text())
        change(tree, self.mutant.index)
        exec(compile(tree, str(REPOSITORY / self.mutant.file), "exec"), module.__dict__)


class LineMap:
    """A pytest plugin: which test runs which lines, and for how long."""

    def __init__(self, cov: Any):
        self.cov, self.seconds = cov, {}

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self.cov.switch_context(nodeid)
        self.seconds[nodeid] = time.process_time()

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self.seconds[nodeid] = time.process_time() - self.seconds[nodeid]


def measure_map(tests: list[str]) -> dict[str, Any]:
    """{"seconds": {test: s}, "tests": {file: {line: [test, ...]}}}; lines run at import have no
    test.
    """
    import coverage
    import pytest

    cov = coverage.Coverage(data_file=None, source=[str(REPOSITORY / "vstestbed")], branch=False)
    plugin = LineMap(cov)
    cov.start()
    pytest.main(
        [
            "-m",
            "not study",
            "-q",
            "-p",
            "no:cacheprovider",
            *(str(REPOSITORY / "tests" / t) for t in tests),
        ],
        plugins=[plugin],
    )
    cov.stop()
    data = cov.get_data()
    files = {
        str(Path(f).relative_to(REPOSITORY)): data.contexts_by_lineno(f)
        for f in data.measured_files()
    }
    found = {
        f: {str(n): [t for t in contexts if t] for n, contexts in lines.items()}
        for f, lines in files.items()
    }
    return {"seconds": plugin.seconds, "tests": found}


def tests_for(mutant: Mutant, lines: dict[str, Any]) -> list[str]:
    """The tests that run its line, quick ones first; for a line run at import those that run any
    line of the file.
    """
    seconds, by_line = lines["seconds"], lines["tests"].get(mutant.file, {})
    found = set(by_line.get(str(mutant.line), ())) or {
        t for tests in by_line.values() for t in tests
    }
    own = f"tests/{mutant.file.removeprefix('vstestbed/').rpartition('/')[0]}/"
    return sorted(
        (t for t in found if seconds[t] < LONGEST_S),
        key=lambda t: (not t.startswith(own), seconds[t]),
    )


def start(mutant: Mutant, tests: list[str]) -> int:
    """Run the tests on a mutant in a process of its own, which ends with 0 where they all pass;
    returns its number.
    """
    child = os.fork()
    if child:
        return child
    code = 70
    # Whatever a mutant raises, it has been noticed: the code stays 70.
    with contextlib.suppress(BaseException), Path(os.devnull).open("w") as nothing:
        resource.setrlimit(resource.RLIMIT_CPU, (CPU_S, CPU_S))
        os.dup2(nothing.fileno(), 1)
        os.dup2(nothing.fileno(), 2)
        sys.meta_path.insert(0, MutatingFinder(mutant))
        import pytest

        code = int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", *tests]))
    os._exit(code)


def survivors(mutants: list[Mutant], lines: dict[str, Any], jobs: int) -> Iterator[Mutant]:
    """The mutants that no test notices, `jobs` of them at a time."""
    running: dict[int, Mutant] = {}
    for mutant in [*mutants, *[None] * jobs]:  # at the end, wait for those that still run
        if mutant is not None and not (tests := tests_for(mutant, lines)):
            yield mutant
            continue
        if len(running) == jobs or (mutant is None and running):
            process, status = os.wait()
            done = running.pop(process)
            if status == 0:
                yield done
        if mutant is not None:
            running[start(mutant, tests)] = mutant


def main() -> None:
    """Sample mutants, run them, print survivors and scores."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rooms", nargs="+", default=["laws", "tasks", "vision"])
    parser.add_argument(
        "--tests", nargs="+", default=TESTS, help="folders and files of tests that may notice"
    )
    parser.add_argument("--sample", type=int, default=100, help="mutants of each room; 0: all")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--map", type=Path, default=Path("/tmp/vstestbed_lines.json"))
    asked = parser.parse_args()
    os.chdir(REPOSITORY)
    sys.path.insert(0, str(REPOSITORY))
    if not asked.map.exists():
        child = os.fork()  # in a process of its own: this one must not have imported the package
        if child == 0:
            asked.map.write_text(json.dumps(measure_map(asked.tests)))
            os._exit(0)
        os.waitpid(child, 0)
    lines = json.loads(asked.map.read_text())
    for heavy in (
        "cv2",
        "mujoco",
        "numpy",
        "polars",
        "pydantic",
        "pytest",
        "scipy.spatial",
        "spatialmath",
    ):
        importlib.import_module(heavy)  # shared by all processes
    for room in asked.rooms:
        every = mutants_of(room)
        some = random.Random(asked.seed).sample(every, min(asked.sample or len(every), len(every)))
        count = 0
        for mutant in survivors(some, lines, asked.jobs):
            count += 1
            print(f"  survived  {mutant.file}:{mutant.line}  {mutant.words}", flush=True)
        share = 100 * (1 - count / len(some))
        print(
            (
                f"{room}: {len(some) - count} of {len(some)} noticed ({share:.0f} %),"
                f" of {len(every)} mutants in all"
            ),
            flush=True,
        )


if __name__ == "__main__":
    main()
