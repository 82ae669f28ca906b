"""The comparison's data: labels, numbers, pairs, errors over time, words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from tests.report.comparison.comparisons import build, errors, start_px
from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.report.comparison.figures import INSTANTS, read_series
from vstestbed.report.comparison.pairs import against, pairs
from vstestbed.report.comparison.results import TIME, ComparisonResults, short_names
from vstestbed.tasks.metrics import Metric


def table(**columns: list[Any]) -> pl.DataFrame:
    n = len(next(iter(columns.values())))
    return pl.DataFrame(
        {"scenario": ["a"] * n, "seed": list(range(n)), "success": [True] * n} | columns,
        strict=False,
    )


def compared(
    a: list[float | None], b: list[float | None], ok: tuple[list[bool], list[bool]] | None = None
) -> ComparisonResults:
    """Two controllers with these times to converge; None is a run that failed."""
    success = ok or ([v is not None for v in a], [v is not None for v in b])
    seeds = [*range(len(a)), *range(len(b))]
    rows = {
        "scenario": ["A"] * len(a) + ["B"] * len(b),
        "seed": seeds,
        "success": success[0] + success[1],
        "time_to_converge_s": a + b,
    }
    return ComparisonResults(pl.DataFrame(rows, strict=False), (), ("time_to_converge_s",))


def test_what_tells_of_a_run_whatever_its_end_is_of_all_runs_and_paired_on_all_seeds() -> None:
    over = {"A": [0.6, 0.7, 0.8], "B": [0.1, 0.2, 0.4]}
    rows = {
        "scenario": ["A"] * 3 + ["B"] * 3,
        "seed": [0, 1, 2] * 2,
        "success": [False] * 3 + [True] * 3,
    }
    frame = pl.DataFrame(
        rows | {"feature_overshoot": over["A"] + over["B"], "peak_speed_mps": [1.0] * 6}
    )
    comparison = ComparisonResults(frame, (), ("feature_overshoot", "peak_speed_mps"))
    failing = comparison.controllers[0]
    assert np.median(failing.counted(comparison.shown[0])) == pytest.approx(0.7)
    assert np.isnan(failing.counted(comparison.shown[1])).all()
    (pair,) = pairs(comparison)
    assert pair.differences["feature_overshoot"].mean == pytest.approx(
        np.mean(np.subtract(over["B"], over["A"]))
    )
    assert pair.differences["peak_speed_mps"].n == 0


def test_labels_name_what_differs() -> None:
    one = table(**{"robot.actuation": ["ideal", "industrial"], "law.gain": [0.5, 2.0]})
    assert [
        c.label for c in ComparisonResults(one, ("robot.actuation", "law.gain")).controllers
    ] == [
        "ideal, gain=0.5",
        "industrial, gain=2",
    ]
    two = one.with_columns(pl.Series("scenario", ["arm_ibvs", "arm_polar"]))
    assert [c.label for c in ComparisonResults(two, ("robot.actuation",)).controllers] == [
        "arm_ibvs, ideal",
        "arm_polar, industrial",
    ]
    assert [c.label for c in ComparisonResults(one).controllers] == ["a"]


def test_labels_of_values_that_are_no_words() -> None:
    """What is the same in all says nothing; of blocks their kind and what differs is named; of
    lists their items.
    """

    def labels(**columns):
        frame = table(**columns)
        return [c.label for c in ComparisonResults(frame, tuple(columns)).controllers]

    assert labels(**{"law.limits": [None, None], "law.on": [True, False]}) == [
        "on=true",
        "on=false",
    ]
    laws = [
        '{"kind": "ibvs", "gain": 0.8, "interaction": "mean"}',
        '{"kind": "ibvs", "gain": 0.8, "interaction": "desired"}',
    ]
    assert labels(law=laws) == ["interaction=mean", "interaction=desired"]
    assert labels(law=[laws[0], '{"kind": "pbvs", "gain": 0.8}']) == [
        "ibvs, interaction=mean",
        "pbvs",
    ]
    assert labels(law=["pbvs", laws[0]]) == ["pbvs", "ibvs, gain=0.8, interaction=mean"]
    assert labels(**{"robot.effects": ["[]", '["thermal"]']}) == ["none", "thermal"]


def test_names_are_as_short_as_they_can_be() -> None:
    assert short_names(["law.gain", "robot.actuation"]) == ["gain", "actuation"]
    assert short_names(["law.gain", "robot.gain", "seed"]) == ["law.gain", "robot.gain", "seed"]
    assert short_names(["gain", "law.gain"]) == ["gain", "law.gain"]


def test_controllers_come_in_order_of_first_appearance_with_their_runs_by_seed() -> None:
    frame = pl.DataFrame(
        {
            "scenario": ["b", "a", "b", "a"],
            "seed": [1, 0, 0, 1],
            "success": [True, None, False, True],
        }
    )
    controllers = ComparisonResults(frame).controllers
    assert [(c.label, c.seeds, c.success.tolist()) for c in controllers] == [
        ("b", [0, 1], [False, True]),
        ("a", [0, 1], [False, True]),
    ]


def test_numbers_come_in_their_unit_and_gaps_as_nan() -> None:
    controller = ComparisonResults(
        table(
            success=[True, False, True],
            final_position_error_m=[0.001, 0.5, None],
            path_ratio=[1, 9, 2],
        )
    ).controllers[0]
    # of every run, in mm
    np.testing.assert_array_equal(
        controller.counted(Metric.named("final_position_error_m")), [1.0, 500.0, np.nan]
    )
    # of those that reached the goal
    np.testing.assert_array_equal(controller.counted(Metric.named("path_ratio")), [1, np.nan, 2])
    assert np.isnan(controller.values(Metric.named("no_such_number"))).all()


def test_pairs_are_of_the_same_seed_and_can_be_turned() -> None:
    comparison = compared([5.0, 6.0, None, 8.0, 7.0, 7.0], [4.0, 5.5, 1.0, 7.0, 6.0, 6.5])
    (pair,) = pairs(comparison)
    difference = pair.differences[TIME.name]
    assert difference.n == 5 and difference.mean == pytest.approx((-1 - 0.5 - 1 - 1 - 0.5) / 5)
    assert (pair.test.only_a, pair.test.only_b, pair.test.both, pair.seeds) == (0, 1, 5, 6)
    (turned,) = against([pair], 1)
    assert (turned.a, turned.b, turned.test.only_a) == (1, 0, 1)
    assert turned.differences[TIME.name].low == -difference.high
    assert turned.deciding == (-pair.deciding[1], -pair.deciding[0])


def test_seeds_are_matched_by_number_not_by_place() -> None:
    frame = pl.DataFrame(
        {
            "scenario": ["A", "A", "B", "B", "B"],
            "seed": [3, 1, 1, 2, 3],
            "success": [True] * 5,
            "time_to_converge_s": [30.0, 10.0, 11.0, 99.0, 32.0],
        }
    )
    (pair,) = pairs(ComparisonResults(frame, (), (TIME.name,)))
    assert pair.seeds == 2 and pair.differences[TIME.name].mean == pytest.approx(1.5)


def test_all_pairs_or_a_reference_and_of_many_controllers_each_with_the_first() -> None:
    frame = pl.DataFrame(
        {"scenario": [f"s{k:02}" for k in range(30)], "seed": [0] * 30, "success": [True] * 30}
    )
    assert [(p.a, p.b) for p in pairs(ComparisonResults(frame))] == [(0, b) for b in range(1, 30)]
    found = pairs(ComparisonResults(frame[:8]))
    assert len(found) == 28
    assert [(p.a, p.b) for p in found if p.improvements] == [(0, b) for b in range(1, 8)]
    assert [(p.a, p.b) for p in pairs(ComparisonResults(frame[:3], reference="s01"))] == [
        (1, 0),
        (1, 2),
    ]
    with pytest.raises(ParameterError, match="reference must be one of s00, s01"):
        pairs(ComparisonResults(frame[:2], reference="pbvs"))


def test_a_run_holds_its_last_value_and_what_sees_nothing_ranks_last(tmp_path: Path) -> None:
    frame = build(tmp_path, {"a": 1.0}, 4, {("a", 1): "target_lost", ("a", 2): "crashed"})
    series = read_series(tmp_path, ComparisonResults(frame))
    error = series.errors[0]
    assert error.dtype == np.float32 and error.shape == (4, INSTANTS) and series.t[-1] == 10
    at = np.floor(series.t * 25 + 1e-6) / 25  # the last frame
    np.testing.assert_allclose(error[0], errors(1.0, 0, at), rtol=1e-5)
    # the last 25 of its 51 frames are blind, and it stays so
    assert np.isfinite(error[1]).sum() == (series.t < 1.04 - 1e-9).sum()
    assert np.isnan(error[2]).all()
    low, middle, high = series.quartiles(0)
    # one of four has no log: the upper quartile lies between a number and none
    assert np.isinf(high).all()
    assert np.isfinite(low).all() and np.isinf(middle[-1])
    np.testing.assert_allclose(middle[10], np.sort(error[[0, 1, 3], 10])[1:].mean(), rtol=1e-6)


def test_logs_that_are_missing_or_empty_are_gaps_and_damaged_ones_are_named(tmp_path: Path) -> None:
    frame = build(tmp_path, {"a": 1.0}, 3)
    (tmp_path / "runs/a/base/0/log.parquet").unlink()
    pl.DataFrame(
        {"t": [], "error_px": []}, schema={"t": pl.Float64, "error_px": pl.Float64}
    ).write_parquet(tmp_path / "runs/a/base/1/log.parquet")
    error = read_series(tmp_path, ComparisonResults(frame)).errors[0]
    assert np.isnan(error[:2]).all() and np.isfinite(error[2]).all()
    (tmp_path / "runs/a/base/0/log.parquet").write_bytes(b"PAR1 and no more")
    with pytest.raises(RunFolderError, match=r"base/0/log\.parquet: cannot be read"):
        read_series(tmp_path, ComparisonResults(frame))


def test_starts_of_the_synthetic_runs_differ() -> None:
    assert len({round(start_px(k), 6) for k in range(20)}) == 20
