"""Image-based visual servoing with any feature."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Time
from vstestbed.core.spec import spec
from vstestbed.features import FEATURES, LineFeature, Point
from vstestbed.features.base import Feature
from vstestbed.features.depth import Depth, PnP
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws.base import Command, ConstantGain, Gain, LawBase, TwistLimits
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
from vstestbed.laws.projection import Classical, Projection
from vstestbed.laws.select import ALL, Rows, check_goal
from vstestbed.laws.smoothing import BEGIN, CommandShape, Shaped
from vstestbed.laws.solve import Solve, least_squares
from vstestbed.laws.views import Views
from vstestbed.laws.visibility import Visibility


@dataclass(frozen=True, slots=True)
class IBVSMemory:
    """The last command, and the state of the feedforward."""

    shaped: Shaped = BEGIN
    followed: Followed = NOTHING


@spec
class IBVS(LawBase):
    """u = -lambda pinv(L B) e with e = s - s*, camera twist v = B u.

    With `smooth_start_s` = tau the command grows from rest: u - u(0) exp(-t/tau). With `smoothing_s` it is filtered (`smoothing.py`).

    A goal view that moves along a path adds its own velocity u*.

    With `feedforward` a moving target is tracked without lag (`feedforward.py`), for CARRY_S also while it is not visible (`following.py`).

    Errata. Chapter 16 of Corke 2017 has polar and spherical features as here (eqs 16.9, 16.15), but theta = asin(r) in
    eq. 16.11, which is wrong behind the camera's equator; see the docstrings of the features. With an exact half turn the
    matrix at the current view makes points diverge, the one at the goal drives the camera through the target, and their mean
    does not move: these are properties of the law. Three markers have the same image from up to four poses, and with points
    (`point`, `polar`, `spherical`) e is zero at each: the law may converge to another one than the goal. Four in one plane have
    one.

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

    References: Chaumette & Hutchinson 2006, eqs 3-5, doi:10.1109/MRA.2006.250573; mean matrix: Malis 2004,
    doi:10.1109/ROBOT.2004.1308092; moving target: Chaumette & Hutchinson 2007, doi:10.1109/MRA.2007.339609; smooth start:
    Mansard & Chaumette 2007, doi:10.1109/TRO.2006.889487.
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
        """The two inputs of the feature, of the selected markers."""
        what, distance = self.feature.inputs
        return getattr(sight, what)[rows], getattr(sight, distance)[rows]

    def equations(self, x: Array, distance: Array, goal_x: Array, goal_distance: Array) -> tuple[Array, Array]:
        """The error e (..., rows) and its interaction matrix L (..., rows, 6), or (rows, 6) for `desired`.

        Args:
            x, distance: the feature's inputs in views of N markers, e.g. xy (..., N, 2) and depth (..., N) [m].
            goal_x, goal_distance: the same in the goal view, (N, 2) and (N,).
        """
        feature, which = self.feature, self.interaction
        if which == "current":
            return feature.error(feature.measure(x), feature.measure(goal_x)), feature.interaction(x, distance)
        s_star, L_star = _at_goal(feature, goal_x.tobytes(), goal_distance.tobytes())
        e = feature.error(feature.measure(x), s_star)
        return e, L_star if which == "desired" else 0.5 * (feature.interaction(x, distance) + L_star)


@lru_cache(maxsize=256)
def _at_goal(feature: Feature, x: bytes, distance: bytes) -> tuple[Array, Array]:
    """The feature s* and its interaction matrix L* in the goal view, its inputs given as bytes, which can be hashed.

    Most goals are the same at every frame.
    """
    of_points = np.frombuffer(distance)
    at = np.frombuffer(x).reshape(len(of_points), -1)
    return feature.measure(at), feature.interaction(at, of_points)
