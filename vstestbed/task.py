"""How far a run is from what its scenario asks for: in truth, for the log and the judge, and by the robot's own estimate."""

from __future__ import annotations

import math

import numpy as np

from vstestbed.course import Path
from vstestbed.geometry import Array, inverse, rigid_error
from vstestbed.goal import KEPT, GoalGap, GoalLine, GoalPath, GoalTrack
from vstestbed.ground import place_of, relative
from vstestbed.ground_lines import GroundLines
from vstestbed.observation import Goal, Observation
from vstestbed.scenario import Scenario
from vstestbed.stop import Band


def band_of(scenario: Scenario) -> Band | None:
    """The band of a task without an end."""
    goal = scenario.goal
    return Band(goal.band, goal.settle_s) if isinstance(goal, KEPT) else None


def off(scenario: Scenario, T_world_base: Array, T_world_target: Array) -> float:
    """True error of a task without an end [m]: of the gap, off the line, the path, the camera's place; NaN for other tasks."""
    goal = scenario.goal
    if isinstance(goal, GoalPath):
        return Path(goal).off(inverse(T_world_target) @ T_world_base @ scenario.camera.mount.T)
    if isinstance(goal, GoalGap):
        return math.dist(T_world_base[:2, 3], T_world_target[:2, 3]) - goal.gap_m
    if isinstance(goal, GoalLine) and isinstance(scenario.target, GroundLines):
        here = place_of(inverse(T_world_target) @ T_world_base)
        return scenario.target.route.beside(here) - goal.offset_m
    if isinstance(goal, GoalTrack):
        T_camera = T_world_base @ scenario.camera.mount.T
        return rigid_error(T_camera, T_world_target @ inverse(goal.T_camera_target.T))[0]
    return math.nan


def estimated(seen: Observation, goal: Goal) -> tuple[float, float]:
    """How far from the goal the robot thinks it is: (distance [m], angle [rad]), NaN where it cannot tell.

    A vehicle whose goal is a place goes by its place; else it is the camera, by the target's pose.
    """
    if goal.place is not None and seen.place is not None:
        ahead, left, turn = relative(goal.place, seen.place)
        return math.hypot(ahead, left), abs(float(turn))
    if seen.T_camera_target is not None:
        return rigid_error(inverse(seen.T_camera_target), inverse(goal.T_camera_target))
    return math.nan, math.nan


def slipped(T_before: Array, T_now: Array, odometry_before: Array, odometry_now: Array, duration: float) -> float:
    """How fast a vehicle slid over the floor between two frames, unnoticed by its encoders [m/s].

    The true step less the one by odometry, both in the vehicle's frame before it.
    """
    if duration <= 0:
        return 0.0
    true = relative(place_of(T_before), place_of(T_now))
    told = relative(odometry_before, odometry_now)
    return float(np.hypot(*(true - told)[:2])) / duration
