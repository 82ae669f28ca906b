"""The comparison's data: labels, numbers, pairs, errors over time, words."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from tests.report.comparison.comparisons import build, errors, start_px
from vstestbed.core.errors import RunFolderError
from vstestbed.report.comparison.figures import INSTANTS, read_series
from vstestbed.report.comparison.results import TIME, ComparisonResults, against, pairs, short_names
from vstestbed.report.comparison.tables import headline, pair_text
from vstestbed.tasks.metrics import Metric


def table(**columns: list[Any]) -> pl.DataFrame:
    n = len(next(iter(columns.values())))
    return pl.DataFrame({"scenario": ["a"] * n, "seed": list(range(n)), "success": [True] * n} | columns, strict=False)


def compared(a: list[float | None], b: list[float | None], ok: tuple[list[bool], list[bool]] | None = None) -> ComparisonResults:
    """Two controllers with these times to converge; None is a run that failed."""
    success = ok or ([v is not None for v in a], [v is not None for v in b])
    seeds = [*range(len(a)), *range(len(b))]
    rows = {"scenario": ["A"] * len(a) + ["B"] * len(b), "seed": seeds, "success": success[0] + success[1], "time_to_converge_s": a + b}
    return ComparisonResults(pl.DataFrame(rows, strict=False), (), ("time_to_converge_s",))


def test_what_tells_of_a_run_whatever_its_end_is_of_all_runs_and_paired_on_all_seeds() -> None:
    over = {"A": [0.6, 0.7, 0.8], "B": [0.1, 0.2, 0.4]}
    rows = {"scenario": ["A"] * 3 + ["B"] * 3, "seed": [0, 1, 2] * 2, "success": [False] * 3 + [True] * 3}
    frame = pl.DataFrame(rows | {"feature_overshoot": over["A"] + over["B"], "peak_speed_mps": [1.0] * 6})
    comparison = ComparisonResults(frame, (), ("feature_overshoot", "peak_speed_mps"))
    failing = comparison.controllers[0]
    assert np.median(failing.counted(comparison.shown[0])) == pytest.approx(0.7)
    assert np.isnan(failing.counted(comparison.shown[1])).all()
    (pair,) = pairs(comparison)
    assert pair.differences["feature_overshoot"].mean == pytest.approx(np.mean(np.subtract(over["B"], over["A"])))
    assert pair.differences["peak_speed_mps"].n == 0


def test_labels_name_what_differs() -> None:
    one = table(**{"robot.actuation": ["ideal", "industrial"], "law.gain": [0.5, 2.0]})
    assert [c.label for c in ComparisonResults(one, ("robot.actuation", "law.gain")).controllers] == [
        "actuation=ideal, gain=0.5",
        "actuation=industrial, gain=2",
    ]
    two = one.with_columns(pl.Series("scenario", ["arm_ibvs", "arm_polar"]))
    assert [c.label for c in ComparisonResults(two, ("robot.actuation",)).controllers] == [
        "arm_ibvs, actuation=ideal",
        "arm_polar, actuation=industrial",
    ]
    assert [c.label for c in ComparisonResults(one).controllers] == ["a"]


def test_labels_of_values_that_are_no_words() -> None:
    frame = table(**{"law.limits": [None, None], "law.on": [True, False]})
    assert [c.label for c in ComparisonResults(frame, ("law.limits", "law.on")).controllers] == [
        "limits=null, on=true",
        "limits=null, on=false",
    ]


def test_names_are_as_short_as_they_can_be() -> None:
    assert short_names(["law.gain", "robot.actuation"]) == ["gain", "actuation"]
    assert short_names(["law.gain", "robot.gain", "seed"]) == ["law.gain", "robot.gain", "seed"]
    assert short_names(["gain", "law.gain"]) == ["gain", "law.gain"]


def test_controllers_come_in_order_of_first_appearance_with_their_runs_by_seed() -> None:
    frame = pl.DataFrame({"scenario": ["b", "a", "b", "a"], "seed": [1, 0, 0, 1], "success": [True, None, False, True]})
    controllers = ComparisonResults(frame).controllers
    assert [(c.label, c.seeds, c.success.tolist()) for c in controllers] == [("b", [0, 1], [False, True]), ("a", [0, 1], [False, True])]


def test_numbers_come_in_their_unit_and_gaps_as_nan() -> None:
    controller = ComparisonResults(
        table(success=[True, False, True], final_position_error_m=[0.001, 0.5, None], path_ratio=[1, 9, 2])
    ).controllers[0]
    np.testing.assert_array_equal(controller.counted(Metric.named("final_position_error_m")), [1.0, 500.0, np.nan])  # of every run, in mm
    np.testing.assert_array_equal(controller.counted(Metric.named("path_ratio")), [1, np.nan, 2])  # of those that reached the goal
    assert np.isnan(controller.values(Metric.named("no_such_number"))).all()


def test_pairs_are_of_the_same_seed_and_can_be_turned() -> None:
    comparison = compared([5.0, 6.0, None, 8.0], [4.0, 5.5, 1.0, 7.0])
    (pair,) = pairs(comparison)
    difference = pair.differences[TIME.name]
    assert difference.n == 3 and difference.mean == pytest.approx((-1 - 0.5 - 1) / 3)
    assert pair.means[TIME.name] == pytest.approx(19 / 3)
    assert (pair.success.only_a, pair.success.only_b, pair.success.both, pair.seeds) == (0, 1, 3, 4)
    (turned,) = against([pair], 1)
    assert (turned.a, turned.b, turned.success.only_a) == (1, 0, 1)
    assert turned.differences[TIME.name].low == -difference.high
    assert turned.means[TIME.name] == pytest.approx(16.5 / 3)


def test_seeds_are_matched_by_number_not_by_place() -> None:
    frame = pl.DataFrame(
        {
            "scenario": ["A", "A", "B", "B", "B"],
            "seed": [3, 1, 1, 2, 3],
            "success": [True] * 5,
            "time_to_converge_s": [30.0, 10.0, 11.0, 99.0, 32.0],
        }
    )
    (pair,) = pairs(ComparisonResults(frame))
    assert pair.seeds == 2 and pair.differences[TIME.name].mean == pytest.approx(1.5)


def test_of_many_controllers_each_is_compared_with_the_first() -> None:
    frame = pl.DataFrame({"scenario": list("abcdefgh"), "seed": [0] * 8, "success": [True] * 8})
    assert [(p.a, p.b) for p in pairs(ComparisonResults(frame))] == [(0, b) for b in range(1, 8)]
    assert len(pairs(ComparisonResults(frame[:6]))) == 15


def test_a_run_holds_its_last_value_and_what_sees_nothing_ranks_last(tmp_path: Path) -> None:
    frame = build(tmp_path, {"a": 1.0}, 4, {("a", 1): "target_lost", ("a", 2): "crashed"})
    series = read_series(tmp_path, ComparisonResults(frame))
    error = series.errors[0]
    assert error.dtype == np.float32 and error.shape == (4, INSTANTS) and series.t[-1] == 10
    at = np.floor(series.t * 25 + 1e-6) / 25  # the last frame
    np.testing.assert_allclose(error[0], errors(1.0, 0, at), rtol=1e-5)
    assert np.isfinite(error[1]).sum() == (series.t < 1.04 - 1e-9).sum()  # the last 25 of its 51 frames are blind, and it stays so
    assert np.isnan(error[2]).all()
    low, middle, high = series.quartiles(0)
    assert np.isinf(high).all()  # one of four has no log: the upper quartile lies between a number and none
    assert np.isfinite(low).all() and np.isinf(middle[-1])
    np.testing.assert_allclose(middle[10], np.sort(error[[0, 1, 3], 10])[1:].mean(), rtol=1e-6)


def test_logs_that_are_missing_or_empty_are_gaps_and_damaged_ones_are_named(tmp_path: Path) -> None:
    frame = build(tmp_path, {"a": 1.0}, 3)
    (tmp_path / "runs/a/base/0/log.parquet").unlink()
    pl.DataFrame({"t": [], "error_px": []}, schema={"t": pl.Float64, "error_px": pl.Float64}).write_parquet(
        tmp_path / "runs/a/base/1/log.parquet"
    )
    error = read_series(tmp_path, ComparisonResults(frame)).errors[0]
    assert np.isnan(error[:2]).all() and np.isfinite(error[2]).all()
    (tmp_path / "runs/a/base/0/log.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(RunFolderError, match=r"base/0/log\.parquet: cannot be read"):
        read_series(tmp_path, ComparisonResults(frame))


def said(comparison: ComparisonResults) -> str:
    verdict, look, sentences, others = headline(comparison, pairs(comparison))
    return " ".join([verdict, f"outcome {look}", *sentences, *others])


def test_the_faster_one_is_better_and_by_how_much() -> None:
    slow = [10 + 0.1 * math.sin(k) for k in range(20)]
    text = said(compared(slow, [0.5 * t for t in slow]))
    assert "B is better than A: it converges 5.00 s (50.0 %) sooner." in text and "outcome good" in text
    assert "B and A reached the goal on all 20 seeds. B converged" in text
    assert "B is better" not in said(compared([0.5 * t for t in slow], slow))


def test_no_difference_is_told_with_the_number_of_runs() -> None:
    rng = np.random.default_rng(1)
    a = rng.normal(10, 1, 20)
    text = said(compared(a.tolist(), (a + rng.permutation(np.tile([-0.5, 0.5], 10))).tolist()))
    assert "No difference between A and B that 20 runs each could show." in text and "outcome open" in text


def test_the_one_that_reaches_the_goal_more_often_is_better() -> None:
    a: list[float | None] = [None] * 12 + [5.0] * 8
    text = said(compared(a, [5.0] * 20))
    assert "B is better than A: it reaches the goal on 12 more of 20 seeds." in text
    assert "B reached the goal on 20 of 20 seeds, A on 8: a real difference (p = 0.0015)." in text
    few = said(compared([None, None, *[5.0] * 18], [5.0] * 20))
    assert "no difference that 20 runs could show (p = 1)" in few


def test_more_often_but_later_is_no_clear_answer() -> None:
    a: list[float | None] = [None] * 8 + [5.0 + 0.01 * k for k in range(12)]
    text = said(compared(a, [9.0] * 20))
    assert "B reaches the goal more often, A sooner." in text and "outcome open" in text


def test_one_seed_and_one_controller_claim_nothing() -> None:
    (pair,) = pairs(compared([5.0], [4.0]))
    words = pair_text(pair, ["A", "B"])
    assert "on the only seed" in words and "one pair shows nothing" in words
    (none,) = pairs(compared([None], [None]))
    assert pair_text(none, ["A", "B"]) == "B and A reached the goal on no seed."
    alone = said(ComparisonResults(table(success=[True] * 18 + [False] * 2)))
    assert "a reached the goal in 18 of 20 runs (90 %, 95 % interval 70 to 97 %)." in alone


def test_the_answer_for_many() -> None:
    for times, words in (
        ((4, 5, 6), "a is better than each of the other two: than b, it converges 1.00 s (20.0 %) sooner."),
        ((5, 5, 5), "No difference between them that 6 runs each could show."),
        ((5, 5, 9), "a and b are better than the rest; 6 runs each show neither of them ahead."),
        ((4, 4, 4, 6, 6), "a, b and c are better than the rest; 6 runs each show none of them ahead."),
        ((*range(5, 12),), "Against a: 0 of 6 are better, 6 worse; for 0, 6 runs each do not tell."),
    ):
        names = "abcdefg"[: len(times)]
        rows = [(n, k, True, t + 0.001 * k) for n, t in zip(names, times, strict=True) for k in range(6)]
        frame = pl.DataFrame(rows, schema=["scenario", "seed", "success", "time_to_converge_s"], orient="row")
        assert words in said(ComparisonResults(frame, (), ("time_to_converge_s",)))


def test_starts_of_the_synthetic_runs_differ() -> None:
    assert len({round(start_px(k), 6) for k in range(20)}) == 20
