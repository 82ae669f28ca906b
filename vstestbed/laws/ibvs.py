"""Image-based visual servoing with any feature."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Time
from vstestbed.core.spec import OneOf, spec
from vstestbed.features import FEATURES, LineFeature, Point
from vstestbed.features.base import Feature
from vstestbed.features.depth import Depth, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, ConstantGain, FreeMotions, Gain, LawBase, TwistLimits
from vstestbed.laws.feedforward import Feedforward, NoFeedforward
from vstestbed.laws.following import (
    NOTHING,
    Followed,
    anti_windup,
    change_of_markers,
    coasting,
    feedforward_term,
    inputs_of,
    usable_markers,
)
from vstestbed.laws.points import ALL, Rows, Visibility, check_goal
from vstestbed.laws.solve import Solve, least_squares
from vstestbed.laws.views import Views

STEEP = 6.0
"""Slope of the logistic function: that of the paper, 1 / (1 + exp(-12 x + 6)) for x from 0 to 1."""


@spec
class Classical:
    """P = I - pinv(L B) L B: the motions that leave all features as they are."""

    kind: Literal["classical"] = "classical"

    def free(self, solve: Solve, A: Array, e: Array, solved: Array, basis: Array) -> tuple[FreeMotions, ...]:
        """The free motions, for A = L B (m, n), e (m,), the remaining motion solved (n,) and the robot's motions basis (6, n)."""
        return (FreeMotions(1.0, basis @ solve.null_space(A)),)


@spec
class Large:
    """P = share P_|e| + (1 - share) P_e: away from the goal, all motions are free that leave the norm of the error as it is.

    P_e is the classical projection, and with A = L B

    P_|e| = I - A^T e e^T A / (e^T A A^T e)

    that of the task |e|, of rank n - 1: even where the features determine all n motions, all but one of them are free, and |e| decreases
    as it does without a secondary task. The single features do not: the camera takes another way. `share` goes
    from 0, where the largest component x of the remaining motion pinv(L B) e is `near`, by a logistic function of x to 1 at `far`.
    Without P_e near the goal, where A^T e vanishes, the motion would not settle.

    The projections are orthogonal in the joint space of the robot, which takes its secondary task as near as it can to the one wanted.

    Args:
        near: remaining motion under which the operator is the classical one [rad; m for translations].
        far: remaining motion above which it is P_|e| alone, over `near` [rad; m for translations].

    Reference: Marey & Chaumette 2010, doi:10.1109/ROBOT.2010.5509296 (the operator; there the share is a function of |e|) and
    doi:10.1109/IROS.2010.5650967 (for joint limits).
    """

    kind: Literal["large"] = "large"
    near: Annotated[float, Gt(0), Le(10)] = 0.02
    far: Annotated[float, Gt(0), Le(10)] = 0.1

    def __post_init__(self) -> None:
        """Refuse a share that would decrease with the error."""
        if self.near >= self.far:
            raise ParameterError("near", f"must be under far = {self.far}", self.near)

    def share(self, solved: Array) -> float:
        """The weight of P_|e|, 0 to 1, at a remaining motion (n,) [m, rad]."""
        along = (float(np.abs(solved).max(initial=0.0)) - self.near) / (self.far - self.near)
        along = min(max(along, 0.0), 1.0) - 0.5
        return (1 + math.tanh(STEEP * along) / math.tanh(STEEP / 2)) / 2  # a logistic function that is 0 and 1 at its ends

    def free(self, solve: Solve, A: Array, e: Array, solved: Array, basis: Array) -> tuple[FreeMotions, ...]:
        """The free motions; see `Classical.free`."""
        share, gradient = self.share(solved), A.T @ e
        classical = basis @ solve.null_space(A)
        if share == 0 or not gradient.any():
            return (FreeMotions(1.0, classical),)
        return FreeMotions(1 - share, classical), FreeMotions(share, basis @ solve.null_space(gradient[None]))


PROJECTIONS = OneOf("projection", Classical, Large)
Projection = Annotated[Classical | Large, PROJECTIONS]


# The shape of a law's command over time: a smooth start, a low-pass filter, and the last command where nothing can be measured.
@dataclass(frozen=True, slots=True)
class Shaped:
    """What the next command depends on.

    Attributes:
        t0: time of the first command [s]. u0: that command without the smooth start (n,).
        t: time of the last command [s]. u: that command, before limits (n,).
    """

    t0: float = math.nan
    u0: Array | None = None
    t: float = math.nan
    u: Array | None = None


BEGIN = Shaped()


