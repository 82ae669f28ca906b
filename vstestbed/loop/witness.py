"""The witness: completes the controller's cycle to a frame, with the truth that the controller never sees."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from vstestbed.camera import Image
from vstestbed.core.geometry import inverse, transform
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
        # Of points that are not the target's markers, by the true lens: they lie in the target's plane where it saw them at the goal.
        self._goal = (
            Goal.from_view(scenario.camera, scenario.target.points, scenario.goal_poses[-1]) if scenario.detector.rows is not None else None
        )
        self._own = len(self._robot_log.columns) + len(self.task.columns)

    def frame(self, cycle: Cycle, shot: Exposure, truth: Truth, image: Image | None) -> Frame:
        """The cycle, of the exposure `shot`, with the truth then, and the robot's and the task's own columns."""
        row = np.empty(self._own)
        c, depth = cycle, shot.picture.depth if shot.picture else None
        if self._goal is not None:
            points = points_of(goal_of_points(self._goal, c.goal.uv))
            truth = replace(truth, p_camera=transform(inverse(truth.T_world_camera) @ truth.T_world_target, points))
        parts = c.timing, c.observation, c.goal, c.error, c.command, c.allocation
        frame = Frame(*parts, truth, image, row, order=c.order, depth_image=depth)
        values = self.task.measure(frame)
        row[:] = (*self._robot_row(frame, shot), *values)
        return frame

    def _robot_row(self, frame: Frame, shot: Exposure) -> Iterable[float]:
        """Values of the robot's own columns."""
        if self._robot_log.columns == RobotLog.columns:
            return (self._supervisor.mode,)  # the state, which takes a tenth of an ideal frame, is not needed
        seen, truth = frame.observation, frame.truth
        place, odometry = (_NOWHERE if known is None else known for known in (seen.place, seen.odometry))
        T_base = frame.T_world_base(self.task.mount_inverse)
        return self._robot_log.row(RobotState(shot.t, T_base, place, odometry, shot.reading, truth.act, truth.wind))
