"""The spherical camera: the whole sphere in one equidistant disc."""

import numpy as np
import pytest

from vstestbed.camera import Fisheye, SphericalCamera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import direction


def test_the_picture_is_the_equidistant_map():
    lens = SphericalCamera(width=720, height=360)  # 1 px a degree
    theta_phi = np.radians([[0, 0], [30, 0], [90, 90], [90, 180], [135, -90], [179, 0]])
    expected = [[0, 0], [30, 0], [0, 90], [-90, 0], [0, -135], [179, 0]]
    np.testing.assert_allclose(
        lens.project(direction(theta_phi)) - lens.centre, expected, atol=1e-9
    )
    assert lens.f == pytest.approx(180 / np.pi)


def test_it_is_the_fisheye_of_360_degrees():
    lens, fisheye = SphericalCamera(), Fisheye(fov_deg=360)
    p = np.random.default_rng(1).standard_normal((1000, 3))
    np.testing.assert_allclose(lens.project(p), fisheye.project(p), atol=1e-10)


def test_straight_back_is_on_the_ring():
    lens = SphericalCamera()
    back = np.array([[0.0, 0.0, -2.0], [-0.0, -0.0, -1.0], [0.0, -0.0, -1.0]])
    uv = lens.project(back)
    np.testing.assert_allclose(uv - lens.centre, np.tile([240.0, 0.0], (3, 1)), atol=1e-9)
    np.testing.assert_allclose(lens.ray(uv), np.tile([0, 0, -1.0], (3, 1)), atol=1e-12)


def test_every_direction_is_seen():
    p = np.random.default_rng(2).standard_normal((10_000, 3))
    lens = SphericalCamera(width=300, height=200)
    assert lens.inside(lens.project(p)).all()


def test_corners_of_the_picture_are_dark():
    lens = SphericalCamera()
    assert np.isnan(lens.ray(np.array([[0.0, 0.0], [639.0, 479.0]]))).all()


def test_faces_have_a_size():
    assert SphericalCamera().face_px == 256
    with pytest.raises(ParameterError, match="face_px"):
        SphericalCamera(face_px=2)
