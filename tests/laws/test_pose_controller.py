"""The pose controller as a law: it chooses its direction once, arrives and stays, and says why it
cannot drive.
"""

import numpy as np
import pytest

from tests.laws.vehicles import BASIS, goal, move, observe
from vstestbed.core.errors import ParameterError
from vstestbed.core.planar import relative
from vstestbed.features.depth import OnFloor
from vstestbed.laws import PoseController

DT = 0.04


def arrive(law, start, there, seconds=60.0):
    """The places on the way and the commands, of a vehicle that does as told with curvature up to
    1.5 1/m.
    """
    want, place, state = (
        goal(place=np.array(there, dtype=float)),
        np.array(start, dtype=float),
        None,
    )
    state, ways, speeds = law.init(want), [place], []
    for k in range(round(seconds / DT)):
        state, command = law.step(state, observe(k * DT, place, ways[0]), want, BASIS)
        v, w = command.u
        w = np.clip(w, -1.5 * abs(v), 1.5 * abs(v))
        place = move(place, np.array([v, w]), DT)
        ways.append(place)
        speeds.append(v)
    return np.array(ways), np.array(speeds)


@pytest.mark.parametrize(
    ("start", "there"),
    [((2, 2, 0.35), (5, 5, np.pi / 2)), ((0, 0, 0), (4, -2, -0.5)), ((1, 1, 2.0), (-2, 4, 2.5))],
)
def test_it_arrives_forwards_and_stays(start, there):
    ways, speeds = arrive(PoseController(k_alpha=4, k_beta=-2.5), start, there)
    off = relative(np.array(there, dtype=float), ways[-1])
    assert np.hypot(*off[:2]) < 0.021  # rest_m is 2 cm
    # without noise the smoothing of the last 30 cm costs some of it
    assert abs(off[2]) < np.radians(1.5)
    assert speeds.min() >= 0 and speeds.max() <= 1
    assert (speeds[-100:] == 0).all()


def test_it_reverses_to_a_goal_behind_it():
    ways, speeds = arrive(PoseController(k_alpha=4, k_beta=-2.5), (3, 1.2, 0.35), (0, 0, 0))
    assert speeds.max() <= 0 and speeds.min() < -0.5
    assert np.hypot(*ways[-1, :2]) < 0.021


def test_a_direction_may_be_told():
    _, speeds = arrive(
        PoseController(direction="reverse"), (2, 2, 0.35), (5, 5, np.pi / 2), seconds=1.0
    )
    assert speeds.max() < 0


def test_the_direction_is_chosen_once():
    law, want = PoseController(), goal(place=np.array([5.0, 0.0, 0.0]))
    state, _ = law.step(law.init(want), observe(0, np.zeros(3), np.zeros(3)), want, BASIS)
    assert state[0] == 1
    # now it lies behind
    state, command = law.step(state, observe(1, np.array([0, 0, 3.0]), np.zeros(3)), want, BASIS)
    assert state[0] == 1 and command.u[0] > 0


def test_a_missed_goal_is_not_circled():
    law, want = PoseController(), goal(place=np.zeros(3))
    state, _ = law.step(
        law.init(want), observe(0, np.array([-1.0, 0, 0]), np.zeros(3)), want, BASIS
    )
    # abeam, 5 cm aside
    state, command = law.step(
        state, observe(1, np.array([0.02, 0.05, 0.0]), np.zeros(3)), want, BASIS
    )
    assert state[1] and not command.u.any() and not command.rest_reason


def test_without_a_place_it_rests_and_says_so():
    law, want = PoseController(), goal(place=np.zeros(3))
    blind = observe(0, np.zeros(3), np.zeros(3))
    _, command = law.step(
        law.init(want), type(blind)(0.0, blind.uv, blind.xy, blind.depth), want, BASIS
    )
    assert not command.u.any() and command.rest_reason == "the vehicle's place cannot be estimated"


@pytest.mark.parametrize(
    ("gains", "field"),
    [({"k_rho": -1}, "k_rho"), ({"k_beta": 0.5}, "k_beta"), ({"k_alpha": 0.5}, "k_alpha")],
)
def test_gains_that_are_unstable_are_refused(gains, field):
    with pytest.raises(ParameterError, match=field):
        PoseController(**gains)