@dataclass(frozen=True, slots=True)
class CommandShape:
    """From rest with u - u(0) exp(-t/start_s), then through the filter u_k = u_(k-1) + (1 - exp(-dt/smoothing_s)) (u - u_(k-1)).

    The filter begins at the first command. Time constants in seconds give the same motion at every camera rate.

    Attributes:
        start_s, smoothing_s: time constants [s]; 0: none. keep: whether the last command is kept where nothing can be measured.
    """

    start_s: float = 0.0
    smoothing_s: float = 0.0
    keep: bool = False

    def __call__(self, before: Shaped, t: float, u: Array) -> tuple[Shaped, Array]:
        """The next state, and the command for the law's u (n,) at a time t [s]."""
        t0, u0 = before.t0, before.u0
        if self.start_s > 0:
            t0, u0 = (t, u) if u0 is None else (t0, u0)
            u = u - u0 * math.exp(-(t - t0) / self.start_s)
        if self.smoothing_s > 0 and before.u is not None:
            u = before.u + (1 - math.exp(-(t - before.t) / self.smoothing_s)) * (u - before.u)
        return Shaped(t0, u0, t, u), u

    def unseen(self, before: Shaped, limits: TwistLimits, basis: Array, why: str) -> tuple[Shaped, Command]:
        """The state and the command of a frame without a measurement: rest, or the last command; why: in words."""
        if not self.keep or before.u is None:
            return BEGIN, Command.rest(basis, why)  # from rest the next command starts smoothly again
        return before, replace(limits.command(before.u, basis), rest_reason=why)

    @property
    def size(self) -> int:
        """Numbers of the state of one of many runs: u0, u and t."""
        return 13 if self.start_s > 0 or self.smoothing_s > 0 else 0

    def of_many(self, state: Array, t: float, u: Array) -> tuple[Array, Array]:
        """The next states (M, size) of many runs, NaN before the first frame, and their commands for the law's u (M, 6)."""
        if not self.size:
            return state, u
        u0, last, since = state[:, :6], state[:, 6:12], t - state[:, 12:]
        if self.start_s > 0:
            u0 = np.where(np.isnan(u0), u, u0)
            u = u - u0 * math.exp(-t / self.start_s)
        if self.smoothing_s > 0:
            u = np.where(np.isnan(last), u, last + (1 - np.exp(-since / self.smoothing_s)) * (u - last))
        return np.column_stack([u0, u, np.full(len(u), t)]), u


@dataclass(frozen=True, slots=True)
class IBVSMemory:
    """The last command, and the state of the feedforward."""

    shaped: Shaped = BEGIN
    followed: Followed = NOTHING


