"""Submissions to the suite: what is refused before anything is unpacked, which rows are the plan's,
how surely forged ones are found.
"""

from __future__ import annotations

import json
import math
import os
import re
import resource
import struct
import sys
import time
import zipfile
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest

from vstestbed.apps.suite.submission import (
    MOST_TEXT,
    MOST_UNPACKED,
    Asked,
    contents,
    draws,
    pack,
    unpacked,
)
from vstestbed.apps.suite.suite import (
    NAME,
    SuiteEntry,
    SuiteTask,
    TaskSuite,
    fingerprint,
    opened,
    read_suite,
)
from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.loop.isolated import offered
from vstestbed.studies import submission

# Two tasks, both from random starts: the bundled suite's tasks are these and longer ones.
PLAN = """base: [ibvs_book]
set: {detector: {kind: oracle, field_of_view: unlimited}, stop.duration_s: 20}
cases: {gain of the camera: {one: {}, two: {camera.rate_hz: 20}}}
seeds: 3
"""
SUITE = """description: two tasks
laws: {points: {law: {kind: ibvs, gain: 1.0}}}
tasks: {only: {plan: plan.yaml, asks: little}, declined: {plan: plan.yaml, asks: as little}}
"""
LAW = "law: {kind: pbvs, gain: 1.5}\ntasks: {declined: it is tired}\n"
Files = dict[str, bytes]
Rows = list[dict[str, Any]]


def rows_of(suite: Path, law: Path, word: str | None = None) -> Rows:
    """Rows that a law could have: those of the plan, each reached in 5 s."""
    entry = opened(str(law), str(suite), word=word, alone=True)
    return [
        {"task": task, "law": law.stem, "start": start, "success": "true", "value": 5.0}
        for task in entry.plans
        for start in entry.jobs(task)
    ]


def text_of(rows: Rows) -> bytes:
    return pl.DataFrame(rows, infer_schema_length=None).write_csv().encode()


def zipped(files: Files, path: Path, **more: Any) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, **more) as packed:
        for name, content in files.items():
            packed.writestr(name, content)
    return path


