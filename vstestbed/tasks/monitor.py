"""The monitor of a task: its error for the log, and the verdict, reached or missed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, inverse, rigid_error
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.core.planar import relative
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Law
from vstestbed.robots import Robot
from vstestbed.robots.base import Supervisor
from vstestbed.sim.scene.world import World
from vstestbed.targets import Target
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.stop import Stop
from vstestbed.vision import Detector

__all__ = ["REST", "Setup", "TaskMonitor", "has_held", "held_since", "is_over", "timed_out_words"]

# a commanded twist under this (goal distances/s and rad/s) is rest; with any pixel noise, commands
# never are so small
REST = 1e-6


# eq=False: compared by identity, since the comparison of its arrays has no single truth value.
@dataclass(frozen=True, eq=False)
class Setup:
    """The parts of an experiment that a task uses.

    Attributes:
        robot, camera, target, law, detector, stop, world: as the scenario has them.
            believed_camera: the camera as the robot knows it.
        depth_scale: ratio of each marker's assumed depth to the true one, (N,); None for exact
            depths.
        goal_shown: the goal image was taken by the true camera (teaching by showing); else it is
            computed with the believed one.
    """

    robot: Robot
    camera: Camera
    believed_camera: Camera
    target: Target
    law: Law[Any]
    detector: Detector[Any]
    stop: Stop
    world: World
    depth_scale: Array | None = None
    goal_shown: bool = False


def held_since(since: float, holds: bool, t: float) -> float:
    """Since when a condition has held without a break, at a time t [s]; infinite where it does not
    hold. since: the same before.
    """
    return min(since, t) if holds else math.inf


def has_held(since: float, t: float, duration_s: float) -> bool:
    """Whether a condition that has held since then has held for so long [s]."""
    # times are sums of steps: a hold of 0.5 s must not miss its frame by a rounding
    return t - since + 1e-9 >= duration_s


def is_over(t: float, duration_s: float) -> bool:
    """Whether a duration [s] is over at a time t [s]."""
    # times are sums of steps, and may miss the end by a rounding
    return t >= duration_s - 1e-9


class TaskMonitor:
    """Measures once a frame; asked then, once each, whether the task is reached and whether it is
    missed.

    A task with a goal is reached when `stop.converged` holds at the last view; it is missed in a
    local minimum, or when the duration is over. Other tasks override both.

    Columns of the log: `view`, the number of the current goal view, where there are several; the
    task's own (`error_columns`); `est_position_m`, `est_rotation_rad`, the robot's estimated
    distance from its goal, where `stop.converged` uses it; `level_error_px` of a craft that tilts:
    as `error_px`, after derotation; `error_grey` of a law that works on grey levels: the RMS
    difference between picture and goal picture, with the law's weights.

    Args:
        setup: the experiment's parts. views: how many goal views there are. supervisor: the
            robot's.
    """

    error_columns: tuple[str, ...] = ()

    def __init__(self, setup: Setup, views: int, supervisor: Supervisor):
        self.setup = setup
        self.views = views
        self.supervisor = supervisor
        self.mount_inverse = inverse(setup.camera.mount.T)
        self._by_estimate = setup.stop.converged.by_estimate
        self._leans = setup.robot.base == "floating"
        self.estimate = math.nan, math.nan
        self.error_px = self.error_grey = math.nan
        self._in_grey = "image" in setup.law.inputs
        self._near = False
        self._held_since = math.inf
        self._rest_since = math.inf

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the task's columns in the log."""
        names = [*self.error_columns]
        if self.views > 1:
            names.insert(0, "view")
        if self._by_estimate:
            names += ["est_position_m", "est_rotation_rad"]
        if self._leans:
            names.append("level_error_px")
        if self._in_grey:
            names.append("error_grey")
        return tuple(names)

    def measure(self, frame: Frame) -> tuple[float, ...]:
        """The columns' values, by which `reached` and `missed` also decide."""
        seen = frame.observation
        goal = frame.goal
        self.error_px = level_error(seen, goal) if self._leans else frame.error.rms_px
        self.error_grey = frame.command.error_grey
        if self._by_estimate:
            self.estimate = estimated_error(seen, goal)
        values = [*self.task_error(frame)]
        if self.views > 1:
            values.insert(0, goal.view)
        if self._by_estimate:
            values += self.estimate
        if self._leans:
            values.append(self.error_px)
        if self._in_grey:
            values.append(self.error_grey)
        return tuple(values)

    def task_error(self, frame: Frame) -> tuple[float, ...]:
        """Values of `error_columns`."""
        return ()

    def near(self, frame: Frame) -> bool:
        """Whether the conditions hold in this frame."""
        if frame.goal.view + 1 < self.views or frame.goal.moves or frame.error.lost:
            return False
        errors = self.error_px, *self.estimate, self.error_grey
        return self.setup.stop.converged.near(frame.error.all_seen, *errors)

    def reached(self, frame: Frame) -> Verdict | None:
        """Converged, when the conditions have held for long enough."""
        goal = self.setup.stop.converged
        self._near = self.near(frame)
        self._held_since = held_since(self._held_since, self._near, frame.t)
        if has_held(self._held_since, frame.t, goal.hold_s):
            return Outcome.converged, f"{goal.summary} for {goal.hold_s:g} s"
        return None

    def missed(self, frame: Frame) -> Verdict | None:
        """A local minimum, or the end of the duration."""
        # Rest of a law that sees nothing is no minimum: the supervisor ends such a run.
        twist = frame.command.twist.tolist()
        reach = frame.goal.reach_m
        rests = max(map(abs, twist[:3])) < REST * reach and max(map(abs, twist[3:])) < REST
        at_rest = rests and not frame.error.lost and not self._near
        self._rest_since = held_since(self._rest_since, at_rest, frame.t)
        if has_held(self._rest_since, frame.t, self.setup.stop.rest_after):
            goal = self.setup.stop.converged
            (distance, angle) = self.estimate
            said = list[str]()
            if goal.error_px is not None:
                said.append(f"at an RMS error of {self.error_px:.3g} px")
            if goal.error_grey is not None:
                said.append(f"at an RMS error of {self.error_grey:.3g} grey levels")
            if goal.by_estimate:
                said.append(
                    f"{distance:.3g} m and {math.degrees(angle):.3g} deg from the goal by the"
                    " robot's own estimate"
                )
            return Outcome.local_minimum, f"the commanded twist is zero {', '.join(said)}"
        # After the local minimum: of a law that rests in the last frame, the more telling reason
        # counts.
        duration = self.setup.stop.duration_s
        if not is_over(frame.t, duration):
            return None
        return Outcome.timed_out, timed_out_words(duration)


def estimated_error(seen: Observation, goal: Goal) -> tuple[float, float]:
    """Estimated distance from the goal [m, rad]: of a vehicle by its place, else of the camera by
    the target's pose; NaN if unknown.
    """
    if goal.place is not None and seen.place is not None:
        ahead, left, turn = relative(goal.place, seen.place)
        return math.hypot(ahead, left), abs(float(turn))
    if seen.T_camera_target is not None:
        return rigid_error(inverse(seen.T_camera_target), inverse(goal.T_camera_target))
    return math.nan, math.nan


def level_error(seen: Observation, goal: Goal) -> float:
    """RMS of goal minus measured after derotation, in pixels of the camera [px]; NaN where nothing
    is seen.
    """
    # The raw error would not do: a craft that tilts to hold against wind never brings it to zero
    # over its goal.
    p = np.column_stack([seen.xy, np.ones(len(seen.xy))]) if seen.ray is None else seen.ray
    error = goal.camera.project(p) - goal.uv
    error = error[np.isfinite(error[:, 0])]
    return float(np.sqrt(np.mean(error**2))) if error.size else math.nan


def timed_out_words(duration_s: float) -> str:
    """Why a run has timed out."""
    return f"{duration_s:g} s were not enough"
