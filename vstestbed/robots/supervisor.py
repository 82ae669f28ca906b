"""Supervisor: may override the law's order for the robot's safety, from proprioception alone.

    follow --no measurement--> hold (the law rests, or drives on by what it knew) --lost_after_s, lost_after_m--> stop
    follow, hold --the law fails--> stop

Every robot has one. How a robot stops is its own matter (`Robot.stopping`); when it must is decided here, and for a craft that must
set down besides in `failsafe`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.robots.orders import Order
from vstestbed.robots.reading import Reading

FOLLOWS, HOLDS, STOPS = range(3)
"""Modes, as numbered in the log's column `supervisor`."""
STANDS_RADPS = 0.02
"""A robot whose joints are all slower than this stands [rad/s; m/s for joints that slide]: the rim of a car's wheel makes 3 mm/s."""


@dataclass
class Supervisor:
    """Passes the law's order on, until the target has been out of sight for too long, or the law has failed: then it stops the robot.

    Attributes:
        lost_after_s, lost_after_m: longest time [s], and longest way of the camera by the robot's own sensors [m], without a measurement.
        aborted: why the task was aborted; None while it goes on. mode: see FOLLOWS, ...
    """

    DOWN: ClassVar[tuple[str, str]] = "the robot stands", "the robot was still moving when the time ran out"
    """The end of an aborted task, in words: brought to rest, or not in time."""
    lost_after_s: float = math.inf
    lost_after_m: float = math.inf
    aborted: Verdict | None = None
    mode: int = FOLLOWS
    _lost_at: float = math.nan
    _blind_m: float = 0.0
    _seen_once: bool = False
    _stands: bool = False

    def filter(self, t: float, blind: str, reading: Reading, order: Order, basis: Array, moved_m: float = 0.0) -> Order:
        """The order that goes to the robot.

        Args:
            t: time of exposure [s].
            blind: why the law has no measurement ("" while it has one). Without one it may command motion by what it knew.
            reading: the robot's sensor reading.
            order: the law's, after allocation.
            basis: camera twists (6, n) of the robot's motions.
            moved_m: way of the camera since the last frame, by the robot's own sensors [m]; it counts while blind.
        """
        if (why := self._look(t, blind, moved_m)) and not self.aborted:
            self.abort(t, Outcome.target_lost, why if self._seen_once else f"{why}, from the start on")
        if not self.aborted:
            self.mode = HOLDS if blind else FOLLOWS
            return order
        self.mode, self._stands = STOPS, bool(np.abs(reading.qd).max(initial=0.0) < STANDS_RADPS)
        return order.halted(self.aborted[1], latched=True)

    def abort(self, t: float, outcome: Outcome, reason: str) -> None:
        """Give the task up at a time [s]."""
        self.aborted = outcome, reason

    @property
    def may_touch(self) -> bool:
        """Whether ground contact of the robot's feet is allowed now."""
        return True

    def down(self, t: float) -> bool:
        """Whether the robot has come to rest for good, by its own sensors."""
        return self.aborted is not None and self._stands

    def _look(self, t: float, blind: str, moved_m: float) -> str:
        """Note whether there is a measurement; once it has been missing for too long, why ("" before)."""
        if not blind:
            self._lost_at, self._blind_m, self._seen_once = math.nan, 0.0, True
            return ""
        if math.isnan(self._lost_at):
            self._lost_at = t  # the way to here was commanded by a picture that showed the target
        else:
            self._blind_m += moved_m
        # Times are sums of steps: without 1e-9 a rounding would cost a frame.
        if t - self._lost_at + 1e-9 >= self.lost_after_s:
            return f"{blind} for {self.lost_after_s:g} s"
        return f"{blind} for {self.lost_after_m:g} m of the way" if self._blind_m >= self.lost_after_m else ""