@pytest.fixture
def world(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[SimpleNamespace]:
    """A suite, a law of one's own, and the files of its submission,
    of runs that nobody has flown. Its parameter is another plan.
    """
    (tmp_path / "plan.yaml").write_text(getattr(request, "param", PLAN))
    suite = tmp_path / "own.yaml"
    suite.write_text(SUITE)
    law = tmp_path / "mine.yaml"
    law.write_text(LAW)
    rows = rows_of(suite, law)
    about = json.dumps(opened(str(law), str(suite), alone=True).about).encode()
    files: Files = {
        "suite.json": about,
        "runs.csv": text_of(rows),
        "scores.csv": b"law\n",
        "law/mine.yaml": LAW.encode(),
    }
    with offered():
        yield SimpleNamespace(
            folder=tmp_path, suite=suite, law=law, rows=rows, files=files, asked=Asked(str(suite))
        )


# Rows: the plan's, exactly.


def test_the_rows_handed_in_are_those_of_the_plan(world: SimpleNamespace) -> None:
    entry, given = unpacked(
        zipped(world.files, world.folder / "true.zip"), world.folder / "law", world.asked
    )
    assert list(entry.plans) == ["only"]
    assert given.rows() == [("only", "mine", row["start"], True, 5.0) for row in world.rows]
    shuffled = world.files | {"runs.csv": text_of(world.rows[::-1])}
    unpacked(
        zipped(shuffled, world.folder / "other_order.zip"), world.folder / "other", world.asked
    )


def changed(rows: Rows, i: int, **values: Any) -> Rows:
    return [row | values if j == i else row for j, row in enumerate(rows)]


FORGED_ROWS: dict[str, tuple[Callable[[Rows], Rows], str]] = {
    "one left out": (lambda rows: rows[1:], "lacks .'only', 'mine', 'one 0'., of 1 runs"),
    "one double": (lambda rows: [*rows, rows[0]], "there twice"),
    "a better one beside it": (lambda rows: [*rows, rows[0] | {"value": 1.0}], "there twice"),
    "an invented start": (
        lambda rows: [*rows, rows[0] | {"start": "one 99"}],
        "'one 99'.*not of the plan",
    ),
    "a start by another spelling": (lambda rows: changed(rows, 0, start="one 00"), "lacks"),
    "a task that is declined": (
        lambda rows: [*rows, rows[0] | {"task": "declined"}],
        "'declined'.*not of the plan",
    ),
    "a task that is not there": (
        lambda rows: [*rows, rows[0] | {"task": "easy"}],
        "'easy'.*not of the plan",
    ),
    "a law of the suite, worse": (
        lambda rows: [*rows, *(r | {"law": "points", "value": 20.0} for r in rows)],
        "'points'.*not of the plan",
    ),
    "another law's name": (lambda rows: changed(rows, 0, law="Mine"), "lacks"),
    "no rows": (lambda rows: [r | {"task": "easy"} for r in rows][:1], "lacks"),
    "a column more": (lambda rows: [r | {"weight": 1} for r in rows], "has the columns"),
    "columns in another order": (
        lambda rows: [dict(reversed(r.items())) for r in rows],
        "has the columns",
    ),
    "success in other words": (lambda rows: changed(rows, 0, success="yes"), "is no submission"),
    "a number that is none": (
        lambda rows: changed(rows, 0, value="nan "),
        "says success 'true' and value 'nan ' of 'one 0'",
    ),
    "success as a number": (lambda rows: changed(rows, 0, success="1"), "is no submission"),
    "no success": (lambda rows: changed(rows, 0, success=None), "says success None"),
    "a value that is no number": (lambda rows: changed(rows, 0, value=math.nan), "value nan"),
    "an endless value": (lambda rows: changed(rows, 0, value=-math.inf), "value -inf"),
    "a value in words": (lambda rows: [r | {"value": "fast"} for r in rows], "is no submission"),
    "reached, without a value": (lambda rows: changed(rows, 0, value=None), "value None"),
    "a time before the start": (lambda rows: changed(rows, 0, value=-1e6), "value -1000000"),
    "a little before the start": (lambda rows: changed(rows, 0, value=-0.001), "value -0.001"),
    "reached after the limit": (lambda rows: changed(rows, 0, value=21.0), "value 21.0"),
    "a failure that is quick": (
        lambda rows: changed(rows, 0, success="false"),
        "success False and value 5.0",
    ),
    "a failure a little before the limit": (
        lambda rows: changed(rows, 0, success="false", value=19.9),
        "success False and value 19.9",
    ),
    "a failure after it": (
        lambda rows: changed(rows, 0, success="false", value=20.1),
        "success False and value 20.1",
    ),
}


@pytest.mark.parametrize("kind", FORGED_ROWS)
def test_other_rows_are_refused_by_what_is_wrong_with_them(
    kind: str, world: SimpleNamespace
) -> None:
    forge, words = FORGED_ROWS[kind]
    file = zipped(
        world.files | {"runs.csv": text_of(forge(world.rows))}, world.folder / "false.zip"
    )
    with pytest.raises(RunFolderError, match=words) as refused:
        unpacked(file, world.folder / "law", world.asked)
    assert str(refused.value).startswith(f"{file}: is no submission (")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["POINTS", "po\u0456nts", "my law", "mine\u200b"])
def test_a_law_has_a_name_that_looks_like_no_other_in_the_tables(
    name: str, world: SimpleNamespace
) -> None:
    law = world.law.rename(world.folder / f"{name}.yaml")
    with pytest.raises(
        ParameterError, match=r"must have a name of the letters A to Z|a law of the suite"
    ):
        opened(str(law), str(world.suite))


@pytest.mark.process
def test_no_law_that_is_judged_takes_its_depths_from_the_truth(world: SimpleNamespace) -> None:
    """The ideal camera's detector knows the truth, so that a scenario may; a law of one's own in
    the suite may not.
    """
    world.law.write_text("law: {kind: ibvs, depth: oracle}\n")
    for apart in (False, True):
        entry = opened(str(world.law), str(world.suite), alone=True, apart=apart)
        with offered():
            assert not entry.plans
        assert all(
            "may not be oracle, the truth, for a law that is judged" in why
            for why in entry.blank.values()
        ), entry.blank
    world.suite.write_text(SUITE.replace("gain: 1.0", "gain: 1.0, depth: oracle"))
    assert opened(None, str(world.suite)).plans


