"""Checks between two parts of a scenario that do not know one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import kind_of
from vstestbed.features.depth import OnFloor, PnP
from vstestbed.features.observation import Goal
from vstestbed.laws import Law
from vstestbed.robots import VEHICLES, Mount, Robot
from vstestbed.sim.scene.world import World
from vstestbed.sim.timing import Timing
from vstestbed.targets import Target
from vstestbed.tasks.stop import Stop
from vstestbed.vision import DETECTORS, Detector

ON_ONE_LINE = 1e-6
"""Ratio of the second to the first singular value of marker positions under which they count as collinear."""
MOST_FRAMES, MOST_BYTES = 10_000_000, 4 << 30
"""Most frames of a run: a day at 115 Hz, whose log is a table of some 10 GB. Most bytes of pictures in transit."""


MOST_MOUNT_M, MOST_VIEW_M, MOST_PLACE_M = 10.0, 50.0, 100.0
"""Farthest that a camera is from its flange, a goal view from the target, and the target and the ideal camera from the origin:
several times what any experiment here needs [m]. What lies beyond was meant in millimetres."""


def check_metres(robot: Robot, camera: Camera, target: Target) -> None:
    """Refuse a mount and a place of the target that are far beyond an experiment, as lengths in millimetres are.

    Raises:
        ParameterError: it names the field.
    """
    _check_length("camera.mount", camera.mount.T, MOST_MOUNT_M)
    _check_length("target.pose", target.pose.T, MOST_PLACE_M)
    if robot.model is None:  # the ideal camera; a vehicle may be further, and its field has bounds of its own
        _check_length("robot.start", robot.flange_pose(robot.configuration()), MOST_PLACE_M)


def check_views_metres(field: str, views: Sequence[Goal]) -> None:
    """The same of goal views; field: the field of the goal that has them."""
    for view in views:
        _check_length(field, view.T_camera_target, MOST_VIEW_M)


def _check_length(field: str, T: Array, most_m: float) -> None:
    length = float(np.linalg.norm(T[:3, 3]))
    if length > most_m:
        words = f"is {length:.4g} m away, and may be at most {most_m:g} m; lengths are in metres: did you mean {length / 1000:.4g} m?"
        raise ParameterError(field, words)


def check_memory(camera: Camera, detector: Detector[Any], timing: Timing, stop: Stop) -> None:
    """Refuse runs whose log, or pictures in transit to the law, would not fit into memory.

    Raises:
        ParameterError: with the limit.
    """
    if stop.duration_s * camera.rate_hz > MOST_FRAMES:
        most = f"{MOST_FRAMES / camera.rate_hz:g} s, {MOST_FRAMES} pictures at {camera.rate_hz:g} Hz"
        words = f"must be at most {most}: a longer log is a table of more than 10 GB"
        raise ParameterError("stop.duration_s", words, stop.duration_s)
    if not detector.needs_image:
        return
    size = sum(3 * panel.lens.width * panel.lens.height for panel in camera.panels)
    transit_s = MOST_BYTES / size / camera.rate_hz
    if camera.latency_s + timing.latency_jitter_s > transit_s:
        words = f"may be at most {transit_s:.4g} s with its jitter: more of these pictures in transit do not fit into memory"
        raise ParameterError("camera.latency_s", words, camera.latency_s)


def check_robot(robot: Robot, target: Target, world: World, derotation: str, level_trim_s: float) -> None:
    """Refuse derotation, wind, friction and a target in the gripper for robots to which they do not apply.

    Raises:
        ParameterError: it names the field, and what would work.
    """
    if robot.model is None and robot.joints:
        words = f"{robot.kind} has joints and no body; let its `model` name an MJCF file"
        raise ParameterError("robot.kind", words)
    if robot.base != "floating":
        _check_without_flight(robot, world, derotation)
    _check_level_trim(target, derotation, level_trim_s)
    if world.floor_friction is not None and not robot.slips:
        words = "is not felt by wheels: planar, which never slip; use wheels: rollers"
        raise ParameterError("world.floor_friction", words, world.floor_friction)
    if target.on_gripper and not robot.gripper:
        raise ParameterError("target.motion", f"held is for an arm's hand; robot {robot.kind} has none, use puma560")


def _check_level_trim(target: Target, derotation: str, level_trim_s: float) -> None:
    """Refuse a correction of the tilt where nothing is derotated, or where the target's own motion would be taken for a tilt."""
    if level_trim_s and (derotation == "none" or target.moves):
        words = "corrects the tilt for a derotation by a target that stands still; here it must be 0"
        raise ParameterError("level_trim_s", words, level_trim_s)


