"""Feedforward state, and the feedforward term that is added to the proportional command."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.features.observation import Observation
from vstestbed.laws.base import Command
from vstestbed.laws.feedforward import Change, Estimator, Feedforward, Integral, NoFeedforward, Trend, follow, look_ahead

COAST_S = 1.0
"""How long the estimated motion of an unseen target is followed [s]."""


@dataclass(frozen=True, slots=True)
class Followed:
    """The state of the feedforward between frames.

    Attributes:
        seen: the last observation, with which the next is compared; None after a frame without usable markers.
        t: time of the last observation with usable markers [s]; NaN before the first.
        trend: the estimate of the target's motion.
        integral: integral of the remaining motion (n,), for the feedforward `integral`.
    """

    seen: Observation | None = None
    t: float = math.nan
    trend: Trend | None = None
    integral: Array | None = None


NOTHING = Followed()
"""The state before the first frame."""


def inputs_of(kind: Feedforward) -> tuple[str, ...]:
    """The fields of an Observation that a feedforward needs: for an estimator, the camera's own motion."""
    return ("motion",) if isinstance(kind, Estimator) else ()


def feedforward_term(
    kind: Feedforward, memory: Followed, seen: Observation, solved: Array, change: Change | None, basis: Array
) -> tuple[Followed, Array, Array]:
    """The next state, the predicted remaining motion x' (n,), and the feedforward term tau (n,) in u = -lambda x' - tau.

    Args:
        kind: the feedforward. memory: its state at the last frame. seen: the observation of this frame.
        solved: the remaining motion x = pinv(L B) e (n,).
        change: change of the features since the last frame; None where the two have too few markers in common.
        basis: the robot's motions (6, n).
    """
    if isinstance(kind, Integral):
        # Without an observation at the last frame nothing is added: the error in between is unknown.
        since = seen.t - memory.seen.t if memory.seen else 0.0
        total = solved * since + (0 if memory.integral is None else memory.integral)
        return replace(memory, seen=seen, integral=total), solved, kind.rate_per_s2 * total
    if isinstance(kind, NoFeedforward) or seen.motion is None:
        return memory, solved, np.zeros(solved.shape)
    trend = follow(kind, memory.trend, change, basis, seen.motion)
    shift, rate = look_ahead(kind, trend, basis, seen.motion)
    return replace(memory, seen=seen, t=seen.t, trend=trend), solved + shift, rate


def anti_windup(before: Followed, after: Followed, command: Command) -> Followed:
    """The state after a command: while limits scale the command down, the integral does not grow."""
    return replace(after, integral=before.integral) if command.scale < 1 else after


def coast(kind: Feedforward, memory: Followed, seen: Observation, basis: Array) -> tuple[Followed, Array] | None:
    """A frame without usable markers: the next state and the estimated motion u = -tau (n,); None, rest, after COAST_S."""
    trend, motion = memory.trend, seen.motion
    # `not <=` and not `>`: before the first usable frame memory.t is NaN, and the law rests.
    if not isinstance(kind, Estimator) or trend is None or motion is None or not seen.t - memory.t <= COAST_S:
        return None
    trend = follow(kind, trend, None, basis, motion)
    return replace(memory, seen=None, trend=trend), -trend.rate
