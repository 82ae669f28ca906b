"""Pose and homography of four points of a plane, as a survey's programs print them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vstestbed.core.geometry import Array, transform
from vstestbed.vision.homography import homography
from vstestbed.vision.pnp import solve_pose

# Marchand, Uchiyama & Spindler 2016, doi:10.1109/TVCG.2015.2513408; its programs,
# github.com/lagadic/camera_localization, and what their pages print:
# doc/tutorial-pose-gauss-newton-visp.doc, tutorial-pose-dlt-planar-visp.doc,
# tutorial-homography-opencv.doc.
POINTS = 0.2 * np.array([[-1, -1, 0], [2, -1, 0], [1, 1, 0], [-1, 1, 0]])
PRINTED_R = [
    [0.7072945484, -0.706170438, 0.03252282796],
    [0.706170438, 0.7036809008, -0.078463382],
    [0.03252282796, 0.078463382, 0.9963863524],
]
PRINTED_H = [
    [0.5425233873981674, -0.04785624324415742, 0.03308292557420141],
    [0.0476448024215215, 0.5427592708789931, 0.005830349194436123],
    [-0.02550335176952741, -0.005978041062955012, 0.6361649706821216],
]


SPACE = 0.1 * np.array([[-2, -2, 0], [2, -2, 2], [2, 2, -1], [-2, 2, 0]])
# tutorial-pose-dementhon-visp.doc prints the true rotation, as above, and this one by POSIT.
POSIT_R = [
    [0.6172726698, -0.7813181607, 0.09228425059],
    [0.690659622, 0.4249461799, -0.5851581245],
    [0.4179788298, 0.4249391234, 0.8019325685],
]


def pose(xyz: list[float], theta_u_deg: list[float]) -> Array:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(theta_u_deg, degrees=True).as_matrix()
    T[:3, 3] = xyz
    return T


def seen(T: Array, points: Array = POINTS) -> Array:
    """Normalised coordinates (4, 2) of the points."""
    p = transform(T, points)
    return p[:, :2] / p[:, 2:]


@pytest.mark.parametrize("z", [0.5, 1.2])
def test_the_pose_of_four_points(z: float):
    """By Gauss and Newton from .5 m, by a homography from 1.2 m; here from no first guess."""
    found = solve_pose(seen(pose([-0.1, 0.1, z], [5, 0, 45])), POINTS)
    assert found is not None
    # Half of the tenth digit.
    np.testing.assert_allclose(found[:3, :3], PRINTED_R, atol=0.5e-10)
    np.testing.assert_allclose(found[:3, 3], [-0.1, 0.1, z], atol=0.5e-10)


def test_where_posit_is_printed_33_degrees_off_the_pose_is_right():
    found = solve_pose(seen(pose([-0.1, 0.1, 0.5], [5, 0, 45]), SPACE), SPACE)
    assert found is not None
    np.testing.assert_allclose(found[:3, :3], PRINTED_R, atol=0.5e-10)
    np.testing.assert_allclose(found[:3, 3], [-0.1, 0.1, 0.5], atol=0.5e-10)
    off = Rotation.from_matrix(found[:3, :3].T @ np.array(POSIT_R)).magnitude()
    assert np.degrees(off) == pytest.approx(33.3, abs=0.1)


def test_the_homography_between_two_views():
    first = pose([-0.1, 0.1, 1.2], [5, 0, 45])
    second = pose([0.01, 0.01, 0.2], [0, 3, 5]) @ first
    H = homography(seen(first), seen(second), least=0.01)
    assert H is not None
    # The programs scale it to a Frobenius norm of 1; rounding of their singular value decomposition
    # and ours.
    np.testing.assert_allclose(H / np.linalg.norm(H) * np.sign(H[2, 2]), PRINTED_H, atol=1e-14)
