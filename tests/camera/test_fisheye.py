"""The fisheye lens: OpenCV's model where OpenCV has one, equidistant without coefficients, refused
where it folds.
"""

import cv2
import numpy as np
import pytest

from vstestbed.camera import Fisheye
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import direction

CALIBRATED = (-0.03, 0.01, -0.006, 0.0009)


def up_to(degrees: float, n: int = 500) -> np.ndarray:
    """Points at up to so many degrees from the axis, 0.5 to 5 m off."""
    rng = np.random.default_rng(1)
    ray = direction(
        np.stack([np.radians(rng.uniform(0, degrees, n)), rng.uniform(-np.pi, np.pi, n)], axis=-1)
    )
    return ray * rng.uniform(0.5, 5, (n, 1))


def matrix(lens: Fisheye) -> np.ndarray:
    return np.array([[lens.f, 0, lens.centre[0]], [0, lens.f, lens.centre[1]], [0, 0, 1.0]])


@pytest.mark.parametrize("coefficients", [(0.0,) * 4, CALIBRATED])
def test_projection_is_opencvs(coefficients):
    lens = Fisheye(
        coefficients=coefficients, focal_length_px=180.5, principal_px=(330.5, 230.25), fov_deg=170
    )
    p, K, k = up_to(80), matrix(lens), np.array(coefficients)
    expected, _ = cv2.fisheye.projectPoints(p[:, None], np.zeros(3), np.zeros(3), K, k)
    np.testing.assert_allclose(lens.project(p), expected[:, 0], atol=1e-9)  # rounding at 600 px
    xy = p[:, :2] / p[:, 2:]
    np.testing.assert_allclose(
        lens.project(p), cv2.fisheye.distortPoints(xy[:, None], K, k)[:, 0], atol=1e-9
    )


@pytest.mark.parametrize("coefficients", [(0.0,) * 4, CALIBRATED])
def test_rays_are_opencvs(coefficients):
    lens = Fisheye(coefficients=coefficients, focal_length_px=180.5, fov_deg=170)
    uv = lens.project(up_to(80))
    exact = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-14)
    expected = cv2.fisheye.undistortPoints(
        uv[:, None], matrix(lens), np.array(coefficients), criteria=exact
    )[:, 0]
    np.testing.assert_allclose(lens.normalise(uv), expected, atol=1e-8)


def test_without_coefficients_pixels_are_proportional_to_the_angle():
    lens = Fisheye(width=360, height=360, fov_deg=180)  # 2 px a degree
    theta = np.radians([0, 10, 45, 90])
    uv = lens.project(direction(np.stack([theta, np.zeros(4)], axis=-1)))
    np.testing.assert_allclose(uv[:, 0] - 179.5, [0, 20, 90, 180], atol=1e-12)


def test_it_sees_behind_itself():
    """At 100 degrees a 220-degree lens of 440 px has its point 200 px from the middle; OpenCV's has
    none there.
    """
    lens = Fisheye(width=440, height=440, fov_deg=220)
    p = direction(np.radians([[100.0, 90.0]]))
    assert p[0, 2] < 0
    np.testing.assert_allclose(lens.project(p), [[219.5, 419.5]], atol=1e-9)
    np.testing.assert_allclose(lens.ray(lens.project(p)), p, atol=1e-12)


def test_the_polynomial_goes_on_behind():
    lens = Fisheye(coefficients=CALIBRATED, focal_length_px=100.0, fov_deg=220)
    t, (k1, k2, k3, k4) = np.radians(105), CALIBRATED
    expected = 100 * (t + k1 * t**3 + k2 * t**5 + k3 * t**7 + k4 * t**9)
    uv = lens.project(direction(np.array([[t, 0.0]])))
    np.testing.assert_allclose(uv - lens.centre, [[expected, 0]], atol=1e-10)


def test_a_polynomial_may_rise_up_to_its_turn():
    """k1 = -.1: theta - .1 theta^3 rises up to theta = sqrt(10/3) rad, 209.2 degrees full."""
    assert Fisheye(coefficients=(-0.1, 0, 0, 0)).turn == pytest.approx(np.sqrt(10 / 3))
    lens = Fisheye(coefficients=(-0.1, 0, 0, 0), fov_deg=209.2)
    theta = np.linspace(0, lens.reach[1], 10_001)
    np.testing.assert_allclose(lens.angle(lens.radius(theta)), theta, atol=1e-9)
    with pytest.raises(
        ParameterError,
        match=r"fold the picture over itself within fov_deg = 210; .* a fov_deg below 209\.2",
    ):
        Fisheye(coefficients=(-0.1, 0, 0, 0), fov_deg=210)


def test_bad_lenses_are_refused_in_one_sentence():
    for values, words in (
        (
            {"coefficients": (-0.2, 0, 0, 0)},
            "coefficients fold the picture over itself within fov_deg = 185",
        ),
        ({"coefficients": (0.1, 0.1)}, "coefficients"),
        ({"fov_deg": 361}, "fov_deg"),
        ({"fov_deg": 0}, "fov_deg"),
        ({"coefficients": (float("nan"), 0, 0, 0)}, "coefficients"),
    ):
        with pytest.raises(ParameterError, match=words) as caught:
            Fisheye(**values)
        assert "ArgsKwargs" not in str(caught.value)
