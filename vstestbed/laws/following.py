"""What a law with feedforward remembers from picture to picture, and what it orders beside its gain's share."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.features.observation import Observation
from vstestbed.laws.base import Command
from vstestbed.laws.feedforward import Change, Estimator, Feedforward, Integral, NoFeedforward, Trend, follow, look_ahead

COAST_S = 1.0
"""How long a moving target is followed without sight [s]."""


@dataclass(frozen=True, slots=True)
class Followed:
    """The last picture, its time [s], what is known of the target's motion, and the integral (n,)."""

    seen: Observation | None = None
    t: float = math.nan
    trend: Trend | None = None
    integral: Array | None = None


NOTHING = Followed()
"""Before the first picture."""


def inputs_of(kind: Feedforward) -> tuple[str, ...]:
    """The fields of an Observation that it needs: the camera's own motion."""
    return ("motion",) if isinstance(kind, Estimator) else ()


def feedforward_term(
    kind: Feedforward, memory: Followed, seen: Observation, solved: Array, change: Change | None, basis: Array
) -> tuple[Followed, Array, Array]:
    """The motion still to be made (n,) at the time looked ahead to, and what is ordered beside the gain's share of it (n,).

    Args:
        kind: what is done. memory: of the last picture. seen: this one.
        solved: the motion still to be made (n,), pinv(L B) e. change: what changed since the last picture, None where it cannot be told.
        basis: the robot's motions (6, n).
    """
    if isinstance(kind, Integral):
        since = seen.t - memory.seen.t if memory.seen else 0.0
        total = solved * since + (0 if memory.integral is None else memory.integral)
        return replace(memory, seen=seen, integral=total), solved, kind.rate_per_s2 * total
    if isinstance(kind, NoFeedforward) or seen.motion is None:
        return memory, solved, np.zeros_like(solved)
    trend = follow(kind, memory.trend, change, basis, seen.motion)
    shift, rate = look_ahead(kind, trend, basis, seen.motion)
    return replace(memory, seen=seen, t=seen.t, trend=trend), solved + shift, rate


def anti_windup(before: Followed, after: Followed, command: Command) -> Followed:
    """What is remembered after a command: what limits took off it is not summed up."""
    return replace(after, integral=before.integral) if command.scale < 1 else after


def coast(kind: Feedforward, memory: Followed, seen: Observation, basis: Array) -> tuple[Followed, Array] | None:
    """A picture that the law cannot work with: the target's own motion (n,) is gone on with for COAST_S; after that None, rest."""
    trend, motion = memory.trend, seen.motion
    if not isinstance(kind, Estimator) or trend is None or motion is None or not seen.t - memory.t <= COAST_S:
        return None
    trend = follow(kind, trend, None, basis, motion)
    return replace(memory, seen=None, trend=trend), -trend.rate
