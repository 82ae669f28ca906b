"""The judge: the verdict on each frame, from the task's monitor and the safety monitors."""

from __future__ import annotations

from collections.abc import Sequence

from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.loop.lost_markers import LostMarkers
from vstestbed.loop.monitors import Collision, safety_monitors
from vstestbed.loop.stability import Stability
from vstestbed.robots.supervisor import Supervisor
from vstestbed.sim.base import Truth
from vstestbed.targets import Target
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import TaskMonitor
from vstestbed.tasks.monitors import Monitor
from vstestbed.tasks.reached import timed_out_words
from vstestbed.tasks.stop import Stop

DRIVEN_TO = (Outcome.target_lost, Outcome.diverged, Outcome.collided)
"""Ends to which a loop that swings or grows may drive a robot before its time is over."""


class Judge:
    """Decides by truth, measurements and commands; nothing of it comes back to the law.

    Precedence of several outcomes in one frame: a task aborted by the supervisor (unless the robot touches something), a task
    that is reached, the safety monitors in their order, the scenario's own, a task that is missed.

    Args:
        task: the task's monitor, which has already measured the frame. stop: time limits.
        target: the scenario's. supervisor: the robot's. own: the scenario's monitors.
        stability: tells a run that would end as `timed_out`, and is unstable; None: no run is looked at so.
        markers: tells where those are lost that are not seen; None: it is not said.
    """

    def __init__(
        self,
        task: TaskMonitor,
        stop: Stop,
        target: Target,
        supervisor: Supervisor,
        own: Sequence[Monitor] = (),
        stability: Stability | None = None,
        markers: LostMarkers | None = None,
    ):
        self._task, self._supervisor, self._duration_s = task, supervisor, stop.duration_s
        self.stability, self._markers = stability, markers
        self._collision = Collision(supervisor)
        self._monitors = (*safety_monitors(target, self._collision, stop), *own)

    def verdict(self, frame: Frame) -> Verdict | None:
        """The outcome after this frame with its reason, or None to go on."""
        # All monitors see every frame, whichever decides: they measure durations, and a tolerance that was violated while the task
        # was aborted stays violated when the supervisor resumes it.
        reached, missed = self._task.reached(frame), self._task.missed(frame)
        found = [monitor.update(frame) for monitor in self._monitors]
        if self._markers is not None:
            self._markers.add(frame)
        if self.stability is not None:
            self.stability.add(frame)
        if self._supervisor.aborted and not self._collision.touches(frame.truth):
            return self._after_abort(frame.t, self._supervisor.aborted)
        verdict = reached or next(filter(None, found), None) or missed
        return verdict and self._told_apart(verdict)

    def _told_apart(self, verdict: Verdict) -> Verdict:
        """Unstable, of a run that has timed out because its loop swings or grows; where that drove it elsewhere, the reason says so."""
        outcome, reason = verdict
        if self.stability is None or outcome not in (Outcome.timed_out, *DRIVEN_TO):
            return verdict
        how = self.stability.unstable(seen=outcome in DRIVEN_TO)
        if not how:
            return verdict
        if outcome in DRIVEN_TO:
            return outcome, f"{reason}; before, the loop was unstable: {how}"
        return Outcome.unstable, how if reason == timed_out_words(self._duration_s) else f"{reason}; {how}"

    def without_picture(self, t: float, truth: Truth) -> Verdict | None:
        """The outcome while no picture arrives [s]: of a collision, of an aborted task, or of the end of the duration."""
        if verdict := self._collision.verdict(truth):
            return verdict
        if self._supervisor.aborted:
            return self._after_abort(t, self._supervisor.aborted)
        return (Outcome.timed_out, timed_out_words(self._duration_s)) if t >= self._duration_s - 1e-9 else None

    def _after_abort(self, t: float, aborted: Verdict) -> Verdict | None:
        """The abort's verdict, once the robot is at rest, or down, or the duration is over."""
        down = self._supervisor.down(t)
        if not (down or t >= self._duration_s - 1e-9):
            return None
        outcome, reason = aborted
        where = self._markers.sentence() if self._markers is not None and outcome is Outcome.target_lost else ""
        return self._told_apart((outcome, "; ".join(filter(None, (reason, where, self._supervisor.DOWN[0 if down else 1])))))
