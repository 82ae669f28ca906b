"""Refuses what no vehicle on a floor could do, or could be told to have done: bends, speeds, gaps, mounts, goals."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.features.depth import OnFloor, PnP
from vstestbed.laws import IBVS, PBVS, Hybrid, LineFollowing, Partitioned, PoseController, Pursuit
from vstestbed.robots import VEHICLES, Car, Omni, Robot
from vstestbed.scenario.goal import AnyGoal, GoalGap, GoalLine, GoalPlace
from vstestbed.scenario.stop import Stop
from vstestbed.targets.attached import Carried
from vstestbed.targets.base import Target
from vstestbed.targets.ground_lines import GroundLines
from vstestbed.targets.route import Route
from vstestbed.vision.pose.floor_pose import LEVEL

AnyLaw = IBVS | Partitioned | PBVS | Hybrid | PoseController | Pursuit | LineFollowing
ONE_PLACE_M = 1e-6
"""Points within this of one another in the floor plan are at one place [m]."""


def check_leader(target: Target) -> None:
    """Refuse a way that the vehicle which carries the target cannot drive.

    Raises:
        ParameterError: a bend is tighter than its turning circle, or it is told to be faster than it can.
    """
    motion = target.motion
    if not isinstance(motion, Carried):
        return
    leader: Car | Omni = VEHICLES[motion.by]()
    if motion.route.least_radius_m < leader.turning_radius_m:
        words = f"has a bend of {motion.route.least_radius_m:.3g} m, and the car that carries the target turns no tighter than"
        raise ParameterError("target.motion.route", f"{words} {leader.turning_radius_m:.3g} m; make it wider, or use by: omni")
    if motion.speed_mps > leader.top_speed_mps:
        words = f"must be at most {leader.top_speed_mps:g} m/s, the top speed of the {motion.by} that carries the target"
        raise ParameterError("target.motion.speed_mps", words, motion.speed_mps)


def check_drive(robot: Robot, camera: Camera, target: Target, law: AnyLaw, goal: AnyGoal, stop: Stop) -> None:
    """Refuse what a vehicle on the floor cannot do or know.

    Raises:
        ParameterError: it names the field, and what would work.
    """
    if isinstance(law.depth, OnFloor) and not robot.grounded:
        words = f"may be floor only for a vehicle, and robot {robot.kind} is none; use pnp, goal or estimate"
        raise ParameterError("law.depth", words)
    if isinstance(goal, GoalGap | GoalPlace) and not isinstance(law.depth, PnP | OnFloor):
        words = f"may not be {law.depth.kind} with law {law.kind}, which needs the pose itself; use floor or pnp"
        raise ParameterError("law.depth", words)
    if not isinstance(robot, Car | Omni):
        return
    if camera.mount.xyz[2] <= 0:
        words = "must have z > 0: the vehicle's frame lies on the floor, and the camera would be under it"
        raise ParameterError("camera.mount.xyz", words, camera.mount.xyz)
    _check_rest(law, goal, target, stop)
    if isinstance(goal, GoalGap):
        _check_gap(robot, target, goal)
        if isinstance(law.depth, OnFloor):
            _check_told(camera, target, goal)
    if isinstance(goal, GoalLine) and isinstance(target, GroundLines):
        _check_line(robot, target.route, law, goal)


def _check_rest(law: AnyLaw, goal: AnyGoal, target: Target, stop: Stop) -> None:
    """A place counts as reached by estimate, and by one that the law does not rest before."""
    near = stop.converged.position_m
    if isinstance(goal, GoalPlace) and not stop.converged.by_estimate and not target.moves:
        words = "must have position_m or rotation_deg for a goal of kind pose, where some of the target may be out of the picture"
        raise ParameterError("stop.converged", words)
    if isinstance(law, PoseController) and near is not None and law.rest_m >= near:
        words = f"must be under stop.converged.position_m = {near:g} m: nearer than rest_m the vehicle stands for good"
        raise ParameterError("law.rest_m", words, law.rest_m)


def _check_gap(robot: Car | Omni, target: Target, goal: GoalGap) -> None:
    """The vehicle's front must stay behind the rear of the one that carries the target."""
    if not isinstance(target.motion, Carried):
        return
    leader: Car | Omni = VEHICLES[target.motion.by]()
    ahead = target.pose.xyz[0]
    least = ahead - leader.ends_m[0] + robot.ends_m[1]
    if goal.gap_m <= least:
        words = f"must be over {least:.4g} m: there the front of robot {robot.kind}, {robot.ends_m[1]:g} m before its origin, touches the"
        raise ParameterError("goal.gap_m", f"{words} {target.motion.by} that carries the target", goal.gap_m)


def _check_told(camera: Camera, target: Target, goal: GoalGap) -> None:
    """Points at one place of the floor plan do not tell which way the target heads: they must be where the gap is measured to."""
    p: Array = target.points @ target.pose.T[:3, :3].T  # from the target's origin, in the axes of what carries it
    if np.ptp(p[:, :2], axis=0).max() > ONE_PLACE_M:
        return
    if np.abs(p[0, :2]).max() > ONE_PLACE_M:
        words = "has its points at one place of the floor plan, which does not tell its heading, so that its origin, to which the gap is"
        remedy = "measured, stays unknown; use x = y = 0 there and put the place into target.pose, or add a point beside it"
        raise ParameterError("target", f"{words} {remedy}")
    height = p[:, 2] + target.pose.xyz[2] - camera.mount.xyz[2]
    if np.abs(height).max() <= LEVEL * (goal.gap_m + abs(camera.mount.xyz[0])):
        words = "has its points at the camera's own height, where their pictures do not tell how far they are"
        raise ParameterError("target", f"{words}; mount the camera higher or lower, or add a point beside it")


def _check_line(robot: Car | Omni, route: Route, law: AnyLaw, goal: GoalLine) -> None:
    """Bends that the vehicle can drive, `offset_m` to the left of the way, at a speed that it can have."""
    k = route.samples.curvature
    tightest = float(np.abs(k / np.maximum(1 - k * goal.offset_m, 1e-9)).max())
    if tightest * robot.turning_radius_m > 1:
        words = f"has a bend of {1 / tightest:.3g} m where the vehicle shall drive, which turns no tighter than"
        raise ParameterError("target.route", f"{words} {robot.turning_radius_m:.3g} m; make it wider, or use robot omni")
    if not isinstance(law, LineFollowing):
        return
    most = min(robot.top_speed_mps, law.limits.speed_mps or np.inf)
    if law.cruise_mps > most:
        raise ParameterError("law.cruise_mps", f"must be at most {most:g} m/s, which the limits of robot and law allow", law.cruise_mps)
