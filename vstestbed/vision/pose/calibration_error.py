"""Effects of calibration errors: the goal view as shown to a miscalibrated camera, and poses with wrong depths."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, transform
from vstestbed.features.observation import Goal
from vstestbed.targets.base import Target
from vstestbed.vision.pose.pnp import solve_pose_from_rays


def shown_goal(true: Camera, believed: Camera, target: Target, T_camera_target: Array) -> Goal:
    """The goal view recorded by the true camera and interpreted with the believed calibration (teach by showing).

    The pixels are those of the true camera; the pose, and with it every depth, is solved from them and the target's dimensions
    with the believed calibration. Where the pixels leave the pose open, the true one is kept. (Of a ball the depths follow from its size.)

    Args:
        true: the camera that took the picture.
        believed: its calibration as known to the robot.
        target: its markers.
        T_camera_target: true pose where the picture was taken, shape (4, 4).
    """
    points = target.points
    uv = true.project(target.points_at(T_camera_target))
    ray = believed.ray(uv)
    if (sized := target.by_size(ray)) is not None:
        return Goal.of_picture(believed, uv, sized, T_camera_target)
    placed = len(target.places) > 2 and bool(np.isfinite(ray).all())
    solved = solve_pose_from_rays(ray, points, T_camera_target) if placed else None
    T = T_camera_target if solved is None else solved
    return Goal.of_picture(believed, uv, target.points_at(T), T)


def pose_by_depth(T: Array, points: Array, scale: Array) -> Array:
    """The pose (4, 4) that fits markers whose depths along their rays are multiplied by `scale` (N,).

    Rigid registration of the points P_i to scale_i T P_i: R from the singular vectors of the covariance,
    t = mean(scale_i T P_i) - R mean(P_i). A common factor leaves the rotation and scales the centroid's position.

    Reference: Umeyama 1991, eqs 40-42 without scale, doi:10.1109/34.88573.
    """
    q = scale[:, None] * transform(T, points)
    at, to = points.mean(axis=0), q.mean(axis=0)
    U, s, Vt = np.linalg.svd((q - to).T @ (points - at))
    line = s[1] < 1e-9 * s[0]  # collinear: the registration leaves the rotation about the line open, the old one is kept
    R = T[:3, :3] if line else U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = R, to - R @ at
    return out


def scaled(
    depth: Array, reach: Array | None, pose: Array | None, points: Array, scale: Array | None
) -> tuple[Array, Array | None, Array | None]:
    """Depths and ranges (N,) [m] of points (N, 3) in the target's frame and its pose (4, 4), with depths wrong by `scale` (N,)."""
    if scale is None:
        return depth, reach, pose
    wrong = None if pose is None else pose_by_depth(pose, points, scale)
    return depth * scale, None if reach is None else reach * scale, wrong
