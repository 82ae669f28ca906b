"""A line of the picture as a line on the floor, and how both change when the vehicle moves."""

import numpy as np
import pytest

from vstestbed.core.geometry import Pose, inverse, transform
from vstestbed.core.planar import moved, pose_on_ground
from vstestbed.features.line import (
    LineFeature,
    floor_plane,
    floor_point,
    line_interaction,
    line_on_floor,
)
from vstestbed.robots import Mount
from vstestbed.robots.vehicle import PLANE

MOUNTS = {
    "straight down": Pose(xyz=(0.5, 0, 0.3), rpy_deg=(180, 0, -90)).T,
    "ahead and down": Pose(xyz=(0.2, 0.1, 0.4), rpy_deg=(-150, 0, -90)).T,
    "any": Pose(xyz=(0.3, -0.2, 0.5), rpy_deg=(-140, 12, -75)).T,
}


@pytest.fixture(params=MOUNTS)
def mount(request):
    return MOUNTS[request.param]


def picture_of(y0, phi, mount, place=(0.0, 0.0, 0.0)):
    """(rho, theta) of the floor's line y = y0 + x tan(phi) in the world, seen from a vehicle at a
    place.
    """
    x = np.array([0.4, 0.8])
    p = np.column_stack([x, y0 + x * np.tan(phi), np.zeros(2)])
    p = transform(inverse(pose_on_ground(np.array(place)) @ mount), p)
    return LineFeature().measure(p[:, :2] / p[:, 2:])


def test_the_floors_plane_holds_the_floor(mount):
    p = transform(inverse(mount), np.array([[1.0, 2, 0], [-3, 0.5, 0], [0, 0, 0]]))
    np.testing.assert_allclose(p @ floor_plane(mount)[:3] + floor_plane(mount)[3], 0, atol=1e-12)


def test_a_ray_meets_the_floor_where_it_came_from(mount):
    at = np.array([[0.7, 0.1], [0.4, -0.2]])
    p = transform(inverse(mount), np.column_stack([at, np.zeros(2)]))
    np.testing.assert_allclose(floor_point(p[:, :2] / p[:, 2:], mount), at, atol=1e-12)


def test_a_ray_that_goes_up_meets_no_floor():
    ahead = Pose(xyz=(0, 0, 1), rpy_deg=(-90, 0, -90)).T
    assert np.isnan(floor_point(np.array([[0.0, -0.1]]), ahead)).all()


def test_the_line_on_the_floor_is_the_one_that_was_painted(mount):
    (y, phi), _ = line_on_floor(*picture_of(0.1, 0.3, mount), mount, 0.6)
    np.testing.assert_allclose([y, phi], [0.1 + 0.6 * np.tan(0.3), 0.3], atol=1e-12)


def test_its_name_does_not_matter(mount):
    rho, theta = picture_of(0.1, 0.3, mount)
    np.testing.assert_allclose(
        line_on_floor(-rho, theta + np.pi, mount, 0.6)[0],
        line_on_floor(rho, theta, mount, 0.6)[0],
        atol=1e-12,
    )


def test_the_derivative_is_the_finite_difference(mount):
    s, h = picture_of(-0.1, 0.25, mount), 1e-6
    _, J = line_on_floor(*s, mount, 0.6)
    for k in range(2):
        step = h * np.eye(2)[k]
        numeric = (
            line_on_floor(*(s + step), mount, 0.6)[0] - line_on_floor(*(s - step), mount, 0.6)[0]
        ) / (2 * h)
        np.testing.assert_allclose(J[:, k], numeric, atol=1e-7)


def test_the_chain_through_the_interaction_matrix_is_what_a_driving_vehicle_sees(mount):
    """d(y, phi)/dt = J L B u, against lines seen from places a moment before and after; and in
    closed form.
    """
    rho, theta = picture_of(0.08, -0.2, mount)
    (y, phi), J = line_on_floor(rho, theta, mount, 0.6)
    rows = J @ line_interaction(rho, theta, floor_plane(mount)) @ Mount.of(mount).to_camera @ PLANE
    h = 1e-5
    for k, motion in enumerate(np.eye(3)):
        after, before = (
            picture_of(0.08, -0.2, mount, moved(np.zeros(3), motion, t)) for t in (h, -h)
        )
        numeric = (line_on_floor(*after, mount, 0.6)[0] - line_on_floor(*before, mount, 0.6)[0]) / (
            2 * h
        )
        np.testing.assert_allclose(rows[:, k], numeric, atol=1e-6)
    # y_dot = tan(phi) vx - vy - (X + y tan(phi)) w,  phi_dot = -w
    np.testing.assert_allclose(
        rows, [[np.tan(phi), -1, -(0.6 + y * np.tan(phi))], [0, 0, -1]], atol=1e-12
    )
