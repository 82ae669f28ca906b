"""Checks between two parts of a scenario that do not know one another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vstestbed.camera import DEPTH_SENSORS, Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.features.observation import Goal
from vstestbed.laws import Law
from vstestbed.robots import VEHICLES, Robot
from vstestbed.sim.scene.world import World
from vstestbed.sim.timing import Timing
from vstestbed.targets import Target
from vstestbed.tasks.base import Task
from vstestbed.tasks.stop import Stop
from vstestbed.vision import Detector

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


def check_clocks(robot: Robot, timing: Timing) -> None:
    """Refuse stamps of readings for a robot that has none.

    Raises:
        ParameterError: it names the field.
    """
    if timing.robot_clock is not None and robot.model is None:
        words = f"stamps a robot's sensor readings, and robot {robot.kind} has none; errors of the pictures' stamps: timing.camera_clock"
        raise ParameterError("timing.robot_clock", words)


def check_memory(camera: Camera, pictures: bool, timing: Timing, stop: Stop) -> None:
    """Refuse runs whose log, or pictures in transit to the law, would not fit into memory. pictures: whether any are taken.

    Raises:
        ParameterError: with the limit.
    """
    if stop.duration_s * camera.rate_hz > MOST_FRAMES:
        most = f"{MOST_FRAMES / camera.rate_hz:g} s, {MOST_FRAMES} pictures at {camera.rate_hz:g} Hz"
        words = f"must be at most {most}: a longer log is a table of more than 10 GB"
        raise ParameterError("stop.duration_s", words, stop.duration_s)
    if not pictures:
        return
    each = 3 if camera.depth_sensor is None else 7  # bytes of a pixel
    size = sum(each * panel.lens.width * panel.lens.height for panel in camera.panels)
    transit_s = MOST_BYTES / size / camera.rate_hz
    if camera.latency_s + timing.latency_jitter_s > transit_s:
        words = f"may be at most {transit_s:.4g} s with its jitter: more of these pictures in transit do not fit into memory"
        raise ParameterError("camera.latency_s", words, camera.latency_s)


def check_step(robot: Robot, step_s: float) -> None:
    """Refuse a physics step [s] at which a robot's vibrations would be those of the arithmetic.

    Raises:
        ParameterError: with the longest step that works.
    """
    if step_s > (1 + 1e-9) * robot.needed_step_s:
        words = f"must be at most {robot.needed_step_s:.4g} s with these gears and drives; without step_s the longest that works is taken"
        raise ParameterError("physics.step_s", words, step_s)


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


def check_depth(robot: Robot, camera: Camera, detector: Detector[Any], law: Law[Any]) -> None:
    """Refuse a source of depth that this scenario has not got: the truth, a depth camera, or a vehicle's place on the floor.

    Raises:
        ParameterError: it names the field, and what would work.
    """
    if law.depth.true and not detector.needs_truth:
        words = "may be oracle only with detector: {kind: oracle}; with pixels use pnp, constant, goal, estimate or sensor"
        raise ParameterError("law.depth", words)
    if law.depth.measured and camera.depth_sensor is None:
        words = "may be sensor only with a depth camera: add camera.depth_sensor"
        others = "goal or constant" if "image" in law.inputs else "pnp, constant, goal or estimate"
        raise ParameterError("law.depth", f"{words} ({', '.join(DEPTH_SENSORS.members)}), or use {others}")
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


def check_goal_pictures(goal: Task, camera: Camera, needed: bool, law: Law[Any], detector: Detector[Any]) -> None:
    """Refuse pictures of the goal that nobody looks at, that cannot be read, and that lack the depth that the law needs.

    Raises:
        ParameterError: it names the field, and what would work.
    """
    for i, said in enumerate(goal.pictures):
        field = "goal.picture" if len(goal.pictures) == 1 else f"goal.views.{i}.picture"
        if not needed and (said.file is not None or said.other_light):
            words = f"is looked at by neither law {law.kind} nor detector {detector.kind}; it is for law photometric, or detector keypoints"
            raise ParameterError(field, words)
        if said.file is None:
            continue
        if law.depth.measured and "image" in law.inputs:
            raise ParameterError("law.depth", "may not be sensor with goal.picture, a file without depth; use goal or constant", "sensor")
        try:
            said.read(camera)
        except ParameterError as error:
            raise ParameterError(field, error.problem, error.found) from None


def check_mirror(camera: Camera, world: World) -> None:
    """Refuse a floor that mirrors where pictures are drawn by rays."""
    if world.floor.mirror and camera.renderer == "rays":
        raise ParameterError("camera.renderer", "must be gl or auto: a floor that mirrors needs OpenGL", camera.renderer)