class TestArrival:
    """Nearer than rest_m it stands for good; within pass_m only where the goal is not ahead."""

    def after(self, place, law=None, direction="auto"):
        law, want = (
            law or PoseController(rest_m=0.03, pass_m=0.2, direction=direction),
            goal(place=np.zeros(3)),
        )
        start = observe(0, np.array([-1.0, 0, 0]), np.zeros(3))
        state, _ = law.step(law.init(want), start, want, BASIS)
        return law.step(state, observe(1, np.asarray(place, dtype=float), np.zeros(3)), want, BASIS)

    def test_where(self):
        for place, arrived in (
            ((-0.029, 0, 0), True),  # ahead, nearer than rest_m
            ((-0.031, 0, 0), False),
            ((-0.19, 0, 0), False),  # within pass_m, but ahead
            ((0.19, 0, 0), True),  # behind
            ((0.21, 0, 0), False),  # behind, too far off to count
            ((-0.001, 0.1, 0), False),  # just not abeam: the goal is at 89 degrees
            ((0.001, 0.1, 0), True),  # at 91 degrees
        ):
            state, command = self.after(place)
            assert state[1] is arrived
            assert command.u.any() != arrived

    def test_for_good(self):
        law, want = PoseController(), goal(place=np.zeros(3))
        state, _ = law.step(
            law.init(want), observe(0, np.array([-0.01, 0, 0]), np.zeros(3)), want, BASIS
        )
        state, command = law.step(
            state, observe(1, np.array([-0.5, 0.3, 0]), np.zeros(3)), want, BASIS
        )
        assert state[1] and not command.u.any()

    def test_directions(self):
        for direction, sign in (("forward", 1), ("reverse", -1)):
            law, want = PoseController(direction=direction), goal(place=np.array([3.0, 0, 0]))
            state, command = law.step(
                law.init(want), observe(0, np.zeros(3), np.zeros(3)), want, BASIS
            )
            assert state[0] == sign and np.sign(command.u[0]) == sign

    def test_the_command_is_the_polar_laws(self):
        law, want = (
            PoseController(k_rho=0.4, k_alpha=3, k_beta=-1, speed_mps=0.7),
            goal(place=np.array([1.0, 0.5, 0.3])),
        )
        _, command = law.step(law.init(want), observe(0, np.zeros(3), np.zeros(3)), want, BASIS)
        rho, alpha = np.hypot(1, 0.5), np.arctan2(0.5, 1)
        np.testing.assert_allclose(command.u, [0.4 * rho, 3 * alpha - (0.3 - alpha)], rtol=1e-12)

    def test_three_landmarks_or_two_on_the_floor(self):
        assert PoseController().markers_needed(BASIS) == 3
        assert PoseController(depth=OnFloor()).markers_needed(BASIS) == 2


class TestNoiseNearTheGoal:
    """The vehicle's place is measured with an error across its way, at 5 cm from the goal
    multiplied by 2600 rad/m.
    """

    def curvatures(self, law, rho, errors):
        want, state = goal(place=np.zeros(3)), law.init(goal(place=np.zeros(3)))
        found = []
        for k, error in enumerate(errors):
            place = np.array([-rho, error, 0.0])
            state, command = law.step(state, observe(k * DT, place, place), want, BASIS)
            found.append(command.u[-1] / command.u[0])
        return np.array(found)

    def test_what_the_singularity_makes_of_it(self):
        law = PoseController(k_alpha=4, k_beta=-2.5, average_m=0)
        found = self.curvatures(law, 0.05, [0.0, 1e-3])
        # the equation at the head of the law, of first order in n / rho = .02
        assert found[1] - found[0] == pytest.approx(-6.5 * 1e-3 / 0.05**2, rel=1e-3)

    @pytest.mark.parametrize("rho", [0.2, 0.1, 0.05])
    def test_what_is_left_of_it(self, rho):
        law = PoseController(k_alpha=4, k_beta=-2.5)
        found = self.curvatures(law, rho, [0.0, 1e-4])
        # 6.5 n / rho^2 times the frame's weight, (rho / .3)^3: it vanishes towards the goal
        assert found[1] - found[0] == pytest.approx(-6.5 * 1e-4 * rho / 0.3**3, rel=1e-3)

    def test_a_whole_way(self):
        law, rng = PoseController(k_alpha=4, k_beta=-2.5), np.random.default_rng(0)
        want, state, found = goal(place=np.zeros(3)), law.init(goal(place=np.zeros(3))), []
        # as v = rho drives it, to 3.8 cm
        for k, rho in enumerate(0.6 * np.exp(-DT * np.arange(70))):
            place = np.array([-rho, 1e-3 * rng.standard_normal(), 0.0])
            state, command = law.step(state, observe(k * DT, place, place), want, BASIS)
            found.append((rho, command.u[-1] / command.u[0]))
        rho, curvature = np.array(found).T
        # A frame's own noise of 1 mm makes .072 at .3 m, where the smoothing begins, and 4.5 at the
        # end.
        assert np.abs(curvature).max() < 0.4
        assert np.abs(np.diff(curvature[rho < 0.1])).max() < 0.06

    def test_it_still_steers_near_the_goal(self):
        # A place that is 1 cm aside for good, after 10 frames at 15 cm: a mean of all frames would
        # give 25 of 35.
        law = PoseController(k_alpha=4, k_beta=-2.5)
        weight = (np.hypot(0.15, 0.01) / 0.3) ** 3
        found = self.curvatures(law, 0.15, [0.0] * 10 + [0.01] * 25)
        plain = PoseController(k_alpha=4, k_beta=-2.5, average_m=0)
        asked = self.curvatures(plain, 0.15, [0.01])[0]
        assert found[-1] / asked == pytest.approx(1 - (1 - weight) ** 25, rel=1e-6)

    def test_a_vehicle_that_leaves_begins_anew(self):
        law = PoseController(k_alpha=4, k_beta=-2.5)
        want, state = goal(place=np.zeros(3)), law.init(goal(place=np.zeros(3)))
        for k, at in enumerate(((-0.25, 0.02), (-0.4, 0.0), (-0.25, 0.0))):
            place = np.array([*at, 0.0])
            state, command = law.step(state, observe(k * DT, place, place), want, BASIS)
        assert command.u[-1] == pytest.approx(0, abs=1e-12)
