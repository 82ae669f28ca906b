"""The perspective camera: pixel and ray, intrinsics both ways, and a distortion that ends where its
polynomial does.
"""

import cv2
import numpy as np
import pytest

from vstestbed.camera import Camera, Perspective
from vstestbed.core.errors import ParameterError

BARREL = (-0.2, 0.05, 0.001, -0.002, 0.0)


def test_the_textbooks_lens_both_ways():
    by_angle = Perspective(width=1000, height=1000, fovy_deg=2 * np.degrees(np.arctan(500 / 800)))
    by_lens = Perspective(width=1000, height=1000, focal_length_m=0.008, pixel_size_m=1e-5)
    assert by_lens.f == pytest.approx(800) == by_angle.f
    # A goal of the textbook: corners of a .5 m square 1 m off lie 200 px from the middle of the
    # picture, (499.5, 499.5).
    corner = by_lens.project(np.array([[0.25, -0.25, 1.0]]))[0]
    np.testing.assert_allclose(corner, [699.5, 299.5], atol=1e-9)


@pytest.mark.parametrize("distortion", [None, BARREL])
def test_projection_is_opencvs(distortion):
    camera = Perspective(distortion=distortion, principal_px=(330.5, 230.25))
    p = np.random.default_rng(1).uniform([-0.5, -0.4, 0.9], [0.5, 0.4, 1.5], (200, 3))
    expected, _ = cv2.projectPoints(
        p, np.zeros(3), np.zeros(3), camera.K, np.array(distortion or (0.0,) * 5)
    )
    np.testing.assert_allclose(camera.project(p), expected[:, 0], atol=1e-9)  # rounding at 1000 px


@pytest.mark.parametrize("distortion", [None, BARREL])
def test_rays_invert_projection(distortion):
    camera = Perspective(distortion=distortion)
    p = np.random.default_rng(2).uniform([-0.5, -0.4, 0.9], [0.5, 0.4, 1.5], (3, 50, 3))
    unit = p / np.linalg.norm(p, axis=-1, keepdims=True)
    np.testing.assert_allclose(camera.ray(camera.project(p)), unit, atol=1e-12)


@pytest.mark.parametrize("distortion", [None, BARREL])
def test_every_pixel_has_a_ray(distortion):
    """A detector relies on it: only blobs of wide lenses are tested for one (`sees_all`)."""
    camera = Perspective(width=64, height=48, distortion=distortion)
    assert camera.sees_all
    assert np.isfinite(camera.ray(np.argwhere(np.ones((64, 48))) + 0.0)).all()


def test_nothing_is_seen_behind_the_lens_or_in_its_plane():
    assert np.isnan(Perspective().project(np.array([[0.1, 0.1, -1.0], [0.1, 0.1, 0.0]]))).all()


def test_a_distortion_does_not_fold_far_things_into_the_picture():
    """k1 = -.1: r (1 - .1 r^2) rises up to r = sqrt(10/3) = 1.826; at r = 3 the polynomial is back
    at .3, well inside.
    """
    camera = Perspective(distortion=(-0.1, 0.0, 0.0, 0.0, 0.0))
    assert camera.reach2 == pytest.approx(10 / 3)
    assert np.isfinite(camera.project(np.array([[1.8, 0.0, 1.0]]))).all()
    assert np.isnan(camera.project(np.array([[1.9, 0.0, 1.0], [3.0, 0.0, 1.0]]))).all()


def test_bad_lenses_are_refused_in_one_sentence():
    for values, words in (
        ({"focal_length_m": 0.008}, "pixel_size_m is missing"),
        (
            {"focal_length_m": 0.008, "pixel_size_m": 1e-5, "fovy_deg": 60},
            "excludes focal_length_m",
        ),
        ({"principal_px": (700, 200)}, "must be within the 640 x 480 picture"),
        ({"distortion": (-0.9, 0, 0, 0, 0)}, "distortion folds the picture over itself"),
        ({"fovy_deg": float("nan")}, "fovy_deg"),
    ):
        with pytest.raises(ParameterError, match=words) as caught:
            Perspective(**values)
        assert "ArgsKwargs" not in str(caught.value)


def test_whole_without_distortion_is_what_every_lens_says():
    rng = np.random.default_rng(1)
    p = np.concatenate(
        [rng.uniform((-1.2, -1, 0.3), (1.2, 1, 3), (400, 3)), [[0.0, 0.0, -1.0], [0.1, 0.0, 0.0]]]
    )
    for camera in (Perspective(), Perspective(width=500, height=400, principal_px=(100.0, 260.0))):
        for radius, margin in ((0.02, 0.0), (0.1, 10.0)):
            found = camera.whole(p, radius, margin)
            np.testing.assert_array_equal(found, Camera.whole(camera, p, radius, margin))
            assert 0 < found.sum() < len(p)
    np.testing.assert_array_equal(
        camera.whole(p.reshape(3, 134, 3), 0.02), camera.whole(p, 0.02).reshape(3, 134)
    )
