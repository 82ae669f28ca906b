"""Line following without masses and pictures: exact in bends, poles as told, corners cut as told,
recovery, refusals.
"""

from contextlib import nullcontext

import numpy as np
import pytest

from tests.shortcuts import one_quick
from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.planar import moved, pose_on_ground
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import LineFollowing
from vstestbed.robots import Mount
from vstestbed.robots.vehicle import PLANE
from vstestbed.targets.ground_lines import GroundLines
from vstestbed.targets.route import CircularRoute, Piece, Straight, Track

UNDER = Pose(xyz=(0.5, 0, 0.3), rpy_deg=(180, 0, -90))
LOOK = (-0.25, 0.05)  # .25 and .55 m before the rear axle: m = .4
FRONT = Pose(xyz=(1.1, 0, 0.35), rpy_deg=(-150, 0, -90))
CAR, OMNI = PLANE[:, [0, 2]], PLANE
DT, SUB = 0.04, 8
BEND = Track(pieces=(Piece(length_m=5), Piece(turn_deg=180, radius_m=2.0), Piece(length_m=5)))


def world(route, mount=UNDER, look=LOOK, offsets=(0.0,), offset=0.0):
    lines = GroundLines(route=route, look_m=look, offsets_m=offsets)
    camera = Perspective(width=640, height=480, fovy_deg=120, mount=mount)
    return lines, Goal.of_points(camera, lines.straight_ahead(mount.T, offset), np.eye(4))


def observe(lines, goal, place, t=0.0):
    p = lines.seen_from(pose_on_ground(np.asarray(place, dtype=float)) @ goal.T_base_camera)
    uv = goal.camera.project(p)
    return Observation(t=t, uv=uv, xy=goal.camera.normalise(uv), depth=p[:, 2])


def drive(law, plane, lines, goal, start, seconds, steering_radps=2.0):
    """Offsets from the way, a frame at a time; a car's steering (wheelbase 1 m) turns no faster
    than given.
    """
    basis, place = Mount.of(goal.T_base_camera).to_camera @ plane, np.array(start, dtype=float)
    state, steering, off = law.init(goal), 0.0, []
    for k in range(round(seconds / DT)):
        off.append(lines.route.beside(place))
        state, command = law.step(state, observe(lines, goal, place, k * DT), goal, basis)
        commanded = motion = plane[[0, 1, 5]] @ command.u
        for _ in range(SUB):
            if plane is CAR:
                wanted = np.clip(np.arctan(commanded[2] / commanded[0]), -1, 1)
                steering += np.clip(
                    wanted - steering, -steering_radps * DT / SUB, steering_radps * DT / SUB
                )
                motion = np.array([commanded[0], 0, commanded[0] * np.tan(steering)])
            place = moved(place, motion, DT / SUB)
    return np.array(off)


