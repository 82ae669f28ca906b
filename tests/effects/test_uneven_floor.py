"""An uneven floor has the heights, the correlation and the slopes that it is given."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.effects.floor import CELLS, UnevenFloor
from vstestbed.sim.scene.scene import Scene

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
    """sqrt(2) rms / l, less what differences over a cell miss: the mean square of a difference is 2
    (R(0) - R(cell)).
    """
    floor = UnevenFloor(rms_m=0.002, correlation_m=0.3, seed=2)
    h = floor.heights(HALF_M)
    cell = 2 * HALF_M / (len(h) - 1)
    slope = np.diff(h, axis=1).std() / cell
    assert slope == pytest.approx(
        0.002 * np.sqrt(2 * (1 - np.exp(-((cell / 0.3) ** 2)))) / cell, rel=0.03
    )
    assert slope == pytest.approx(np.sqrt(2) * 0.002 / 0.3, rel=0.05)


def test_a_seed_is_a_floor() -> None:
    one, again, other = (UnevenFloor(rms_m=0.002, seed=seed).heights(5.0) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 0.001


def test_one_is_drawn_where_none_is_given() -> None:
    floor = UnevenFloor(rms_m=0.002)
    drawn, other = (floor.drawn(np.random.default_rng(seed)) for seed in (1, 2))
    assert drawn.seed is not None and drawn.seed != other.seed
    assert drawn.drawn(np.random.default_rng(3)) is drawn


def test_a_base_is_tilted_by_the_heights_under_its_wheels() -> None:
    """The plane through wheels 2a and 2b apart has a pitch of standard deviation rms / 2a sqrt((1 +
    R(2b)) (1 - R(2a))): 0.17 degrees.
    """
    rms_m, length, wheelbase, track = 0.001, 0.3, 0.3, 0.32
    found = []
    for seed in range(2):
        h = UnevenFloor(rms_m=rms_m, correlation_m=length, seed=seed).heights(HALF_M)
        cell = 2 * HALF_M / (len(h) - 1)
        i, j = round(track / cell), round(wheelbase / cell)
        found.append((h[i:, j:] + h[:-i, j:] - h[i:, :-j] - h[:-i, :-j]) / (2 * j * cell))
    across, along = (np.exp(-((n * cell / length) ** 2)) for n in (i, j))
    expected = rms_m / (j * cell) * np.sqrt((1 + across) * (1 - along))
    assert np.std(found) == pytest.approx(expected, rel=0.03)
    assert np.degrees(expected) == pytest.approx(0.174, abs=0.004)


def test_the_relief_lies_where_its_heights_say() -> None:
    """Rays straight down find the heights at the grid's corners, the floor's middle in the world's
    origin.
    """
    scenario = vs.load(
        "car_pbvs", {"robot.uneven_floor": {"rms_m": 0.004, "correlation_m": 0.3, "seed": 3}}
    )
    heights = UnevenFloor(rms_m=0.004, correlation_m=0.3, seed=3).heights(HALF_M)
    scene = Scene(scenario.scene)
    mujoco.mj_forward(scene.model, scene.data)
    relief = next(
        i
        for i in range(scene.model.ngeom)
        if scene.model.geom_type[i] == mujoco.mjtGeom.mjGEOM_HFIELD
    )
    cell, n = 2 * HALF_M / (len(heights) - 1), len(heights)
    for i, j in ((n // 4, n // 3), (n // 2 + 7, n // 5), (n // 3, 3 * n // 4)):
        above = np.array([j * cell - HALF_M, i * cell - HALF_M, 0.5])
        away = mujoco.mj_rayHfield(
            scene.model, scene.data, relief, above, np.array([0.0, 0, -1]), None
        )
        assert above[2] - away == pytest.approx(heights[i, j], abs=2e-4)
    assert np.ptp(heights) > 0.01
    scene.close()
