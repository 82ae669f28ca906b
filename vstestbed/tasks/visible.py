"""Can the camera see what a goal view asks for, and does the robot stand as its camera must?"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.laws import Law
from vstestbed.robots import Robot
from vstestbed.targets import Target
from vstestbed.vision import Detector

PLANE_INPUTS = {"xy", "depth", "relative"}
"""Fields of an observation that exist only for what is in front of the camera."""
LEVEL_DEG = 1.0
"""The craft of a goal view may lean by so much [deg]."""


def check_visible(
    camera: Camera,
    target: Target,
    law: Law[Any],
    detector: Detector[Any],
    field: str,
    T_camera_target: Array,
    counted: NDArray[np.bool_] | None,
) -> None:
    """Refuse a goal view with a marker that counts outside the picture, or any behind an image plane.

    Raises:
        ParameterError: it names the field, the markers, and what would work.
    """
    p = target.seen_from(inverse(T_camera_target))
    counted = np.ones(len(p), dtype=bool) if counted is None else counted
    uv, flat = camera.project(p), isinstance(camera, Perspective)
    behind = p[:, 2] <= 0 if flat or PLANE_INPUTS & set(law.inputs) else np.zeros(len(p), dtype=bool)
    has_borders = len(camera.panels) == 1 and getattr(detector, "field_of_view", "limited") == "limited"  # an oracle may see all round
    outside = ~(camera.inside(uv) if has_borders else np.isfinite(uv[:, 0]))
    bad = [str(i) for i in np.flatnonzero(behind if behind.any() else outside & counted)]
    if not bad:
        return
    where, remedy = f"outside the {camera.width} x {camera.height} picture", "a wider camera"
    if behind.any():
        where = "behind the camera"
        if not flat:
            where += f", where law {law.kind} has no image plane to work in"
            remedy = "a law of rays (feature spherical) or poses"
    markers = f"marker {bad[0]} is" if len(bad) == 1 else f"markers {', '.join(bad)} are"
    words = f"is a view in which {markers} {where}; move the goal back, or use {remedy} or a smaller target"
    raise ParameterError(field, words)


def check_level(robot: Robot, camera: Camera, target: Target, T_camera_target: Array, field: str) -> None:
    """Refuse a goal view in which a craft would lean: it hovers level, and what it sees there is compared with a level craft's.

    Raises:
        ParameterError: it names the field, and what would work.
    """
    if robot.base != "floating":
        return
    up = (target.T_world_start @ inverse(T_camera_target) @ inverse(camera.mount.T))[2, 2]
    lean = math.degrees(math.acos(max(-1.0, min(1.0, float(up)))))
    if lean > LEVEL_DEG:
        words = f"is the view from a craft that leans by {lean:.3g} deg, and it hovers level; turn the view, or camera.mount, by as much"
        raise ParameterError(field, words)
