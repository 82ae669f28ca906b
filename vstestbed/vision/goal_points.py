"""Points of the goal's picture as a goal: their depths by the depth camera or by the target's plane."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.features.depth import depth_at
from vstestbed.features.observation import Goal


def goal_of_points(goal: Goal, uv: Array) -> Goal:
    """The goal with other points: those at uv (K, 2) [px] of its picture, in place of the target's markers.

    Their depths are the depth camera's at the nearest pixel where it measured, else those of the target's plane z = 0 at the goal pose,
    which the robot knows as it knows a target's dimensions.
    """
    ray = goal.camera.ray(uv)
    z = _depth_of_plane(goal.T_camera_target, ray)
    if goal.image is not None and goal.image.depth is not None:
        measured = depth_at(goal.image.depth, uv)
        z = np.where(np.isfinite(measured), measured, z)
    z = np.where(z > 0, z, np.nan)
    p = ray * (z / ray[:, 2])[:, None]
    known = np.isfinite(p[:, 0])
    if np.count_nonzero(known) < 3:  # they span no plane
        reach = np.where(known, np.linalg.norm(p, axis=1), np.nan)
        return replace(goal, uv=uv, depth=p[:, 2], ray=ray, range=reach, counted=known if len(uv) else None)
    made = Goal.of_picture(goal.camera, uv[known], p[known], goal.T_camera_target)
    full = made.rows(np.where(known, np.cumsum(known) - 1, -1)) if not known.all() else made
    return replace(goal, uv=uv, depth=full.depth, ray=ray, range=full.range, plane=made.plane, counted=None if known.all() else known)


def points_of(goal: Goal) -> Array:
    """The goal's points (K, 3) in the target's frame [m], by their depths in its view."""
    return transform(inverse(goal.T_camera_target), goal.ray * goal.range[:, None])


def _depth_of_plane(T_camera_target: Array, ray: Array) -> Array:
    """Depth (K,) [m] along unit rays (K, 3) at which they meet the target's plane z = 0; negative behind the camera."""
    normal = T_camera_target[:3, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        return (normal @ T_camera_target[:3, 3]) / (ray @ normal) * ray[:, 2]