@spec
class IBVS(LawBase):
    """u = -lambda pinv(L B) e with e = s - s*, camera twist v = B u.

    With `smooth_start_s` = tau the command grows from rest: u - u(0) exp(-t/tau). With `smoothing_s` it is filtered. A goal view that moves
    along a path adds its own velocity u*.

    With `feedforward` a moving target is tracked without lag, for CARRY_S also while it is not visible.

    Errata. Chapter 16 of Corke 2017 has polar and spherical features as here (eqs 16.9, 16.15), but theta = asin(r) in eq. 16.11, which is
    wrong behind the camera's equator; see the docstrings of the features. With an exact half turn the matrix at the current view makes
    points diverge, the one at the goal drives the camera through the target, and their mean does not move: these are properties of the law.
    Three markers have the same image from up to four poses, and with points (`point`, `polar`, `spherical`) e is zero at each: the law may
    converge to another one than the goal. Four in one plane have one.

    Args:
        gain: lambda [1/s], a number or an adaptive gain of the remaining motion pinv(L B) e.
        feature: the feature s.
        interaction: L at the current view, at the desired one, or the mean of both matrices.
        solve: inversion of L B (`Solve`), in the estimate of the feedforward, too.
        depth: source of Z (for `spherical`, of the range) in L.
        smooth_start_s: tau [s]; 0 starts with the full command.
        smoothing_s: time constant of a low-pass filter of the command [s]; 0: none. An exponential average that gives each new command
            the weight a is -1/(rate ln(1 - a)): 0.0249 s for a = 0.8 at 25 pictures a second.
        keep_last: where too few markers are seen, go on with the last command in place of rest, until `stop.lost_after_s`.
        limits: largest speed and rate of the commanded twist.
        visibility: repulsive field at the border of the image.
        feedforward: the feedforward term for a moving target.
        redundant: accept fewer markers than determine all of the robot's motions, such as two on an arm. Motions in the null space of
            the task are not made, unless the robot has a secondary task (`robot.avoid_limits`).
        projection: which motions are left to that task: `classical`, the null space, or `large`, which keeps only the norm of e, so that
            also features that determine all motions leave some free.

    References: Chaumette & Hutchinson 2006, eqs 3-5, doi:10.1109/MRA.2006.250573; mean matrix: Malis 2004, doi:10.1109/ROBOT.2004.1308092;
    moving target: Chaumette & Hutchinson 2007, doi:10.1109/MRA.2007.339609; smooth start: Mansard & Chaumette 2007,
    doi:10.1109/TRO.2006.889487.
    """

    kind: Literal["ibvs"] = "ibvs"
    tasks = ("view", "path", "landing")
    gain: Gain = ConstantGain()
    feature: Annotated[Feature, FEATURES] = Point()
    interaction: Literal["current", "desired", "mean"] = "current"
    solve: Solve = Solve()
    depth: Depth = PnP()
    smooth_start_s: Time = 0.0
    smoothing_s: Time = 0.0
    keep_last: bool = False
    limits: TwistLimits = TwistLimits()
    visibility: Visibility = Visibility()
    feedforward: Feedforward = NoFeedforward()
    redundant: bool = False
    projection: Projection = Classical()

    def __post_init__(self) -> None:
        """Refuse a projection without a use."""
        if self.projection != Classical() and not self.redundant:
            raise ParameterError("projection", "is for law.redundant: true, which leaves motions to the robot", self.projection.kind)

    @property
    def inputs(self) -> tuple[str, ...]:
        """The inputs of the feature, the camera's own motion for feedforward, and the markers' radii for `visibility`."""
        return self.feature.inputs + inputs_of(self.feedforward) + self.visibility.inputs

    @property
    def needs_same_markers(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """The features that describe the markers as a set do, and lines, which are made of two each."""
        return self.feature.rows_per_marker == 0 or isinstance(self.feature, LineFeature)

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse a goal view at which the feature cannot work, by its `check_goal`."""
        check_goal(self.feature, goal)

    def init(self, goal: Goal) -> IBVSMemory:
        """No command so far."""
        return IBVSMemory()

    def markers_needed(self, basis: Array) -> int:
        """As many markers as give one equation for each of the robot's motions, basis (6, n)."""
        # A polygon's two rows belong to the set (rows_per_marker 0): no number of markers gives it more.
        rows = 0 if self.redundant else self.feature.rows_per_marker
        return max(self.feature.least_markers, math.ceil(basis.shape[1] / rows) if rows else 0)

    def step(self, memory: IBVSMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[IBVSMemory, Command]:
        """One frame with the visible markers; rest when they are too few for the robot's motions."""
        kind, before, needed = self.feedforward, memory.followed, self.markers_needed(basis)
        known, rows, why = usable_markers(kind, before, observation, basis, self.feature.inputs, needed)
        if isinstance(rows, str):
            shaped, command = self._shape.unseen(memory.shaped, self.limits, basis, rows)
            return IBVSMemory(shaped), command
        e, L = self.equations(*self._taken(known, rows), *self._taken(goal, rows))
        solved = self.solve.least_squares(L @ basis, e)  # the remaining motion x = pinv(L B) e
        change = change_of_markers(self.feature, before, known, needed, self.solve)
        followed, solved, tau = feedforward_term(kind, before, known, solved, change, basis, why)
        u = -self.gain.at(solved) * solved - tau
        if goal.twist is not None:
            u = u + least_squares(basis, goal.twist)  # u*, as far as the robot's motions allow
        shaped, u = self._shape(memory.shaped, observation.t, u)
        if self.visibility.margin_px > 0:
            u = u + self.visibility.push(observation, goal, basis)
        command = self.limits.command(u, basis)
        if self.redundant:
            command = replace(command, free=self.projection.free(self.solve, L @ basis, e, solved, basis))
        return IBVSMemory(shaped, anti_windup(before, followed, command)), coasting(command, why)

    @cached_property
    def _shape(self) -> CommandShape:
        return CommandShape(self.smooth_start_s, self.smoothing_s, self.keep_last)

    @property
    def state_size(self) -> int:
        """That of the command's shape."""
        return self._shape.size

    def step_batch(self, memory: Array, views: Views, goal: Goal) -> tuple[Array, Array]:
        """One frame of many runs (see `BatchLaw`)."""
        e, L = self.equations(*self._taken(views, ALL), *self._taken(goal, ALL))
        solved = self.solve.least_squares(L, e)
        memory, u = self._shape.of_many(memory, views.t, -self.gain.at(solved) * solved)
        return memory, self.limits.within(u)

    def _taken(self, sight: Observation | Goal | Views, rows: Rows) -> tuple[Array, Array]:
        what, distance = self.feature.inputs
        return getattr(sight, what)[rows], getattr(sight, distance)[rows]

    def equations(self, x: Array, distance: Array, goal_x: Array, goal_distance: Array) -> tuple[Array, Array]:
        """The error e (..., rows) and its interaction matrix L (..., rows, 6), or (rows, 6) for `desired`.

        x, distance: the feature's inputs in views of N markers, e.g. xy (..., N, 2) and depth (..., N) [m]. goal_x, goal_distance: the same
        in the goal view, (N, 2) and (N,).
        """
        feature, which = self.feature, self.interaction
        if which == "current":
            return feature.error(feature.measure(x), feature.measure(goal_x)), feature.interaction(x, distance)
        s_star, L_star = _at_goal(feature, goal_x.tobytes(), goal_distance.tobytes())
        e = feature.error(feature.measure(x), s_star)
        return e, L_star if which == "desired" else 0.5 * (feature.interaction(x, distance) + L_star)


@lru_cache(maxsize=256)
def _at_goal(feature: Feature, x: bytes, distance: bytes) -> tuple[Array, Array]:
    """The feature s* and its L* in the goal view, the same at most frames; its inputs as bytes, which can be hashed."""
    of_points = np.frombuffer(distance)
    at = np.frombuffer(x).reshape(len(of_points), -1)
    return feature.measure(at), feature.interaction(at, of_points)
