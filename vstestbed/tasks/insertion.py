"""Insertion of a plug into the target's socket: a reference that approaches along the hole's axis,
and the verdict on depth and force.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Gt, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse, rotation_angle
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.core.quantity import (
    Angle,
    PositiveAngle,
    PositiveLength,
    PositiveSpeed,
    PositiveTime,
    Time,
)
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal, Observation
from vstestbed.robots.arm import Arm
from vstestbed.robots.base import Supervisor
from vstestbed.targets import Target
from vstestbed.tasks.base import Log, Task, view_from
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.judged import JudgedError, at_the_end
from vstestbed.tasks.monitor import Setup, TaskMonitor, has_held, held_since
from vstestbed.tasks.stop import Stop

Force = Annotated[float, Gt(0), Le(1e4)]
DEEP_ENOUGH_M = 5e-4  # what may be missing of the depth
# how far the reference goes beyond the depth: the arm presses, and the contact with the bottom
# shows
BEYOND_M = 0.004
LEAD_M = 0.01  # farthest that the reference runs ahead of the plug along the axis
CRAWL_M = 5e-4  # a plug that touches and goes no deeper than this is stuck
FORCE_COLUMN = "plug_force_n"  # of the arm's tool


class Approach(NamedTuple):
    """State of the reference: how far it has come along the axis [m], time of the last frame [s],
    since when the plug is in line [s], and the pressure before any contact [N].
    """

    setup: Setup
    way_m: float = 0.0
    t: float = math.nan
    in_line_since: float = math.inf
    rest_n: float = math.nan


@spec
class GoalInsertion(Task):
    """Insert the arm's plug (`robot.tool`) into the target's socket: servo to a view with the tip
    before the mouth, then along its axis.

    The reference waits until the plug is in line by the robot's own estimate, then advances; before
    the mouth it waits again where the plug leaves the line. With a sensor at the wrist it stops
    where the plug presses with `press_n`. Reached with the tip at `depth_m` in the socket, by the
    truth, and touching; failed over `limit_n`, or where the plug touches and stays where it is for
    `jam_s`.

    Args:
        tip_m: distance of the plug's tip from the flange, the length of `robot.tool`, as the robot
            knows it [m].
        roll_deg: how the plug is turned about its axis there: 0 with the flange's x along the
            target's [deg].
        standoff_m: distance of the tip from the mouth at which the approach begins [m].
        within_m, within_deg: largest lateral and rotational error, by the robot's estimate, with
            which it begins and goes on [m, deg].
        hold_s: for how long the plug must be in line before the approach begins [s].
        speed_mps: of the approach [m/s].
        depth_m: to be reached [m]; None: the bottom of the socket; e.g. `0.03`.
        press_n: pressure along the axis at which the reference stops, with `robot.wrist` [N]; None:
            it does not stop by force.
        limit_n: true force on the plug that ends the run [N].
        jam_s: how long a plug that touches may stay where it is [s].
        seat_s: for how long it must touch at its depth until it is inserted [s].
    """

    kind: Literal["insertion"] = "insertion"
    tip_m: PositiveLength
    roll_deg: Angle = 0.0
    standoff_m: PositiveLength = 0.03
    within_m: PositiveLength = 0.002
    within_deg: PositiveAngle = 1.0
    hold_s: PositiveTime = 0.4
    speed_mps: PositiveSpeed = 0.01
    depth_m: PositiveLength | None = None
    press_n: Force | None = 20.0
    limit_n: Force = 200.0
    jam_s: PositiveTime = 3.0
    seat_s: Time = 0.0
    bases = frozenset({"fixed"})
    needs_still = True
    ends = Outcome.inserted

    def check(self, setup: Setup) -> None:
        """The arm must have a plug, the target a socket that takes it, and the law a pose to be in
        line by.
        """
        super().check(setup)
        socket = setup.target.socket
        plug = setup.robot.tool if isinstance(setup.robot, Arm) else None
        if plug is None:
            why = "goal of kind insertion needs a plug, e.g. {radius: 0.01, length: 0.15}"
            raise ParameterError.missing("robot.tool", why)
        if abs(plug.length - self.tip_m) > 1e-9:
            wanted = f"robot.tool.length, {plug.length:g} m"
            raise ParameterError.fixed("goal.tip_m", wanted, self.tip_m)
        if socket is None:
            why = "goal of kind insertion needs one, e.g. {radius: 0.011, depth: 0.04}"
            raise ParameterError.missing("target.socket", why)
        if socket.radius <= plug.radius:
            limit = f"robot.tool.radius = {plug.radius:g} m"
            raise ParameterError.bound("target.socket.radius", "over", limit, socket.radius)
        if self.depth_m is not None and self.depth_m > socket.depth:
            limit = f"target.socket.depth = {socket.depth:g} m"
            raise ParameterError.bound("goal.depth_m", "at most", limit, self.depth_m)
        if not (setup.law.depth.needs_pose or "T_camera_target" in setup.law.inputs):
            words = f"{setup.law.depth.kind}, by which the plug cannot be seen to be in line"
            raise ParameterError.excluded("law.depth", words, works="pnp")

    def pose(self, target: Target, mount: Array, way_m: float) -> Array:
        """T_camera_target (4, 4) with the tip so far along the axis from its standoff [m], for a
        camera at a mount (4, 4).
        """
        socket = target.socket
        assert socket is not None
        roll = math.radians(self.roll_deg)
        c = math.cos(roll)
        s = math.sin(roll)
        T_target_flange = np.eye(4)
        T_target_flange[:2, :2] = [[c, -s], [s, c]]
        T_target_flange[:3, 3] = [*socket.xy, -socket.depth - self.standoff_m + way_m - self.tip_m]
        return inverse(T_target_flange @ mount)

    def depth_in(self, target: Target) -> float:
        """The depth that is to be reached [m]."""
        assert target.socket is not None
        return self.depth_m or target.socket.depth

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        return (self.pose(target, mount, 0.0),)

    def goal_pose_at(self, setup: Setup, poses: tuple[Array, ...], t: float, view: int) -> Array:
        way_m = self.standoff_m + self.depth_in(setup.target)
        return self.pose(setup.target, setup.camera.mount.T, way_m)

    def begin(self, setup: Setup, views: tuple[Goal, ...]) -> Approach:
        return Approach(setup)

    def reference(self, state: Approach, seen: Observation) -> tuple[Approach, Goal]:
        """The view, which advances along the axis while the plug is in line and does not press."""
        setup = state.setup
        way = state.way_m
        dt = seen.t - state.t
        goal = self._view_at(setup, way)
        T = seen.T_camera_target
        reference = goal.T_camera_target
        if T is None or math.isnan(dt):
            return state._replace(t=seen.t), goal
        axis = reference[:3, 2]  # of the hole, into it, in the camera's frame
        # how far the camera still has to go, so that the target comes to where it is wanted
        away = reference[:3, 3] - T[:3, 3]
        lateral = float(np.linalg.norm(away - (away @ axis) * axis))
        lead = float(-away @ axis)
        turned = math.degrees(rotation_angle(T[:3, :3].T @ reference[:3, :3]))
        in_line = lateral < self.within_m and turned < self.within_deg and abs(lead) < LEAD_M
        since = held_since(state.in_line_since, in_line, seen.t)
        press = 0.0 if seen.wrench is None else float(-seen.wrench[:3] @ axis)
        rest_n = state.rest_n
        if way == 0.0 or math.isnan(rest_n):
            rest_n = press  # the weight of the tool
        state = Approach(setup, way, seen.t, since, rest_n)
        last = self.standoff_m + self.depth_in(setup.target) + BEYOND_M
        if way < last and self._advances(state, in_line, lead, press):
            way = min(way + self.speed_mps * dt, last)
            goal = self._view_at(setup, way, self.speed_mps)
        return state._replace(way_m=way), goal

    def _advances(self, state: Approach, in_line: bool, lead: float, press: float) -> bool:
        """Whether the reference goes on: it is not far ahead of the plug [m], which is in line and
        does not press [N].
        """
        begun = state.way_m > 0.0 or state.t - state.in_line_since >= self.hold_s
        inside = state.way_m > self.standoff_m
        presses = self.press_n is not None and press - state.rest_n > self.press_n
        return begun and (in_line or inside) and abs(lead) < LEAD_M and not presses

    def _view_at(self, setup: Setup, way_m: float, speed_mps: float = 0.0) -> Goal:
        """The view at a way along the axis, with the errors of the calibration that the first view
        has; the twist of a camera that goes along.
        """
        goal = view_from(setup, lambda mount: self.pose(setup.target, mount, way_m))
        if not speed_mps:
            return goal
        twist = np.concatenate([speed_mps * goal.T_camera_target[:3, 2], np.zeros(3)])
        return replace(goal, twist=twist, moves=True)

    def monitor(self, setup: Setup, supervisor: Supervisor) -> InsertionMonitor:
        return InsertionMonitor(self, setup, supervisor)

    def metrics(self, log: Log) -> dict[str, float | None]:
        """Depth reached [m], the largest force on the plug,
        and its mean over the last second [N].
        """
        force = log[FORCE_COLUMN]
        last = force[log["t"] > log["t"][-1] - 1.0]
        return {
            "insertion_m": float(log["insertion_m"][-1]),
            "largest_force_n": float(np.nanmax(force)),
            "final_force_n": float(np.nanmean(last)),
        }

    def judged(self, log: Log, stop: Stop) -> JudgedError:
        return at_the_end(log, "task_error_m", DEEP_ENOUGH_M)


class InsertionMonitor(TaskMonitor):
    """Ends when the plug is at its depth and touches, presses with more than its limit, or is
    stuck.

    Columns `insertion_m`: true depth of the tip in the socket, negative before it [m];
    `plug_offset_m`: its true distance from the axis [m]; `task_error_m`: what is missing of the
    depth [m].
    """

    error_columns = ("insertion_m", "plug_offset_m", "task_error_m")

    def __init__(self, goal: GoalInsertion, setup: Setup, supervisor: Supervisor):
        super().__init__(setup, 1, supervisor)
        assert setup.target.socket is not None
        self._goal = goal
        self._socket = setup.target.socket
        self._depth = goal.depth_in(setup.target)
        names = list[str]()
        for effect in setup.robot.acting:
            names += effect.columns
        self._force = names.index(FORCE_COLUMN)
        assert isinstance(setup.robot, Arm) and setup.robot.tool is not None
        self._tip = np.array([0.0, 0.0, setup.robot.tool.length])  # the true one
        self._deepest = -math.inf
        self._stuck_since = self._seated_since = math.inf
        self.depth_m = self.offset_m = math.nan

    def task_error(self, frame: Frame) -> tuple[float, ...]:
        T = inverse(frame.truth.T_world_target) @ frame.T_world_base(self.mount_inverse)
        x, y, z = T[:3, :3] @ self._tip + T[:3, 3]
        self.depth_m = float(z + self._socket.depth)
        self.offset_m = math.hypot(x - self._socket.xy[0], y - self._socket.xy[1])
        return self.depth_m, self.offset_m, max(0.0, self._depth - self.depth_m)

    def reached(self, frame: Frame) -> Verdict | None:
        """The plug touches at its depth inside of the hole."""
        within = self.offset_m < self._socket.radius
        deep = self.depth_m >= self._depth - DEEP_ENOUGH_M
        force = frame.truth.effects[self._force]
        seated = within and deep and force <= self._goal.limit_n and bool(frame.truth.feet)
        self._seated_since = held_since(self._seated_since, seated, frame.t)
        if not has_held(self._seated_since, frame.t, self._goal.seat_s):
            return None
        where = f"{1e3 * self.depth_m:.1f} mm deep, {1e3 * self.offset_m:.2f} mm beside the axis"
        return Outcome.inserted, where

    def missed(self, frame: Frame) -> Verdict | None:
        """Too large a force, a plug that is stuck, or the end of the duration."""
        goal = self._goal
        feet = frame.truth.feet
        force = frame.truth.effects[self._force]
        where = f"{1e3 * self.depth_m:.1f} mm deep, {1e3 * self.offset_m:.1f} mm beside the axis"
        if force > goal.limit_n:
            what = f"contact of {feet or 'the plug'} with {force:.0f} N, over {goal.limit_n:g} N"
            return Outcome.collided, f"{what}, {where}"
        if not feet or self.depth_m > self._deepest + CRAWL_M:
            self._deepest = max(self._deepest, self.depth_m)
            self._stuck_since = math.inf
        stuck = bool(feet) and math.isinf(self._seated_since)
        self._stuck_since = held_since(self._stuck_since, stuck, frame.t)
        if has_held(self._stuck_since, frame.t, goal.jam_s):
            return Outcome.jammed, f"for {goal.jam_s:g} s, {where}"
        return super().missed(frame)
