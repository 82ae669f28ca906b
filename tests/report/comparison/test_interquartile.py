"""Interquartile means against scipy and by brute force, and how often their intervals hold the
truth.
"""

from __future__ import annotations

import math

import numpy as np
import polars as pl
import pytest
from scipy import stats

from vstestbed.report.comparison.results import ComparisonResults, interquartiles
from vstestbed.report.comparison.statistics import interquartile_mean


def iqm(values: np.ndarray) -> float:
    return float(stats.trim_mean(values, 0.25))


@pytest.mark.parametrize("n", [1, 3, 4, 5, 20, 23])
def test_the_mean_is_scipys_trimmed_mean(n: int) -> None:
    x = np.random.default_rng(n).lognormal(0, 1, n)
    found = interquartile_mean([*x, math.nan])
    assert found.mean == pytest.approx(iqm(x), rel=1e-12) and found.n == n
    assert math.isnan(found.low) == (n < 5)


def test_the_interval_is_that_of_a_trimmed_mean_and_the_order_does_not_matter() -> None:
    """As Yuen's test of one sample that scipy has for two: against a sample of zeros without
    spread.
    """
    x = np.random.default_rng(1).lognormal(0, 1, 24)
    found = interquartile_mean(x)
    assert interquartile_mean(np.random.default_rng(2).permutation(x)) == found
    scipys = stats.mstats.trimmed_mean_ci(
        x, limits=(0.25, 0.25), inclusive=(True, True), alpha=0.05
    )
    assert found.mean == pytest.approx(np.mean(scipys))
    assert (
        found.low,
        found.high,
    ) == pytest.approx(tuple(scipys), rel=0.05)


def test_failed_runs_are_worse_than_any_with_a_number() -> None:
    x = np.arange(20.0)
    five, six = (
        interquartile_mean(np.where(np.arange(20) >= 20 - failed, np.inf, x)) for failed in (5, 6)
    )
    # the five greatest do not count
    assert five == interquartile_mean(x) and math.isfinite(five.high)
    assert six.mean == math.inf and math.isnan(six.low)
    assert interquartile_mean(np.full(20, np.inf)).mean == math.inf
    many = interquartile_mean(np.r_[np.arange(900.0), np.full(100, np.inf)])
    assert math.isfinite(many.high) and many.mean == iqm(np.r_[np.arange(900.0), np.full(100, 1e9)])


def test_the_runs_of_a_controller_count_as_the_page_says() -> None:
    rows = {"scenario": ["a"] * 8, "seed": list(range(8)), "success": [True] * 6 + [False] * 2}
    frame = pl.DataFrame(
        rows
        | {
            "time_to_converge_s": [1.0, 2, 3, 4, 5, 6, None, None],
            "min_border_margin_px": [10.0, 20, 30, 40, 50, 60, 99, 99],
        }
        | {
            "final_error_px": [0.1] * 6 + [0.0] * 2,
            "feature_overshoot": [0.5] * 7 + [None],
            "path_ratio": [None] * 8,
        }
    )
    names = (
        "time_to_converge_s",
        "min_border_margin_px",
        "final_error_px",
        "feature_overshoot",
        "path_ratio",
        "tracking_rms_px",
    )
    (found,) = interquartiles(ComparisonResults(frame, (), names))
    assert found["time_to_converge_s"].mean == 4.5  # the mean of 3, 4, 5, 6: two failed
    # 10, 20, 30, 40
    assert found["min_border_margin_px"].mean == 25.0 and found["min_border_margin_px"].low < 10
    assert found["final_error_px"].mean == 0.1  # although both that failed ended nearer
    # of one that failed its own, of one that crashed the worst
    assert found["feature_overshoot"].mean == 0.5
    assert found["path_ratio"].n == found["tracking_rms_px"].n == 0


@pytest.mark.study
@pytest.mark.parametrize(("n", "least"), [(5, 0.70), (10, 0.85), (20, 0.90), (50, 0.92)])
def test_the_interval_holds_the_true_mean(n: int, least: float) -> None:
    rng = np.random.default_rng(n)
    for draw in (
        rng.normal,
        rng.standard_exponential,
        lambda size: rng.lognormal(0, 1, size),
        lambda size: rng.standard_t(2, size),
    ):
        truth = iqm(draw(size=2_000_000))
        found = [interquartile_mean(draw(size=n)) for _ in range(500)]
        assert np.mean([f.low <= truth <= f.high for f in found]) > least
