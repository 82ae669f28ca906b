"""How a run ends: the outcomes, the stop block of a scenario, and the judge that tells them apart."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated

from annotated_types import Ge, Gt

from vstestbed.spec import spec


class Outcome(Enum):
    """How a run ended; the value is the sentence that the user reads."""

    converged = "the goal was reached and held"
    completed = "the task was kept in its band for the whole duration"
    landed = "the craft touched down on its pad"
    timed_out = "the time ran out before the goal was reached"
    target_lost = "the target was out of sight for too long"
    joint_limit = "a joint stood at its limit and the law asked for more"
    singular = "the robot stood at a singular configuration and the law asked for a motion it cannot make"
    local_minimum = "the law orders rest away from the goal"
    diverged = "the camera left for the far distance"
    collided = "the robot touched something"
    crashed = "the simulation became unstable"
    interrupted = "the run was interrupted"

    @property
    def success(self) -> bool:
        """Whether the task was done."""
        return self in (Outcome.converged, Outcome.completed, Outcome.landed)


@spec
class Converged:
    """The goal is reached when all of its markers are seen, the RMS error is under error_px, and that for hold_s."""

    error_px: Annotated[float, Gt(0)] = 0.2
    hold_s: Annotated[float, Ge(0)] = 0.5


@spec
class Stop:
    """When a run ends.

    Args:
        duration_s: simulated time after which the run has timed out [s].
        converged: when the goal counts as reached.
        lost_after_s: how long the target may be out of sight [s].
    """

    duration_s: Annotated[float, Gt(0)] = 30.0
    converged: Converged = Converged()
    lost_after_s: Annotated[float, Ge(0)] = 1.0


FAR_M = 200.0
"""A camera this far from its target has diverged [m]."""
REST = 1e-6
"""A commanded twist under this (m/s and rad/s) is rest: pixels with any noise never order so little."""
REST_S = 2.0
"""How long the law must order rest away from the goal to be in a local minimum [s]."""
BLOCKED_S = 1.0
"""How long a limit must stop the robot to end the run [s]."""
BLOCKED_SCALE = 0.02
"""A command scaled under this has been stopped by the limit."""


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the judge looks at, once a frame.

    Attributes:
        t: time [s].
        lost: too few markers seen, or too few with a depth, for the law to work. held: why the law orders rest.
        all_seen: every marker is seen.
        error_px: RMS error over the coordinates seen [px].
        command_size: largest component of the commanded twist.
        scale, limit: from the allocation of that command.
        distance: camera to target [m]; behind: the camera is behind the target's plane.
        contact: the robot touches something it should not.
    """

    t: float
    lost: bool
    held: str
    all_seen: bool
    error_px: float
    command_size: float
    scale: float
    limit: str
    distance: float
    behind: bool
    contact: bool


@dataclass
class Judge:
    """Watches the evidence and says when a run is over, and why: (Outcome, reason)."""

    stop: Stop
    worked: bool = False
    since: dict[str, float] = field(default_factory=dict)

    def _lasting(self, name: str, holds: bool, t: float) -> float:
        """For how long a condition has held without a break [s]; -inf when it does not hold."""
        if not holds:
            self.since.pop(name, None)
            return -math.inf
        return t - self.since.setdefault(name, t) + 1e-9

    def verdict(self, e: Evidence) -> tuple[Outcome, str] | None:
        """The outcome after this frame with its reason, or None to go on."""
        goal = self.stop.converged
        self.worked = self.worked or not e.lost
        near = not e.lost and e.all_seen and e.error_px < goal.error_px
        held = self._lasting("near", near, e.t)
        lost = self._lasting("lost", e.lost, e.t)
        rest = self._lasting("rest", not e.lost and not near and e.command_size < REST, e.t)
        blocked = self._lasting("blocked", e.limit in ("joint_limit", "singular") and e.scale < BLOCKED_SCALE, e.t)
        if held >= goal.hold_s:
            return Outcome.converged, f"RMS error under {goal.error_px:g} px for {goal.hold_s:g} s"
        if e.contact:
            return Outcome.collided, "the robot touched something"
        if e.distance > FAR_M:
            return Outcome.diverged, f"the camera is more than {FAR_M:g} m away from the target"
        if e.behind:
            return Outcome.target_lost, "the camera crossed the plane of the target"
        if e.lost and lost >= self.stop.lost_after_s:
            never = "" if self.worked else ", from the start on"
            return Outcome.target_lost, f"{e.held or Outcome.target_lost.value} for {self.stop.lost_after_s:g} s{never}"
        if blocked >= BLOCKED_S:
            return Outcome[e.limit], f"{Outcome[e.limit].value} for {BLOCKED_S:g} s"
        if rest >= REST_S:
            return Outcome.local_minimum, f"the commanded twist is zero at an RMS error of {e.error_px:.3g} px"
        if e.t >= self.stop.duration_s - 1e-9:
            return Outcome.timed_out, f"{self.stop.duration_s:g} s were not enough"
        return None
