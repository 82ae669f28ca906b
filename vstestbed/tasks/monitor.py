"""The monitor of a task: its error for the log, and the verdict, reached or missed."""

from __future__ import annotations

import math

import numpy as np

from vstestbed.core.geometry import inverse, rigid_error
from vstestbed.core.outcome import Verdict
from vstestbed.core.planar import relative
from vstestbed.features.observation import Goal, Observation
from vstestbed.robots.supervisor import Supervisor
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.setup import Setup


class HoldTimer:
    """Measures for how long a condition has held without a break."""

    def __init__(self) -> None:
        self._since: float | None = None

    def lasting(self, holds: bool, t: float) -> float:
        """Duration so far [s] at time t [s]; -inf when the condition does not hold."""
        if not holds:
            self._since = None
            return -math.inf
        if self._since is None:
            self._since = t
        return t - self._since + 1e-9  # times are sums of steps: a hold of .5 s must not miss its frame by a rounding


class TaskMonitor:
    """Measures once a frame; asked then, once each, whether the task is reached and whether it is missed.

    Columns of the log: `view`, the number of the current goal view, where there are several; the task's own (`error_columns`);
    `est_position_m`, `est_rotation_rad`, the robot's estimated distance from its goal, where `stop.converged` uses it;
    `level_error_px` of a craft that tilts: as `error_px`, after derotation; `error_grey` of a law that works on grey levels: the RMS
    difference between picture and goal picture, with the law's weights.

    Args:
        setup: the experiment's parts. views: how many goal views there are. supervisor: the robot's.
    """

    error_columns: tuple[str, ...] = ()

    def __init__(self, setup: Setup, views: int, supervisor: Supervisor):
        self.setup, self.views, self.supervisor = setup, views, supervisor
        self.mount_inverse = inverse(setup.camera.mount.T)
        self._by_estimate, self._leans = setup.stop.converged.by_estimate, setup.robot.base == "floating"
        self.estimate = math.nan, math.nan
        self.error_px = self.error_grey = math.nan
        self._in_grey = "image" in setup.law.inputs

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the task's columns in the log."""
        return (
            *(("view",) if self.views > 1 else ()),
            *self.error_columns,
            *(("est_position_m", "est_rotation_rad") if self._by_estimate else ()),
            *(("level_error_px",) if self._leans else ()),
            *(("error_grey",) if self._in_grey else ()),
        )

    def measure(self, frame: Frame) -> tuple[float, ...]:
        """The columns' values, by which `reached` and `missed` also decide."""
        seen, goal = frame.observation, frame.goal
        self.error_px = level_error(seen, goal) if self._leans else frame.error.rms_px
        self.error_grey = frame.command.error_grey
        if self._by_estimate:
            self.estimate = estimated_error(seen, goal)
        return (
            *((goal.view,) if self.views > 1 else ()),
            *self.task_error(frame),
            *(self.estimate if self._by_estimate else ()),
            *((self.error_px,) if self._leans else ()),
            *((self.error_grey,) if self._in_grey else ()),
        )

    def task_error(self, frame: Frame) -> tuple[float, ...]:
        """Values of `error_columns`."""
        return ()

    def reached(self, frame: Frame) -> Verdict | None:
        """The verdict where this frame completes the task."""
        return None

    def missed(self, frame: Frame) -> Verdict | None:
        """The outcome where the task cannot be completed any more; it counts after those of all other monitors."""
        return None


def estimated_error(seen: Observation, goal: Goal) -> tuple[float, float]:
    """Estimated distance from the goal [m, rad]: of a vehicle by its place, else of the camera by the target's pose; NaN if unknown."""
    if goal.place is not None and seen.place is not None:
        ahead, left, turn = relative(goal.place, seen.place)
        return math.hypot(ahead, left), abs(float(turn))
    if seen.T_camera_target is not None:
        return rigid_error(inverse(seen.T_camera_target), inverse(goal.T_camera_target))
    return math.nan, math.nan


def level_error(seen: Observation, goal: Goal) -> float:
    """RMS of goal minus measured after derotation, in pixels of the camera [px]; NaN where nothing is seen."""
    # The raw error would not do: a craft that tilts to hold against wind never brings it to zero over its goal.
    p = np.column_stack([seen.xy, np.ones(len(seen.xy))]) if seen.ray is None else seen.ray
    error = goal.camera.project(p) - goal.uv
    error = error[np.isfinite(error[:, 0])]
    return float(np.sqrt(np.mean(error**2))) if error.size else math.nan
