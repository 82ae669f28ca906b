"""Tracking of a moving target, for all laws: the feedforward term, and frames that do not show what the law needs."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vstestbed.core.geometry import Array, exp
from vstestbed.features.base import Feature
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command
from vstestbed.laws.feedforward import Change, Estimator, Feedforward, Integral, NoFeedforward, Trend, follow, look_ahead
from vstestbed.laws.points import ALL, Rows, carried_markers, carried_pose, usable_rows
from vstestbed.laws.solve import Solve

CARRY_S = 0.3
"""How long what is not seen is carried over by the estimated motion of the target [s]: longer, and what it accelerates by counts."""


@dataclass(frozen=True, slots=True)
class Followed:
    """The state of the feedforward between frames.

    Attributes:
        seen: the last observation, with what was carried over, with which the next is compared; None before the first.
        t: time of the last observation that sufficed for the law [s]; NaN before the first.
        marker_t: time of the last observation of each marker (N,) [s]; None before the first. trend: the estimate of the target's motion.
        integral: integral of the remaining motion (n,), for the feedforward `integral`.
    """

    seen: Observation | None = None
    t: float = math.nan
    marker_t: Array | None = None
    trend: Trend | None = None
    integral: Array | None = None


NOTHING = Followed()


def inputs_of(kind: Feedforward) -> tuple[str, ...]:
    """The fields of an Observation that a feedforward needs: for an estimator, the camera's own motion."""
    return ("motion",) if isinstance(kind, Estimator) else ()


def _way(kind: Feedforward, memory: Followed, seen: Observation, basis: Array) -> Array | None:
    """The motion (4, 4) of the target in the camera's frame since the last frame; None where it is not known.

    Relative to the target, the camera moves by its own measured twist and the estimated motion of the target, v + B tau.
    """
    trend, motion = memory.trend, seen.motion
    if not isinstance(kind, Estimator) or trend is None or motion is None:
        return None
    return exp(-(motion.twist * motion.since_s + basis @ trend.ahead(motion.since_s)[0]))


def usable_pose(kind: Feedforward, memory: Followed, seen: Observation, goal: Goal, basis: Array, why: str) -> Observation | None:
    """The observation, for a law of poses; None where it is to rest.

    Where something is lacking, the pose and the homography are those of the last frame, carried over by the measured motion of the camera
    and the estimated one of the target, for CARRY_S at most. Without an estimator the law rests.

    kind: the feedforward. memory: its state at the last frame. seen: the observation of this frame. goal: the goal view. basis: the robot's
    motions (6, n). why: what the law lacks in this measurement; "" if nothing.
    """
    if not why:
        return seen
    way = _way(kind, memory, seen, basis)
    if way is None or memory.seen is None or seen.t - memory.t > CARRY_S:
        return None
    return carried_pose(seen, memory.seen, way, goal)


def usable_markers(
    kind: Feedforward, memory: Followed, seen: Observation, basis: Array, inputs: tuple[str, ...], needed: int
) -> tuple[Observation, Rows | str, str]:
    """The observation, for a law of markers; its usable markers, or the reason for rest; and what the law lacks, "" if nothing.

    The markers that are not seen are carried over as poses are (`usable_pose`), each for CARRY_S at most (`carried_markers`).

    inputs: the fields of the observation that must be known of a marker. needed: the least number of markers. The others as `usable_pose`.
    """
    rows = usable_rows(seen, inputs, needed)
    why = rows if isinstance(rows, str) else ""
    if rows is ALL or memory.seen is None or memory.marker_t is None:  # the usual frame first
        return seen, rows, why
    way = _way(kind, memory, seen, basis)
    if way is None or (why and seen.t - memory.t > CARRY_S):
        return seen, rows, why
    known = carried_markers(seen, memory.seen, way, seen.t - memory.marker_t, CARRY_S, None if why else basis)
    return known, usable_rows(known, inputs, needed), why


def feedforward_term(
    kind: Feedforward, memory: Followed, seen: Observation, solved: Array, change: Change | None, basis: Array, why: str = ""
) -> tuple[Followed, Array, Array]:
    """The next state, the predicted remaining motion x' (n,), and the feedforward term tau (n,) in u = -lambda x' - tau.

    Args:
        kind: the feedforward. memory: its state at the last frame. seen: the observation of this frame, with what was carried over.
        solved: the remaining motion x = pinv(L B) e (n,).
        change: change of the features since the last frame; None where the two have too little in common.
        basis: the robot's motions (6, n).
        why: what the law lacks in the measurement, "" if nothing; then the change is not measured, and the estimate goes on without.
    """
    if isinstance(kind, Integral):
        # Without an observation at the last frame nothing is added: the error in between is unknown.
        since = seen.t - memory.seen.t if memory.seen else 0.0
        total = solved * since + (0 if memory.integral is None else memory.integral)
        return replace(memory, seen=seen, integral=total), solved, kind.rate_per_s2 * total
    if isinstance(kind, NoFeedforward) or seen.motion is None:
        return memory, solved, np.zeros(solved.shape)
    trend = follow(kind, memory.trend, None if why else change, basis, seen.motion)
    shift, rate = look_ahead(kind, trend, basis, seen.motion)
    marker_t = np.where(seen.seen, seen.t, -np.inf if memory.marker_t is None else memory.marker_t)
    return Followed(seen, memory.t if why else seen.t, marker_t, trend, memory.integral), solved + shift, rate


def change_of_markers(feature: Feature, memory: Followed, now: Observation, needed: int, solve: Solve) -> Change | None:
    """Change of a feature since the last frame, from the markers that are known in both; None if they are fewer than needed."""
    before = memory.seen
    if before is None or memory.trend is None:
        return None
    what, distance = feature.inputs
    both = np.isfinite(getattr(before, what)[:, 0]) & np.isfinite(getattr(now, what)[:, 0])
    both &= np.isfinite(getattr(before, distance)) & np.isfinite(getattr(now, distance)) & now.same(before)
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