def _check_without_flight(robot: Robot, world: World, derotation: str) -> None:
    """Refuse derotation and wind for a robot that does not fly."""
    if derotation != "none":
        raise ParameterError("derotation", "is for a craft that tilts (robot quadrotor); here it must be none", derotation)
    if not world.wind.still:
        raise ParameterError("world.wind", f"acts only on a craft that flies (robot quadrotor), not on robot {robot.kind}")


def check_floor_depth(robot: Robot, law: Law[Any]) -> None:
    """Refuse depth from the place on the floor for a robot that is no vehicle.

    Raises:
        ParameterError: it names the field, and what would work.
    """
    if law.depth.on_floor and robot.base != "planar":
        words = f"may be floor only for a vehicle, and robot {robot.kind} is none; use pnp, goal or estimate"
        raise ParameterError("law.depth", words)


def check_carrier(target: Target) -> None:
    """Refuse a route that the vehicle which carries the target cannot drive.

    Raises:
        ParameterError: a bend is tighter than its turning circle, or the speed higher than its top speed.
    """
    if target.carrier is None:
        return
    by, route, speed = target.carrier.by, target.carrier.route, target.carrier.speed_mps
    leader = VEHICLES[by]()
    if route.least_radius_m < leader.turning_radius_m:
        words = f"has a bend of {route.least_radius_m:.3g} m, and the car that carries the target turns no tighter than"
        raise ParameterError("target.motion.route", f"{words} {leader.turning_radius_m:.3g} m; make it wider, or use by: omni")
    if speed > leader.top_speed_mps:
        words = f"must be at most {leader.top_speed_mps:g} m/s, the top speed of the {by} that carries the target"
        raise ParameterError("target.motion.speed_mps", words, speed)


def check_markers(robot: Robot, camera: Camera, target: Target, detector: Detector[Any], law: Law[Any], needs_pose: bool) -> None:
    """Refuse markers that the detector cannot detect, too few markers, and arrangements that do not determine the pose.

    Args:
        needs_pose: the task needs the target's pose, which not every depth source estimates.

    Raises:
        ParameterError: it names the field, and what would work.
    """
    _check_marker_kind(target.marker.kind, detector)
    _check_shown(target, detector)
    _check_marker_count(robot, camera, target, detector, law)
    if law.depth.needs_pose and not law.depth.on_floor and _leaves_pose_open(target.points):
        raise _open_pose(robot, target.points, law, needs_pose)


def check_own_points(camera: Camera, detector: Detector[Any], law: Law[Any], views: Sequence[Goal]) -> None:
    """Refuse what a detector of other points than the target's markers cannot serve; nothing for a detector of markers.

    Raises:
        ParameterError: it names the field, and what would work.
    """
    if not detector.needs_goal:
        return
    if len(camera.panels) > 1:
        words = f"may not be {detector.kind} with a camera that sees all round: it compares single pictures; use perspective or fisheye"
        raise ParameterError("detector", words)
    if len(views) > 1:
        words = f"may not be {detector.kind} with {len(views)} goal views in turn: it compares with the picture of one; use goal: view"
        raise ParameterError("detector", words)
    if detector.fleeting and law.depth.estimator is not None:
        words = f"estimates each point's depth from its motion, and detector {detector.kind} shows other points in every picture"
        raise ParameterError("law.depth", f"{words}; use pnp or goal, or let it follow its points (track: klt)")
    if not detector.changing:
        return
    if law.needs_same_markers:
        words = f"needs the same markers in every picture, and detector {detector.kind} shows other points; use ibvs, pbvs or hybrid"
        raise ParameterError("law", f"{law.kind} {words}")
    if "radius_px" in law.inputs:
        words = f"may not keep points from the border or a plane with detector {detector.kind}, whose points are all over the picture"
        raise ParameterError("law", f"{law.kind} {words}; leave out margin_px and plane_m (null)")


