"""The quadrotor's failsafe: a state machine that overrides the law's setpoint, from onboard estimates alone.

    follow --target lost--> hold (the law rests, or coasts after a moving target) --lost_after_s, lost_after_m--> sink --feet down--> off
    follow --overturned, a rotor at its limit, or the law fails--> hold --HOLD_S--> sink --feet down--> off

A lost target that is seen again brings it back to `follow`, unless the craft is already near the ground. An overturned craft is
levelled by its flight loops, which ignore setpoints meanwhile; a rotor that stays at its limit means that setpoints cannot be
tracked. These end the task for good, since none of them is cured by seeing the target.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.robots.flight_reading import FlightEstimate, FlightReading, descend
from vstestbed.robots.orders import Order
from vstestbed.robots.reading import Reading
from vstestbed.robots.supervisor import FOLLOWS, HOLDS, Supervisor

HOLD_S = 2.0
"""How long the craft holds after an abort before it sinks [s]."""
SINK_MPS = 0.4
"""Descent rate [m/s], under the .5 m/s at which a touch-down counts as a landing (`GoalLanding.touch_mps`)."""
RESUME_M = 0.5
"""Below this height the descent goes on even when the target is seen again [m]."""
LIMIT_S = 1.0
"""A rotor at its limit for longer aborts the task [s]; a step of the setpoint may saturate one for a moment."""
DOWN_S = 0.5
"""How long the rotors must be off before the craft counts as down [s]; they spin down with a time constant of .117 s."""
SINKS, OFF = 2, 3
"""Modes beside FOLLOWS and HOLDS, as numbered in the log's column `supervisor`."""


@dataclass
class Failsafe(Supervisor):
    """The failsafe of one flight: where other robots stop, it holds the craft, and then sets it down.

    Attributes:
        lands: the task ends on the ground. off_at: when the rotors went off [s]. mode: see FOLLOWS, ...
    """

    DOWN: ClassVar[tuple[str, str]] = "the craft set down", "the craft was still on its way down when the time ran out"
    lands: bool = False
    off_at: float = math.nan
    _since: float = math.nan

    def filter(self, t: float, blind: str, reading: Reading, order: Order, basis: Array, moved_m: float = 0.0) -> Order:
        """The order that the flight loops get: the law's, or a stop (hold, rotors off), or the velocity of the descent."""
        assert isinstance(reading, FlightReading)
        self._update_abort(t, blind, self._look(t, blind, moved_m), reading)
        self.mode = self._next_mode(t, blind, reading.estimate)
        if self.mode == OFF:
            return order.halted(f"{self._why}the craft stands: rotors off", latched=True, stop="off")
        if self.mode == SINKS:
            down = descend(SINK_MPS)
            return Order(down, basis @ down, reason=f"{self._why}the craft sinks", latched=self._final)
        return order.halted(f"{self._why}the craft holds", latched=self._final) if self.aborted else order

    @property
    def _why(self) -> str:
        """Why the task was given up, before what is done about it."""
        return f"{self.aborted[1]}: " if self.aborted else ""

    @property
    def may_touch(self) -> bool:
        """Whether ground contact of the feet is allowed: in a landing, or once it sinks."""
        return self.lands or self.mode in (SINKS, OFF)

    def down(self, t: float) -> bool:
        """Whether the rotors have been off for DOWN_S."""
        # NaN while they are on: the comparison is False then.
        return t - self.off_at >= DOWN_S

    def abort(self, t: float, outcome: Outcome, reason: str) -> None:
        """Give the task up at a time [s], which a reason names: the craft is down much later."""
        self.aborted, self._since = (outcome, f"{reason} at {t:.1f} s"), t

    def _next_mode(self, t: float, blind: str, estimate: FlightEstimate) -> int:
        """The mode of this frame; nothing leads out of OFF."""
        self._note_touchdown(t, estimate)
        if not math.isnan(self.off_at):
            return OFF
        if not self.aborted:
            return HOLDS if blind else FOLLOWS
        # A lost target has already had its `lost_after_s` of holding before the task was given up.
        holds = t - self._since < HOLD_S and self._final
        return HOLDS if holds else SINKS

    def _note_touchdown(self, t: float, estimate: FlightEstimate) -> None:
        """Note when rotors go off: once the craft stands, if it was to land or to set down."""
        if math.isnan(self.off_at) and estimate.stands and (self.lands or self.aborted):
            self.off_at = t

    def _update_abort(self, t: float, blind: str, lost: str, reading: FlightReading) -> None:
        """Give the task up where there is cause; take up again a task whose target was lost and is seen again."""
        if not math.isnan(self.off_at) or self._final:
            return
        if self.aborted and not blind and reading.range_m > RESUME_M:
            self.aborted = None
        if cause := self._cause(lost, reading.estimate):
            self.abort(t, *cause)

    @property
    def _final(self) -> bool:
        """Whether the task was given up for good: overturned, a rotor at its limit, or no law that works."""
        return self.aborted is not None and self.aborted[0] is not Outcome.target_lost

    def _cause(self, lost: str, estimate: FlightEstimate) -> Verdict | None:
        """Why the task must be given up in this frame, the most urgent cause first; None where it need not.

        lost: why the target counts as lost in this frame ("" while it does not).
        """
        if estimate.overturned:
            return Outcome.overturned, Outcome.overturned.value
        if estimate.rotor_limit_s > LIMIT_S:
            return Outcome.rotor_limit, f"a rotor stood at its limit for {LIMIT_S:g} s"
        if lost and not self.aborted:
            return Outcome.target_lost, lost
        return None
