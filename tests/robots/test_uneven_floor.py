"""An uneven floor has the heights, the correlation and the slopes that it is given."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.robots.uneven_floor import CELLS, UnevenFloor

HALF_M = 20.0


@pytest.mark.parametrize(("rms_m", "correlation_m"), [(0.002, 0.3), (0.01, 0.5)])
def test_heights_have_their_size_and_their_correlation(rms_m: float, correlation_m: float) -> None:
    """Over 5000 patches of one correlation length, sizes are known to about 1 %."""
    h = UnevenFloor(rms_m=rms_m, correlation_m=correlation_m, seed=1).heights(HALF_M)
    assert h.std() == pytest.approx(rms_m, rel=0.03)
    assert abs(h.mean()) < 0.05 * rms_m
    cell = 2 * HALF_M / (len(h) - 1)
    for lag in (CELLS, 2 * CELLS):
        expected = np.exp(-((lag * cell / correlation_m) ** 2))
        for a, b in ((h[lag:], h[:-lag]), (h[:, lag:], h[:, :-lag])):
            assert (a * b).mean() / h.var() == pytest.approx(expected, abs=0.04)


def test_slopes_follow() -> None:
    """sqrt(2) rms / l, less what differences over a cell miss: the mean square of a difference is 2 (R(0) - R(cell))."""
    floor = UnevenFloor(rms_m=0.002, correlation_m=0.3, seed=2)
    h = floor.heights(HALF_M)
    cell = 2 * HALF_M / (len(h) - 1)
    slope = np.diff(h, axis=1).std() / cell
    assert slope == pytest.approx(0.002 * np.sqrt(2 * (1 - np.exp(-((cell / 0.3) ** 2)))) / cell, rel=0.03)
    assert slope == pytest.approx(np.sqrt(2) * 0.002 / 0.3, rel=0.05)


def test_a_seed_is_a_floor() -> None:
    one, again, other = (UnevenFloor(rms_m=0.002, seed=seed).heights(5.0) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 0.001


def test_one_is_drawn_where_none_is_given() -> None:
    floor = UnevenFloor(rms_m=0.002)
    drawn, other = (floor.drawn(np.random.default_rng(seed)) for seed in (1, 2))
    assert drawn.drawn_seed is not None and drawn.drawn_seed != other.drawn_seed
    np.testing.assert_array_equal(drawn.heights(2.0), UnevenFloor(rms_m=0.002, seed=drawn.drawn_seed).heights(2.0))
