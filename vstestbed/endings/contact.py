"""The robot touches something."""

from __future__ import annotations

from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.endings.base import Ending
from vstestbed.robots.base import Supervisor
from vstestbed.sim.base import Truth
from vstestbed.tasks.frame import Frame


class Contact(Ending):
    """Collided, by the simulator's contacts. supervisor: feet may not touch before it lets them."""

    def __init__(self, supervisor: Supervisor):
        self._supervisor = supervisor

    def update(self, frame: Frame) -> Verdict | None:
        truth = frame.truth
        # nearly every frame: nothing touches
        return self.verdict(truth) if truth.contact or truth.feet else None

    def verdict(self, truth: Truth) -> Verdict | None:
        """The verdict at any instant, with the reason of an earlier abort."""
        touching = self.touching(truth)
        if not touching:
            return None
        words = f"contact of {touching}"
        if aborted := self._supervisor.aborted:
            words += f", after {aborted[1]}"
        return Outcome.collided, words

    def touching(self, truth: Truth) -> str:
        """What touches that may not, as `forearm and floor`; "" where nothing does."""
        return truth.contact or ("" if self._supervisor.may_touch else truth.feet)
