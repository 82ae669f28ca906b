"""The judge: the verdict on each frame, from the task's monitor and the safety monitors."""

from __future__ import annotations

from collections.abc import Sequence

from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.loop.monitors import Collision, safety_monitors
from vstestbed.robots.supervisor import Supervisor
from vstestbed.sim.base import Truth
from vstestbed.targets import Target
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import TaskMonitor
from vstestbed.tasks.monitors import Monitor
from vstestbed.tasks.stop import Stop


class Judge:
    """Decides by truth, measurements and commands; nothing of it comes back to the law.

    Precedence of several outcomes in one frame: a task aborted by the supervisor (unless the robot touches something), a task
    that is reached, the safety monitors in their order, the scenario's own, a task that is missed.

    Args:
        task: the task's monitor, which has already measured the frame. stop: time limits.
        target: the scenario's. supervisor: the robot's. own: the scenario's monitors.
    """

    def __init__(self, task: TaskMonitor, stop: Stop, target: Target, supervisor: Supervisor, own: Sequence[Monitor] = ()):
        self._task, self._supervisor, self._duration_s = task, supervisor, stop.duration_s
        self._collision = Collision(supervisor)
        self._monitors = (*safety_monitors(target, self._collision, stop), *own)

    def verdict(self, frame: Frame) -> Verdict | None:
        """The outcome after this frame with its reason, or None to go on."""
        # All monitors see every frame, whichever decides: they measure durations, and a tolerance that was violated while the task
        # was aborted stays violated when the supervisor resumes it.
        reached, missed = self._task.reached(frame), self._task.missed(frame)
        found = [monitor.update(frame) for monitor in self._monitors]
        if self._supervisor.aborted and not self._collision.touches(frame.truth):
            return self._after_abort(frame.t, self._supervisor.aborted)
        return reached or next(filter(None, found), None) or missed

    def without_picture(self, t: float, truth: Truth) -> Verdict | None:
        """The outcome while no picture arrives [s]: of a collision, of an aborted task, or of the end of the duration."""
        if verdict := self._collision.verdict(truth):
            return verdict
        if self._supervisor.aborted:
            return self._after_abort(t, self._supervisor.aborted)
        return (Outcome.timed_out, f"{self._duration_s:g} s were not enough") if t >= self._duration_s - 1e-9 else None

    def _after_abort(self, t: float, aborted: Verdict) -> Verdict | None:
        """The abort's verdict, once the robot is at rest, or down, or the duration is over."""
        down = self._supervisor.down(t)
        if not (down or t >= self._duration_s - 1e-9):
            return None
        outcome, reason = aborted
        return outcome, f"{reason}; {self._supervisor.DOWN[0 if down else 1]}"
