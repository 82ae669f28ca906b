"""Vehicles on a floor: poses, arcs, random starts."""

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import exp, inverse
from vstestbed.core.planar import GroundPose, motion_between, moved, place_of, pose_on_ground
from vstestbed.robots.omni import Omni
from vstestbed.robots.vehicle import PLANE, GroundBox, GroundStart

RNG = np.random.default_rng(0)


def test_the_pose_has_its_x_axis_along_the_heading():
    T = pose_on_ground(np.array([1.0, -2.0, np.pi / 2]))
    # a metre ahead is a metre along y
    np.testing.assert_allclose(T @ [1, 0, 0, 1], [1, -1, 0, 1], atol=1e-15)
    np.testing.assert_allclose(T @ [0, 0, 1, 1], [1, -2, 1, 1], atol=1e-15)


def test_configuration_and_pose_are_inverse():
    at = RNG.uniform(-3, 3, (50, 3))
    np.testing.assert_allclose(place_of(pose_on_ground(at)), at, atol=1e-14)


def test_an_arc_is_the_exponential_of_the_body_twist():
    at, motion = RNG.uniform(-3, 3, (200, 3)), RNG.uniform(-2, 2, (200, 3))
    motion[:20, 2] *= (
        1e-9  # nearly straight, where (1 - cos) / theta loses its digits if written so
    )
    T = pose_on_ground(at) @ exp(motion @ PLANE.T * 0.7)
    np.testing.assert_allclose(pose_on_ground(moved(at, motion, 0.7)), T, atol=1e-12)


def test_a_quarter_circle():
    # Radius 2 m to the left from the origin: ends at (2, 2), facing y.
    np.testing.assert_allclose(
        moved(np.zeros(3), [np.pi, 0, np.pi / 2], 1.0), [2, 2, np.pi / 2], atol=1e-15
    )


def test_straight_on_and_at_rest():
    at = np.array([1.0, 2.0, 0.3])
    np.testing.assert_array_equal(moved(at, np.zeros(3), 1.0), at)
    np.testing.assert_allclose(
        moved(at, [2.0, 0, 0], 0.5) - at, [np.cos(0.3), np.sin(0.3), 0], atol=1e-15
    )


def test_the_motion_between_two_configurations_is_the_arc_between_them():
    at, motion = RNG.uniform(-3, 3, (200, 3)), RNG.uniform(-2, 2, (200, 3))
    motion[:20, 2] = 0.0
    np.testing.assert_allclose(motion_between(at, moved(at, motion, 0.4), 0.4), motion, atol=1e-12)


def test_the_motion_between_two_headings_takes_the_short_way():
    got = motion_between(np.array([0, 0, np.radians(179)]), np.array([0, 0, np.radians(-179)]), 1.0)
    np.testing.assert_allclose(got, [0, 0, np.radians(2)], atol=1e-12)


class TestStart:
    def test_random_starts_fill_their_box(self):
        start = GroundStart(
            nominal=GroundPose(x=1, y=2, heading_deg=90),
            random=GroundBox(x=0.5, y=0.2, heading_deg=30),
        )
        rng = np.random.default_rng(1)
        drawn = np.array([Omni(start=start.drawn(rng)).configuration() for _ in range(300)])
        offset = (drawn - Omni(start=start).configuration()) / [0.5, 0.2, np.radians(30)]
        assert np.abs(offset).max() <= 1
        # Of 300 even draws a side's last twentieth is missed with probability .975^300 = 5e-4; the
        # seed is fixed.
        assert (offset.max(axis=0) > 0.95).all() and (offset.min(axis=0) < -0.95).all()

    def test_one_seed_one_start(self):
        start = GroundStart(random=GroundBox(x=1, y=1, heading_deg=10))
        assert start.drawn(np.random.default_rng(3)) == start.drawn(np.random.default_rng(3))

    def test_without_a_box_it_says_what_is_missing(self):
        with pytest.raises(ParameterError, match=r"robot\.start\.random is missing"):
            GroundStart().drawn(np.random.default_rng(0))

    def test_a_negative_width_is_refused(self):
        with pytest.raises(ParameterError, match="heading_deg"):
            GroundBox(heading_deg=-1)


def test_the_plane_leaves_out_what_a_floor_takes():
    np.testing.assert_array_equal(PLANE @ [1, 2, 3], [1, 2, 0, 0, 0, 3])
    np.testing.assert_array_equal(PLANE.T @ PLANE, np.eye(3))
    assert np.allclose(inverse(pose_on_ground(np.zeros(3))), np.eye(4))
