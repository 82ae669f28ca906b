"""The prediction over a horizon: against a step-by-step simulation, and its derivatives against
finite differences.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from tests.laws.test_constraints import POINTS, arm
from vstestbed.core.geometry import exp, inverse, log, transform
from vstestbed.laws.predictive import beginnings, blocks_of, lagged, predict, shifted

P = POINTS + [0.1, 0.0, 1.2]
BLOCKS = blocks_of(10, 4)


@pytest.mark.parametrize(
    ("horizon", "blocks"), [(10, 4), (10, 10), (3, 5), (25, 5), (1, 1), (7, 3)]
)
def test_blocks_fill_the_horizon_and_grow(horizon: int, blocks: int) -> None:
    block = blocks_of(horizon, blocks)
    lengths = np.bincount(block)
    assert len(block) == horizon and len(lengths) == min(horizon, blocks)
    assert list(lengths) == sorted(lengths) and lengths[0] >= 1
    np.testing.assert_array_equal(beginnings(block), np.cumsum(lengths) - lengths)
    each = np.arange(len(lengths), dtype=float)[:, None]
    later = shifted(each, block)[:, 0]
    assert (later >= each[:, 0]).all() and later[-1] == each[-1, 0]


def test_blocks_halve_what_is_left_of_the_horizon() -> None:
    """A sixteenth of 20 periods, an eighth of the 19 left, a quarter of 17, half of 13,
    the rest.
    """
    assert np.bincount(blocks_of(20, 5)).tolist() == [1, 2, 4, 6, 7]


def test_servos_follow_as_a_fine_simulation_does() -> None:
    plan, before, lag = np.array([[1.0], [-2.0], [0.5], [3.0]]), np.array([0.7]), 0.6
    means, changes = lagged(BLOCKS, plan, before, lag)
    r, fine = 0.7, 20_000
    for k, b in enumerate(BLOCKS):
        way = 0.0
        for _ in range(fine):
            r += (plan[b, 0] - r) / (lag * fine)
            way += r / fine
        assert means[k, 0] == pytest.approx(way, abs=2e-4)
    more = plan + [[0.0], [0.1], [0.0], [0.0]]
    np.testing.assert_allclose(
        lagged(BLOCKS, more, before, lag)[0][:, 0] - means[:, 0], 0.1 * changes[:, 1], atol=1e-12
    )


def test_without_lag_the_means_are_the_orders() -> None:
    plan = np.arange(8.0).reshape(4, 2)
    np.testing.assert_array_equal(lagged(BLOCKS, plan, np.ones(2), 0.0)[0], plan[BLOCKS])


@pytest.mark.parametrize("seed", range(3))
def test_markers_and_joints_go_where_the_arm_takes_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scenario = vs.load("arm_ibvs")
    mount = scenario.camera.mount.T
    way = 0.03 * rng.normal(size=6)
    robot = replace(arm(underway=way, coming=way / 3), lag_s=0.0)
    plan = 0.3 * rng.normal(size=(4, 6))
    ahead = predict(P, robot, BLOCKS, plan, relinearise=True)
    here = scenario.robot.flange_pose(robot.q + way / 3 - way) @ mount  # at the exposure
    for k in (0, 4, 9):
        there = scenario.robot.flange_pose(ahead.q[k]) @ mount
        # the Jacobian of each period is that of its beginning: an error of second order in the way
        # of a period
        np.testing.assert_allclose(ahead.p[k], transform(inverse(there) @ here, P), atol=4e-3)
    np.testing.assert_allclose(ahead.q[-1], robot.q + way / 3 + 0.04 * plan[BLOCKS].sum(axis=0))


@pytest.mark.parametrize("lag_s", [0.0, 0.05])
def test_derivatives_of_the_prediction(lag_s: float) -> None:
    rng = np.random.default_rng(5)
    ordered = 0.2 * rng.normal(size=6)
    robot = replace(arm(ordered=ordered, underway=0.01 * rng.normal(size=6)), lag_s=lag_s)
    plan = 0.3 * rng.normal(size=(4, 6))
    # with the Jacobian of now: along the predicted way it changes with the plan, too, which one
    # step of linearisation leaves out
    ahead = predict(P, robot, BLOCKS, plan, relinearise=False)
    for i in range(plan.size):
        step = (1e-6 * np.eye(plan.size)[i]).reshape(plan.shape)
        up, down = (
            predict(P, robot, BLOCKS, plan + side * step, relinearise=False) for side in (1, -1)
        )
        np.testing.assert_allclose((up.q - down.q) / 2e-6, ahead.Q[:, :, i], atol=1e-8)
        for k in range(10):
            v, w = ahead.D[k, :3, i], ahead.D[k, 3:, i]
            change = -v - np.cross(w, ahead.p[k])
            np.testing.assert_allclose(
                (up.p[k] - down.p[k]) / 2e-6, change, atol=1e-3 * max(np.abs(change).max(), 1e-2)
            )


def test_an_ideal_camera_flies_exactly_as_predicted() -> None:
    scenario = vs.load("ibvs_book")
    model = scenario.robot.own_model(
        vs.Reading(np.zeros(0), np.zeros(0)), vs.Controller(scenario).mount
    )
    robot = replace(model, underway=np.zeros(6), coming=np.zeros(6), ordered=np.zeros(6))
    plan = np.random.default_rng(0).normal(size=(4, 6))
    T = np.eye(4)
    for b in BLOCKS:
        T = T @ exp(plan[b] * robot.period_s)
    ahead = predict(P, robot, BLOCKS, plan, relinearise=True)
    np.testing.assert_allclose(ahead.p[-1], transform(inverse(T), P), atol=1e-12)
    step = 1e-6 * np.eye(24)[7].reshape(4, 6)
    other = np.eye(4)
    for b in BLOCKS:
        other = other @ exp((plan + step)[b] * robot.period_s)
    np.testing.assert_allclose(log(inverse(T) @ other) / 1e-6, ahead.D[-1, :, 7], atol=1e-3)
