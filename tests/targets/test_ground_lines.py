"""Lines on the floor: where they cross the look distances of a camera, against closed forms."""

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, transform
from vstestbed.core.planar import pose_on_ground
from vstestbed.targets.ground_lines import GroundLines, foot_of, on_foot
from vstestbed.targets.route import CircularRoute, FigureEight, Piece, Straight, Track

DOWN, TILTED, AHEAD = ((180, 0, -90), (-150, 0, -90), (-90, 0, -90))
"""Mounts that look straight down with the picture's top ahead, ahead and down, and straight ahead
(roll, pitch, yaw [deg]).
"""


def on_floor(lines, place, rpy, height=0.4):
    """The points seen by a camera over (x, y, heading), in its ground frame: (N, 2)."""
    T = pose_on_ground(np.array(place)) @ Pose(xyz=(0, 0, height), rpy_deg=rpy).T
    p = transform(T, lines.seen_from(T))
    np.testing.assert_allclose(p[np.isfinite(p[:, 0]), 2], 0, atol=1e-12)
    c, s = np.cos(place[2]), np.sin(place[2])
    return (p[:, :2] - place[:2]) @ np.array([[c, -s], [s, c]])


@pytest.mark.parametrize("rpy", [DOWN, TILTED, AHEAD])
def test_ahead_is_ahead_for_cameras_that_look_down_or_ahead(rpy):
    mount = pose_on_ground(np.array([1.0, 2.0, 0.7])) @ Pose(xyz=(0.2, 0, 0.4), rpy_deg=rpy).T
    np.testing.assert_allclose(
        foot_of(mount), [1 + 0.2 * np.cos(0.7), 2 + 0.2 * np.sin(0.7), 0.7], atol=1e-12
    )
    back = transform(mount, on_foot(mount, np.array([[0.3, 0.1]])))
    np.testing.assert_allclose(
        back, transform(pose_on_ground(foot_of(mount)), np.array([[0.3, 0.1, 0.0]])), atol=1e-12
    )


@pytest.mark.parametrize("rpy", [DOWN, TILTED, AHEAD])
def test_a_straight_line_by_trigonometry(rpy):
    lines = GroundLines(route=Straight(length_m=20), look_m=(0.1, 0.5), offsets_m=(0.0, 0.2))
    place = (5.0, 0.3, np.radians(20))
    # The line y = b in the world lies where 0.3 + x sin a + y cos a = b in the vehicle's ground
    # frame.
    left = [
        (b - 0.3 - x * np.sin(place[2])) / np.cos(place[2]) for b in (0.0, 0.2) for x in (0.1, 0.5)
    ]
    np.testing.assert_allclose(
        on_floor(lines, place, rpy), np.column_stack([[0.1, 0.5] * 2, left]), atol=1e-12
    )


def test_a_circle_by_pythagoras():
    lines = GroundLines(
        route=CircularRoute(radius_m=2.0), look_m=(0.2, 0.6), offsets_m=(0.25, -0.25)
    )
    found = on_floor(lines, (0.0, 0.0, 0.0), DOWN)
    # Concentric circles of 1.75 and 2.25 m round (0, 2); samples a centimetre apart leave arcs of 7
    # um.
    left = [2 - np.sqrt(r * r - x * x) for r in (1.75, 2.25) for x in (0.2, 0.6)]
    np.testing.assert_allclose(found[:, 1], left, atol=1e-5)


def test_the_pose_moves_the_paint():
    lines = GroundLines(route=Straight(length_m=20), pose=Pose(xyz=(1, 2, 0), rpy_deg=(0, 0, 90)))
    np.testing.assert_allclose(lines.floor_path[[0, -1]], [[1, 2], [1, 22]], atol=1e-12)


def test_beyond_the_ends_of_the_paint_there_is_nothing():
    lines = GroundLines(route=Straight(length_m=2), look_m=(0.1, 0.3))
    found = on_floor(lines, (1.8, 0.0, 0.0), DOWN)
    assert np.isfinite(found[0]).all() and np.isnan(found[1]).all()


def test_of_several_crossings_the_one_nearest_to_straight_ahead():
    there_and_back = Track(
        pieces=(Piece(length_m=4), Piece(turn_deg=180, radius_m=1), Piece(length_m=4))
    )
    found = on_floor(GroundLines(route=there_and_back), (1.0, 0.1, 0.0), DOWN)
    np.testing.assert_allclose(found[:, 1], -0.1, atol=1e-12)  # the way back is 1.9 m to the left


def test_what_is_seen_where_all_is_well():
    lines = GroundLines(route=CircularRoute(radius_m=3), look_m=(0.1, 0.4), offsets_m=(0.2, -0.2))
    mount = Pose(xyz=(0.3, 0, 0.4), rpy_deg=TILTED).T
    p = transform(mount, lines.straight_ahead(mount, 0.05))
    np.testing.assert_allclose(
        p, [[0.4, 0.15, 0], [0.7, 0.15, 0], [0.4, -0.25, 0], [0.7, -0.25, 0]], atol=1e-12
    )


def test_each_line_has_its_hue():
    lines = GroundLines(route=Straight(), offsets_m=(0.2, -0.2))
    assert lines.hues_deg == (0, 0, 180, 180) and len(lines.points) == 4


def test_refuses():
    for wrong, words in (
        ({"pose": Pose(xyz=(0, 0, 0.1))}, "flat on the floor"),
        ({"pose": Pose(rpy_deg=(0, 5, 0))}, "flat on the floor"),
        ({"look_m": (0.3, 0.1)}, "far 0.02 m or more beyond near"),
        ({"offsets_m": (0.0, 0.05)}, "2 stripe widths"),
        ({"offsets_m": (2.0,)}, "tightest radius, 2 m"),
        ({"motion": {"kind": "carried", "route": {"kind": "straight"}}}, "painted on the floor"),
    ):
        with pytest.raises(ParameterError, match=words):
            GroundLines(**{"route": CircularRoute(radius_m=2.0), **wrong})


class TestBeside:
    """How far a vehicle is beside its way: Route.beside."""

    def test_sign_and_direction(self):
        way = Straight()
        assert way.beside(np.array([3.0, 0.2, 0.1])) == pytest.approx(0.2, abs=1e-12)
        # against it: to its right
        assert way.beside(np.array([3.0, 0.2, np.pi])) == pytest.approx(-0.2, abs=1e-12)

    def test_on_a_circle(self):
        # 5 mm to each side of a sample the arc is taken as its tangent: 6 um.
        assert CircularRoute(radius_m=2.0).beside(np.array([1.9, 2.0, np.pi / 2])) == pytest.approx(
            0.1, abs=1e-5
        )

    def test_at_a_crossing_it_is_the_branch_that_is_driven(self):
        way = FigureEight(length_m=10, width_m=5)
        other = way.at(way.length / 2)
        assert np.cos(other[2]) < 0.2  # the second branch crosses the first at about a right angle
        # on the second it would be about 0
        assert way.beside(np.array([0.0, 0.1, 0.0])) == pytest.approx(0.1, abs=2e-3)
