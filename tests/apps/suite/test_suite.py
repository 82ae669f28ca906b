"""The suite: what takes part, from which starts, how laws score and rank; laws of one's own."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from vstestbed.apps.suite.suite import (
    NAME,
    SuiteEntry,
    SuiteLaw,
    SuiteTask,
    TaskSuite,
    fingerprint,
    kept_runs,
    law_of_file,
    opened,
    read_suite,
)
from vstestbed.core.errors import ParameterError, PluginError, ScenarioError
from vstestbed.studies.comparison.plan import controllers

LAW = "law: {kind: pbvs, gain: 1.5}\n"
PLAN = """base: [ibvs_book]
set: {detector: {kind: oracle, field_of_view: unlimited}, stop.duration_s: 20}
cases: {gain of the camera: {one: {}, two: {camera.rate_hz: 20}}}
seeds: 3
"""
PLUGIN = """from typing import Literal

import vstestbed as vs


@vs.LAWS.add
@vs.spec
class Resting(vs.LawBase):
    kind: Literal["resting"] = "resting"

    def step(self, state, observation, goal, basis):
        return state, vs.Command.rest(basis, "it rests")


"""
OWN = """description: two laws
laws:
  points: {law: {kind: ibvs, gain: 1.0}}
  line: {law: {kind: line_following}}
tasks: {only: {plan: plan.yaml, asks: little}}
"""
POLICY = """from pathlib import Path

import numpy as np

import gains

WEIGHTS = np.load(Path(__file__).parent / "weights.npy")


def act(observation):
    offset = (observation["goal"] - observation["markers"]).ravel()
    return np.clip(WEIGHTS @ offset * gains.GAIN, -1, 1)
