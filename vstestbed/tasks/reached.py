"""Tasks with a goal to reach: completed when `stop.converged` holds."""

from __future__ import annotations

import math

from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.robots.supervisor import Supervisor
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import HoldTimer, TaskMonitor
from vstestbed.tasks.setup import Setup
from vstestbed.tasks.stop import Converged

REST = 1e-6
"""A commanded twist under this (m/s and rad/s) is rest; with any pixel noise, commands never are so small."""


def converged_words(goal: Converged) -> str:
    """Why a run has converged."""
    return f"{goal.summary} for {goal.hold_s:g} s"


def at_rest_words(
    goal: Converged, error_px: float, estimate: tuple[float, float] = (math.nan, math.nan), error_grey: float = math.nan
) -> str:
    """Why a run is in a local minimum: it rests so far from the goal, by the quantities that `stop.converged` tests."""
    said = []
    if goal.error_px is not None:
        said.append(f"at an RMS error of {error_px:.3g} px")
    if goal.error_grey is not None:
        said.append(f"at an RMS error of {error_grey:.3g} grey levels")
    if goal.by_estimate:
        distance, angle = estimate
        said.append(f"{distance:.3g} m and {math.degrees(angle):.3g} deg from the goal by the robot's own estimate")
    return f"the commanded twist is zero {', '.join(said)}"


def timed_out_words(duration_s: float) -> str:
    """Why a run has timed out."""
    return f"{duration_s:g} s were not enough"


class GoalMonitor(TaskMonitor):
    """Reached when `stop.converged` holds at the last view; missed in a local minimum, or when the duration is over."""

    def __init__(self, setup: Setup, views: int, supervisor: Supervisor):
        super().__init__(setup, views, supervisor)
        self._near, self._held, self._rest = False, HoldTimer(), HoldTimer()

    def near(self, frame: Frame) -> bool:
        """Whether the conditions hold in this frame."""
        last = frame.goal.view + 1 == self.views and not frame.goal.moves
        errors = self.error_px, *self.estimate, self.error_grey
        return last and not frame.error.lost and self.setup.stop.converged.near(frame.error.all_seen, *errors)

    def reached(self, frame: Frame) -> Verdict | None:
        """Converged, when the conditions have held for long enough."""
        goal = self.setup.stop.converged
        self._near = self.near(frame)
        if self._held.lasting(self._near, frame.t) >= goal.hold_s:
            return Outcome.converged, converged_words(goal)
        return None

    def missed(self, frame: Frame) -> Verdict | None:
        """A local minimum, or the end of the duration."""
        # Rest of a law that sees nothing is no minimum: the supervisor ends such a run.
        at_rest = not frame.error.lost and not self._near and max(map(abs, frame.command.twist.tolist())) < REST
        if self._rest.lasting(at_rest, frame.t) >= self.setup.stop.rest_after:
            return Outcome.local_minimum, at_rest_words(self.setup.stop.converged, self.error_px, self.estimate, self.error_grey)
        # After the local minimum: of a law that rests in the last frame, the more telling reason counts.
        duration = self.setup.stop.duration_s
        return (Outcome.timed_out, timed_out_words(duration)) if frame.t >= duration - 1e-9 else None
