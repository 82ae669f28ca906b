"""The search for settings: what it takes, what it finds, that it goes on where it was cut off, what
it says.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import vstestbed as vs
from vstestbed.apps.tune.search_space import Choice, Range, Trial, best_of, parameter, read_record
from vstestbed.apps.tune.tuning import NoListener
from vstestbed.core.errors import EnvironmentLackError, ParameterError, RunFolderError
from vstestbed.studies.comparison import Comparison
from vstestbed.studies.comparison.plan import changed, read_comparison
from vstestbed.studies.comparison.tuning_record import settings_of

SMALL: dict[str, Any] = {
    "trials": 6,
    "seeds": 2,
    "check": 1,
    "set": {"camera.rate_hz": 10, "stop.converged.hold_s": 0.1},
}


@pytest.fixture
def no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vstestbed.apps.tune.tuning.write_tuning", lambda *_: None)


class Interrupts(NoListener):
    """Ctrl-C after so many runs."""

    def __init__(self, after: int):
        self.left = after

    def run_done(self, job: Any, summary: Any) -> None:
        self.left -= 1
        if not self.left:
            raise KeyboardInterrupt


def test_a_search_finds_the_gain_and_leaves_a_whole_folder(
    quick: Path, tmp_path: Path, here: None
) -> None:
    found = vs.tune(quick, {"law.gain": "1:12:log"}, out=tmp_path / "t", **SMALL)
    times = {t.values["law.gain"]: t.mean for t in found.trials}
    assert found.trials[0].values == {"law.gain": 6.0}  # what the scenario has now
    assert found.best.mean == min(times.values()) and len(times) == 6
    assert found.settings["law.gain"] > 3
    assert found.check is not None and [len(one.reached) for one in found.check] == [1, 1]
    assert {p.name for p in (tmp_path / "t").iterdir()} == {
        *(
            "tuning.yaml",
            "scenarios",
            "trials.json",
            "trials.parquet",
            "trials.csv",
            "best.yaml",
            "report.html",
            "figures",
            "runs",
        )
    }
    assert len(list((tmp_path / "t/figures").iterdir())) == 6
    table = pl.read_parquet(tmp_path / "t/trials.parquet")
    assert table.columns == [
        "trial",
        "law.gain",
        "runs",
        "reached",
        "mean_time_to_converge_s",
        "outcomes",
        "best",
    ]
    assert table.filter(pl.col("best"))["law.gain"].to_list() == [found.settings["law.gain"]]
    # a trial is what `run --seed` gives, and best.yaml is the scenario with the best values
    best = vs.load(tmp_path / "t/best.yaml", seed=2_000_000_001)
    assert best.law == found.scenario.law
    assert vs.run(best).summary()["time_to_converge_s"] == found.best.found[1]
    page = (tmp_path / "t/report.html").read_text(encoding="utf-8")
    assert found.headline in page and "--set law.gain=" in page and page.count("<svg") == 2


def test_an_interrupted_search_goes_on_to_the_same_end(
    quick: Path, tmp_path: Path, here: None, no_page: None
) -> None:
    few = SMALL | {"trials": 3}
    whole = vs.tune(quick, {"law.gain": "1:12"}, out=tmp_path / "whole", **few)
    for after in (1, 4):
        with pytest.raises(KeyboardInterrupt):
            vs.tune(
                quick,
                {"law.gain": "1:12"},
                out=tmp_path / f"cut{after}",
                listener=Interrupts(after),
                **few,
            )
        again = vs.tune(out=tmp_path / f"cut{after}", resume=True)
        assert again.trials == whole.trials and again.check == whole.check
    for name in ("trials.csv", "trials.json", "best.yaml"):
        assert (tmp_path / "cut1" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    done = Interrupts(1)  # nothing is run again
    assert (
        vs.tune(out=tmp_path / "whole", resume=True, listener=done).trials == whole.trials
        and done.left == 1
    )
    more = vs.tune(out=tmp_path / "whole", resume=True, trials=4)
    assert more.trials[:3] == whole.trials and len(more.trials) == 4
    for damaged in ("[{}]", "[" * 100_000):
        (tmp_path / "whole/trials.json").write_text(damaged)
        with pytest.raises(RunFolderError, match="is damaged"):
            vs.tune(out=tmp_path / "whole", resume=True)


def test_choices_and_whole_numbers_are_tried_once_each(
    quick: Path, tmp_path: Path, here: None, no_page: None
) -> None:
    vary = {
        "law": [{"kind": "ibvs", "gain": 6}, {"kind": "pbvs", "gain": 6}],
        "stop.converged.error_px": [1, 2],
        "camera.width": "320:321",
    }
    own = SMALL | {"set": {"camera.rate_hz": 10}, "seeds": 1, "check": 0}
    found = vs.tune(quick, vary, out=tmp_path / "t", **own, metric="final_error_px")
    assert [p.size for p in found.space.parameters] == [2, 2, 2]
    assert isinstance(found.space.parameters[2], Range) and found.space.parameters[2].whole
    settings = {json.dumps(t.values) for t in found.trials}
    assert len(settings) == 6
    again = vs.tune(out=tmp_path / "t", resume=True, trials=20)
    assert len(again.trials) == 8 and len({json.dumps(t.values) for t in again.trials}) == 8


def test_the_nominal_start_alone_is_no_sure_thing(
    quick: Path, tmp_path: Path, here: None, no_page: None
) -> None:
    quick.write_text(re.sub(r", random: {.*?}", "", quick.read_text()))
    found = vs.tune(
        quick, {"law.gain": "5:7"}, out=tmp_path / "t", **(SMALL | {"trials": 1, "seeds": None})
    )
    assert found.check is None and found.plan.seeds is None
    assert any("one start decides" in words for words in found.cautions())


def trial(number: int, reached: tuple[bool, ...], found: tuple[float, ...]) -> Trial:
    return Trial(
        number,
        {"a": number},
        tuple("converged" if good else "timed_out" for good in reached),
        reached,
        found,
    )


@pytest.mark.parametrize("higher", [False, True])
def test_a_failure_outweighs_any_number(higher: bool) -> None:
    bad, good = (-1e9, 1e9) if higher else (1e9, -1e9)
    slow, lucky = trial(0, (True, True), (bad, bad)), trial(1, (True, False), (good, math.nan))
    none, refused = trial(2, (False, False), (good, good)), Trial(3, {"a": 3}, refused="no")
    ordered = [slow, lucky, none, refused]
    for key in (lambda t: t.rank(higher), lambda t: t.score(higher, 2)):
        assert all(key(a) < key(b) for a, b in itertools.pairwise(ordered))
    assert best_of(ordered, higher) is slow
    assert best_of([none, refused], higher) is None
    close = [
        trial(i, (True,), (x,))
        for i, x in enumerate((-1e3, -1.0, -1e-3, 0.0, 1e-3, 1.0, 1.001, 1e3))
    ]
    scores = [t.score(higher, 1) for t in close]
    assert (
        scores == sorted(scores, reverse=higher)
        and len(set(scores)) == len(scores)
        and all(0 < s < 1 for s in scores)
    )


def test_what_is_no_range() -> None:
    for given, words in (
        ("2:1", "needs the form LOW:HIGH with LOW < HIGH"),
        ("1:1", "needs the form LOW:HIGH with LOW < HIGH"),
        ("0:1:log", "must begin above 0"),
        (
            "1:2:lin",
            "is no range of numbers; it needs a.b=LOW:HIGH, a.b=LOW:HIGH:log, or a.b=v1,v2",
        ),
        ("a:b", "is no range of numbers"),
        ("1:nan", "is no range of numbers"),
        ("1:1e999", "is no range of numbers"),
        ("1", "one value leaves nothing to choose"),
        ((3,), "one value leaves nothing to choose"),
        ((), "one value leaves nothing to choose"),
    ):
        with pytest.raises(ParameterError, match=words.replace(".", r"\.")) as error:
            parameter("law.gain", given)
        assert str(error.value).startswith("--vary law.gain: ")


def test_ranges_are_read_as_they_are_written() -> None:
    assert parameter("a", (".2:2",)) == Range("a", 0.2, 2)
    assert parameter("a", "-1e-3:10") == Range("a", -0.001, 10)
    assert str(parameter("a", "1:10:log")) == "1:10:log"
    assert parameter("a", ("p", "q:r")) == Choice("a", ("p", "q:r"))
    one = Range("a", 0.2, 2)
    assert (one.rounded(1.23456), one.rounded(0.20000001), one.rounded(1.99999)) == (1.235, 0.2, 2)
    assert Range("a", 1e-6, 1, log=True).rounded(1.23456e-6) == 1.235e-6
    assert [Range("a", 1, 3, whole=True).at(x) for x in (0, 0.4, 0.99)] == [1, 2, 3]


BAD = [
    ([], "SCENARIO is missing: name the scenario"),
    (["quick.yaml"], "--vary is missing: it names what is tuned"),
    (
        ["quick.yaml", "--vary", "law.gain=2:.2"],
        "--vary law.gain: needs the form LOW:HIGH with LOW < HIGH, got '2:.2'",
    ),
    (["quick.yaml", "--vary", "law.gain=-1:2"], "--vary: law.gain: must be > 0, got -1"),
    (
        ["quick.yaml", "--vary", "law.gian=1:2"],
        "--vary: law.gian: is an unknown field; did you mean 'gain'?",
    ),
    (["quick.yaml", "--vary", "law.feature=1:2"], "--vary: law.feature"),
    (["quick.yaml", "--vary", "law.interaction=current,wrong"], "--vary: law.interaction: "),
    (
        ["quick.yaml", "--vary", "law.gain=1:2", "--metric", "speed"],
        "--metric must be one of sim_time_s, ",
    ),
    (
        ["quick.yaml", "--vary", "law.gain=1:2", "--metric", "iae_px_s"],
        "which the scenario does not have; --set metrics=[error_integrals]",
    ),
    (
        ["quick.yaml", "--vary", "law.gain=1:2", "--set", "law.gain=1"],
        "axes.law.gain excludes the same field in `set`",
    ),
    (["ibvs_retreat", "--vary", "law.gain=1:2", "--seeds", "3"], "robot.start.random is missing"),
    (["arm_laws", "--vary", "law.gian=1:2"], "--vary fits none of the laws: "),
    (["quick.yaml", "--resume", "--out", "x"], "--resume goes on with what the folder searches"),
    (["--resume", "--out", "x"], "x: no such folder"),
    (["--resume"], "--resume needs the folder that `vstestbed tune` has made: --out DIR"),
    (
        ["quick.yaml", "--vary", "law.gain=1:2", "--executor", "ray"],
        "--executor must be local, warp or dask",
    ),
]


def test_bad_input_is_found_before_anything_runs(command, quick: Path) -> None:
    for words, line in BAD:
        ended = command("tune", *words)
        assert (ended.code, ended.out) == (2, ""), words
        assert line in ended.err and "Traceback" not in ended.err, ended.err
        assert not Path("runs").exists()


def test_a_metric_that_no_run_has_is_told_after_the_first_trials(
    quick: Path, tmp_path: Path, here: None
) -> None:
    with pytest.raises(ParameterError, match="is no number of the runs that reached the goal"):
        vs.tune(quick, {"law.gain": "5:8"}, metric="tracking_rms_m", out=tmp_path / "t", **SMALL)


def test_the_command_and_a_search_in_which_nothing_arrives(
    command, quick: Path, here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    # the first test has them
    monkeypatch.setattr("vstestbed.report.studies.publish", lambda *_: "")
    ended = command(
        "tune",
        "quick.yaml",
        "--vary",
        "law.gain=.01:.02",
        "--set",
        "stop.duration_s=.5",
        "--trials",
        2,
        "--seeds",
        1,
    )
    assert ended.code == 3
    assert ended.err.startswith(
        "No run of any trial reached the goal\n  The runs ended with: timed_out (2).\n  results   "
    )
    assert (
        not Path("runs/tune/001/best.yaml").exists() and Path("runs/tune/001/report.html").exists()
    )
    words = ("--trials", 2, "--seeds", 1, "--check", 1, "--set", "camera.rate_hz=10", "--json")
    found = json.loads(command("tune", "quick.yaml", "--vary", "law.gain=5:7", *words).out)
    assert found["command"].startswith(
        "vstestbed run quick.yaml --set camera.rate_hz=10 --set law.gain="
    )
    assert [row["trial"] for row in found["trials"]] == [0, 1] and found["best"] in (0, 1)
    page = Path("runs/tune/002/report.html")
    assert "vstestbed tune quick.yaml" in page.read_text(encoding="utf-8")
    page.unlink()
    assert command(
        "report", page.parent
    ).code == 0 and "vstestbed tune runs/tune/002/scenarios/quick.yaml" in page.read_text(
        encoding="utf-8"
    )
    next(page.parent.glob("runs/*/*/*/summary.json")).unlink()
    assert (
        "holds a search that is not finished; `vstestbed tune --resume"
        in command("report", page.parent).err
    )


def test_without_optuna_the_extra_is_named(
    quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(
        EnvironmentLackError, match=r"optuna.* is not installed; pip install 'vstestbed\[tune\]'"
    ):
        vs.tune(quick, {"law.gain": "1:2"}, out=tmp_path / "t")
    assert not (tmp_path / "t").exists()


@pytest.mark.process
@pytest.mark.study
def test_killed_and_resumed_and_with_other_jobs_it_is_the_same(
    quick: Path, tmp_path: Path, vstestbed_process
) -> None:
    words, environment = vstestbed_process
    search = [
        "tune",
        str(quick),
        "--vary",
        "law.gain=1:12:log",
        "--trials",
        "8",
        "--seeds",
        "3",
        "--check",
        "2",
        "--quiet",
    ]
    for name, jobs in (("one", 1), ("two", 2)):
        done = subprocess.run(
            [*words, *search, "--jobs", str(jobs), "--out", name],
            cwd=tmp_path,
            env=environment,
            check=False,
        )
        assert done.returncode == 0
    started = subprocess.Popen(
        [*words, *search, "--jobs", "2", "--out", "cut"], cwd=tmp_path, env=environment
    )
    while (
        started.poll() is None and len(list((tmp_path / "cut").glob("runs/*/*/*/summary.json"))) < 5
    ):
        time.sleep(0.05)
    assert started.poll() is None
    os.kill(started.pid, signal.SIGKILL)
    started.wait()
    recorded = read_record(tmp_path / "cut", ["law.gain"])
    done = subprocess.run(
        [*words, "tune", "--resume", "--out", "cut", "--quiet"],
        cwd=tmp_path,
        env=environment,
        check=False,
    )
    assert done.returncode == 0
    assert read_record(tmp_path / "cut", ["law.gain"])[: len(recorded)] == recorded
    for name in ("trials.csv", "best.yaml"):
        assert (
            len({(tmp_path / folder / name).read_bytes() for folder in ("one", "two", "cut")}) == 1
        )
    assert not list((tmp_path / "cut").rglob("*.part")) and not (tmp_path / "cut/.running").exists()


def test_each_law_of_a_comparison_is_tuned_and_compared_from_starts_that_no_search_has_seen(
    command, quick: Path, here: None, one_figure: None
) -> None:
    """A law of points and one of poses, each with its own gain; a law without the field goes as it
    is, and the page says so.
    """
    text = (
        "base: [quick.yaml]\n"
        "set: {camera.rate_hz: 10, stop.converged.hold_s: 0.1}\n"
        "seeds: 4\n"
        "cases:\n"
        "  law:\n"
    )
    laws = (
        "points: {law: {kind: ibvs, gain: 1}}",
        "pose: {law: {kind: pbvs, gain: 1}}",
        "jacobian: {law: {kind: uncalibrated}}",
    )
    Path("laws.yaml").write_text(text + "".join(f"    {law}\n" for law in laws))
    search = (
        "--vary",
        "law.gain=5:7",
        "--vary",
        "law.interaction=current,mean",
        "--trials",
        3,
        "--seeds",
        2,
        "--check",
        0,
    )
    ended = command("tune", "laws.yaml", *search, "--out", "t")
    assert ended.code == 0, ended.err
    assert (
        "points law.gain=" in ended.err
        and "pose as it is (" in ended.err
        and "jacobian as it is (" in ended.err
    )
    plan = " ".join(Path("t/comparison/comparison.yaml").read_text().split())
    assert (
        "each law with 3 trials from 2 starts that are not among these:"
        " law.gain=5:7, law.interaction=" in plan
    )
    seeds = [
        {int(p.parent.name) for p in Path(f"t/{part}").rglob("summary.json")}
        for part in ("tune", "comparison")
    ]
    assert seeds[0] == {2_000_000_000, 2_000_000_001} and seeds[1] == {0, 1, 2, 3}
    table = pl.read_parquet("t/comparison/comparison.parquet")
    assert table["law"].unique(maintain_order=True).to_list() == ["points", "pose", "jacobian"]
    assert "Tuned before by time to converge" in Path("t/comparison/report.html").read_text()


def test_all_gains_of_all_laws_are_tuned_where_none_is_named_and_the_record_makes_them_laws(
    command, quick: Path, here: None, one_figure: None
) -> None:
    """Points with one gain, a partitioned law with three."""
    laws = (
        "    points: {law: {kind: ibvs, gain: 4}}\n"
        "    partitioned: {law: {kind: partitioned, gain: 3, gain_z: 3, gain_turn: 3}}\n"
    )
    world = "set: {camera.rate_hz: 10, stop.converged.hold_s: 0.1}"
    Path("laws.yaml").write_text(f"base: [quick.yaml]\n{world}\nseeds: 2\ncases:\n  law:\n{laws}")
    ended = command("tune", "laws.yaml", "--trials", 2, "--seeds", 2, "--check", 0, "--out", "t")
    assert ended.code == 0, ended.err
    plan = read_comparison(Path("t/comparison/comparison.yaml"))
    points, partitioned = plan.tuned["points"], plan.tuned["partitioned"]
    assert points.vary == {"law.gain": "0.3:8:log"}
    assert (
        points.trials,
        points.seeds,
        points.set,
    ) == (2, 2, plan.set)
    assert (
        list(partitioned.vary) == ["law.gain", "law.gain_z", "law.gain_turn"]
        and partitioned.scenario == "quick"
    )
    assert settings_of(plan) == ""
    assert set(json.loads(Path("t/comparison/record.json").read_text())["tuned"]) == set(plan.tuned)
    slower = {name: {"law": case["law"], "law.gain": 1} for name, case in plan.cases["law"].items()}
    assert "points flies with law.gain 1.0 in place of" in settings_of(
        changed(plan, cases={"law": slower})
    )


def test_laws_in_scenarios_of_their_own_have_their_record_by_the_name_of_the_file(
    command, quick: Path, here: None, one_figure: None
) -> None:
    """A comparison of two scenarios, one in a file whose name is no word, with what was set for
    both.
    """
    Path("my pose.yaml").write_text(quick.read_text().replace("ibvs", "pbvs"))
    Path("laws.yaml").write_text(
        f"base: [quick.yaml, {Path('my pose.yaml').absolute()}]\n"
        "set: {camera.rate_hz: 10}\n"
        "seeds: 2\n"
    )
    ended = command("tune", "laws.yaml", "--trials", 2, "--seeds", 2, "--check", 0, "--out", "t")
    assert ended.code == 0, ended.err
    plan = read_comparison(Path("t/comparison/comparison.yaml"))
    assert list(plan.tuned) == ["quick", "my_pose"] and settings_of(plan) == ""
    assert settings_of(changed(plan, tuned={"quick": plan.tuned["quick"]})).startswith(
        "These are settings, not laws: my_pose flies with gain "
    )


def test_laws_that_the_search_leaves_as_they_are_make_the_comparison_one_of_settings(
    command, quick: Path, here: None, one_figure: None
) -> None:
    Path("laws.yaml").write_text(
        "base: [quick.yaml]\n"
        "set: {camera.rate_hz: 10, stop.converged.hold_s: 0.1}\n"
        "seeds: 2\n"
        "cases:\n"
        "  law:\n"
        "    points: {law: {kind: ibvs, gain: 4}}\n"
        "    pose: {law: {kind: pbvs, gain: 4}}\n"
    )
    ended = command(
        "tune",
        "laws.yaml",
        "--vary",
        "law.interaction=current,mean",
        "--trials",
        2,
        "--seeds",
        2,
        "--check",
        0,
        "--out",
        "t",
    )
    assert ended.code == 0, ended.err
    words = settings_of(read_comparison(Path("t/comparison/comparison.yaml")))
    assert words.startswith(
        "These are settings, not laws: points and pose fly with gain 4, for which none was tuned. "
    )


def test_laws_on_two_axes_are_refused_before_anything_is_searched(command, quick: Path) -> None:
    cases = (
        "cases: {law: {points: {law: {kind: ibvs, gain: 4}}, pose: {law: {kind: pbvs, gain: 4}}}}\n"
    )
    Path("other.yaml").write_text(quick.read_text())
    for text in (
        f"base: [quick.yaml, other.yaml]\n{cases}",
        f"base: [quick.yaml]\n{cases}axes: {{law.smooth_start_s: [0, 1]}}\n",
    ):
        Path("laws.yaml").write_text(text)
        ended = command("tune", "laws.yaml", "--trials", 2, "--out", "t")
        assert ended.code == 2 and "give its laws as one axis of `cases`" in ended.err
        assert not Path("t").exists()


def test_no_comparison_can_have_the_seeds_of_a_search() -> None:
    with pytest.raises(ParameterError, match=r"seeds must be at most 5: .*searches"):
        Comparison(base=("quick",), first_seed=1_999_999_995, seeds=6)
