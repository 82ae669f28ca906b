"""Image-based visual servoing with any feature."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge

from vstestbed.features import FEATURES, Line, Point, Polar, Polygon, Spherical
from vstestbed.geometry import Array
from vstestbed.laws.base import Command, ConstantGain, Gain, TwistLimits
from vstestbed.laws.select import ALL, Rows, require_area, usable_rows
from vstestbed.laws.solve import least_squares
from vstestbed.laws.views import Views
from vstestbed.laws.visibility import Visibility
from vstestbed.observation import Depth, Goal, Observation, PnP
from vstestbed.spec import spec

COAST_S = 1.0
"""How long a moving target is followed without sight [s]."""
JUMP = 0.5
"""An error that changes by more than this from one frame to the next has jumped (radians, or normalised coordinates)."""


@dataclass(frozen=True, slots=True)
class IBVSMemory:
    """Time of the first command [s] and the command that the law would have jumped to there (n,); with `target_motion_s` the last
    frame's time [s] and error, and the drift (n,).
    """

    t0: float = math.nan
    u0: Array | None = None
    t: float = math.nan
    e: Array | None = None
    drift: Array | None = None


@spec
class IBVS:
    """u = -lambda pinv(L B) e with e = s - s*, camera twist v = B u.

    With `smooth_start_s` = tau the command grows from rest: u - u(0) exp(-t/tau).

    A view that moves along a path adds its own velocity u* to that.

    With `target_motion_s` a target, or a goal, that moves is followed without lag: what the robot's own measured motion u_m leaves
    unexplained of the error's change, d = pinv(L B) e_dot - u_m, filtered with that time constant, is taken off: u - d.

    Errata. Chapter 16 of Corke 2017 has polar and spherical features as here (eqs 16.9, 16.15), but theta = asin(r) in
    eq. 16.11, which is wrong behind the camera's equator; each feature says what it does instead. With an exact half turn
    the matrix at the current view makes points diverge, the one at the goal takes the camera through the target, their mean
    stands still: that is the law, not a defect. Three markers look the same from up to four places, and with points (`point`,
    `polar`, `spherical`) e is zero at each of them: the law may come to rest at another one than the goal. Four in one plane
    have one.

    Args:
        gain: lambda [1/s], a number or an adaptive gain of pinv(L B) e, the motion still to be made.
        feature: what s is.
        interaction: L at the current view, at the desired one, or the mean of both matrices.
        depth: where Z (for `spherical` the range) in L comes from.
        smooth_start_s: tau [s]; 0 starts with the full command.
        target_motion_s: time constant of the estimate of the target's own motion [s]; 0 takes it to stand still.
        limits: largest speed and rate of the commanded twist.
        visibility: keeps markers off the picture's border.

    References: Chaumette & Hutchinson 2006, eqs 3-5, doi:10.1109/MRA.2006.250573; mean matrix: Malis 2004,
    doi:10.1109/ROBOT.2004.1308092; moving target: Chaumette & Hutchinson 2007, doi:10.1109/MRA.2007.339609; smooth start:
    Mansard & Chaumette 2007, doi:10.1109/TRO.2006.889487.
    """

    kind: Literal["ibvs"] = "ibvs"
    tasks: ClassVar[tuple[str, ...]] = ("view", "path", "landing")
    gain: Gain = ConstantGain()
    feature: Annotated[Point | Polar | Spherical | Polygon | Line, FEATURES] = Point()
    interaction: Literal["current", "desired", "mean"] = "current"
    depth: Depth = PnP()
    smooth_start_s: Annotated[float, Ge(0)] = 0.0
    target_motion_s: Annotated[float, Ge(0)] = 0.0
    limits: TwistLimits = TwistLimits()
    visibility: Visibility = Visibility()

    @property
    def inputs(self) -> tuple[str, ...]:
        """The fields of an Observation that it looks at: those of its feature, and the robot's motion where it needs that."""
        return (*self.feature.inputs, "twist") if self.target_motion_s > 0 else self.feature.inputs

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse what `visibility` does; with the feature `polygon`, a goal view of three or more markers without a size."""
        self.visibility.check(goal)
        if isinstance(self.feature, Polygon) and len(points) > 2:
            require_area(goal)

    def init(self, goal: Goal) -> IBVSMemory:
        """No command given yet."""
        return IBVSMemory()

    def markers_needed(self, basis: Array) -> int:
        """How many markers must be seen for as many equations as the robot has motions (6, n)."""
        rows = self.feature.rows_per_marker
        return max(self.feature.least_markers, math.ceil(basis.shape[1] / rows) if rows else 0)

    def step(self, memory: IBVSMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[IBVSMemory, Command]:
        """One frame, with the markers that are seen; rest when they are too few for the robot's motions."""
        rows = usable_rows(observation, self.feature.inputs, self.markers_needed(basis))
        if isinstance(rows, str):
            return self._without(memory, observation.t, basis, rows)
        e, L = self.equations(*self._taken(observation, rows), *self._taken(goal, rows))
        LB = L @ basis
        solved = least_squares(LB, e)  # pinv(L B) e
        u = -self.gain.at(solved) * solved
        if self.target_motion_s > 0 and observation.twist is not None:
            memory = self._followed(memory, observation.t, e, LB, least_squares(basis, observation.twist))
            u = u if memory.drift is None else u - memory.drift
        if goal.twist is not None:
            u = u + least_squares(basis, goal.twist)
        if self.smooth_start_s > 0:
            u0 = u if memory.u0 is None else memory.u0
            memory = replace(memory, t0=observation.t if memory.u0 is None else memory.t0, u0=u0)
            u = u - u0 * math.exp(-(observation.t - memory.t0) / self.smooth_start_s)
        if self.visibility.margin_px > 0:
            u = u + self.visibility.push(observation, goal, basis)
        return memory, self.limits.command(u, basis)

    def _without(self, memory: IBVSMemory, t: float, basis: Array, why: str) -> tuple[IBVSMemory, Command]:
        """A frame without sight: rest; a target that moved is followed by its own motion for COAST_S."""
        if memory.drift is None or not t - memory.t <= COAST_S:
            return IBVSMemory(), Command.rest(basis, why)
        return replace(memory, e=None), replace(self.limits.command(-memory.drift, basis), held=why)

    def _followed(self, memory: IBVSMemory, t: float, e: Array, LB: Array, own: Array) -> IBVSMemory:
        """The memory with the drift d (n,) of this frame in it; a jump of the error (a marker lost, an angle wrapped) tells nothing."""
        before, drift = memory.e, memory.drift
        if before is not None and before.shape == e.shape and t > memory.t and np.abs(e - before).max() < JUMP:
            now = least_squares(LB, (e - before) / (t - memory.t)) - own
            old = np.zeros_like(now) if drift is None else drift
            drift = old + (1 - math.exp(-(t - memory.t) / self.target_motion_s)) * (now - old)
        return replace(memory, t=t, e=e, drift=drift)

    @property
    def remembers(self) -> int:
        """The first command, where the law starts smoothly."""
        return 6 if self.smooth_start_s > 0 else 0

    def many(self, memory: Array, views: Views, goal: Goal) -> tuple[Array, Array]:
        """One frame of many runs (see `ForMany`)."""
        e, L = self.equations(*self._taken(views, ALL), *self._taken(goal, ALL))
        solved = least_squares(L, e)
        u = -self.gain.at(solved) * solved
        if self.smooth_start_s > 0:
            memory = np.where(np.isnan(memory), u, memory)
            u = u - memory * math.exp(-views.t / self.smooth_start_s)
        return memory, self.limits.within(u)

    def _taken(self, sight: Observation | Goal | Views, rows: Rows) -> tuple[Array, Array]:
        """The two inputs of the feature, of those markers."""
        what, distance = self.feature.inputs
        return getattr(sight, what)[rows], getattr(sight, distance)[rows]

    def equations(self, x: Array, distance: Array, goal_x: Array, goal_distance: Array) -> tuple[Array, Array]:
        """The error e (..., rows) and its matrix L (..., rows, 6), or (rows, 6) where that is the goal's.

        Args:
            x, distance: the feature's inputs in views of N markers, e.g. xy (..., N, 2) and depth (..., N) [m].
            goal_x, goal_distance: the same in the goal view, (N, 2) and (N,).
        """
        feature = self.feature
        e = feature.error(feature.measure(x), feature.measure(goal_x))
        L = np.empty(0) if self.interaction == "desired" else feature.interaction(x, distance)
        if self.interaction == "current":
            return e, L
        at_goal = feature.interaction(goal_x, goal_distance)
        return e, at_goal if self.interaction == "desired" else 0.5 * (L + at_goal)
