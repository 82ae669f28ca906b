"""Tracking of a moving target, for all laws: the feedforward term, and frames that do not show what the law needs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vstestbed.core.geometry import Array, all_finite, exp
from vstestbed.features.base import Feature
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command
from vstestbed.laws.carry import carried
from vstestbed.laws.feedforward import Change, Estimator, Feedforward, Integral, NoFeedforward, Trend, follow, look_ahead
from vstestbed.laws.select import Rows, usable_rows
from vstestbed.laws.solve import Solve

CARRY_S = 1.0
"""How long what is not seen is carried over by the estimated motion of the target [s]."""


@dataclass(frozen=True, slots=True)
class Followed:
    """The state of the feedforward between frames.

    Attributes:
        seen: the last observation, completed by what was carried over, with which the next is compared; None before the first.
        t: time of the last observation that sufficed for the law [s]; NaN before the first.
        marker_t: time of the last observation of each marker (N,) [s]; None before the first.
        trend: the estimate of the target's motion.
        integral: integral of the remaining motion (n,), for the feedforward `integral`.
    """

    seen: Observation | None = None
    t: float = math.nan
    marker_t: Array | None = None
    trend: Trend | None = None
    integral: Array | None = None


NOTHING = Followed()
"""The state before the first frame."""


def inputs_of(kind: Feedforward) -> tuple[str, ...]:
    """The fields of an Observation that a feedforward needs: for an estimator, the camera's own motion."""
    return ("motion",) if isinstance(kind, Estimator) else ()


def completed(kind: Feedforward, memory: Followed, seen: Observation, goal: Goal, basis: Array, why: str) -> Observation | None:
    """The observation, with what this frame does not show carried over from the last one; None where the law is to rest.

    Relative to the target, the camera moves by its own measured twist and by the estimated motion of the target, v + B tau. Whatever
    was seen in the last CARRY_S is carried over by exp(-(v + B tau) dt). Without an estimator nothing is: a law without one
    rests where its measurement lacks something.

    Args:
        kind: the feedforward. memory: its state at the last frame. seen: the observation of this frame.
        goal: the goal view. basis: the robot's motions (6, n).
        why: what the law lacks in this measurement; "" if nothing.
    """
    last, trend, motion = memory.seen, memory.trend, seen.motion
    if not isinstance(kind, Estimator) or last is None or trend is None or motion is None or memory.marker_t is None:
        return None if why else seen
    whole = seen.t - memory.t <= CARRY_S
    if why and not whole:
        return None
    if not why and all_finite(seen.uv):
        return seen  # the usual frame
    way = exp(-(motion.twist * motion.since_s + basis @ trend.ahead(motion.since_s)[0]))
    return carried(seen, last, way, goal, ~seen.seen & (seen.t - memory.marker_t <= CARRY_S), whole)


def usable_markers(
    kind: Feedforward, memory: Followed, seen: Observation, goal: Goal, basis: Array, inputs: tuple[str, ...], needed: int
) -> tuple[Observation, Rows | str, str]:
    """The observation, `completed`; its usable markers, or the reason for rest; and what the law lacks in the measurement, "" if nothing.

    Args:
        inputs: the fields of the observation that must be known of a marker. needed: the least number of markers.
        The others as `completed`.
    """
    rows = usable_rows(seen, inputs, needed)
    why = rows if isinstance(rows, str) else ""
    known = completed(kind, memory, seen, goal, basis, why)
    if known is None or known is seen:
        return seen, rows, why
    return known, usable_rows(known, inputs, needed), why


def feedforward_term(
    kind: Feedforward, memory: Followed, seen: Observation, solved: Array, change: Change | None, basis: Array, suffices: bool = True
) -> tuple[Followed, Array, Array]:
    """The next state, the predicted remaining motion x' (n,), and the feedforward term tau (n,) in u = -lambda x' - tau.

    Args:
        kind: the feedforward. memory: its state at the last frame. seen: the observation of this frame, `completed`.
        solved: the remaining motion x = pinv(L B) e (n,).
        change: change of the features since the last frame; None where the two have too little in common.
        basis: the robot's motions (6, n).
        suffices: whether the law had enough without what was carried over.
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
    marker_t = np.where(seen.seen, seen.t, -np.inf if memory.marker_t is None else memory.marker_t)
    return Followed(seen, seen.t if suffices else memory.t, marker_t, trend, memory.integral), solved + shift, rate


def change_of_markers(feature: Feature, memory: Followed, now: Observation, needed: int, solve: Solve) -> Change | None:
    """Change of a feature since the last frame, from the markers that are known in both; None if they are fewer than needed."""
    before = memory.seen
    if before is None or memory.trend is None:
        return None
    what, distance = feature.inputs
    both = np.isfinite(getattr(before, what)[:, 0]) & np.isfinite(getattr(now, what)[:, 0])
    both &= np.isfinite(getattr(before, distance)) & np.isfinite(getattr(now, distance))
    if np.count_nonzero(both) < needed:
        return None
    (x0, d0), (x1, d1) = ((getattr(o, what)[both], getattr(o, distance)[both]) for o in (before, now))
    # The mean of both matrices: with one of them, the change is explained to first order in the motion only.
    L = (feature.interaction(x0, d0) + feature.interaction(x1, d1)) / 2
    return Change(feature.error(feature.measure(x1), feature.measure(x0)), L, solve)


def anti_windup(before: Followed, after: Followed, command: Command) -> Followed:
    """The state after a command: while limits scale the command down, the integral does not grow."""
    return replace(after, integral=before.integral) if command.scale < 1 else after


def coasting(command: Command, why: str) -> Command:
    """The command with what the law lacks in the measurement, where it goes on with what was carried over."""
    return replace(command, rest_reason=why) if why else command
