"""How a landing went, in truth: where the craft first touched its pad, and how fast."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.scenario.goal import GoalLanding
from vstestbed.scenario.stop import Outcome


@dataclass
class Touchdown:
    """Watches a craft and its pad, frame by frame.

    Attributes:
        goal: the task. offset_m: from the pad's centre, sideways, at the first touch [m]; speed_mps: against the pad in the frame before
        it [m/s]; both NaN before.
    """

    goal: GoalLanding
    offset_m: float = math.nan
    speed_mps: float = math.nan
    _t: float = math.nan
    _away: Array | None = None
    _speed: float = math.nan

    def watch(self, t: float, T_world_craft: Array, T_world_target: Array, feet: bool) -> None:
        """One frame: true poses (4, 4), and whether a foot touches something."""
        away = T_world_craft[:3, 3] - T_world_target[:3, 3]
        if feet and math.isnan(self.offset_m):
            self.offset_m, self.speed_mps = float(np.hypot(*away[:2])), self._speed
        if self._away is not None and t > self._t:
            self._speed = float(np.linalg.norm(away - self._away)) / (t - self._t)
        self._t, self._away = t, away

    @property
    def verdict(self) -> tuple[Outcome, str] | None:
        """The outcome of the first touch; None before it."""
        if math.isnan(self.offset_m):
            return None
        where = f"{100 * self.offset_m:.0f} cm from the pad's centre at {self.speed_mps:.2f} m/s"
        if self.offset_m <= self.goal.pad_m and self.speed_mps <= self.goal.touch_mps:
            return Outcome.landed, f"touched down {where}"
        return Outcome.collided, f"touched down {where}: more than {100 * self.goal.pad_m:g} cm or {self.goal.touch_mps:g} m/s"