class TestBends:
    @pytest.mark.parametrize("plane", one_quick(CAR, OMNI), ids=["car", "omni"])
    @pytest.mark.parametrize(("radius", "bound"), [(2.0, 2e-3), (-2.0, 2e-3), (6.0, 5e-5)])
    def test_a_constant_curvature_leaves_no_error_to_second_order(self, plane, radius, bound):
        # What is left is of fourth order, x^4 / 8 R^3 (.5 m, 2 m: 1 mm), and with three times the
        # radius 27 times less.
        lines, goal = world(CircularRoute(radius_m=radius))
        off = drive(LineFollowing(), plane, lines, goal, (0, 0, 0), 12)
        assert np.abs(off[-100:]).max() < bound

    def test_between_two_lines(self):
        lines, goal = world(CircularRoute(radius_m=2.0), look=(-0.1, 0.1), offsets=(0.25, -0.25))
        off = drive(LineFollowing(), OMNI, lines, goal, (0, 0, 0), 10)
        assert np.abs(off[-100:]).max() < 2e-3

    def test_beside_a_line(self):
        lines, goal = world(CircularRoute(radius_m=2.0), offset=0.2)
        off = drive(LineFollowing(), CAR, lines, goal, (0, 0.2, 0), 12)
        np.testing.assert_allclose(off[-100:], 0.2, atol=2e-3)

    def test_where_it_begins_the_corner_is_cut_as_told(self):
        # k m^2 / 9 = 9 mm for the lookahead of .4 m and a bend of 2 m, with the gain of damping
        # .707, 2 v / m.
        lines, goal = world(BEND)
        off = drive(LineFollowing(gain=4.0), CAR, lines, goal, (0, 0, 0), 18, steering_radps=100)
        assert np.abs(off).max() == pytest.approx(0.5 * 0.4**2 / 9, rel=0.15)

    @pytest.mark.study
    def test_a_camera_at_the_front_cuts_it_by_a_decimetre(self):
        # It measures 1.25 to 1.55 m before the rear axle: (1.4 / .4)^2 = 12 times the way off.
        under, front = (world(BEND, *at) for at in ((UNDER, LOOK), (FRONT, (0.15, 0.45))))
        best = [
            drive(LineFollowing(gain=1.6 / m), CAR, *at, (0, 0, 0), 18)
            for at, m in ((under, 0.4), (front, 1.4))
        ]
        assert np.abs(best[0]).max() < 0.015 and np.abs(best[1]).max() > 0.1


class TestPoles:
    def test_the_car_comes_back_as_the_linear_system_does(self):
        # y0'' + (lambda x_e + v)/m y0' + lambda v/m y0 = 0, x_e = .25 x .55 / .8; 5 mm off: linear
        # to a part in a thousand.
        law, (lines, goal) = LineFollowing(gain=2.0), world(Straight(length_m=30))
        off = drive(law, CAR, lines, goal, (1, 0.005, 0), 3, steering_radps=100)
        m, exact, v, gain = 0.4, 0.25 * 0.55 / 0.8, 0.8, 2.0
        y, slope, h, told = 0.005, 0.0, DT / 100, []
        for k in range(round(3 / h)):
            if k % 100 == 0:
                told.append(y)
            y, slope = (
                y + h * slope,
                slope - h * ((gain * exact + v) / m * slope + gain * v / m * y),
            )
        # The law acts on pictures that are up to .04 s old: some 6 % of the largest rate, .4 /s,
        # times 5 mm.
        np.testing.assert_allclose(off, told, atol=3e-4)

    def test_the_base_comes_back_as_an_exponential(self):
        law, (lines, goal) = LineFollowing(gain=2.0), world(Straight(length_m=30))
        off = drive(law, OMNI, lines, goal, (1, 0.02, 0), 2)
        # held for a frame
        np.testing.assert_allclose(off, 0.02 * (1 - 2.0 * DT) ** np.arange(len(off)), atol=1e-6)


class TestRecovery:
    @pytest.mark.parametrize("plane", one_quick(CAR, OMNI), ids=["car", "omni"])
    @pytest.mark.parametrize(("side", "turn"), [(0.3, 20), (0.3, -20), (-0.3, 20), (-0.3, -20)])
    def test_from_30_cm_and_20_degrees(self, plane, side, turn):
        lines, goal = world(Straight(length_m=30))
        off = drive(LineFollowing(), plane, lines, goal, (1, side, np.radians(turn)), 5)
        assert np.abs(off[round(2.5 / DT) :]).max() < 0.03 and abs(off[-1]) < 0.002

    def test_far_away_it_comes_straight_at_the_angle_of_approach(self):
        lines, goal = world(Straight(length_m=30))
        off = drive(LineFollowing(approach_deg=20), CAR, lines, goal, (1, 1.5, 0), 4)
        fall = -np.diff(off)[50:75] / DT
        np.testing.assert_allclose(fall, 0.8 * np.sin(np.radians(20)), rtol=0.02)


