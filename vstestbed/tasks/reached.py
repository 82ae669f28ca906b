"""Tasks with a goal to reach: completed when `stop.converged` holds."""

from __future__ import annotations

import math

from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.robots.supervisor import Supervisor
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import HoldTimer, TaskMonitor
from vstestbed.tasks.setup import Setup

REST = 1e-6
"""A commanded twist under this (m/s and rad/s) is rest; with any pixel noise, commands never are so small."""
REST_S = 2.0
"""How long a commanded rest away from the goal must last to count as a local minimum [s]."""


class GoalMonitor(TaskMonitor):
    """Reached when `stop.converged` holds at the last view; missed in a local minimum, or when the duration is over."""

    def __init__(self, setup: Setup, views: int, supervisor: Supervisor):
        super().__init__(setup, views, supervisor)
        self._near, self._held, self._rest = False, HoldTimer(), HoldTimer()

    def near(self, frame: Frame) -> bool:
        """Whether the conditions hold in this frame."""
        last = frame.goal.view + 1 == self.views
        return last and not frame.error.lost and self.setup.stop.converged.near(frame.error.all_seen, self.error_px, *self.estimate)

    def reached(self, frame: Frame) -> Verdict | None:
        """Converged, when the conditions have held for long enough."""
        goal = self.setup.stop.converged
        self._near = self.near(frame)
        if self._held.lasting(self._near, frame.t) >= goal.hold_s:
            return Outcome.converged, f"{goal.summary} for {goal.hold_s:g} s"
        return None

    def missed(self, frame: Frame) -> Verdict | None:
        """A local minimum, or the end of the duration."""
        # Rest of a law that sees nothing is no minimum: the supervisor ends such a run.
        at_rest = not frame.error.lost and not self._near and max(map(abs, frame.command.twist.tolist())) < REST
        if self._rest.lasting(at_rest, frame.t) >= REST_S:
            return Outcome.local_minimum, f"the commanded twist is zero {self._distance()}"
        # After the local minimum: of a law that rests in the last frame, the more telling reason counts.
        duration = self.setup.stop.duration_s
        return (Outcome.timed_out, f"{duration:g} s were not enough") if frame.t >= duration - 1e-9 else None

    def _distance(self) -> str:
        """How far from the goal it rests, by the quantities that `stop.converged` tests."""
        goal, said = self.setup.stop.converged, []
        if goal.error_px is not None:
            said.append(f"at an RMS error of {self.error_px:.3g} px")
        if goal.by_estimate:
            distance, angle = self.estimate
            said.append(f"{distance:.3g} m and {math.degrees(angle):.3g} deg from the goal by the robot's own estimate")
        return ", ".join(said)
