"""Pure pursuit: the gap settles without error behind a steady leader, also in a bend; out of sight
it holds its command, then rests.
"""

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
    state, errors = law.init(want), []
    for k in range(round(seconds / DT)):
        there = leader(k * DT)
        errors.append(np.hypot(*(there - place)[:2]) - gap)
        state, command = law.step(state, observe(k * DT, place, start, there), want, BASIS)
        place = move(place, command.u, DT)
    return np.array(errors), place


def straight(t):
    return np.array([0.5 * t, 0.0, 0.0])


def circle(t):
    return np.array([4 * np.sin(0.125 * t), 4 - 4 * np.cos(0.125 * t), 0.125 * t])


@pytest.mark.parametrize(("leader", "bound"), [(straight, 1e-3), (circle, 0.03)])
def test_the_gap_settles(leader, bound):
    errors, _ = follow(Pursuit(), leader)
    # In a bend the leader's speed along the line of sight is less than its own, which the filter
    # follows: a few millimetres.
    assert np.abs(errors[-200:]).max() < bound


def test_it_drives_the_leaders_own_circle():
    """The arc that leads tangentially to the leader is, once settled, the leader's circle itself:
    no corner is cut.
    """
    _, place = follow(Pursuit(), circle, seconds=80)
    assert np.hypot(place[0], place[1] - 4) == pytest.approx(4, abs=0.01)


def test_a_pose_without_the_floor_needs_three_points():
    assert Pursuit().markers_needed(BASIS) == 1
    assert Pursuit(depth=PnP()).markers_needed(BASIS) == 3


def test_too_near_it_waits():
    law, want = Pursuit(), goal(gap_m=2.0)
    _, command = law.step(
        law.init(want), observe(0, np.zeros(3), np.zeros(3), np.array([1.0, 0, 0])), want, BASIS
    )
    assert command.u[0] == 0


def test_out_of_sight_it_holds_its_command_and_then_rests():
    law, want = Pursuit(coast_s=0.5), goal(gap_m=2.0)
    state, first = law.step(
        law.init(want), observe(0, np.zeros(3), np.zeros(3), np.array([3.0, 1, 0])), want, BASIS
    )
    assert first.u[0] > 0
    unseen = observe(0.4, np.zeros(3), np.zeros(3), np.array([3.0, 1, 0]), seen=False)
    state, holding = law.step(state, unseen, want, BASIS)
    np.testing.assert_array_equal(holding.u, first.u)
    assert holding.rest_reason
    _, resting = law.step(
        state,
        observe(0.6, np.zeros(3), np.zeros(3), np.array([3.0, 1, 0]), seen=False),
        want,
        BASIS,
    )
    assert not resting.u.any() and resting.rest_reason


class TestOneFrame:
    """The command by hand; the vehicle at the origin, looking along x."""

    HERE, LEADER = np.zeros(3), np.array([3.0, 1.0, 0])

    def step(self, law, state, t, place, there, seen=True):
        return law.step(
            state,
            observe(
                t, np.asarray(place, dtype=float), self.HERE, np.asarray(there, dtype=float), seen
            ),
            goal(gap_m=2.0),
            BASIS,
        )

    def test_speed_and_arc(self):
        _, command = self.step(
            Pursuit(gain=0.5), Pursuit().init(goal(gap_m=2.0)), 0.0, self.HERE, self.LEADER
        )
        gap = np.sqrt(10)
        # The first frame takes the leader to stand: v = lambda (d - d*), kappa = 2 y / d^2.
        np.testing.assert_allclose(
            command.u, [0.5 * (gap - 2), 0.5 * (gap - 2) * 2 * 1 / 10], rtol=1e-9
        )

    def test_the_leaders_speed_is_filtered_and_counts_the_own_way(self):
        law = Pursuit(gain=1.0, filter_s=0.5)
        state, _ = self.step(law, law.init(goal(gap_m=2.0)), 1.0, self.HERE, (3, 0, 0))
        # In .2 s .1 m nearer by its own .3 m: the leader drove .2 m, at 1 m/s; the filter takes 1 -
        # exp(-.2/.5) of that.
        state, command = self.step(law, state, 1.2, (0.3, 0, 0), (3.2, 0, 0))
        speed = (1 - np.exp(-0.4)) * 1.0
        assert state.speed == pytest.approx(speed, rel=1e-6)
        assert command.u[0] == pytest.approx(speed + 0.9, rel=1e-6)
        # Sideways of the line of sight its own way brings it no nearer: at 60 degrees, half of it.
        aside = np.array([1.0, np.sqrt(3.0), 0]) * 1.5
        before, _ = self.step(law, law.init(goal(gap_m=2.0)), 1.0, self.HERE, aside)
        after, _ = self.step(law, before, 1.2, (0.002, 0, 0), aside + [0.002, 0, 0])
        assert after.speed == pytest.approx((1 - np.exp(-0.4)) * 0.01 * 0.5, rel=1e-3)

    def test_a_second_picture_of_the_same_time_tells_no_speed(self):
        law = Pursuit()
        state, _ = self.step(law, law.init(goal(gap_m=2.0)), 1.0, self.HERE, (3, 0, 0))
        again, command = self.step(law, state, 1.0, self.HERE, (3.5, 0, 0))
        assert again.speed == 0 and command.u[0] == pytest.approx(1.5)

    def test_at_the_target_itself_the_arc_is_bounded(self):
        law = Pursuit(gain=1.0)
        state, _ = self.step(law, law.init(goal(gap_m=2.0)), 0.0, (-9, 0, 0), (0, 0, 0))
        _, command = law.step(
            state,
            observe(0.04, self.HERE, np.array([-9.0, 0, 0]), np.array([0, 1e-9, 0])),
            goal(gap_m=2.0),
            BASIS,
        )
        assert np.isfinite(command.u).all()

    def test_it_holds_its_command_up_to_its_time_and_says_what_is_missing(self):
        law = Pursuit(coast_s=0.5)
        state, first = self.step(law, law.init(goal(gap_m=2.0)), 0.0, self.HERE, self.LEADER)
        for t, moves in ((0.5, True), (0.51, False)):
            after, command = self.step(law, state, t, self.HERE, self.LEADER, seen=False)
            assert after is state and command.rest_reason == "too few markers in sight"
            np.testing.assert_array_equal(command.u, first.u if moves else [0, 0])
        _, command = law.step(
            law.init(goal()), observe(0.0, self.HERE, self.HERE), goal(gap_m=2.0), BASIS
        )
        assert command.rest_reason == "the pose cannot be estimated" and not command.u.any()
