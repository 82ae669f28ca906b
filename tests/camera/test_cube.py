"""The cube round a camera: right-handed faces, and panels that hold a marker at any seam whole."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.camera import Catadioptric, Fisheye, Perspective, SphericalCamera
from vstestbed.camera.wide import CUBE


def test_faces_are_rotations_that_look_along_the_six_axes():
    looks = {name: tuple(R[:, 2]) for name, R in CUBE.items()}
    assert looks == {
        "front": (0, 0, 1),
        "right": (1, 0, 0),
        "back": (0, 0, -1),
        "left": (-1, 0, 0),
        "up": (0, -1, 0),
        "down": (0, 1, 0),
    }
    for R in CUBE.values():
        np.testing.assert_array_equal(R @ R.T, np.eye(3))
        assert np.linalg.det(R) == 1


def test_what_is_right_of_the_front_face_is_left_in_the_right_one():
    ray = np.array([1.0, 0, 1.0])
    assert (ray @ CUBE["right"])[0] < 0 < (ray @ CUBE["front"])[0]
    above = np.array([0, -1.0, 1.0])
    assert (above @ CUBE["up"])[1] > 0 > (above @ CUBE["front"])[1]


def test_a_marker_anywhere_is_whole_in_a_panel():
    rays = np.random.default_rng(0).normal(size=(3000, 3))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    camera = SphericalCamera()
    # 5 degrees are said to fit. At 1 m that is a radius of .087 m; cube corners are the narrowest
    # places.
    corners = np.array(
        [[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
    ) / np.sqrt(3)
    assert camera.whole(np.concatenate([rays, corners]), 0.08).all()


@pytest.mark.parametrize(
    "camera",
    [Fisheye(width=640, height=640), Catadioptric(width=640, height=640)],
    ids=lambda c: c.kind,
)
def test_whole_ends_where_the_lens_does(camera: Fisheye | Catadioptric):
    end = camera.reach[1]
    for off, whole in ((0.03, False), (0.09, True), (end, True)):
        theta = end - off
        p = np.array(
            [
                [np.sin(theta) * np.cos(a), np.sin(theta) * np.sin(a), np.cos(theta)]
                for a in np.arange(0, 6.2, 0.3)
            ]
        )
        assert (camera.whole(p, 0.05) == whole).all()


def test_a_perspective_camera_has_nothing_whole_behind_it():
    assert Perspective().whole(
        np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0]]), 0.01
    ).tolist() == [True, False, False]
