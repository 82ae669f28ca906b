"""The gain limit of an arm with its servos and elastic joints: measured in closed loop, and in its
linear model.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.apps.maps.delay import (
    displaced,
    find_limits,
    growth,
    linear_gain_limit,
    locus,
    prepared,
    sampled,
)
from vstestbed.effects.joints import Gears
from vstestbed.loop.stability import closed_form, gain_limit, polynomial
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.plant import LinearArm, linear_arm

PERIOD = 0.04


@pytest.fixture(scope="module")
def at_goal() -> Scenario:
    return prepared(vs.load("arm_ibvs", {"robot.actuation": "ideal"}))


def soft(scenario: Scenario, k: float, damping_s: float) -> Scenario:
    gears = Gears(stiffness_nmprad=(k, k, 0.4 * k, 0, 0, 0), damping_s=damping_s)
    return replace(scenario, robot=replace(scenario.robot, gears=gears))


@pytest.mark.parametrize(
    ("k", "damping_s", "d"), one_quick((25_000.0, 0.0005, 0), (5_000.0, 0.002, 1))
)
def test_an_elastic_arm_goes_unstable_where_two_masses_say(
    at_goal: Scenario, k: float, damping_s: float, d: int
) -> None:
    scenario = soft(at_goal, k, damping_s)
    g = linear_gain_limit(linear_arm(scenario.robot), d, PERIOD)
    assert g is not None and g < 0.75 * closed_form(d)  # the elasticity lowers it
    start = displaced(scenario)
    assert growth(start, 0.97 * g / PERIOD, d) < 1 < growth(start, 1.03 * g / PERIOD, d)


@pytest.mark.parametrize("d", [0, 1, 3])
def test_a_rigid_arm_with_ideal_servos_has_the_limit_of_the_delay_alone(d: int) -> None:
    """A stiff velocity servo on a light joint:
    all but the integrator has decayed within a period.
    """
    one = np.ones((1, 1))
    rigid = LinearArm(one, 0 * one, 0 * one, one, np.zeros(1), np.array([1e5]), np.array([False]))
    assert linear_gain_limit(rigid, d, PERIOD) == pytest.approx(closed_form(d), rel=2e-3)


def test_its_phase_crosses_where_its_gain_is_one() -> None:
    """The same limit by the open loop's frequency response: its gain margin at the phase of -180
    deg, not by poles.
    """
    d = 2
    spring, tie = 400.0, np.array([[1.0, -1.0], [-1.0, 1.0]])
    plant = LinearArm(
        np.diag([1.0, 0.5]),
        spring * tie,
        2.0 * tie,
        np.array([[0.0], [1.0]]),
        np.array([800.0]),
        np.array([30.0]),
        np.array([True]),
    )
    A, B = sampled(plant, PERIOD)
    w = np.linspace(0.005, 0.999, 20_000) * math.pi
    z = np.exp(1j * w)
    open_loop = np.array(
        [np.linalg.solve(x * np.eye(len(A)) - A, B[:, 0])[0] / PERIOD * x**-d for x in z[::10]]
    )
    phase = np.unwrap(np.angle(open_loop))
    i = np.flatnonzero((phase[:-1] > -math.pi) & (phase[1:] <= -math.pi))[0]
    margin = 1 / np.interp(-math.pi, phase[i : i + 2][::-1], np.abs(open_loop[i : i + 2])[::-1])
    assert linear_gain_limit(plant, d, PERIOD) == pytest.approx(margin, rel=1e-3)


@pytest.mark.parametrize("d", [0.25, 1.5])
def test_a_delay_of_part_of_a_frame(d: float) -> None:
    """As the loop of the theory, whose servo has no lag."""
    one = np.ones((1, 1))
    rigid = LinearArm(one, 0 * one, 0 * one, one, np.zeros(1), np.array([1e5]), np.array([False]))
    assert linear_gain_limit(rigid, d, PERIOD) == pytest.approx(gain_limit(d), rel=3e-3)


def test_the_servos_of_a_real_arm_explain_its_limit() -> None:
    """With the Panda's servos the theory of the delay alone is off by 40 %;
    the linear arm is not.
    """
    at_goal = prepared(vs.load("arm_panda"))
    g = linear_gain_limit(linear_arm(at_goal.robot), 0, PERIOD)
    assert g is not None and g < 0.62 * closed_form(0)
    start = displaced(at_goal)
    assert growth(start, 0.97 * g / PERIOD, 0) < 1 < growth(start, 1.03 * g / PERIOD, 0)


@pytest.mark.study
@pytest.mark.parametrize("actuation", ["ideal", "industrial"])
def test_the_search_lands_near_the_linear_model(actuation: str) -> None:
    """Within 5 %; friction damps small motions of the industrial arm, and gravity is a spring of
    its own.
    """
    gears = {"stiffness_nmprad": [25_000, 25_000, 10_000, 0, 0, 0]}
    (limit,) = find_limits(
        vs.load("arm_ibvs", {"robot.actuation": actuation, "robot.gears": gears}), [2]
    )
    assert limit.g_linear is not None and limit.lags == () and limit.g_lag is None
    assert limit.g == pytest.approx(limit.g_linear, rel=0.05)
    assert limit.row()["measured_to_linear"] == pytest.approx(limit.g / limit.g_linear)


def test_branches_are_followed():
    gains = np.linspace(1e-3, 1.5, 3000)
    ways = locus(2, gains)
    assert ways.shape == (3000, 3)
    for i in (0, 1500, 2999):
        np.testing.assert_allclose(np.poly(ways[i]), polynomial(gains[i], 2), atol=1e-9)
    # From one gain to the next .0005 apart a pole moves little, but where two meet (square root of
    # the step).
    assert np.abs(np.diff(ways, axis=0)).max() < 0.05