"""


@pytest.fixture
def own(tmp_path: Path) -> str:
    """A suite of one task and two laws, of which one cannot take part."""
    (tmp_path / "plan.yaml").write_text(PLAN)
    (tmp_path / "own.yaml").write_text(OWN)
    (tmp_path / "mine.yaml").write_text(LAW)
    return str(tmp_path / "own.yaml")


def test_the_bundled_suite_is_whole_and_every_law_of_it_takes_part() -> None:
    suite, path = read_suite()
    assert path.stem == NAME and len(suite.laws) == 13 and len(suite.tasks) == 11
    entry = opened(None, quick=True)
    took = {task: list(plan.cases["law"]) for task, plan in entry.plans.items()}
    every = ("arm", "border", "latency", "calibration", "realism")
    assert list(took) == list(suite.tasks) and all(took[task] == list(suite.laws) for task in every)
    without_delay = [law for law in suite.laws if law != "smith"]
    assert took["ideal"] == took["tracking"] == without_delay
    assert (
        took["poster"]
        == took["boxes"]
        == ["points", "points_mean", "polar", "spherical", "pose", "hybrid", "qp", "predictive"]
    )
    assert entry.blank["recurrent", "craft"] == "it was trained for six motions of the camera"
    assert (
        entry.blank["partitioned", "base"].startswith("base.yaml:")
        and "six directions" in entry.blank["partitioned", "base"]
    )
    assert len(entry.blank) == 13 * 11 - sum(map(len, took.values()))
    block = entry.plans["poster"].cases["law"]["points"]["law"]
    there = suite.laws["points"].tasks["poster"]
    assert not isinstance(there, str)
    assert (block["gain"], block["depth"]["kind"]) == (
        there["gain"],
        "sensor",
    )


def test_every_task_has_sixty_starts_and_pictures_or_says_that_it_has_the_oracle() -> None:
    entry = opened(None)
    alone = of_one_law(entry)
    for task, plan in alone.plans.items():
        assert len(alone.jobs(task)) == 60, task
        sees = {one.scenario.detector.kind for one in controllers(plan)}
        by_oracle = sees == {"oracle"}
        assert by_oracle or sees <= {"blobs", "keypoints"}, (task, sees)
        assert by_oracle == ("oracle" in entry.suite.tasks[task].asks), task


def test_the_effort_of_a_suite_is_told_before_it_flies(own: str) -> None:
    entry = opened(None, own)
    assert entry.effort() == "6 runs"  # of a suite without times
    entry.suite.tasks["only"] = replace(entry.suite.tasks["only"], run_s=3600)
    assert (
        entry.effort(jobs=2) == "6 runs, about 6.0 processor hours; here, 2 at a time, about 3.0 h"
    )
    assert (
        entry.effort(3, jobs=2)
        == "2 runs, about 2.0 processor hours; here, 2 at a time, about 1.0 h"
    )


def of_one_law(entry: SuiteEntry) -> SuiteEntry:
    return replace(entry, laws={"points": entry.laws["points"]}, blank={})


def test_a_word_draws_the_random_starts_and_leaves_the_lists() -> None:
    plain, a, b = (of_one_law(opened(None, word=word)).plans for word in (None, "a", "b"))
    assert plain["latency"].first_seed == 0 < a["latency"].first_seed != b["latency"].first_seed
    assert a["latency"].first_seed == a["realism"].first_seed < 2_000_000_000
    assert plain["ideal"].tasks == a["ideal"].tasks


def test_a_law_of_ones_own_is_a_block_or_a_plugin(
    tmp_path: Path, own: str, own_kinds: None
) -> None:
    assert law_of_file(str(tmp_path / "mine.yaml")) == (
        "mine",
        SuiteLaw(law={"kind": "pbvs", "gain": 1.5}),
        (),
    )
    (tmp_path / "resting.py").write_text(PLUGIN)
    name, law, plugins = law_of_file(str(tmp_path / "resting.py"))
    assert (name, law.law, len(plugins)) == ("resting", {"kind": "resting"}, 1)
    (tmp_path / "none.py").write_text("x = 1\n")
    with pytest.raises(PluginError, match="adds no kind"):
        law_of_file(str(tmp_path / "none.py"))
    (tmp_path / "two.py").write_text(
        PLUGIN.replace("esting", "olling")
        + PLUGIN[PLUGIN.index("@vs") :].replace("esting", "unning")
    )
    with pytest.raises(ParameterError, match="must add one law"):
        law_of_file(str(tmp_path / "two.py"))
    (tmp_path / "bad.yaml").write_text("robot: free\n")
    with pytest.raises(ScenarioError, match="law: "):
        law_of_file(str(tmp_path / "bad.yaml"))
    entry = opened(str(tmp_path / "mine.yaml"), own)
    assert list(entry.laws) == ["points", "line", "mine"]
    assert list(opened(str(tmp_path / "mine.yaml"), own, alone=True).laws) == ["mine"]
    with pytest.raises(ParameterError, match="LAW_FILE"):
        opened(None, own, alone=True)
    with pytest.raises(ScenarioError, match="tasks"):
        (tmp_path / "half.yaml").write_text("laws: {}\n")
        read_suite(str(tmp_path / "half.yaml"))


@pytest.mark.process
def test_a_quick_suite_leaves_scores_and_a_page_goes_on_and_knows_itself(
    command, own: str, tmp_path: Path
) -> None:
    words = (
        "suite",
        str(tmp_path / "mine.yaml"),
        "--suite",
        own,
        "--quick",
        "--jobs",
        1,
        "--out",
        "found",
    )
    ended = command(*words)
    assert ended.code == 0, ended.err
    assert (
        "8 runs\n" in ended.err
        and "mean rank" in ended.err
        and "line takes no part in only" in ended.err
    )
    scored = pl.read_csv("found/scores.csv")
    assert (
        scored["law"].to_list() == ["points", "mine"]
        and scored["runs"].to_list() == [4, 4]
        and (scored["reached"] == 4).all()
    )
    page = Path("found/report.html").read_text()
    assert "Without part" in page and "rank 1" in page and "<svg" in page
    assert f"vstestbed suite {tmp_path / 'mine.yaml'} --suite {own} --quick" in page
    assert "points & 2.0 [2.0, 2.0] & 4/4" in Path("found/scores.tex").read_text()
    about = json.loads(Path("found/suite.json").read_text())
    assert about["suite"] == "own" and list(about["laws"]) == ["points", "line", "mine"]
    before = Path("found/scores.csv").read_bytes()
    assert command(*words).code == 0 and Path("found/scores.csv").read_bytes() == before
    other = command("suite", "--suite", own, "--quick", "--out", "found")
    assert other.code == 2 and "holds another suite" in other.err


def test_a_changed_plan_has_another_hash(own: str, tmp_path: Path) -> None:
    first = opened(None, own).about["sha256"]
    (tmp_path / "plan.yaml").write_text(PLAN + "\n")
    assert opened(None, own).about["sha256"] != first
    suite = TaskSuite(
        laws={"p": SuiteLaw(law={"kind": "ibvs"})}, tasks={"t": SuiteTask(plan="plan.yaml")}
    )
    assert SuiteEntry(suite, Path(own), suite.laws).plan("t") is not None


@pytest.mark.process
def test_a_submission_is_checked_by_a_drawn_part_and_a_false_number_is_found(
    command, own: str, tmp_path: Path
) -> None:
    assert (
        command(
            "suite", str(tmp_path / "mine.yaml"), "--suite", own, "--jobs", 1, "--out", "found"
        ).code
        == 0
    )
    ended = command("submit", "found")
    assert ended.code == 0 and Path("found.zip").is_file()
    with zipfile.ZipFile("found.zip") as packed:
        assert sorted(packed.namelist()) == [
            "environment.json",
            "law/mine.yaml",
            "runs.csv",
            "scores.csv",
            "suite.json",
        ]
        inside = {name: packed.read(name) for name in packed.namelist()}
    rows = pl.read_csv(inside["runs.csv"])
    for name, runs, code in (
        ("true.zip", rows, 0),
        ("near.zip", rows.with_columns(value=pl.col("value") * (1 + 1e-6)), 0),
        ("false.zip", rows.with_columns(value=pl.col("value") / 2), 3),
        ("short.zip", rows.filter(pl.col("start") != "one 1"), 2),
    ):
        with zipfile.ZipFile(name, "w") as packed:
            for inner, content in (inside | {"runs.csv": runs.write_csv().encode()}).items():
                packed.writestr(inner, content)
        ended = command(
            "suite", "--check", name, "--suite", own, "--jobs", 1, "--out", f"again_{name}"
        )
        assert ended.code == code, ended.err
        assert ("6 of 6 runs that were flown again agree" in ended.err) == (code == 0)
    (tmp_path / "plan.yaml").write_text(PLAN + "\n")
    ended = command("suite", "--check", "true.zip", "--suite", own, "--out", "later")
    assert ended.code == 2 and "was flown on another" in ended.err
    Path("no.zip").write_bytes(b"PK")
    assert "is no submission" in command("suite", "--check", "no.zip", "--out", "never").err
    assert "own laws alone" in command("submit", _plain_suite(command, own)).err


def _plain_suite(command, own: str) -> str:
    assert command("suite", "--suite", own, "--quick", "--jobs", 1, "--out", "plain").code == 0
    return "plain"


def test_a_law_differs_by_task_or_says_why_it_does_not_fly_one(own: str, tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text(LAW + "tasks: {only: {gain: 0.7}}\n")
    assert opened(str(tmp_path / "mine.yaml"), own).block("mine", "only") == {
        "kind": "pbvs",
        "gain": 0.7,
    }
    (tmp_path / "mine.yaml").write_text(LAW + "tasks: {only: {kind: ibvs}}\n")
    assert opened(str(tmp_path / "mine.yaml"), own).block("mine", "only") == {"kind": "ibvs"}
    (tmp_path / "mine.yaml").write_text(LAW + "tasks: {only: it is tired}\n")
    entry = opened(str(tmp_path / "mine.yaml"), own)
    assert (
        list(entry.plans["only"].cases["law"]) == ["points"]
        and entry.blank["mine", "only"] == "it is tired"
    )
    (tmp_path / "mine.yaml").write_text(LAW + "tasks: {onyl: it is tired}\n")
    with pytest.raises(
        ParameterError, match=r"mine: tasks must be tasks of the suite; .*only.*got 'onyl'"
    ):
        opened(str(tmp_path / "mine.yaml"), own)


def test_a_failure_counts_the_worst_that_a_task_names(own: str) -> None:
    entry = opened(None, own)
    entry.suite.tasks["only"] = SuiteTask(plan="plan.yaml", metric="tracking_rms_m", worst=0.2)
    outcomes = ["completed", "timed_out", "target_lost", "crashed"]
    table = pl.DataFrame(
        {
            "law": list("abcd"),
            "seed": range(4),
            "outcome": outcomes,
            "success": [True, False, False, None],
        }
    )
    table = table.with_columns(pl.Series("tracking_rms_m", [0.01, 0.03, 0.001, None]))
    assert entry.rows_of(table, entry.plans["only"], "only")["value"].to_list() == [
        0.01,
        0.03,
        0.2,
        0.2,
    ]


@pytest.mark.process
def test_shards_of_a_suite_are_put_together_to_what_one_process_leaves(command, own: str) -> None:
    assert command("suite", "--suite", own, "--jobs", 1, "--out", "whole").code == 0
    for i in (1, 2):
        ended = command(
            "suite", "--suite", own, "--jobs", 1, "--shard", f"{i}/2", "--out", f"part{i}"
        )
        assert ended.code == 0 and not Path(f"part{i}/scores.csv").exists(), ended.err
    ended = command(
        "suite", "--suite", own, "--merge", "part1", "--merge", "part2", "--out", "merged"
    )
    assert ended.code == 0, ended.err
    assert Path("merged/runs.csv").read_bytes() == Path("whole/runs.csv").read_bytes()
    assert Path("merged/scores.csv").read_bytes() == Path("whole/scores.csv").read_bytes()


def runs_in(place: str) -> set[Path]:
    """The summaries of finished runs: one that is being written is in a folder that ends with
    .part.
    """
    return {
        path.relative_to(place)
        for path in Path(place).rglob("summary.json")
        if path.parent.suffix != ".part"
    }


@pytest.mark.process
@pytest.mark.parametrize("share", ["", "1/2"])
def test_a_flight_that_is_killed_goes_on_and_ends_as_one_that_was_not(
    command, own: str, tmp_path: Path, share: str
) -> None:
    words = [
        "suite",
        "--suite",
        own,
        "--jobs",
        "1",
        "--quiet",
        *(["--shard", share] if share else []),
    ]
    assert command(*words, "--out", "whole").code == 0
    with subprocess.Popen(
        [sys.executable, "-m", "vstestbed", *words, "--out", "killed"], start_new_session=True
    ) as flight:
        for _ in range(1200):  # a minute: the machine may be busy
            if runs_in("killed"):
                break
            time.sleep(0.05)
        os.killpg(flight.pid, signal.SIGKILL)
    whole, killed = runs_in("whole"), runs_in("killed")
    assert 0 < len(killed) < len(whole) and not Path("killed/runs.csv").exists()
    times = {path: (Path("killed") / path).stat().st_mtime_ns for path in killed}
    assert command(*words, "--out", "killed").code == 0
    # these are not flown again
    assert {path: (Path("killed") / path).stat().st_mtime_ns for path in killed} == times
    assert runs_in("killed") == whole
    if not share:
        assert Path("killed/runs.csv").read_bytes() == Path("whole/runs.csv").read_bytes()


@pytest.mark.process
def test_a_policy_is_handed_in_with_its_weights_and_modules_in_their_folders(
    command, own: str, tmp_path: Path
) -> None:
    inside = tmp_path / "mine" / "net"
    inside.mkdir(parents=True)
    (inside / "act.py").write_text(POLICY)
    (inside / "gains.py").write_text("GAIN = 1.0\n")
    np.save(inside / "weights.npy", np.full((6, 8), 1e-4))
    (tmp_path / "mine" / "net.yaml").write_text('law: {kind: policy, file: "net/act.py:act"}\n')
    ended = command(
        "suite",
        str(tmp_path / "mine" / "net.yaml"),
        "--suite",
        own,
        "--quick",
        "--alone",
        "--jobs",
        1,
        "--out",
        "found",
    )
    assert ended.code == 0, ended.err
    assert command("submit", "found").code == 0
    with zipfile.ZipFile("found.zip") as packed:
        assert {name for name in packed.namelist() if name.startswith("law/")} == {
            "law/net.yaml",
            *(f"law/net/{name}" for name in ("act.py", "gains.py", "weights.npy")),
        }
    again = command(
        "suite", "--check", "found.zip", "--suite", own, "--quick", "--jobs", 1, "--out", "again"
    )
    assert "4 of 4 runs that were flown again agree" in again.err


@pytest.mark.process
def test_beside_a_law_flown_alone_stand_the_kept_runs_of_the_same_starts(
    command, own: str, tmp_path: Path
) -> None:
    assert command("suite", "--suite", own, "--jobs", 1, "--out", "whole").code == 0
    runs = Path("whole/runs.csv").read_text()
    Path(own).with_suffix(".csv").write_text(f"# {fingerprint(*read_suite(own))}\n{runs}")
    words = "suite", str(tmp_path / "mine.yaml"), "--suite", own, "--alone", "--quick", "--jobs", 1
    assert command(*words, "--out", "beside").code == 0
    scored = pl.read_csv("beside/scores.csv")
    # of its quick starts alone
    assert sorted(scored["law"]) == ["mine", "points"] and scored["runs"].to_list() == [4, 4]
    # what is handed in is what was flown
    assert pl.read_csv("beside/runs.csv")["law"].unique().to_list() == ["mine"]
    # other tasks: the kept runs are none of theirs
    (tmp_path / "plan.yaml").write_text(PLAN.replace("20}}", "25}}"))
    assert command(*words, "--out", "alone").code == 0
    assert pl.read_csv("alone/scores.csv")["law"].to_list() == ["mine"]


def test_the_kept_runs_of_vs_1_are_of_its_tasks_and_laws_or_the_page_says_that_they_are_not() -> (
    None
):
    suite, path = read_suite()
    kept = kept_runs(suite, path)
    # not flown again since the tasks have changed: vstestbed suite --out flown; python -m
    # docs.build.suite flown/runs.csv
    if kept is None:
        page = (Path(__file__).parents[3] / "docs" / "research" / "suite.md").read_text(
            encoding="utf-8"
        )
        read = re.sub(r"<!--.*?-->\n?", "", page, flags=re.DOTALL)
        first = path.with_suffix(".csv").read_text(encoding="utf-8")[2:14]
        assert f"former flight, of the files `{first}`" in "\n".join(read.splitlines()[:12])
        return
    entry = opened(None)
    wanted = {(task, law) for task, plan in entry.plans.items() for law in plan.cases["law"]}
    assert (
        set(kept.select("task", "law").unique().iter_rows()) == wanted and len(kept) == entry.total
    )
    assert not kept.select("task", "law", "start").is_duplicated().any()
