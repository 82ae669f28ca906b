"""What a learned policy sees and what its actions mean, the same where it is trained and where it drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import TwistLimits

SPEED_MPS, RATE_RADPS = 1.0, 1.0
"""Velocities of an action of 1 where the law of the scenario has no limits."""


MOST_PX = 1e6
"""Bound of the pixels that a policy sees [px]: an oracle's are anywhere when its field of view is unlimited."""


def observed(seen: Observation, goal: Goal) -> dict[str, Array]:
    """What a policy sees of one frame, in new arrays of float64.

    `markers` (N, 2) [px], 0 for a marker that is not seen; `seen` (N,), 1 or 0; `goal` (N, 2), the markers at the goal [px], 0 where
    none would be seen; and where the observation has it, `agent_pos` (k,), what the robot's own sensors tell (`Robot.proprioception`).
    Pixels are within +-MOST_PX.
    """
    found = {"markers": _pixels(seen.uv), "seen": seen.seen.astype(float), "goal": _pixels(goal.uv)}
    return found if seen.proprioception is None else found | {"agent_pos": np.array(seen.proprioception, dtype=float)}


def _pixels(uv: Array) -> Array:
    """Pixels (N, 2) as a new array of finite numbers, 0 for NaN."""
    return np.clip(np.nan_to_num(uv, nan=0.0), -MOST_PX, MOST_PX)


@dataclass(frozen=True)
class ActionScale:
    """An action in [-1, 1]^n as velocities u along the robot's motions: u = per_unit * action.

    Attributes:
        per_unit: velocities (n,) of an action of 1 [m/s, rad/s].
    """

    per_unit: Array

    @classmethod
    def of(cls, limits: TwistLimits, basis: Array) -> ActionScale:
        """The scale for a law's limits and the robot's motions, basis (6, n): a motion that turns the camera has the limit of rate."""
        speed, rate = limits.speed_mps or SPEED_MPS, limits.rate_radps or RATE_RADPS
        turns = np.abs(basis[3:]).max(axis=0) > 1e-9  # a turn of the base also moves the camera; a translation never turns it
        return cls(np.where(turns, rate, speed))

    def velocities(self, action: Array) -> Array:
        """The velocities u (n,) [m/s, rad/s] of an action (n,), which is clipped to [-1, 1]."""
        return self.per_unit * np.clip(action, -1.0, 1.0)

    def action(self, u: Array) -> Array:
        """The action (n,) of velocities u (n,), clipped to [-1, 1]."""
        return np.clip(u / self.per_unit, -1.0, 1.0)
