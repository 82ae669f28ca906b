"""How a run ends: the outcomes, the stop block of a scenario, and the judge that tells them apart."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated

from annotated_types import Ge, Gt

from vstestbed.core.spec import spec
from vstestbed.scenario.progress_check import Pace, PaceMaker


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
    overturned = "the craft tilted by more than 60 degrees"
    rotor_limit = "a rotor stood at its limit for too long"
    crashed = "the simulation became unstable"
    interrupted = "the run was interrupted"

    @property
    def success(self) -> bool:
        """Whether the task was done."""
        return self in (Outcome.converged, Outcome.completed, Outcome.landed)


@spec
class Converged:
    """When the goal counts as reached: every condition given holds for hold_s. Without any, error_px is 0.2.

    Args:
        error_px: all markers are seen, and their RMS error is under this [px].
        position_m, rotation_deg: by the law's own estimate (the pose from the markers; a vehicle's place) the robot is this near
            to its goal [m, deg].
        hold_s: for how long [s].
    """

    error_px: Annotated[float, Gt(0)] | None = None
    position_m: Annotated[float, Gt(0)] | None = None
    rotation_deg: Annotated[float, Gt(0)] | None = None
    hold_s: Annotated[float, Ge(0)] = 0.5

    def __post_init__(self) -> None:
        """Without a condition, 0.2 px."""
        if self.error_px is None and self.position_m is None and self.rotation_deg is None:
            object.__setattr__(self, "error_px", 0.2)

    @property
    def by_estimate(self) -> bool:
        """Whether the robot's own estimate counts."""
        return self.position_m is not None or self.rotation_deg is not None

    def near(self, all_seen: bool, error_px: float, position_m: float, rotation_rad: float) -> bool:
        """Whether the conditions hold; NaN, of what is not known, does not."""
        if self.error_px is not None and not (all_seen and error_px < self.error_px):
            return False
        if self.position_m is not None and not position_m < self.position_m:
            return False
        return self.rotation_deg is None or math.degrees(rotation_rad) < self.rotation_deg

    @property
    def words(self) -> str:
        """The conditions as a person says them."""
        given = ((self.error_px, "RMS error under {:g} px"), (self.position_m, "under {:g} m"), (self.rotation_deg, "under {:g} deg"))
        said = ", ".join(form.format(value) for value, form in given if value is not None)
        return said if self.error_px is not None else f"by its own estimate {said} off"


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
        last_view: the goal is the last of its views.
        position_m, rotation_rad: how far the robot is from its goal by the law's own estimate, NaN where it has none.
        off_m: true error of a task without an end [m], NaN for other tasks. ways: true ways so far of what shall keep going [m],
            in the order of the band's paces.
        aborted: why a craft that flies gave its task up, if it did: then it holds, sinks, and the run ends when it stands.
        down: it stands with its rotors off. touchdown: how a landing went, in truth; None before.
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
    last_view: bool = True
    position_m: float = math.nan
    rotation_rad: float = math.nan
    off_m: float = math.nan
    ways: tuple[float, ...] = ()
    aborted: tuple[Outcome, str] | None = None
    down: bool = False
    touchdown: tuple[Outcome, str] | None = None
    flies: bool = False


@dataclass(frozen=True, slots=True)
class Band:
    """A task without an end: how far off it may be [m] from `settle_s` on, what shall keep going all the while, until when at least [s]."""

    width_m: float
    settle_s: float
    paces: tuple[Pace, ...] = ()
    until_s: float = 0.0


