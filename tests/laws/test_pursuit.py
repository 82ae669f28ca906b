"""Pure pursuit: the gap settles without error behind a steady leader, also in a bend; out of sight it coasts, then rests."""

import numpy as np
import pytest

from tests.laws.vehicles import BASIS, goal, move, observe
from vstestbed.features.depth import PnP
from vstestbed.laws import Pursuit

DT = 0.04


def follow(law, leader, seconds=40.0, gap=2.0):
    """Gap errors of a follower without masses behind a leader whose place is a function of time."""
    want = goal(gap_m=gap)
    place = start = np.array([-3.0, 0.3, 0.2])
    memory, errors = law.init(want), []
    for k in range(round(seconds / DT)):
        there = leader(k * DT)
        errors.append(np.hypot(*(there - place)[:2]) - gap)
        memory, command = law.step(memory, observe(k * DT, place, start, there), want, BASIS)
        place = move(place, command.u, DT)
    return np.array(errors), place


def straight(t):
    return np.array([0.5 * t, 0.0, 0.0])


def circle(t):
    return np.array([4 * np.sin(0.125 * t), 4 - 4 * np.cos(0.125 * t), 0.125 * t])


@pytest.mark.parametrize(("leader", "bound"), [(straight, 1e-3), (circle, 0.03)])
def test_the_gap_settles(leader, bound):
    errors, _ = follow(Pursuit(), leader)
    # In a bend the leader's speed along the line of sight is less than its own, which the filter follows: a few millimetres.
    assert np.abs(errors[-200:]).max() < bound


def test_it_drives_the_leaders_own_circle():
    """The arc that leads tangentially to the leader is, once settled, the leader's circle itself: no corner is cut."""
    _, place = follow(Pursuit(), circle, seconds=80)
    assert np.hypot(place[0], place[1] - 4) == pytest.approx(4, abs=0.01)


def test_a_pose_without_the_floor_needs_three_points():
    assert Pursuit().markers_needed(BASIS) == 1
    assert Pursuit(depth=PnP()).markers_needed(BASIS) == 3


def test_too_near_it_waits():
    law, want = Pursuit(), goal(gap_m=2.0)
    _, command = law.step(law.init(want), observe(0, np.zeros(3), np.zeros(3), np.array([1.0, 0, 0])), want, BASIS)
    assert command.u[0] == 0


def test_out_of_sight_it_coasts_and_then_rests():
    law, want = Pursuit(coast_s=0.5), goal(gap_m=2.0)
    memory, first = law.step(law.init(want), observe(0, np.zeros(3), np.zeros(3), np.array([3.0, 1, 0])), want, BASIS)
    assert first.u[0] > 0
    unseen = observe(0.4, np.zeros(3), np.zeros(3), np.array([3.0, 1, 0]), seen=False)
    memory, coasting = law.step(memory, unseen, want, BASIS)
    np.testing.assert_array_equal(coasting.u, first.u)
    assert coasting.rest_reason
    _, resting = law.step(memory, observe(0.6, np.zeros(3), np.zeros(3), np.array([3.0, 1, 0]), seen=False), want, BASIS)
    assert not resting.u.any() and resting.rest_reason
