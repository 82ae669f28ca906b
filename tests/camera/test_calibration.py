"""Believed cameras: each error does what it says; what a lens does not have is refused."""

import numpy as np
import pytest

from vstestbed.camera import Calibration, Catadioptric, Fisheye, Perspective, SphericalCamera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose

P = np.array([[0.3, -0.2, 1.5], [-0.4, 0.1, 0.9]])
PIXELS = Perspective(width=1000, height=1000, focal_length_m=0.008, pixel_size_m=1e-5)
LENSES = [Perspective(), PIXELS, Fisheye(), Catadioptric()]


@pytest.mark.parametrize("camera", LENSES, ids=lambda c: c.kind)
def test_focal_error_stretches_the_picture_about_the_believed_centre(camera):
    believed = Calibration(focal_error=0.1, principal_error_px=(12.0, -7.0)).believed(camera)
    np.testing.assert_allclose(believed.centre, camera.centre + [12, -7])
    # u = f m + c: rounding of a tangent there and back for a field of view in degrees.
    np.testing.assert_allclose(
        believed.project(P) - believed.centre, 1.1 * (camera.project(P) - camera.centre), rtol=1e-12
    )


def test_without_error_it_is_the_camera_itself():
    assert Calibration().believed(PIXELS) is PIXELS
    assert Calibration(goal="shown", depth_factor=2).believed(PIXELS) is PIXELS


def test_mount_error_is_in_the_true_cameras_frame():
    camera = Perspective(mount=Pose(xyz=(0.1, 0, 0.2), rpy_deg=(0, 30, 90)))
    error = Pose(xyz=(0.01, 0.02, 0.03), rpy_deg=(0, 5, 40))
    believed = Calibration(mount_error=error).believed(camera)
    np.testing.assert_allclose(believed.mount.T, camera.mount.T @ error.T, atol=1e-12)
    np.testing.assert_array_equal(believed.project(P), camera.project(P))


def test_distortion_that_nobody_knows_of():
    lens = Perspective(distortion=(-0.2, 0.05, 0.001, -0.001, 0.0))
    np.testing.assert_array_equal(
        Calibration(ignores_distortion=True).believed(lens).project(P), Perspective().project(P)
    )
    fisheye = Fisheye(coefficients=(0.01, 0, 0, 0), focal_length_px=150.0)
    believed = Calibration(ignores_distortion=True).believed(fisheye)
    np.testing.assert_allclose(
        believed.project(P), Fisheye(focal_length_px=150.0).project(P), atol=1e-12
    )


def test_what_a_lens_does_not_have_is_refused():
    for error, camera, words in (
        ({"focal_error": 0.1}, SphericalCamera(), "no lens errors with camera spherical"),
        ({"ignores_distortion": True}, Catadioptric(), "lenses perspective and fisheye"),
        (
            {"principal_error_px": (400.0, 0.0)},
            Perspective(),
            "must be within the 640 x 480 picture",
        ),
    ):
        with pytest.raises(ParameterError, match=words):
            Calibration(**error).believed(camera)


def test_depths_are_told_wrong_by_the_factor_and_the_spread():
    scale = Calibration(depth_factor=2.0, depth_spread=0.3).depth_scale(
        20_000, np.random.default_rng(0)
    )
    # Of 20 000 numbers the mean is known to .3 / 141 = .002, the deviation to .3 / 200 = .0015;
    # three times that.
    assert np.log(scale).mean() == pytest.approx(np.log(2), abs=0.0065)
    assert np.log(scale).std() == pytest.approx(0.3, abs=0.005)
    assert Calibration().depth_scale(4, np.random.default_rng(0)) is None