class TestSight:
    def test_one_line_of_two_is_enough(self):
        lines, goal = world(Straight(length_m=9), look=(-0.1, 0.1), offsets=(0.25, -0.25))
        basis, law = Mount.of(goal.T_base_camera).to_camera @ OMNI, LineFollowing()
        seen = observe(lines, goal, (3, 0.05, 0))
        _, whole = law.step(law.init(goal), seen, goal, basis)
        seen.xy[2] = np.nan  # half of the second line: no line
        _, half = law.step(law.init(goal), seen, goal, basis)
        np.testing.assert_allclose(half.u, whole.u, atol=1e-9)
        assert not half.rest_reason

    def test_out_of_sight_it_holds_its_command_and_then_rests(self):
        lines, goal = world(Straight(length_m=9))
        basis, law = Mount.of(goal.T_base_camera).to_camera @ CAR, LineFollowing(coast_s=0.2)
        state, first = law.step(law.init(goal), observe(lines, goal, (3, 0.05, 0)), goal, basis)
        state, holding = law.step(state, observe(lines, goal, (30, 0, 0), 0.2), goal, basis)
        np.testing.assert_array_equal(holding.u, first.u)
        _, resting = law.step(state, observe(lines, goal, (30, 0, 0), 0.24), goal, basis)
        assert holding.rest_reason and resting.rest_reason and not resting.u.any()


def test_refuses_to_look_beside_itself():
    lines, goal = world(Straight(length_m=9), look=(-0.8, -0.4))
    with pytest.raises(ParameterError, match="before the vehicle's origin"):
        LineFollowing().check(lines.points, goal)


@pytest.mark.parametrize(("near", "right"), [(-0.44, False), (-0.44 + 0.02, True)])
def test_the_least_distance_to_look_ahead_is_5_cm(near, right):
    # The camera is .5 m before the axle: the middle of near and near - .02 at .05 m or just under.
    lines, goal = world(Straight(length_m=9), look=(near - 0.02, near))
    ahead = 0.5 + near - 0.01
    assert (ahead >= 0.05) is right
    with nullcontext() if right else pytest.raises(ParameterError, match=r"0\.05 m or more"):
        LineFollowing().check(lines.points, goal)


def test_one_frame_of_a_car_by_hand():
    """On a straight line, y to the left: w m = -gain (y - y*) - v tan(phi), the first bounded by v
    tan(approach).
    """
    lines, goal = world(Straight(length_m=9))
    basis = Mount.of(goal.T_base_camera).to_camera @ CAR
    for off, turn, gain in (
        (0.02, 0.0, 3.0),
        (0.02, 0.05, 2.0),
        (0.15, 0.0, 3.0),
        (-0.15, 0.0, 3.0),
    ):
        law = LineFollowing(gain=gain, cruise_mps=0.6)
        u = law.step(law.init(goal), observe(lines, goal, (3, off, turn)), goal, basis)[1].u
        assert u[0] == pytest.approx(0.6)
        x_e, m = 0.25 * 0.55 / 0.8, 0.4
        e = -(off / np.cos(turn) + x_e * np.tan(turn))
        bound = 0.6 * np.tan(np.radians(25))
        slope = -np.tan(turn)
        # y(m) of the line changes by v tan(phi) as the car drives, and by -(m + y* tan(phi)) w as
        # it turns, y* = 0.
        assert u[1] == pytest.approx((np.clip(gain * e, -bound, bound) + 0.6 * slope) / m, rel=1e-3)


def test_two_points_and_nothing_else():
    assert LineFollowing().markers_needed(CAR) == 2
    assert LineFollowing().tasks == ("line",) and LineFollowing().inputs == ("xy",)


def test_it_holds_no_command_before_it_has_seen_a_line():
    lines, goal = world(Straight(length_m=9))
    law, basis = LineFollowing(coast_s=5), Mount.of(goal.T_base_camera).to_camera @ CAR
    state, command = law.step(law.init(goal), observe(lines, goal, (30, 0, 0)), goal, basis)
    assert command.rest_reason and not command.u.any() and state is None
