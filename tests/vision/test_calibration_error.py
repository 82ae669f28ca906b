"""Poses with wrong depths, and the goal view of a miscalibrated camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Pose, rigid_error, transform
from vstestbed.targets import Points
from vstestbed.vision.observe import pose_by_depth, shown_goal

SQUARE = np.array([[-0.25, -0.25, 0], [0.25, -0.25, 0], [0.25, 0.25, 0], [-0.25, 0.25, 0]])
T = Pose(xyz=(0.1, -0.05, 1.2), rpy_deg=(10, 20, 30)).T
TARGET = Points(at=tuple(map(tuple, SQUARE.tolist())), pose=Pose())
CAMERA = Perspective(width=640, height=480, fovy_deg=60)


def test_depths_that_are_a_rigid_motion_give_it() -> None:
    other = Pose(xyz=(0, 0, 2), rpy_deg=(0, 0, 0)).T
    points = np.array([[0.1, 0.2, 0], [-0.3, 0.1, 0.2], [0.2, -0.2, 0.1], [0.0, 0.0, 0.5]])
    np.testing.assert_allclose(pose_by_depth(other, points, np.ones(4)), other, atol=1e-12)
    doubled = pose_by_depth(T, SQUARE, np.full(4, 2.0))
    np.testing.assert_allclose(doubled[:3, :3], T[:3, :3], atol=1e-12)
    np.testing.assert_allclose(doubled[:3, 3], 2 * T[:3, 3], atol=1e-12)


def test_unequal_depths_tilt_the_target_as_the_best_fit() -> None:
    scale = np.array([1.1, 0.9, 0.9, 1.1])
    found = pose_by_depth(T, SQUARE, scale)
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1)
    measured = scale[:, None] * transform(T, SQUARE)

    def misfit(F: np.ndarray) -> float:
        return float(np.sum((transform(F, SQUARE) - measured) ** 2))

    rng = np.random.default_rng(0)
    for _ in range(20):
        nearby = (
            found @ Pose(xyz=tuple(rng.normal(0, 0.02, 3)), rpy_deg=tuple(rng.normal(0, 2, 3))).T
        )
        assert misfit(nearby) > misfit(found)


def test_points_on_a_line_keep_the_rotation() -> None:
    line = np.array([[-0.25, 0, 0], [0, 0, 0], [0.25, 0, 0]])
    found = pose_by_depth(T, line, np.array([1.0, 1.1, 1.2]))
    np.testing.assert_array_equal(found[:3, :3], T[:3, :3])


def test_the_goal_of_a_right_calibration_is_the_true_view_and_of_a_wrong_one_its_own_pose() -> None:
    exact = shown_goal(CAMERA, CAMERA, TARGET, T)
    assert rigid_error(exact.T_camera_target, T) == pytest.approx((0, 0), abs=1e-9)
    np.testing.assert_allclose(exact.uv, CAMERA.project(transform(T, SQUARE)))
    wrong = shown_goal(CAMERA, Perspective(width=640, height=480, fovy_deg=50), TARGET, T)
    # A longer focal length puts the target farther away, nearly in its ratio.
    ratio = np.tan(np.radians(30)) / np.tan(np.radians(25))
    assert wrong.T_camera_target[2, 3] / T[2, 3] == pytest.approx(ratio, rel=0.03)
    np.testing.assert_allclose(wrong.depth, transform(wrong.T_camera_target, SQUARE)[:, 2])
    # leave the pose open: the true one
    two = shown_goal(CAMERA, CAMERA, replace(TARGET, at=TARGET.at[:2]), T)
    np.testing.assert_array_equal(two.T_camera_target, T)