def test_a_result_is_one_that_a_run_of_the_task_can_have(world: SimpleNamespace) -> None:
    """By what the task asks for: (success, number) of what can be, and of what cannot."""
    entry = opened(str(world.law), str(world.suite), alone=True)
    flown = next(iter(entry.jobs("only").values())).controller.scenario
    last = 20 + flown.camera.period
    cases: list[tuple[dict[str, Any], list[tuple[bool, Any]], list[tuple[bool, Any]]]] = [
        (
            {},
            # a run may end with the picture behind its limit; one that crashed has the longest
            [(True, 0.0), (True, last), (False, 20 * (1 + 1e-6)), (False, 30.0)],
            [
                (True, -1e-9),
                (False, math.inf),
                (False, math.nan),
                (True, last + 0.01),
                (False, 19.99),
                (False, 25.0),
                (False, None),
            ],
        ),
        (
            {"worst": 50.0},
            [(True, 20.0), (False, 20.0), (False, 50.0)],
            [(True, 21.0), (False, 30.0), (False, 49.0)],
        ),
        (
            {"metric": "tracking_rms_m", "worst": 0.2},
            [(True, 0.2), (False, 0.2), (False, 0.0115)],  # the last has timed out
            [(True, 0.201), (False, 0.201), (True, -0.01), (False, -0.01), (False, None)],
        ),
        (
            {"metric": "max_retreat_m"},
            [(True, 1e3), (False, None), (False, 0.0)],
            [(True, -0.01), (True, None), (False, math.inf)],
        ),
        (
            {"metric": "saturated_fraction"},  # in per cent
            [(True, 100.0), (False, 0.0)],
            [(True, 100.1), (False, -1.0)],
        ),
        ({"metric": "min_border_margin_px"}, [(True, -9.0), (False, 9.0)], [(True, math.nan)]),
        ({"metric": "time_to_converge_s"}, [(True, 20.0)], [(True, 21.0), (True, -1.0)]),
        ({"metric": "wall_time_s"}, [(True, 2000.0)], [(True, -1.0)]),
        ({"metric": "a_metric_of_a_plugin"}, [(True, -5.0)], [(True, math.nan)]),
    ]
    for asked, right, wrong in cases:
        task = SuiteTask(plan="plan.yaml", **asked)
        found = [submission._can_be(*one, task, flown, 30.0) for one in (*right, *wrong)]
        assert found == [True] * len(right) + [False] * len(wrong), asked


def test_a_run_that_crashed_has_the_tasks_limit_and_no_run_lacks_its_number(
    world: SimpleNamespace,
) -> None:
    for value in (None, 20.0):
        crashed = world.files | {
            "runs.csv": text_of(changed(world.rows, 0, success="false", value=value))
        }
        with (
            pytest.raises(RunFolderError, match="success False and value None")
            if value is None
            else nullcontext()
        ):
            unpacked(
                zipped(crashed, world.folder / "crashed.zip"), world.folder / "law", world.asked
            )


def test_starts_have_the_names_by_which_the_kept_runs_have_them() -> None:
    suite, path = read_suite()
    laws, kept = (
        {"pose": suite.laws["pose"]},
        pl.read_csv(
            path.with_suffix(".csv"), comment_prefix="#", schema_overrides={"start": pl.String}
        ),
    )
    # a list of starts, and random ones of several cases
    tasks = {task: suite.tasks[task] for task in ("ideal", "latency")}
    entry = SuiteEntry(TaskSuite(laws=laws, tasks=tasks), path, laws)
    for task in tasks:
        of_one = kept.filter((pl.col("task") == task) & (pl.col("law") == "pose"))[
            "start"
        ].to_list()
        there = set(of_one)  # a former flight has fewer starts
        assert (
            len(there) >= 30 and [start for start in entry.jobs(task) if start in there] == of_one
        )


# What was flown: said by who checks it, and by the archive repeated.


def test_a_submission_to_an_older_vs_1_is_refused_by_its_hash_and_told_what_to_do(
    world: SimpleNamespace,
) -> None:
    """A law that was flown on the first VS-1, which is no more."""
    first = "32187406c2dcfa5d8b3624e636a6a38b795e2b49b7786ac0a6952887f2ad15e0"
    now = fingerprint(*read_suite(NAME))
    assert now != first
    older = world.files | {
        "suite.json": json.dumps({"suite": NAME, "sha256": first, "file": "mine.yaml"}).encode()
    }
    with pytest.raises(RunFolderError) as refused:
        unpacked(zipped(older, world.folder / "older.zip"), world.folder / "law")
    assert str(refused.value).endswith(
        f"older.zip: was flown on another VS-1, of the files '32187406c2dc' and not '{now[:12]}';"
        " fly the law again: `vstestbed suite LAW_FILE --alone --out DIR`,"
        " then `vstestbed submit DIR`"
    )
    assert not (world.folder / "law").exists()  # nothing of it is unpacked