def _check_marker_kind(marker: str, detector: Detector[Any]) -> None:
    """Refuse a kind of marker that the detector cannot detect; a detector that names none detects all."""
    seen = detector.markers
    if seen and marker not in seen:
        words = f"may not be {marker}: detector {detector.kind} sees {', '.join(seen)}; with {marker} use"
        able = [kind for kind, member in DETECTORS.members.items() if not member.markers or marker in member.markers]
        raise ParameterError("target.marker", f"{words} detector {' or '.join(able)}")


def _check_shown(target: Target, detector: Detector[Any]) -> None:
    """Refuse a detector of markers where none are drawn and no picture shows any; a detector that names no kinds may see other things."""
    if target.shows_markers or target.sheet is not None or not detector.markers:
        return
    able = [kind for kind, member in DETECTORS.members.items() if not member.markers]
    words = f"may not be false with detector {detector.kind}: a {kind_of(type(target))} without markers shows it nothing to detect"
    raise ParameterError("target.draw_markers", f"{words}; use true, or detector {' or '.join(able)}", False)


def _check_marker_count(robot: Robot, camera: Camera, target: Target, detector: Detector[Any], law: Law[Any]) -> None:
    """Refuse fewer markers than the law needs for the motions that the robot can make."""
    points, basis = target.points, robot.motion_basis(Mount.of(camera.mount.T), robot.start_joints())
    # One at least: a robot whose motions need none would still have nothing to look at.
    needed = max(law.markers_needed(basis), 1)
    if detector.rows is None and len(points) < needed:
        markers = f"{len(points)} marker{'s' * (len(points) != 1)}"
        words = f"has {markers}, and law {law.kind} needs {needed} or more for this robot's motions"
        less = _needed_on_floor(robot, law, basis)
        enough = less is not None and len(points) >= less
        raise ParameterError("target", words + (f"; with law.depth floor {less} will do" if enough else ""))


def _leaves_pose_open(points: Array) -> bool:
    """Whether points (N, 3) do not determine a pose: fewer than three, or collinear."""
    # Rotation about their common line is not observable: the scatter round the centroid has rank one.
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return len(points) < 3 or bool(spread[1] < ON_ONE_LINE * spread[0])


def _open_pose(robot: Robot, points: Array, law: Law[Any], needs_pose: bool) -> ParameterError:
    """The error for markers that do not determine the pose."""
    if not _has_depth(law):
        words = f"has all markers on one line, which leaves the pose open that law {law.kind} works with; use other places"
        return ParameterError("target", words)
    # Only what this robot and task would accept: `floor` needs a vehicle, a task with a pose needs a source that estimates one.
    depths = "floor" if needs_pose else "floor, goal or estimate" if robot.base == "planar" else "goal or estimate"
    which = "all markers lie on one line" if len(points) > 1 else "there is a single marker"
    return ParameterError("law.depth", f"may not be pnp: {which}, which leaves the pose open; use {depths}")


def _has_depth(law: Law[Any]) -> bool:
    """Whether the source of depth is a parameter of the law."""
    return any(field.name == "depth" for field in fields(law))


def _needed_on_floor(robot: Robot, law: Law[Any], basis: Array) -> int | None:
    """Markers that the law would need with depth `floor`, as a remedy in a message; None where `floor` is no alternative to `pnp`."""
    if robot.base != "planar" or not isinstance(law.depth, PnP) or not _has_depth(law):
        return None
    return replace(law, depth=OnFloor()).markers_needed(basis)  # pyright: ignore[reportCallIssue] - it has the field
