"""A vehicle without masses: an observation of its place and its target, and exact motion in the
plane.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, Pose, inverse
from vstestbed.core.planar import composed, moved, pose_on_ground, relative
from vstestbed.features.observation import Goal, Observation
from vstestbed.robots.vehicle import PLANE

CAMERA = Perspective(mount=Pose(xyz=(0.2, 0, 0.8), rpy_deg=(-90, 0, -90)))
POINTS = np.array([[0.0, 0.3, 0.0], [0.0, -0.3, 0.4]])
BASIS = np.eye(6)[:, [0, 5]]
"""The test's motion space: u = (v, w) as a twist of the base itself."""


def goal(place: Array | None = None, gap_m: float | None = None) -> Goal:
    T = inverse(CAMERA.mount.T) @ pose_on_ground(np.array([gap_m or 3.0, 0.0, 0.0]))
    view = Goal.from_view(CAMERA, POINTS, T)
    return replace(view, place=place, gap_m=gap_m)


def observe(
    t: float, place: Array, start: Array, target: Array | None = None, seen: bool = True
) -> Observation:
    uv = np.zeros((2, 2)) if seen else np.full((2, 2), np.nan)
    T = None
    if target is not None:
        T = inverse(pose_on_ground(place) @ CAMERA.mount.T) @ pose_on_ground(target)
    return Observation(t, uv, uv, np.ones(2), T, odometry=relative(start, place), place=place)


def move(place: Array, u: Array, dt: float) -> Array:
    return moved(place, np.array([u[0], 0.0, u[-1]]), dt)


__all__ = ["BASIS", "PLANE", "composed", "goal", "move", "observe"]
