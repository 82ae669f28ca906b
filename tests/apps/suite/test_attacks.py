"""Attacks on `suite --check`: submissions that claim what was not flown. None passes, and the
honest one does.

Each attack is an honest submission with one change. The claims of those that bring code are halved
times: they would pass if the code did what it is for.
"""

from __future__ import annotations

import json
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import polars as pl
import pytest

from tests.shortcuts import Here

PLAN = """base: [ibvs_book]
set: {detector: {kind: oracle, field_of_view: unlimited}, stop.duration_s: 20}
seeds: 10
"""
SUITE = """description: two tasks
laws: {points: {law: {kind: ibvs, gain: 1.0}}}
tasks: {only: {plan: plan.yaml, asks: little}, declined: {plan: plan.yaml, asks: as little}}
"""
LAW = "law: {kind: pbvs}\ntasks: {declined: it is tired}\n"
CODED = "plugins: [mine_law.py]\nlaw: {kind: mine}\ntasks: {declined: it is tired}\n"
PLUGIN = '''"""A law by the pose."""

from typing import Literal

import vstestbed as vs

POSE = vs.laws.PBVS()


@vs.LAWS.add
@vs.spec
class Mine(vs.ErrorLaw):
    """Straight to its goal."""

    kind: Literal["mine"] = "mine"
    inputs = ("T_camera_target",)

    def equations(self, view, goal):
        """The error and its Jacobian."""
        return POSE.equations(view, goal)
'''
Files = dict[str, bytes]


def rows(change: Callable[[pl.DataFrame], pl.DataFrame]) -> Callable[[Files], Files]:
    """A submission with other runs."""
    return lambda files: (
        files | {"runs.csv": change(pl.read_csv(files["runs.csv"])).write_csv().encode()}
    )


def more(place: str, text: str) -> Callable[[Files], Files]:
    """A submission with a file more, and runs of half the time."""
    return lambda files: coded(PLUGIN)(files) | {place: text.encode()}


def coded(text: str) -> Callable[[Files], Files]:
    """A submission whose law is a module, and runs of half the time."""
    return lambda files: (
        halved(files) | {"law/mine.yaml": CODED.encode(), "law/mine_law.py": text.encode()}
    )


def with_code(text: str) -> Callable[[Files], Files]:
    """A submission whose law's module runs other code first, and runs of half the time."""
    return coded(f"{text}\n{PLUGIN}")


def in_flight(line: str) -> Callable[[Files], Files]:
    """A submission whose law runs a line at its first picture, and runs of half the time."""
    return coded(PLUGIN.replace("        return POSE", f"        {line}\n        return POSE"))


def about(**changes: Any) -> Callable[[Files], Files]:
    """A submission that says that something else was flown, and runs of half the time."""
    return lambda files: (
        halved(files)
        | {"suite.json": json.dumps(json.loads(files["suite.json"]) | changes).encode()}
    )


def first(table: pl.DataFrame, **values: Any) -> pl.DataFrame:
    """The first run with other values."""
    return pl.concat(
        [
            table.head(1).with_columns(**{k: pl.lit(v, table[k].dtype) for k, v in values.items()}),
            table.tail(-1),
        ]
    )


halved = rows(lambda t: t.with_columns(value=pl.col("value") / 2))
PATCH = "import {module} as patched\npatched.{name} = {value}\n"

CLAIMS: dict[str, Callable[[Files], Files]] = {
    "half of each time": halved,
    "a little less than each time": rows(
        lambda t: t.with_columns(value=pl.col("value") * 0.95 - 0.06)
    ),
    "one run is better": rows(lambda t: first(t, value=1.0)),
    "a success is a failure": rows(lambda t: first(t, success=False, value=20.0)),
    "a run has no number": rows(lambda t: first(t, success=False, value=None)),
    "a start that is easy": rows(
        lambda t: pl.concat([t, t.head(1).with_columns(start=pl.lit(99, pl.Int64), value=0.1)])
    ),
    "a start twice, once better": rows(lambda t: pl.concat([t.head(1).with_columns(value=0.1), t])),
    "the hardest start is left out": rows(lambda t: t.sort("value").head(9)),
    "a task that was declined": rows(
        lambda t: pl.concat([t, t.with_columns(task=pl.lit("declined"), value=0.1)])
    ),
    "other laws, which are worse": rows(
        lambda t: pl.concat([t, t.with_columns(law=pl.lit("points"), value=20.0)])
    ),
    "no runs": rows(lambda t: t.head(0)),
    "numbers below zero": rows(lambda t: t.with_columns(value=-pl.col("value"))),
    "a suite of its own, inside": lambda files: (
        about(suite="law/own.yaml")(files) | {"law/own.yaml": SUITE.encode()}
    ),
    "a suite of its own, beside": lambda files: (
        about(suite="own")(files) | {"own.yaml": SUITE.encode()}
    ),
    "few starts": about(quick=True, starts="the first starts of each list"),
    "a word of its own": about(word="lucky"),
    "another hash": about(sha256="0" * 64),
    "a law's file elsewhere": about(file="../../mine.yaml"),
    "a file above its folder": more("law/../../only/comparison.yaml", PLAN),
}
FILES: dict[str, Callable[[Files], Files]] = {
    "a module of the program": more("vstestbed/__init__.py", "raise SystemExit(0)"),
    "a module of the program beside the law": more(
        "law/vstestbed/__init__.py", "raise SystemExit(0)"
    ),
    "sitecustomize": more("law/sitecustomize.py", "import os\nos._exit(0)"),
    "conftest": more("law/conftest.py", "import os\nos._exit(0)"),
    "json in place of Python's": more("law/json.py", "import os\nos._exit(0)"),
    "numpy in its place": more("law/numpy.py", "import os\nos._exit(0)"),
    "polars in its place": more("law/polars/__init__.py", "import os\nos._exit(0)"),
    "a law that ends the process in flight": in_flight("__import__('os')._exit(0)"),
    "a law that raises in flight": in_flight("raise SystemExit(0)"),
}  # fmt: skip
CODE: dict[str, Callable[[Files], Files]] = {
    "what compares is replaced": with_code(
        PATCH.format(
            module="vstestbed.apps.suite.submission", name="_agrees", value="lambda *words: True"
        )
    ),
    "what draws is replaced": with_code(
        PATCH.format(module="vstestbed.apps.suite.submission", name="draws", value="lambda n: 0")
    ),
    "what flies is replaced": with_code(
        PATCH.format(module="vstestbed.apps.suite.submission", name="LEAST", value="1e9")
    ),
    "summaries are replaced": with_code(
        "from vstestbed.loop.recording import Recording\n"
        "plain = Recording.summary\n"
        "Recording.summary = lambda self:"
        " (found := plain(self)) | {'time_to_goal_s': found['time_to_goal_s'] / 2}\n"
    ),
    "the process is ended": with_code("import os\nos._exit(0)"),
    "exits are replaced": with_code(
        PATCH.format(module="vstestbed.cli.compare", name="NOT_REACHED", value="0")
    ),
}