@dataclass
class Judge:
    """Watches the evidence and says when a run is over, and why: (Outcome, reason)."""

    stop: Stop
    band: Band | None = None
    worked: bool = False
    judged: bool = False
    left_at: tuple[float, float] | None = None
    since: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Nothing watched yet."""
        self.pacemaker = PaceMaker(self.band.paces, self.band.settle_s) if self.band and self.band.paces else None

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
        near = self.band is None and not e.lost and e.last_view and goal.near(e.all_seen, e.error_px, e.position_m, e.rotation_rad)
        held = self._lasting("near", near, e.t)
        lost = self._lasting("lost", e.lost, e.t)
        rest = self._lasting("rest", self.band is None and not e.lost and not near and e.command_size < REST, e.t)
        blocked = self._lasting("blocked", e.limit in ("joint_limit", "singular") and e.scale < BLOCKED_SCALE, e.t)
        if e.aborted and not e.contact:
            return self._after_abort(e)
        if e.touchdown and e.down:
            return e.touchdown
        if held >= goal.hold_s:
            return Outcome.converged, f"{goal.words} for {goal.hold_s:g} s"
        if e.contact:
            after = f", after {e.aborted[1]}" if e.aborted else ""
            return Outcome.collided, f"the robot touched something{after}"
        if e.distance > FAR_M:
            return Outcome.diverged, f"the camera is more than {FAR_M:g} m away from the target"
        if e.behind:
            return Outcome.target_lost, "the camera crossed the plane of the target"
        if e.lost and lost >= self.stop.lost_after_s and not e.flies:  # a craft sets down first
            never = "" if self.worked else ", from the start on"
            return Outcome.target_lost, f"{e.held or Outcome.target_lost.value} for {self.stop.lost_after_s:g} s{never}"
        if blocked >= BLOCKED_S:
            return Outcome[e.limit], f"{Outcome[e.limit].value} for {BLOCKED_S:g} s"
        if rest >= REST_S:
            return Outcome.local_minimum, f"the commanded twist is zero {self._away(e)}"
        self.judged = self.judged or (self.band is not None and e.t >= self.band.settle_s)
        if self.band and e.t >= self.band.settle_s and not abs(e.off_m) <= self.band.width_m:
            self.left_at = self.left_at or (e.t, e.off_m)
        if self.pacemaker:
            self.pacemaker.watch(e.t, e.ways, e.t >= self.stop.duration_s - 1e-9)
        if e.t >= self.stop.duration_s - 1e-9:
            return self._at_the_end()
        return None

    def _away(self, e: Evidence) -> str:
        """How far from the goal it rests, by what counts: the picture's error, the robot's own estimate."""
        goal, said = self.stop.converged, []
        if goal.error_px is not None:
            said.append(f"at an RMS error of {e.error_px:.3g} px")
        if goal.by_estimate:
            said.append(f"{e.position_m:.3g} m and {math.degrees(e.rotation_rad):.3g} deg from the goal by the robot's own estimate")
        return ", ".join(said)

    def _after_abort(self, e: Evidence) -> tuple[Outcome, str] | None:
        """A craft that gave up: its reason, once it stands or the time is out."""
        if not e.aborted or not (e.down or e.t >= self.stop.duration_s - 1e-9):
            return None
        outcome, reason = e.aborted
        return outcome, f"{reason}; the craft {'set down' if e.down else 'was still on its way down when the time ran out'}"

    def _at_the_end(self) -> tuple[Outcome, str]:
        if self.band is None:
            return Outcome.timed_out, f"{self.stop.duration_s:g} s were not enough"
        width, settle = self.band.width_m, self.band.settle_s
        if not self.judged:
            return Outcome.timed_out, f"{self.stop.duration_s:g} s ended before the {settle:g} s in which it may settle"
        slow = self.pacemaker.slow if self.pacemaker else None
        if slow and (self.left_at is None or slow[0] < self.left_at[0]):
            return Outcome.timed_out, slow[1]
        if self.left_at is None and self.stop.duration_s < self.band.until_s:
            return Outcome.timed_out, f"{self.stop.duration_s:g} s ended on the way: its end is reached at {self.band.until_s:.3g} s"
        if self.left_at is None:
            return Outcome.completed, f"within {width:g} m from {settle:g} s on"
        t, off = self.left_at
        return Outcome.timed_out, f"out of its band of {width:g} m at {t:.3g} s, {abs(off):.3g} m off"
