"""The task is reached, or missed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.endings.base import Ending, FrameLimits, IdealRuns
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import TaskMonitor


class Reached(Ending):
    """The task's own word that it is done. task: has already measured the frame."""

    outcome = Outcome.converged

    def __init__(self, task: TaskMonitor):
        self._task = task

    def update(self, frame: Frame) -> Verdict | None:
        return self._task.reached(frame)

    @staticmethod
    def over(runs: IdealRuns, limits: FrameLimits) -> NDArray[np.bool_]:
        return runs.near > limits.hold


class Missed(Ending):
    """The task's own word that it will not be done: rest elsewhere, or the end of its time. task:
    has already measured the frame.
    """

    def __init__(self, task: TaskMonitor):
        self._task = task

    def update(self, frame: Frame) -> Verdict | None:
        return self._task.missed(frame)


class AtRest(Ending):
    """Of an ideal run: the law orders rest away from the goal."""

    outcome = Outcome.local_minimum

    @staticmethod
    def over(runs: IdealRuns, limits: FrameLimits) -> NDArray[np.bool_]:
        return runs.rest > limits.rest


class OutOfTime(Ending):
    """Of an ideal run: its duration is over."""

    outcome = Outcome.timed_out

    @staticmethod
    def over(runs: IdealRuns, limits: FrameLimits) -> NDArray[np.bool_]:
        return runs.frame >= limits.last
