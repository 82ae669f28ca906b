"""Refuses views that a craft which flies could not keep."""

from __future__ import annotations

import math

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.robots import Robot
from vstestbed.targets.base import Target

LEVEL_DEG = 1.0
"""A goal view may be off a level craft's by so much [deg]."""


def check_level(robot: Robot, camera: Camera, target: Target, T_camera_target: Array, field: str) -> None:
    """Refuse a goal view in which the craft would lean: it hovers level, and what it sees there is compared with a level craft's.

    Raises:
        ParameterError: it names the field, and what would work.
    """
    if not robot.feet:
        return
    up = (target.T_world_start @ inverse(T_camera_target) @ inverse(camera.mount.T))[2, 2]
    lean = math.degrees(math.acos(max(-1.0, min(1.0, float(up)))))
    if lean > LEVEL_DEG:
        words = f"is the view from a craft that leans by {lean:.3g} deg, and it hovers level; turn the view, or camera.mount, by as much"
        raise ParameterError(field, words)