def test_the_archive_decides_neither_suite_nor_starts(world: SimpleNamespace) -> None:
    about = json.loads(world.files["suite.json"])
    kept = {"easy.yaml": SUITE.encode(), "law/own.yaml": SUITE.encode()}
    for change, asked, words in (
        (
            {"suite": str(world.suite)},
            world.asked,
            "'suite' in its suite.json is not what is asked for, 'own'",
        ),
        ({"quick": True}, world.asked, "'quick' in its suite.json"),
        ({"word": "lucky"}, world.asked, "'word' in its suite.json"),
        ({"starts": "all starts, twice"}, world.asked, "'starts' in its suite.json"),
        ({"more": 1}, world.asked, "'more' in its suite.json"),
        ({"sha256": "0" * 64}, world.asked, "own.yaml, of the files '000000000000' and not '"),
        ({"file": "none.yaml"}, world.asked, "names no file of a law"),
        ({"file": "../own.yaml"}, world.asked, "names no file of a law"),
        ({"file": ["mine.yaml"]}, world.asked, "names no file of a law"),
        ({}, Asked(), "was flown on another VS-1, of the files"),
        (
            {},
            Asked(str(world.suite), word="judge"),
            "'starts' in its suite.json is not what is asked for",
        ),
        (
            {},
            Asked(str(world.suite), quick=True),
            "'starts' in its suite.json is not what is asked for",
        ),
    ):
        file = zipped(
            world.files | {"suite.json": json.dumps(about | change).encode()},
            world.folder / "other.zip",
        )
        with pytest.raises(RunFolderError, match=re.escape(words)):
            unpacked(file, world.folder / "law", asked)
    for name, content in kept.items():
        if not name.startswith("law/"):
            with pytest.raises(RunFolderError, match="is no file of one"):
                contents(zipped(world.files | {name: content}, world.folder / "with_suite.zip"))


def test_a_file_in_the_current_folder_does_not_take_the_name_of_a_bundled_suite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("VS-1").write_text(SUITE)
    assert len(read_suite("VS-1")[0].tasks) == 11


# Drawing: with 95 % one of a tenth of forged rows is among those that are flown.


