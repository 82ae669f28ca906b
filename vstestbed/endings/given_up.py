"""The task was given up: the target is lost, or the law has failed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.endings.base import Ending, FrameLimits, IdealRuns
from vstestbed.robots.base import Supervisor
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import is_over


class GivenUp(Ending):
    """The reason for which the supervisor has given the task up, once the robot has come to rest,
    or the time is over.

    duration_s: of the run. lost: adds to the reason where the target was lost; None: nothing does.
    """

    def __init__(
        self,
        supervisor: Supervisor,
        duration_s: float,
        lost: Callable[[Verdict], str] | None = None,
    ):
        self._supervisor = supervisor
        self._duration_s = duration_s
        self._lost = lost

    def update(self, frame: Frame) -> Verdict | None:
        return self.verdict(frame.t)

    def verdict(self, t: float) -> Verdict | None:
        """The verdict at a time [s]."""
        if self._supervisor.aborted is None:
            return None
        down = self._supervisor.down(t)
        if not (down or is_over(t, self._duration_s)):
            return None
        outcome, reason = self._supervisor.aborted
        if self._lost is not None:
            reason = self._lost((outcome, reason))
        how = self._supervisor.DOWN[0 if down else 1]
        return outcome, f"{reason}; {how}" if how else reason


class Lost(Ending):
    """Of an ideal run, which stands at once: no measurement for too long, or too long a way."""

    outcome = Outcome.target_lost

    @staticmethod
    def over(runs: IdealRuns, limits: FrameLimits) -> NDArray[np.bool_]:
        return (runs.blind > limits.lost) | (runs.blind_m >= limits.lost_m)


class LawFailed(Ending):
    """Of an ideal run: the law gave no command."""

    outcome = Outcome.law_failed

    @staticmethod
    def over(runs: IdealRuns, limits: FrameLimits) -> NDArray[np.bool_]:
        return runs.failed
