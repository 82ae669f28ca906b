"""Checks of goal views: markers within the picture and not hidden, a flying robot level."""

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
from vstestbed.targets.markers import HIDDEN_M
from vstestbed.tasks.setup import Setup
from vstestbed.vision import Detector

PLANE_INPUTS = {"xy", "depth", "relative"}
"""Fields of an observation that exist only for points in front of the camera."""
LEVEL_DEG = 1.0
"""Largest tilt of the craft at a goal view [deg]."""


def check_visible(setup: Setup, field: str, T_camera_target: Array, counted: NDArray[np.bool_] | None) -> None:
    """Refuse a goal view with a marker that counts outside the picture or hidden, or any behind an image plane.

    Args:
        setup: the experiment's parts. field: of the view. T_camera_target: its pose (4, 4). counted: the markers that count (N,);
            None: all.

    Raises:
        ParameterError: it names the field, the markers, what hides them, and what would work.
    """
    camera, target, law, detector = setup.camera, setup.target, setup.law, setup.detector
    p = target.seen_from(inverse(T_camera_target))
    counted = np.ones(len(p), dtype=bool) if counted is None else counted
    if (behind := _behind_image_plane(camera, law, p)).any():
        raise _not_visible(field, target, behind, *_behind_words(camera, law))
    if detector.rows is not None:  # it finds other points than the target's markers
        return
    if (outside := _outside_picture(camera, detector, p) & counted).any():
        where = f"outside the {camera.width} x {camera.height} picture"
        raise _not_visible(field, target, outside, where, "a wider camera")
    if _limited(detector):
        _check_hidden(setup, field, T_camera_target, counted)


def _check_hidden(setup: Setup, field: str, T_camera_target: Array, counted: NDArray[np.bool_]) -> None:
    """Refuse a goal view in which the target itself, or the scenery, hides a marker that counts."""
    target = setup.target
    if (hidden := target.hides(inverse(T_camera_target)) & counted).any():
        words = f"is a view in which {_markers(target, hidden)} hidden by the target itself"
        raise ParameterError(field, f"{words}; move the goal, or let goal.markers name those that are to be seen")
    if target.moves and not target.on_gripper:  # where the goal view is in the room is not known before the run
        return
    T_world_camera = setup.camera.mount.T if target.on_gripper else target.T_world_start @ inverse(T_camera_target)
    names = setup.world.scenery_before(T_world_camera, target.seen_from(inverse(T_camera_target)), target.marker.height_m + HIDDEN_M)
    if (hidden := np.array([bool(name) for name in names]) & counted).any():
        what = ", ".join(dict.fromkeys(name for name, counts in zip(names, hidden, strict=True) if counts))
        words = f"is a view in which {_markers(target, hidden)} hidden by the scenery ({what})"
        remedy = "move the goal, or the scenery by world.scenery.pose, or let goal.markers name the markers that are to be seen"
        raise ParameterError(field, f"{words}; {remedy}")


def _behind_image_plane(camera: Camera, law: Law[Any], p: Array) -> NDArray[np.bool_]:
    """Which markers (N, 3) lie behind a plane that the lens or the law projects them onto; none for a law of rays or poses."""
    if isinstance(camera, Perspective) or PLANE_INPUTS & set(law.inputs):
        return p[:, 2] <= 0
    return np.zeros(len(p), dtype=bool)


def _outside_picture(camera: Camera, detector: Detector[Any], p: Array) -> NDArray[np.bool_]:
    """Which markers (N, 3) project outside of the picture, or nowhere."""
    uv = camera.project(p)
    # An oracle may report markers all round, and six panels have no border between them.
    has_borders = len(camera.panels) == 1 and _limited(detector)
    return ~(camera.inside(uv) if has_borders else np.isfinite(uv[:, 0]))


def _behind_words(camera: Camera, law: Law[Any]) -> tuple[str, str]:
    """Where a marker behind the camera is, and the remedy."""
    if isinstance(camera, Perspective):
        return "behind the camera", "a wider camera"
    return f"behind the camera, where law {law.kind} has no image plane to work in", "a law of rays (feature spherical) or poses"


def _limited(detector: Detector[Any]) -> bool:
    """Whether the detector sees only what is in the picture; an oracle may see all."""
    return getattr(detector, "field_of_view", "limited") == "limited"


def _markers(target: Target, which: NDArray[np.bool_]) -> str:
    """Markers (N,) with their verb, as `marker 2 is`."""
    called = [target.called(int(i)) for i in np.flatnonzero(which)]
    return f"marker {called[0]} is" if len(called) == 1 else f"markers {', '.join(called)} are"


def _not_visible(field: str, target: Target, bad: NDArray[np.bool_], where: str, remedy: str) -> ParameterError:
    """The error for a goal view in which markers (N,) are not visible."""
    words = f"is a view in which {_markers(target, bad)} {where}; move the goal back, or use {remedy} or a smaller target"
    return ParameterError(field, words)


def check_level(robot: Robot, camera: Camera, target: Target, T_camera_target: Array, field: str) -> None:
    """Refuse a goal view from a tilted craft: a craft hovers level, and would never see that view at rest.

    Raises:
        ParameterError: it names the field, and what would work.
    """
    if robot.base != "floating":
        return
    # z of the base, in the world's axes: its last component is the cosine of the tilt.
    up = (target.T_world_start @ inverse(T_camera_target) @ inverse(camera.mount.T))[2, 2]
    lean = math.degrees(math.acos(max(-1.0, min(1.0, float(up)))))
    if lean > LEVEL_DEG:
        words = f"is the view from a craft tilted by {lean:.3g} deg, and it hovers level; turn the view, or camera.mount, by as much"
        raise ParameterError(field, words)
