"""Termination: all terms in one order, which is their precedence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.endings.base import Ending, FrameLimits, IdealRuns
from vstestbed.endings.blocked import Blocked
from vstestbed.endings.contact import Contact
from vstestbed.endings.divergence import Divergence
from vstestbed.endings.given_up import GivenUp, LawFailed, Lost
from vstestbed.endings.goal import AtRest, Missed, OutOfTime, Reached
from vstestbed.endings.monitors import Monitor, Ruled
from vstestbed.endings.plane import PlaneCrossed
from vstestbed.robots.base import Supervisor
from vstestbed.sim.base import Truth
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import Setup, TaskMonitor, is_over, timed_out_words

GOES_ON = -1  # code of an ideal run that has not ended

ORDER = (
    GivenUp,
    LawFailed,
    Lost,
    Reached,
    Contact,
    Divergence,
    PlaneCrossed,
    Blocked,
    Ruled,
    Missed,
    AtRest,
    OutOfTime,
)
"""All terms by their precedence: of several in one frame the first counts. A task that was given up
ends when the robot has come to rest; until then nothing but a contact ends the run.
"""
OVER_ARRAYS = tuple(term for term in ORDER if term.outcome)
OUTCOMES: tuple[Outcome, ...] = tuple(term.outcome for term in OVER_ARRAYS if term.outcome)
"""Outcomes of ideal runs; an outcome's code is its place."""


class Explains(Protocol):
    """Says more of a verdict than the term knows."""

    def add(self, frame: Frame) -> None:
        """One more frame."""
        ...

    def lost(self, verdict: Verdict) -> str:
        """The reason of a task that was given up, with where its markers were lost."""
        ...

    def explained(self, verdict: Verdict) -> Verdict:
        """The verdict, or another one of a loop that is unstable, with what is known of it."""
        ...


class Termination:
    """Decides by truth, measurements and commands whether a run is over; nothing of it comes back
    to the law.

    Args:
        task: has already measured the frame. setup: with the limits of the run, and the target.
            supervisor: gives tasks up. monitors: the scenario's, each with its kind.
        explanation: sees every frame, and has the last word on a verdict.
    """

    def __init__(
        self,
        task: TaskMonitor,
        setup: Setup,
        supervisor: Supervisor,
        monitors: Sequence[tuple[str, Monitor]] = (),
        explanation: Explains | None = None,
    ):
        self._supervisor = supervisor
        self._duration_s = setup.stop.duration_s
        self._explanation = explanation
        self._contact = Contact(supervisor)
        self._given_up = GivenUp(
            supervisor, self._duration_s, explanation.lost if explanation else None
        )
        # the given-up task is asked apart; the other terms of ORDER are of ideal runs alone
        terms = (
            Reached(task),
            self._contact,
            Divergence(),
            PlaneCrossed(setup),
            Blocked(),
            *(Ruled(kind, monitor) for kind, monitor in monitors),
            Missed(task),
        )
        self.terms: tuple[Ending, ...] = tuple(sorted(terms, key=lambda t: ORDER.index(type(t))))

    def verdict(self, frame: Frame) -> Verdict | None:
        """The outcome after this frame with its reason, or None to go on."""
        # All terms see every frame, whichever decides: they measure durations, and a tolerance that
        # was violated while the task was given up stays violated when the supervisor resumes it.
        found = [term.update(frame) for term in self.terms]
        if self._explanation is not None:
            self._explanation.add(frame)
        if self._supervisor.aborted and not self._contact.touching(frame.truth):
            verdict = self._given_up.update(frame)
        else:
            verdict = next(filter(None, found), None)
        return verdict and self._explained(verdict)

    def without_picture(self, t: float, truth: Truth) -> Verdict | None:
        """The outcome while no picture arrives [s]: of a collision, of a task that was given up, or
        of the end of the duration.
        """
        if collided := self._contact.verdict(truth):
            return collided
        if self._supervisor.aborted:
            verdict = self._given_up.verdict(t)
            return verdict and self._explained(verdict)
        if not is_over(t, self._duration_s):
            return None
        return Outcome.timed_out, timed_out_words(self._duration_s)

    def _explained(self, verdict: Verdict) -> Verdict:
        return verdict if self._explanation is None else self._explanation.explained(verdict)


def codes(runs: IdealRuns, limits: FrameLimits) -> NDArray[np.int_]:
    """How each of m ideal runs ends with this frame, as positions in OUTCOMES; GOES_ON (m,)."""
    code = np.full(len(runs.frame), GOES_ON)
    for i, term in reversed([*enumerate(OVER_ARRAYS)]):  # the first of ORDER is written last
        code[term.over(runs, limits)] = i
    return code