def test_a_tenth_of_forged_rows_is_drawn_with_95_percent_and_no_run_more_is_flown() -> None:
    from scipy.stats import hypergeom

    for n in (*range(1, 60), 70, 100, 299):  # 70: a tenth of it in floating point is above 7
        forged, k = -(-n // 10), draws(n)
        missed = hypergeom.pmf(0, n, forged, k)
        assert missed <= 0.05 + 1e-12  # the survival function's own rounding
        assert k == 1 or hypergeom.pmf(0, n, forged, k - 1) > 0.05 - 1e-12
    assert [draws(n) for n in (1, 10, 20, 30, 44, 50, 100)] == [1, 10, 16, 19, 19, 22, 25]


@pytest.mark.parametrize("n", [20, 30, 44, 50])
def test_forged_rows_are_among_those_drawn_as_often_as_is_said(n: int) -> None:
    rng, times = np.random.default_rng(7), 4000
    forged = np.arange(-(-n // 10))
    found = sum(
        bool(np.isin(rng.choice(n, draws(n), replace=False), forged).any()) for _ in range(times)
    )
    # three standard deviations of the simulation
    assert found / times > 0.95 - 3 * math.sqrt(0.05 * 0.95 / times)


@pytest.fixture
def flown(world: SimpleNamespace, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Runs need not be flown: the plan's have the rows that the honest submission says."""
    truth = {row["start"]: row for row in world.rows}

    def table(folder: Path, drawn: list[Any], jobs: int | None) -> pl.DataFrame:
        found = []
        for job in drawn:
            case = job.controller.values["gain of the camera"]
            row = truth[f"{case} {job.seed}"]
            ended = {
                "outcome": "converged",
                "success": row["success"] == "true",
                "time_to_goal_s": row["value"],
            }
            found.append({"law": "mine", "gain of the camera": case, "seed": job.seed} | ended)
        return pl.DataFrame(found)

    monkeypatch.setattr(submission, "_flown", table)
    return world


def checked(world: SimpleNamespace, rows: Rows, seed: int) -> tuple[str, ...]:
    file = zipped(world.files | {"runs.csv": text_of(rows)}, world.folder / "handed_in.zip")
    return submission.check(file, world.folder / "checked", 1, seed, world.asked).otherwise


@pytest.mark.parametrize("noise", [0.0, 1e-6])
def test_an_honest_submission_agrees_also_with_other_last_digits(
    noise: float, flown: SimpleNamespace
) -> None:
    rng = np.random.default_rng(3)
    rows = [
        row | {"value": row["value"] * (1 + noise * rng.standard_normal())} for row in flown.rows
    ]
    assert checked(flown, rows, 0) == ()


@pytest.mark.parametrize(
    "forged",
    [{"success": "false", "value": 20.0}, {"value": 4.8}, {"value": 0.0}],
    ids=lambda forged: ",".join(forged),
)  # fmt: skip
def test_a_forged_run_that_is_drawn_is_named(
    forged: dict[str, Any], flown: SimpleNamespace
) -> None:
    # six runs, of which one forged is a tenth: all are flown
    (words,) = checked(flown, changed(flown.rows, 2, **forged), 0)
    assert (
        words.startswith(f"only {flown.rows[2]['start']}: handed in ")
        and "flown again reached (5.0)" in words
    )


MANY = PLAN.replace("seeds: 3", "seeds: 15")  # 30 runs, of which 19 are drawn


@pytest.mark.parametrize("world", [MANY], indirect=True)
def test_numbers_that_are_all_a_little_better_are_no_chance(flown: SimpleNamespace) -> None:
    """Each agrees within its own tolerance. What flatters is found however it is spread: in most
    runs, or much in one half and next to nothing back in the other.
    """
    rng = np.random.default_rng(5)
    shares: dict[str, np.ndarray] = {
        "all": np.full(30, 0.019),
        "all, hardly": np.full(30, 1e-4),
        "all but four": np.where(np.arange(30) < 4, -0.019, 0.019),
        "half, and hardly back": np.where(rng.permutation(30) < 15, 0.019, -1e-5),
        "none": np.zeros(30),
        "last digits": 1e-6 * rng.standard_normal(30),
        "either sign": rng.uniform(-0.019, 0.019, 30),
        "worse": np.full(30, -0.019),
        "in three": np.where(np.arange(30) < 3, 0.019, 0.0),
    }
    found = dict[str, str]()
    for name, share in shares.items():
        rows = [
            row | {"value": row["value"] * (1 - one)}
            for row, one in zip(flown.rows, share.tolist(), strict=True)
        ]
        file = zipped(flown.files | {"runs.csv": text_of(rows)}, flown.folder / "handed_in.zip")
        done = submission.check(file, flown.folder / "checked", 1, 0, flown.asked)
        assert done.runs == 19 and not done.otherwise, name
        found[name] = " ".join(done.flattering)
    assert [name for name, words in found.items() if words] == list(shares)[:4]
    assert found["all"].startswith(
        "its numbers are better than those flown here in 19 of 19 runs that differ,"
        " by 1.9% of their mean, which chance does not do: p = "
    )


def test_gains_are_those_of_the_metric_and_each_task_is_asked_by_itself() -> None:
    both = pl.DataFrame({"value": [1.0, 2.0, None, 3.0], "value_again": [1.1, 1.9, None, 3.0]})
    less, more = submission._gains(both, more=False), submission._gains(both, more=True)
    assert less == pytest.approx(np.array([[0.1 / 1.1, 0.1 / 2], [-0.05, -0.1 / 2]]))
    assert (more == -less).all()
    # 20 other tasks do not hide one, nor does one that is found by chance tell anything
    quiet = {f"quiet {i}": np.tile([[0.01], [-0.01]], (10, 2)) for i in range(20)}
    (words,) = submission._flattering(quiet | {"loud": np.full((13, 2), 0.001)})
    assert words.startswith("loud: its numbers are better than those flown here in 13 of 13 runs")
    assert not list(submission._flattering(quiet | {"a little": np.full((8, 2), 0.001)}))
    assert not list(submission._flattering({"none": np.empty((0, 2))}))
    assert not list(submission._flattering({}))


@pytest.mark.parametrize("long", [10.0, 4.0])
def test_much_off_long_runs_and_as_much_put_on_short_ones_is_seen_in_the_mean(long: float) -> None:
    """By shares they are even; by the mean, which the score is made of, they are better."""
    again = np.tile([long, 1.0], 20)
    given = again * np.tile([1 - 0.019, 1 + 0.019], 20)
    both = pl.DataFrame({"value": given, "value_again": again})
    assert len(list(submission._flattering({"only": submission._gains(both, more=False)}))) == 1
    honest = again * (1 + 0.019 * np.random.default_rng(2).uniform(-1, 1, 40))
    both = pl.DataFrame({"value": honest, "value_again": again})
    assert not list(submission._flattering({"only": submission._gains(both, more=False)}))


def test_chance_is_the_exact_sign_test_of_equal_gains_and_counts_sizes() -> None:
    from scipy.stats import binomtest

    for better, n in ((7, 7), (9, 12), (6, 12), (0, 5)):
        gains = [0.01] * better + [-0.01] * (n - better)
        exact = binomtest(better, n, alternative="greater").pvalue
        assert submission.chance(gains) == pytest.approx(exact)
    many = [0.01] * 60 + [-0.01] * 40
    exact = binomtest(60, 100, alternative="greater").pvalue  # 0.028; of 10,000 drawn
    assert submission.chance(many) == pytest.approx(exact, abs=0.006)
    assert submission.chance([0.01] * 100) == 1 / 10_001
    assert submission.chance([0.02] * 7 + [-1e-5] * 7) == pytest.approx(2**-7)
    assert submission.chance([]) == 1.0


def test_a_run_of_which_nothing_is_left_here_is_otherwise(
    flown: SimpleNamespace, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = submission._flown
    monkeypatch.setattr(submission, "_flown", lambda *words: table(*words).head(5))
    assert [words.endswith("left no run") for words in checked(flown, flown.rows, 0)] == [True]


def test_distances_have_no_tolerance_of_a_time() -> None:
    """A tracking distance is of some millimetres: the 0.05 of times, in metres, would pass any."""
    row = {"success": True, "success_again": True, "value": 0.001, "value_again": 0.03}
    assert not submission._agrees(row, 0.0)
    assert submission._agrees(row | {"value": 0.03 * (1 + 1e-6)}, 0.0)


# Archives: one sentence each, before anything is unpacked.


def member(name: str, content: bytes = b"1", **fields: Any) -> Callable[[zipfile.ZipFile], None]:
    def write(packed: zipfile.ZipFile) -> None:
        info = zipfile.ZipInfo(name)
        info.compress_type = fields.get("compress_type", zipfile.ZIP_STORED)
        info.external_attr = fields.get("mode", 0o100644) << 16
        packed.writestr(info, content)

    return write


MEMBERS: dict[str, tuple[Callable[[zipfile.ZipFile], object], str]] = {
    "above its folder": (member("law/../../gone.py"), "is no file of one"),
    "absolute": (member("/law/x.py"), "is no file of one"),
    "a drive": (member("C:/law/x.py"), "is no file of one"),
    "a drive inside": (member("law/C:x.py"), "is no file of one"),
    "backslashes": (member("law\\x.py"), "is no file of one"),
    "backslashes inside": (member("law/..\\x.py"), "is no file of one"),
    "an empty part": (member("law//x.py"), "is no file of one"),
    "a part of one dot": (member("law/./x.py"), "is no file of one"),
    "a folder": (member("law/net/", b""), "is no file of one"),
    "a hidden file": (member("law/.git/config"), "is no file of one"),
    "a device": (member("law/aux.py"), "is no file of one"),
    "a name with a dot at its end": (member("law/x.py."), "is no file of one"),
    "a control character": (member("law/x\n.py"), "is no file of one"),
    "letters that turn the others round": (member("law/\u202eyp.x"), "is no file of one"),
    "a letter in two parts": (member("law/e\u0301.py"), "is no file of one"),
    "a long name": (member("law/" + "x" * 151), "is no file of one"),
    "beside the law": (member("conftest.py"), "is no file of one"),
    "a module of this program": (member("vstestbed/apps/suite/submission.py"), "is no file of one"),
    "twice": (member("law/mine.yaml"), "holds 'law/mine.yaml' twice"),
    "twice in other letters": (member("law/MINE.yaml"), "holds 'law/mine.yaml' twice"),
    "twice in other forms": (member("law/ｍine.yaml"), "holds 'law/mine.yaml' twice"),
    "a file as a folder": (member("law/mine.yaml/x.py"), "holds 'law/mine.yaml' twice"),
    "a link": (member("law/x.py", b"/etc/passwd", mode=0o120777), "is a link"),
    "a pipe": (member("law/x.py", mode=0o010644), "is a link"),
    "another compression": (member("law/x.py", compress_type=zipfile.ZIP_BZIP2), "packed in a way"),
    "a large record": (
        member("environment.json", bytes(MOST_TEXT + 1), compress_type=zipfile.ZIP_DEFLATED),
        "at most 1 are read",
    ),
    "a bomb": (
        member("law/x.npy", bytes(MOST_UNPACKED), compress_type=zipfile.ZIP_DEFLATED),
        "128 MiB are unpacked",
    ),
    "very many": (
        lambda packed: [member(f"law/{i}")(packed) for i in range(1001)],
        "has 1005 files",
    ),
}


@pytest.mark.parametrize("kind", MEMBERS)
def test_members_that_no_submission_has_are_refused(kind: str, world: SimpleNamespace) -> None:
    write, words = MEMBERS[kind]
    file = zipped(world.files, world.folder / "false.zip")
    with (
        zipfile.ZipFile(file, "a") as packed,
        pytest.warns(UserWarning) if kind == "twice" else nullcontext(),
    ):
        write(packed)
    with pytest.raises(RunFolderError, match=words):
        unpacked(file, world.folder / "law", world.asked)
    assert not (world.folder / "law").exists()


def patched(content: bytes, where: bytes, at: int, value: bytes) -> bytes:
    """Bytes put over the last record of an archive that begins as `where`."""
    start = content.rindex(where) + at
    return content[:start] + value + content[start + len(value) :]


def hidden(content: bytes) -> bytes:
    """An archive whose last entry but one says that the last one is its comment."""
    last = content.rindex(b"PK\1\2")
    before = content[:last]
    length = struct.pack("<H", len(content) - 22 - last)
    return patched(before, b"PK\1\2", 32, length) + content[last:]


BYTES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "nothing": (lambda b: b"", "no plain zip"),
    "two letters": (lambda b: b"PK", "no plain zip"),
    "no archive": (lambda b: b"submission" * 100, "no plain zip"),
    "something before": (lambda b: b"#!/bin/sh\n" + b, "no plain zip"),
    "something behind": (lambda b: b + b"\0", "no plain zip"),
    "cut": (lambda b: b[:-30], "no plain zip"),
    "a part lost": (lambda b: b[:40] + b[60:], "no plain zip"),
    "an empty archive": (lambda b: b"PK\5\6" + bytes(18), "no plain zip"),
    "two archives": (lambda b: b + b, "no plain zip"),
    "a record of larger archives": (
        lambda b: b[:-22] + b"PK\6\7" + bytes(16) + b[-22:],
        "no plain zip",
    ),
    "encrypted": (lambda b: patched(b, b"PK\1\2", 8, b"\1\0"), "is a link, encrypted"),
    "strong encryption": (lambda b: patched(b, b"PK\1\2", 8, b"\x40\0"), "is a link, encrypted"),
    "members hidden in a comment": (hidden, "it has 3 files and counts 4"),
    "an unknown compression": (lambda b: patched(b, b"PK\1\2", 10, b"\x63\0"), "packed in a way"),
    "a size that lies": (lambda b: patched(b, b"PK\1\2", 24, struct.pack("<I", 7)), "Bad CRC-32"),
    "a size of 4 GiB": (
        lambda b: patched(b, b"PK\1\2", 24, b"\xfe\xff\xff\xff"),
        "128 MiB are unpacked",
    ),
    "a wrong sum": (lambda b: patched(b, b"PK\1\2", 16, b"1234"), "Bad CRC-32"),
    "another name at its place": (lambda b: patched(b, b"PK\3\4", 30, b"low/"), "differ"),
    "a name with a zero": (
        lambda b: b.replace(b"law/mine.yaml", b"law/min\0.yaml"),
        "is no file of one|is a link",
    ),
}


@pytest.mark.parametrize("kind", BYTES)
def test_bytes_that_are_no_plain_archive_are_refused(kind: str, world: SimpleNamespace) -> None:
    change, words = BYTES[kind]
    file = world.folder / "false.zip"
    file.write_bytes(change(zipped(world.files, file).read_bytes()))
    with pytest.raises(RunFolderError, match=words) as refused:
        unpacked(file, world.folder / "law", world.asked)
    assert str(refused.value).startswith(f"{file}: is no submission (")


def test_what_is_no_regular_file_of_a_size_to_be_read_is_refused_and_waits_for_nothing(
    tmp_path: Path,
) -> None:
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.zip")
        with pytest.raises(RunFolderError, match="not a regular file"):
            contents(tmp_path / "pipe.zip")
    with pytest.raises(RunFolderError, match="not a regular file"):
        contents(tmp_path)
    with pytest.raises(RunFolderError, match="is no submission"):
        contents(tmp_path / "none.zip")
    with (tmp_path / "large.zip").open("wb") as large:
        large.truncate((64 << 20) + 1)
    with pytest.raises(RunFolderError, match="at most 64 are read"):
        contents(tmp_path / "large.zip")


CONTENTS: dict[str, tuple[Files, str]] = {
    "deep JSON": ({"suite.json": b"[" * 100_000}, "nested too deeply"),
    "JSON that is deep and closed": (
        {"suite.json": b'{"file":' * 400 + b"1" + b"}" * 400},
        "names no file of a law",
    ),
    "JSON of other letters": ({"suite.json": b'{"file": "\xff"}'}, "utf-8"),
    "JSON of a list": ({"suite.json": b"[1, 2]"}, "names no file of a law"),
    "no JSON": ({"suite.json": b""}, "is no submission"),
    "a table of other letters": (
        {"runs.csv": b"task,law,start,success,value\n\xff,b,c,true,1\n"},
        "is no submission",
    ),
    "a table with ragged rows": (
        {"runs.csv": b"task,law,start,success,value\na,b,c,true,1,2,3\n"},
        "is no submission",
    ),
    "a table of nothing": ({"runs.csv": b""}, "is no submission"),
    "a table of new lines": (
        {"runs.csv": b"task,law,start,success,value" + b"\n" * 1_000_000},
        "lacks",
    ),
    "a huge table": (
        {"runs.csv": b"task,law,start,success,value\n" + b"a,b,c,true,1\n" * 200_000},
        "at most 1 are read",
    ),
    "a law that is an archive": (
        {"law/mine.yaml": b"", "law/mine.zip": b"PK"},
        "a law's file needs law|is no submission|mine.yaml",
    ),
}


@pytest.mark.parametrize("kind", CONTENTS)
def test_contents_that_are_none_of_a_submission_are_refused(
    kind: str, world: SimpleNamespace
) -> None:
    from vstestbed.core.errors import VstestbedError

    files, words = CONTENTS[kind]
    with pytest.raises(VstestbedError, match=words):
        unpacked(
            zipped(world.files | files, world.folder / "false.zip"),
            world.folder / "law",
            world.asked,
        )


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """An archive with one to four mistakes: bytes changed, lost, doubled, or put over one of its
    records.
    """
    for _ in range(rng.integers(1, 5)):
        i, j = sorted(rng.integers(0, max(len(content), 1), 2).tolist())
        kind, noise = rng.integers(6), rng.bytes(int(rng.integers(1, 9)))
        if kind == 0:
            content = content[:i] + noise + content[i + len(noise) :]
        elif kind == 1:
            content = content[:i] + content[j:]
        elif kind == 2:
            content = content[:j] + content[i:]
        else:  # in a record, where the fields are
            records = [
                found.start() for found in re.finditer(rb"PK(\x01\x02|\x03\x04|\x05\x06)", content)
            ] or [0]
            at = records[rng.integers(len(records))] + int(rng.integers(4, 46))
            content = (
                content[:at] + noise[: 1 + kind % 4] + content[at + len(noise[: 1 + kind % 4]) :]
            )
    return content


def _sweep(world: SimpleNamespace, times: int) -> None:
    whole, file = zipped(world.files, world.folder / "m.zip").read_bytes(), world.folder / "m.zip"
    before, refused = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, 0
    for i in range(times):
        file.write_bytes(mutated(whole, np.random.default_rng(i)))
        start = time.monotonic()
        try:
            found = contents(file)
        except RunFolderError as error:
            refused += 1
            assert str(error).startswith(f"{file}: is no submission (") and "\n" not in str(
                error
            ), i
        else:
            assert found == world.files, i  # what is unpacked nevertheless is what was packed
        assert time.monotonic() - start < 2, i
    assert refused > 0.8 * times
    unit = 1 if sys.platform == "darwin" else 1024
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * unit < 1 << 30


def test_sixty_mutated_archives_are_a_sentence_each(world: SimpleNamespace) -> None:
    _sweep(world, 60)


@pytest.mark.study
def test_five_hundred_mutated_archives_are_a_sentence_each(world: SimpleNamespace) -> None:
    _sweep(world, 500)


def test_a_bomb_whose_stated_size_is_small_is_not_unpacked(world: SimpleNamespace) -> None:
    """200 MiB of zeros that say that they are seven bytes: what is unpacked is bounded by what is
    said.
    """
    import tracemalloc

    file = zipped(world.files | {"law/x.npy": bytes(200 << 20)}, world.folder / "bomb.zip")
    content = file.read_bytes()
    file.write_bytes(patched(content, b"PK\1\2", 24, struct.pack("<I", 7)))
    tracemalloc.start()
    with pytest.raises(RunFolderError, match="Bad CRC-32"):
        contents(file)
    assert tracemalloc.get_traced_memory()[1] < 8 << 20  # the packed 200 kB, and buffers
    tracemalloc.stop()


# What `submit` packs.


def test_what_is_packed_is_the_law_alone_and_can_be_checked(world: SimpleNamespace) -> None:
    """Flown beside the suite's own laws, whose rows are none of the submission's."""
    folder = world.folder / "found"
    (folder / "law").mkdir(parents=True)
    (folder / "law" / "mine.yaml").write_text(LAW)
    (folder / "suite.json").write_text(json.dumps(opened(str(world.law), str(world.suite)).about))
    (folder / "runs.csv").write_bytes(
        text_of([*({**r, "law": "points"} for r in world.rows), *world.rows])
    )
    (folder / "scores.csv").write_text("law\n")
    file = pack(folder, world.folder / "found.zip")
    assert sorted(contents(file)) == [
        "environment.json",
        "law/mine.yaml",
        "runs.csv",
        "scores.csv",
        "suite.json",
    ]
    assert unpacked(file, world.folder / "again", world.asked)[1].height == len(world.rows)
    (folder / "law" / "aux.py").write_text("")
    with pytest.raises(RunFolderError, match=r"'law/aux.py' is no file of one"):
        pack(folder, world.folder / "device.zip")
    assert not (world.folder / "device.zip").exists()
