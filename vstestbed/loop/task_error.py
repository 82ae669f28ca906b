"""How far a run is from what its scenario asks for: in truth, for the log and the judge, and by the robot's own estimate."""

from __future__ import annotations

import math

from vstestbed.core.geometry import Array, inverse, rigid_error
from vstestbed.core.planar import place_of, relative, wrapped
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import LineFollowing
from vstestbed.loop.reference import Path
from vstestbed.scenario.goal import KEPT, GoalGap, GoalLine, GoalPath, GoalTrack
from vstestbed.scenario.progress_check import Pace
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.stop import Band
from vstestbed.targets.base import Carried
from vstestbed.targets.ground_lines import GroundLines
from vstestbed.targets.route import Route

STEADY = 0.8
"""Who shall keep a speed must make this share of it. A straight approach to a line, at 25 degrees, has .91; a start within the first
two seconds .87; steady driving .98 and more."""
FOLLOWS = 0.5
"""Who follows must make this share of the leader's: it cuts corners, and waits where it is too near."""
ALONG_M = 0.5
"""How far from where it was a frame ago its place along a line is looked for [m]: at 3 m/s and 10 Hz .3 m."""


def band_of(scenario: Scenario) -> Band | None:
    """The band of a task without an end, and the speeds that belong to it.

    A line is followed at the speed that the law orders. A gap is kept behind a vehicle that drives as the scenario says: behind
    one that stands although it is told to drive nothing has been shown, nor by one that stands while the other drives round it.
    Behind a target that stands by scenario (`motion: still`) the gap is a place to wait at; and what moves by itself goes as told.
    """
    goal, law, motion = scenario.goal, scenario.law, scenario.target.motion
    if not isinstance(goal, KEPT):
        return None
    paces: tuple[Pace, ...] = ()
    if isinstance(goal, GoalLine) and isinstance(law, LineFollowing):
        paces = (Pace("the vehicle, along its line,", law.cruise_mps, STEADY * law.cruise_mps),)
    if isinstance(goal, GoalGap) and isinstance(motion, Carried):
        v = motion.speed_mps
        paces = (Pace("the vehicle ahead", v, STEADY * v), Pace("the vehicle that follows", v, FOLLOWS * v))
    return Band(goal.band, goal.settle_s, paces, Path(goal).end_s if isinstance(goal, GoalPath) else 0.0)


class Ways:
    """How far what shall keep going has come, in truth, frame by frame: the ways that the band's paces are about."""

    def __init__(self, scenario: Scenario):
        self._target, self._paced = scenario.target, bool((band := band_of(scenario)) and band.paces)
        self._T_target_leader = inverse(scenario.target.pose.T)
        self._before: tuple[Array, Array] | None = None
        self._s, self._sense = math.nan, 1.0
        self._ways = [0.0, 0.0]

    def after(self, T_world_base: Array, T_world_target: Array) -> tuple[float, ...]:
        """The ways [m] when vehicle and target are at these poses (4, 4); nothing where no pace is asked for."""
        if not self._paced:
            return ()
        if isinstance(self._target, GroundLines):
            return (self._along(self._target.route, place_of(inverse(T_world_target) @ T_world_base)),)
        places = T_world_target @ self._T_target_leader, T_world_base
        if self._before is not None:
            steps = [math.dist(a[:2, 3], b[:2, 3]) for a, b in zip(self._before, places, strict=True)]
            self._ways = [way + step for way, step in zip(self._ways, steps, strict=True)]
        self._before = places
        return tuple(self._ways)

    def _along(self, route: Route, place: Array) -> float:
        """Way along a line, in the sense in which the vehicle faced it at the start: a line has no direction of its own.

        A step is that of the vehicle beside the line, ds (1 - curvature offset): in a bend its own way is the longer or shorter one.
        """
        if math.isnan(self._s):
            self._s, with_it = route.branch(place)
            self._sense = 1.0 if with_it >= 0 else -1.0
        s, offset = route.nearest(place[:2], around=self._s, reach=ALONG_M)
        self._ways[0] += self._sense * (s - self._s) * (1 - float(route.at(s)[3]) * offset)
        self._s = s
        return self._ways[0]


def off(scenario: Scenario, T_world_base: Array, T_world_target: Array, t: float) -> float:
    """True error of a task without an end at a time t [s], [m]: of the gap, off the line, the path, the camera's place; NaN for others."""
    goal = scenario.goal
    if isinstance(goal, GoalPath):
        return Path(goal).off(inverse(T_world_target) @ T_world_base @ scenario.camera.mount.T, t)
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


def slipped(T_before: Array, T_now: Array, odometry_before: Array, odometry_now: Array, duration: float) -> tuple[float, float]:
    """How fast a vehicle slid over the floor and turned on it between two frames, unnoticed by its encoders [m/s, rad/s], sizes.

    The true step less the one by odometry, both in the vehicle's frame before it.
    """
    if duration <= 0:
        return 0.0, 0.0
    true = relative(place_of(T_before), place_of(T_now))
    told = relative(odometry_before, odometry_now)
    ahead, left, turn = true - told
    return math.hypot(ahead, left) / duration, abs(float(wrapped(turn))) / duration