def zipped(files: Files, path: Path) -> Path:
    with zipfile.ZipFile(path, "w") as packed:
        for name, content in files.items():
            packed.writestr(name, content)
    return path


@pytest.fixture(scope="module")
def handed_in(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    """An honest submission, flown once."""
    from vstestbed.apps.suite.submission import contents, pack
    from vstestbed.apps.suite.suite import opened

    folder = tmp_path_factory.mktemp("honest")
    for name, text in (("plan.yaml", PLAN), ("own.yaml", SUITE), ("mine.yaml", LAW)):
        (folder / name).write_text(text)
    entry = opened(str(folder / "mine.yaml"), str(folder / "own.yaml"), alone=True)
    out = folder / "flown"
    out.mkdir()
    entry.mark(out)
    entry.write(out, entry.fly(out, 1))
    return SimpleNamespace(
        files=contents(pack(out, folder / "honest.zip")), suite=folder / "own.yaml", folder=folder
    )


def started(handed_in: SimpleNamespace, files: Files, folder: Path) -> list[str]:
    """The command that checks a submission of these files."""
    file = zipped(files, folder / "handed_in.zip")
    return [
        "suite",
        "--check",
        str(file),
        "--suite",
        str(handed_in.suite),
        "--jobs",
        "1",
        "--out",
        str(folder / "checked"),
    ]


@pytest.fixture
def flown_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Runs are flown in this process: no worker has to start."""
    monkeypatch.setattr("vstestbed.apps.suite.submission.pool_of", lambda *_: Here())


@pytest.mark.process
@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_the_honest_submission_passes(
    noise: float, handed_in: SimpleNamespace, tmp_path: Path, command: Any, flown_here: None
) -> None:
    """Also with other last digits, as another machine has them."""
    files = rows(lambda t: t.with_columns(value=pl.col("value") * (1 + noise)))(handed_in.files)
    ended = command(*started(handed_in, files, tmp_path))
    assert ended.code == 0, ended.err
    assert "10 of 10 runs that were flown again agree" in ended.err


@pytest.mark.process
@pytest.mark.parametrize("attack", CLAIMS)
def test_no_claim_passes(
    attack: str, handed_in: SimpleNamespace, tmp_path: Path, command: Any, flown_here: None
) -> None:
    ended = command(*started(handed_in, CLAIMS[attack](handed_in.files), tmp_path))
    assert ended.code in (2, 3), ended.err
    assert "10 of 10 runs" not in ended.err


@pytest.mark.process
def test_times_that_are_all_shorter_within_their_tolerance_do_not_pass(
    handed_in: SimpleNamespace, tmp_path: Path, command: Any, flown_here: None
) -> None:
    shaved = rows(lambda t: t.with_columns(value=pl.col("value") * 0.981))(handed_in.files)
    ended = command(*started(handed_in, shaved, tmp_path))
    assert ended.code == 3, ended.err
    assert "10 of 10 runs that were flown again agree" in ended.err
    assert "numbers are better than those flown here in 10 of 10 runs that differ" in ended.err


@pytest.mark.study
@pytest.mark.process
@pytest.mark.parametrize("attack", [*FILES, *CODE])
def test_no_code_passes(
    attack: str, handed_in: SimpleNamespace, tmp_path: Path, vstestbed_process: Any
) -> None:
    """In a process of its own, which code of a submission may end."""
    words, environment = vstestbed_process
    command = [*words, *started(handed_in, (FILES | CODE)[attack](handed_in.files), tmp_path)]
    ended = subprocess.run(
        command,
        env=environment,
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert ended.returncode in (2, 3), ended.stderr
    assert "Traceback" not in ended.stderr and "10 of 10 runs" not in ended.stderr
