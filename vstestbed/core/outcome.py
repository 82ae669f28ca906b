"""How a run ends: the outcomes, and the sentence that the user reads for each."""

from __future__ import annotations

from enum import Enum

__all__ = ["Outcome", "Verdict"]


class Outcome(Enum):
    """How a run ended; the value is the sentence that the user reads."""

    converged = "the goal was reached and held"
    completed = "the task was kept in its band for the whole duration"
    landed = "the craft touched down on its pad"
    inserted = "the plug sits in its socket"
    timed_out = "the time ran out before the goal was reached"
    unstable = "the loop swung or grew until the time ran out"
    target_lost = "the target was out of sight for too long"
    joint_limit = "a joint stood at its limit and the law asked for more"
    singular = (
        "the robot stood at a singular configuration and the law asked for a motion it cannot make"
    )
    local_minimum = "the law orders rest away from the goal"
    diverged = "the camera left for the far distance"
    collided = "the robot touched something"
    overturned = "the craft tilted by more than 60 degrees"
    jammed = "the plug stuck before its depth"
    rotor_limit = "a rotor stood at its limit for too long"
    law_failed = "the law failed, and the robot was stopped"
    crashed = "the simulation became unstable"
    unreachable = "the robot cannot stand where the run would begin"
    interrupted = "the run was interrupted"

    @property
    def success(self) -> bool:
        """Whether the task was done."""
        return self in (Outcome.converged, Outcome.completed, Outcome.landed, Outcome.inserted)

    @property
    def out_of_time(self) -> bool:
        """Whether the run ended because its time was over, with its task not done."""
        return self in (Outcome.timed_out, Outcome.unstable)


Verdict = tuple[Outcome, str]  # an outcome with its reason, in words
