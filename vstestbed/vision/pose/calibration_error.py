"""What a wrong calibration makes of a view: the goal as shown, and poses from markers whose depths are told wrong."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, transform
from vstestbed.features.observation import Goal
from vstestbed.vision.pose.pnp import solve_pose_from_rays


def shown_goal(true: Camera, believed: Camera, points: Array, T_camera_target: Array) -> Goal:
    """The goal view that the true camera showed, as the believed one understands it.

    The pixels are the picture's own; the pose, and with it every depth, is solved from them and the target's measures. Markers
    whose pose the pixels leave open keep the depths of the place where they were shown.

    Args:
        true: the camera that took the picture. believed: the one it is taken for.
        points: markers in the target's frame (N, 3) [m].
        T_camera_target: where the picture was taken (4, 4).
    """
    uv = true.project(transform(T_camera_target, points))
    ray = believed.ray(uv)
    solved = solve_pose_from_rays(ray, points, T_camera_target) if len(points) > 2 and np.isfinite(ray).all() else None
    T = T_camera_target if solved is None else solved
    return Goal.of_picture(believed, uv, transform(T, points), T)


def pose_by_depth(T: Array, points: Array, scale: Array) -> Array:
    """The pose (4, 4) that fits markers placed along their rays at depths told wrong by `scale` (N,).

    Of rigid placements of the points the one next to scale_i T P_i: R from the singular vectors of the covariance,
    t = mean(scale_i T P_i) - R mean(P_i). A common factor leaves the rotation and moves the markers' middle by that factor.

    Reference: Umeyama 1991, eqs 40-42 without scale, doi:10.1109/34.88573.
    """
    q = scale[:, None] * transform(T, points)
    at, to = points.mean(axis=0), q.mean(axis=0)
    U, s, Vt = np.linalg.svd((q - to).T @ (points - at))
    line = s[1] < 1e-9 * s[0]  # the turn about it is the old one
    R = T[:3, :3] if line else U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = R, to - R @ at
    return out
