"""The witness: completes the controller's cycle to a frame, with the truth that the controller never sees."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from vstestbed.camera import Image
from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.features.observation import Goal
from vstestbed.loop.exposure import Exposure
from vstestbed.robots.robot_log import RobotLog, RobotState
from vstestbed.robots.supervisor import Supervisor
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Truth
from vstestbed.tasks.frame import Cycle, Frame
from vstestbed.vision.goal_points import goal_of_points, points_of

_NOWHERE = np.full(3, np.nan)
"""Place and odometry of a robot that has none."""


class Witness:
    """Makes frames, with the columns that only this robot and this task have; nothing of it comes back to the controller.

    Attributes:
        task: the task's monitor, which measures each frame.

    Args:
        scenario: the experiment. supervisor: the robot's.
    """

    def __init__(self, scenario: Scenario, supervisor: Supervisor):
        self.task, self._supervisor = scenario.goal.monitor(scenario.setup, supervisor), supervisor
        self._robot_log = scenario.robot.log(supervisor)
        self._others = scenario.detector.rows is not None
        camera = scenario.camera
        self._goal = Goal.from_view(camera, scenario.target.points, scenario.goal_poses[-1])
        self._own = len(self._robot_log.columns) + len(self.task.columns)

    def frame(self, cycle: Cycle, shot: Exposure, truth: Truth, image: Image | None) -> Frame:
        """The cycle with the truth at its exposure, and the robot's and the task's own columns."""
        row = np.empty(self._own)
        c = cycle
        if self._others:
            truth = replace(truth, p_camera=self._true_points(c.goal, truth))
        frame = Frame(c.timing, c.observation, c.goal, c.error, c.command, c.allocation, truth, image, row)
        values = self.task.measure(frame)
        row[:] = (*self._robot_row(frame, shot), *values)
        return frame

    def _true_points(self, goal: Goal, truth: Truth) -> Array:
        """True places in the camera frame (K, 3) [m] of a goal's points, in the target's plane where the true lens saw them."""
        at_goal = goal_of_points(replace(self._goal, image=None), goal.uv)
        return transform(inverse(truth.T_world_camera) @ truth.T_world_target, points_of(at_goal))

    def _robot_row(self, frame: Frame, shot: Exposure) -> Iterable[float]:
        """Values of the robot's own columns."""
        if self._robot_log.columns == RobotLog.columns:
            return (self._supervisor.mode,)  # the state, which takes a tenth of an ideal frame, is not needed
        seen, truth = frame.observation, frame.truth
        place, odometry = (_NOWHERE if known is None else known for known in (seen.place, seen.odometry))
        T_base = frame.T_world_base(self.task.mount_inverse)
        return self._robot_log.row(RobotState(shot.t, T_base, place, odometry, shot.reading, truth.act, truth.wind))
