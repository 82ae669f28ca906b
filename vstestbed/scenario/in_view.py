"""Whether a start sees the target."""

from __future__ import annotations

from typing import Any

import numpy as np

from vstestbed.camera import Camera, Perspective
from vstestbed.core.geometry import inverse
from vstestbed.features.observation import Goal
from vstestbed.robots import Robot
from vstestbed.sim.scene.start_pose import camera_start, target_start
from vstestbed.sim.scene.world import World
from vstestbed.targets import Target
from vstestbed.targets.markers import HIDDEN_M
from vstestbed.vision import Detector

VIEW_MARGIN_PX = 10.0
"""Margin round each whole marker in the picture of a random start [px]."""


def in_view(robot: Robot, camera: Camera, target: Target, detector: Detector[Any], goal: Goal, world: World) -> bool:
    """Whether the robot's start has the whole target in the picture, or all of it that counts for the first goal, seen from its front."""
    T_world_camera = camera_start(robot, camera, target)
    T = inverse(T_world_camera) @ target_start(robot, target)
    if detector.rows is not None:  # points that are not its markers: its middle must be seen from the front
        return bool(T[2, 2] > 0.17 and camera.whole(T[None, :3, 3], 0.0, VIEW_MARGIN_PX).all())
    p = target.seen_from(inverse(T))
    facing = float(T[:3, 2] @ T[:3, 3]) / max(float(np.linalg.norm(T[:3, 3])), 1e-9)  # cosine of the view on the plane
    turned = T[2, 2] if isinstance(camera, Perspective) else facing
    faces = turned > 0.17 or not target.one_sided  # within 80 degrees of the target's normal: beyond, discs are slivers
    whole = camera.whole(p, target.marker.radius, VIEW_MARGIN_PX) & ~target.hides(inverse(T))
    if world.scenery is not None and whole.any():
        names = world.scenery_before(T_world_camera, p, target.marker.height_m + HIDDEN_M)
        whole &= np.array([not name for name in names])
    return bool(faces and (whole if goal.counted is None else whole[goal.counted]).all())
