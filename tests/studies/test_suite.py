"""The suite: what takes part, from which starts, how laws score and rank; laws of one's own."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from vstestbed.core.errors import ParameterError, PluginError, ScenarioError
from vstestbed.studies.suite import NAME, SuiteEntry, SuiteTask, TaskSuite, law_of_file, opened, overall, read_suite, scores

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
  points: {kind: ibvs, gain: 1.0}
  line: {kind: line_following}
tasks: {only: {plan: plan.yaml, asks: little}}
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
    assert path.stem == NAME and len(suite.laws) == 9 and list(suite.tasks) == ["ideal", "arm", "latency", "calibration", "realism"]
    entry = opened(None, quick=True)
    assert {task: len(plan.cases["law"]) for task, plan in entry.plans.items()} == dict.fromkeys(suite.tasks, 9)
    assert not entry.blank and entry.total == 324
    assert [opened(None).total, opened(None, word="a").total] == [1566, 1566]


def test_a_word_draws_the_random_starts_and_leaves_the_lists() -> None:
    plain, a, b = (opened(None, word=word).plans for word in (None, "a", "b"))
    assert plain["latency"].first_seed == 0 < a["latency"].first_seed != b["latency"].first_seed
    assert a["latency"].first_seed == opened(None, word="a").plans["realism"].first_seed < 2_000_000_000
    assert plain["ideal"].tasks == a["ideal"].tasks


def test_a_law_of_ones_own_is_a_block_or_a_plugin(tmp_path: Path, own: str, own_kinds: None) -> None:
    assert law_of_file(str(tmp_path / "mine.yaml")) == ("mine", {"kind": "pbvs", "gain": 1.5}, ())
    (tmp_path / "resting.py").write_text(PLUGIN)
    name, block, plugins = law_of_file(str(tmp_path / "resting.py"))
    assert (name, block, len(plugins)) == ("resting", {"kind": "resting"}, 1)
    (tmp_path / "none.py").write_text("x = 1\n")
    with pytest.raises(PluginError, match="adds no kind"):
        law_of_file(str(tmp_path / "none.py"))
    (tmp_path / "two.py").write_text(PLUGIN.replace("esting", "olling") + PLUGIN[PLUGIN.index("@vs") :].replace("esting", "unning"))
    with pytest.raises(ParameterError, match="must add one law"):
        law_of_file(str(tmp_path / "two.py"))
    (tmp_path / "bad.yaml").write_text("robot: free\n")
    with pytest.raises(ParameterError, match="must have a block law"):
        law_of_file(str(tmp_path / "bad.yaml"))
    entry = opened(str(tmp_path / "mine.yaml"), own)
    assert list(entry.laws) == ["points", "line", "mine"]
    assert list(opened(str(tmp_path / "mine.yaml"), own, alone=True).laws) == ["mine"]
    with pytest.raises(ParameterError, match="LAW_FILE"):
        opened(None, own, alone=True)
    with pytest.raises(ScenarioError, match="tasks"):
        (tmp_path / "half.yaml").write_text("laws: {}\n")
        read_suite(str(tmp_path / "half.yaml"))


def rows(times: dict[str, list[float]], limit: float = 20.0) -> pl.DataFrame:
    return pl.DataFrame(
        [
            {"task": "t", "law": law, "start": str(i), "success": value < limit, "time_s": value}
            for law, values in times.items()
            for i, value in enumerate(values)
        ]
    )


def test_scores_are_successes_restricted_means_and_ranks_with_intervals() -> None:
    rng = np.random.default_rng(1)
    hard = rng.uniform(0, 5, 40)  # how hard a start is, the same for all
    found = {s.law: s for s in scores(rows({"slow": list(6 + hard), "fast": list(1 + hard), "fails": [20.0] * 30 + list(1 + hard[30:])}))}
    assert [found[law].rate[:1] + found[law].rate[3:4] for law in found] == [(1.0, 40), (1.0, 40), (0.25, 40)]
    low, high = found["fails"].rate[1:3]
    assert low == pytest.approx(0.1419, abs=1e-3) and high == pytest.approx(0.4019, abs=1e-3)  # Wilson's of 10 in 40
    assert found["fast"].time_s.mean == pytest.approx(1 + hard.mean())
    se = hard.std() / np.sqrt(40)
    np.testing.assert_allclose(
        [found["fast"].time_s.low, found["fast"].time_s.high], 1 + hard.mean() + np.array([-1.96, 1.96]) * se, atol=0.15
    )
    # paired starts: 5 s between them are beyond doubt though times spread as much
    assert {law: s.rank[:3] for law, s in found.items()} == {"slow": (2, 2, 2), "fast": (1, 1, 1), "fails": (3, 3, 3)}
    assert overall(list(found.values())) == [("fast", 1.0, 1), ("slow", 2.0, 1), ("fails", 3.0, 1)]


def test_a_run_that_crashed_counts_as_the_longest_and_a_start_that_is_missing_for_none() -> None:
    table = rows({"a": [2.0, 4.0, 6.0], "b": [3.0, 5.0, 20.0]})
    crashed = table.with_columns(pl.when((pl.col("law") == "a") & (pl.col("start") == "0")).then(None).otherwise("time_s").alias("time_s"))
    assert [s.time_s.mean for s in scores(crashed)] == [10.0, pytest.approx(28 / 3)]
    missing = table.filter(~((pl.col("law") == "a") & (pl.col("start") == "2")))
    assert [s.time_s.mean for s in scores(missing)] == [3.0, 4.0] and [s.rate.n for s in scores(missing)] == [2, 3]


def test_equal_laws_share_their_place_and_close_ones_have_wide_ranks() -> None:
    rng = np.random.default_rng(2)
    a, noise = rng.uniform(1, 9, 30), rng.normal(0, 1, 30)
    found = {s.law: s for s in scores(rows({"a": list(a), "same": list(a), "near": list(a + noise - noise.mean())}))}
    assert found["a"].rank.mean == found["same"].rank.mean
    assert found["near"].rank.low < found["near"].rank.high


@pytest.mark.process
def test_a_quick_suite_leaves_scores_and_a_page_goes_on_and_knows_itself(command, own: str, tmp_path: Path) -> None:
    words = "suite", str(tmp_path / "mine.yaml"), "--suite", own, "--quick", "--jobs", 1, "--out", "found"
    ended = command(*words)
    assert ended.code == 0, ended.err
    assert "mean rank" in ended.err and "line takes no part in only" in ended.err
    scored = pl.read_csv("found/scores.csv")
    assert scored["law"].to_list() == ["points", "mine"] and scored["runs"].to_list() == [4, 4] and (scored["reached"] == 4).all()
    page = Path("found/report.html").read_text()
    assert "Without part" in page and "rank 1" in page and "<svg" in page
    assert f"vstestbed suite {tmp_path / 'mine.yaml'} --suite {own} --quick" in page
    assert "points & 4/4" in Path("found/scores.tex").read_text()
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
    suite = TaskSuite(laws={"p": {"kind": "ibvs"}}, tasks={"t": SuiteTask(plan="plan.yaml")})
    assert SuiteEntry(suite, Path(own), suite.laws).plan("t") is not None


@pytest.mark.process
def test_a_submission_is_checked_by_a_drawn_part_and_a_false_number_is_found(command, own: str, tmp_path: Path) -> None:
    assert command("suite", str(tmp_path / "mine.yaml"), "--suite", own, "--jobs", 1, "--out", "found").code == 0
    ended = command("submit", "found")
    assert ended.code == 0 and Path("found.zip").is_file()
    with zipfile.ZipFile("found.zip") as packed:
        assert sorted(packed.namelist()) == ["environment.json", "law/mine.yaml", "runs.csv", "scores.csv", "suite.json"]
        inside = {name: packed.read(name) for name in packed.namelist()}
    inside["suite.json"] = inside["suite.json"].replace(b'"own"', json.dumps(own).encode())  # a suite by its file, for this test
    rows = pl.read_csv(inside["runs.csv"])
    for name, runs, code in (
        ("true.zip", rows, 0),
        ("false.zip", rows.with_columns(time_s=pl.col("time_s") / 2), 3),
        ("short.zip", rows.filter(pl.col("start") == ""), 3),
    ):
        with zipfile.ZipFile(name, "w") as packed:
            for inner, content in (inside | {"runs.csv": runs.write_csv().encode()}).items():
                packed.writestr(inner, content)
        ended = command("suite", "--check", name, "--jobs", 1, "--out", f"again_{name}")
        assert ended.code == code, ended.err
        assert ("1 of 1 runs that were flown again agree" in ended.err) == (code == 0)
    (tmp_path / "plan.yaml").write_text(PLAN + "\n")
    ended = command("suite", "--check", "true.zip", "--out", "later")
    assert ended.code == 2 and "is of another" in ended.err
    Path("no.zip").write_bytes(b"PK")
    assert "is no submission" in command("suite", "--check", "no.zip", "--out", "never").err
    assert "own laws alone" in command("submit", _plain_suite(command, own)).err


def _plain_suite(command, own: str) -> str:
    assert command("suite", "--suite", own, "--quick", "--jobs", 1, "--out", "plain").code == 0
    return "plain"
