"""What watches a task while a run goes: its error for the log, and whether it is reached or missed."""

from __future__ import annotations

import math

import numpy as np

from vstestbed.core.geometry import inverse, rigid_error
from vstestbed.core.outcome import Verdict
from vstestbed.core.planar import relative
from vstestbed.features.observation import Goal, Observation
from vstestbed.robots.supervisor import Supervisor
from vstestbed.tasks.base import Setup
from vstestbed.tasks.frame import Frame


class HoldTimer:
    """Measures for how long a condition has held without a break."""

    def __init__(self) -> None:
        self._since: float | None = None

    def lasting(self, holds: bool, t: float) -> float:
        """For how long [s] at time t [s]; -inf when it does not hold."""
        if not holds:
            self._since = None
            return -math.inf
        if self._since is None:
            self._since = t
        return t - self._since + 1e-9  # times are sums of steps: a hold of .5 s must not miss its frame by a rounding


class TaskMonitor:
    """Measures once a frame; asked then, once each, whether the task is reached and whether it is missed.

    Columns of the log: `view`, of several goal views the number of the one that counts; the task's own (`error_columns`);
    `est_position_m`, `est_rotation_rad`, how far the robot thinks it is from its goal, where the goal counts as reached by that
    estimate; `level_error_px` of a craft that leans: as `error_px`, of what the law is given, the picture turned level as the
    scenario derotates.

    Args:
        setup: the experiment's parts. views: how many goal views there are. supervisor: the robot's.
    """

    error_columns: tuple[str, ...] = ()

    def __init__(self, setup: Setup, views: int, supervisor: Supervisor):
        self.setup, self.views, self.supervisor = setup, views, supervisor
        self.mount_inverse = inverse(setup.camera.mount.T)
        self._by_estimate, self._leans = setup.stop.converged.by_estimate, setup.robot.base == "floating"
        self.estimate = math.nan, math.nan
        self.error_px = math.nan

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the task's columns in the log."""
        return (
            *(("view",) if self.views > 1 else ()),
            *self.error_columns,
            *(("est_position_m", "est_rotation_rad") if self._by_estimate else ()),
            *(("level_error_px",) if self._leans else ()),
        )

    def measure(self, frame: Frame) -> tuple[float, ...]:
        """The columns' values; also what `reached` and `missed` judge by."""
        seen, goal = frame.observation, frame.goal
        self.error_px = level_error(seen, goal) if self._leans else frame.error.rms_px
        if self._by_estimate:
            self.estimate = estimated_error(seen, goal)
        return (
            *((goal.view,) if self.views > 1 else ()),
            *self.task_error(frame),
            *(self.estimate if self._by_estimate else ()),
            *((self.error_px,) if self._leans else ()),
        )

    def task_error(self, frame: Frame) -> tuple[float, ...]:
        """Values of `error_columns`."""
        return ()

    def reached(self, frame: Frame) -> Verdict | None:
        """The outcome where this frame completes the task."""
        return None

    def missed(self, frame: Frame) -> Verdict | None:
        """The outcome where the task cannot be completed any more; it counts after those of all other monitors."""
        return None


def estimated_error(seen: Observation, goal: Goal) -> tuple[float, float]:
    """How far from the goal the robot thinks it is: (distance [m], angle [rad]), NaN where it cannot tell.

    A vehicle whose goal is a place goes by its place; else it is the camera, by the target's pose.
    """
    if goal.place is not None and seen.place is not None:
        ahead, left, turn = relative(goal.place, seen.place)
        return math.hypot(ahead, left), abs(float(turn))
    if seen.T_camera_target is not None:
        return rigid_error(inverse(seen.T_camera_target), inverse(goal.T_camera_target))
    return math.nan, math.nan


def level_error(seen: Observation, goal: Goal) -> float:
    """RMS over the coordinates of goal minus what the law is given, as pixels of the camera [px]; NaN where nothing is seen."""
    p = np.column_stack([seen.xy, np.ones(len(seen.xy))]) if seen.ray is None else seen.ray
    error = goal.camera.project(p) - goal.uv
    error = error[np.isfinite(error[:, 0])]
    return float(np.sqrt(np.mean(error**2))) if error.size else math.nan
