"""The two poses of a plane: closed form, mirror pairs, what determines none."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.geometry import Array, Pose, exp, rigid_error, transform
from vstestbed.vision.pnp import planar_poses

SQUARE = np.array([[-0.25, -0.25, 0], [0.25, -0.25, 0], [0.25, 0.25, 0], [-0.25, 0.25, 0]])
FIVE = np.array([[0.3, 0, 0], [0.1, 0.25, 0], [-0.2, 0.15, 0], [-0.25, -0.1, 0], [0.05, -0.3, 0]])


def see(T: Array, points: Array) -> Array:
    p = transform(T, points)
    return p[:, :2] / p[:, 2:]


@pytest.mark.parametrize("behind", [False, True], ids=["front", "back"])
@pytest.mark.parametrize(
    "points", [SQUARE, FIVE, FIVE @ exp(np.array([0, 0, 0, 0.4, 1, -0.3]))[:3, :3].T + [3, -2, 1]]
)
def test_one_of_the_two_is_the_pose(points: Array, behind: bool) -> None:
    rng = np.random.default_rng(0)
    for _ in range(30):
        R = Pose(rpy_deg=(*rng.uniform(-50, 50, 2), rng.uniform(-180, 180))).T
        if behind:
            R = exp(np.array([0, 0, 0, np.pi, 0, 0])) @ R
        axes = np.linalg.svd(points - points.mean(axis=0))[2]
        T = np.eye(4)
        # the plane roughly frontal, wherever it is in its frame
        T[:3, :3] = R[:3, :3] @ axes * np.linalg.det(axes)
        T[:3, 3] = [*rng.uniform(-0.4, 0.4, 2), rng.uniform(0.8, 3)] - T[:3, :3] @ points.mean(
            axis=0
        )
        found = planar_poses(see(T, points), points)
        assert len(found) == 2
        assert all(
            np.linalg.det(F[:3, :3]) == pytest.approx(1) and (F[3] == [0, 0, 0, 1]).all()
            for F in found
        )
        assert min(sum(rigid_error(F, T)) for F in found) < 1e-9


def test_the_other_is_the_mirror_pose_about_the_line_of_sight() -> None:
    for tilt in (40.0, 10.0, 1.0, 0.01):
        T = Pose(xyz=(0, 0, 2), rpy_deg=(tilt, 0, 20)).T
        a, b = planar_poses(see(T, SQUARE), SQUARE)
        normals = np.array([a[:3, 2], b[:3, 2]])
        np.testing.assert_allclose(normals[0] * [-1, -1, 1], normals[1], atol=1e-9)
        np.testing.assert_allclose(np.degrees(np.arccos(normals[:, 2])), tilt, atol=1e-5)


def test_in_a_frontal_view_both_are_the_same() -> None:
    for turn in np.arange(0, 180, 0.5):
        T = Pose(xyz=(0.1, -0.2, 2), rpy_deg=(0, 0, turn)).T.copy()
        # Seen along the plane's normal from its middle: the target turned to face the camera.
        T[:3, :3] = exp(
            np.array(
                [
                    0,
                    0,
                    0,
                    *np.cross([0, 0, 1], T[:3, 3])
                    / np.hypot(0.1, 0.2)
                    * np.arctan2(np.hypot(0.1, 0.2), 2),
                ]
            )
        )[:3, :3]
        found = planar_poses(see(T, SQUARE), SQUARE)
        assert len(found) == 2
        for F in found:
            assert rigid_error(F, T) == pytest.approx((0, 0), abs=1e-6)  # a square root of rounding


def test_noise_costs_what_a_least_squares_pose_costs() -> None:
    rng, errors = np.random.default_rng(2), []
    T = Pose(xyz=(0.1, 0, 1), rpy_deg=(25, -10, 40)).T
    for _ in range(100):
        found = planar_poses(see(T, FIVE) + rng.normal(0, 0.1 / 800, (5, 2)), FIVE)
        errors.append(min(rigid_error(F, T) for F in found))
    assert np.sqrt(np.mean(np.square(errors), axis=0)) == pytest.approx([3e-4, 1e-3], abs=1e-3)


@pytest.mark.parametrize(
    "xy",
    [np.full((4, 2), 0.1), np.array([[-0.2, 0], [-0.1, 0], [0.1, 0], [0.2, 0.0]])],
    ids=["a point", "a line"],
)
def test_an_image_without_extent_has_none(xy: Array) -> None:
    assert planar_poses(xy, SQUARE) == []


def test_a_plane_whose_middle_is_on_the_horizon_has_none() -> None:
    # Two corners ahead and two behind the camera: the middle is in its plane z = 0.
    T = exp(np.array([0, 0, 0, 1.2, 0, 0]))
    T[:3, 3] = 0.3, 0.4, 0.0
    assert planar_poses(see(T, SQUARE), SQUARE) == []
