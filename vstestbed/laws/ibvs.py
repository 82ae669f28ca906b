"""Image-based visual servoing with any feature."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from vstestbed.features import FEATURES, Point
from vstestbed.geometry import Array
from vstestbed.laws.base import Command, ConstantGain, Gain, TwistLimits
from vstestbed.observation import Depth, Goal, Observation, PnP
from vstestbed.spec import spec

Rows = slice | NDArray[np.bool_]
"""Which markers' rows are taken."""
TOO_FEW, NO_DEPTH = "too few markers in sight", "the depth of the markers in sight cannot be told"
"""Why the law orders rest."""
PINV_RCOND = 1e-6
"""Cut-off of the pseudo-inverse: singular values under this share of the largest count as zero:
a direction that pixels do not tell is not moved in."""


@dataclass(frozen=True, slots=True)
class IBVSMemory:
    """Time of the first command [s] and the command that the law would have jumped to there (n,)."""

    t0: float = math.nan
    u0: Array | None = None


@spec
class IBVS:
    """u = -lambda pinv(L B) e with e = s - s*, camera twist v = B u.

    With `smooth_start_s` = tau the command grows from rest: u - u(0) exp(-t/tau).

    Args:
        gain: lambda [1/s], a number or an adaptive gain of pinv(L B) e, the motion still to be made.
        feature: what s is.
        interaction: L at the current view, at the desired one, or the mean of both matrices.
        depth: where Z in L comes from.
        smooth_start_s: tau [s]; 0 starts with the full command.
        limits: largest speed and rate of the commanded twist.

    References: Chaumette & Hutchinson 2006, eqs 3-5, doi:10.1109/MRA.2006.250573; mean matrix: Malis 2004,
    doi:10.1109/ROBOT.2004.1308092; smooth start: Mansard & Chaumette 2007, doi:10.1109/TRO.2006.889487.
    """

    kind: Literal["ibvs"] = "ibvs"
    gain: Gain = ConstantGain()
    feature: Annotated[Point, FEATURES] = Point()
    interaction: Literal["current", "desired", "mean"] = "current"
    depth: Depth = PnP()
    smooth_start_s: Annotated[float, Ge(0)] = 0.0
    limits: TwistLimits = TwistLimits()

    def init(self, goal: Goal) -> IBVSMemory:
        """No command given yet."""
        return IBVSMemory()

    def markers_needed(self, basis: Array) -> int:
        """How many markers must be seen for as many equations as the robot has motions (6, n)."""
        return math.ceil(basis.shape[1] / 2)

    def step(self, memory: IBVSMemory, observation: Observation, goal: Goal, basis: Array) -> tuple[IBVSMemory, Command]:
        """One frame, with the markers that are seen; rest when they are too few for the robot's motions."""
        usable, needed = observation.usable, self.markers_needed(basis)
        if np.count_nonzero(usable) < needed:
            blind = np.count_nonzero(observation.seen) < needed
            return IBVSMemory(), Command.rest(basis, TOO_FEW if blind else NO_DEPTH)
        seen: Rows = usable
        if usable.all():
            seen = slice(None)  # a view is cheaper than a selection
        e = self.feature.error(self.feature.measure(observation.xy[seen]), self.feature.measure(goal.xy[seen]))
        L = self._interaction(observation, goal, seen)
        solved = np.asarray(np.linalg.lstsq(L @ basis, e, rcond=PINV_RCOND)[0], dtype=float)  # pinv(L B) e
        u = -self.gain.at(solved) * solved
        if self.smooth_start_s > 0:
            u0 = u if memory.u0 is None else memory.u0
            memory = IBVSMemory(observation.t if memory.u0 is None else memory.t0, u0)
            u = u - u0 * math.exp(-(observation.t - memory.t0) / self.smooth_start_s)
        scale = self.limits.scale(basis @ u)
        return memory, Command(u=u * scale, twist=basis @ u * scale, scale=scale)

    def _interaction(self, observation: Observation, goal: Goal, seen: Rows) -> Array:
        if self.interaction == "desired":
            return self.feature.interaction(goal.xy[seen], goal.depth[seen])
        L = self.feature.interaction(observation.xy[seen], observation.depth[seen])
        if self.interaction == "mean":
            L = 0.5 * (L + self.feature.interaction(goal.xy[seen], goal.depth[seen]))
        return L
