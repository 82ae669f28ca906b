"""Which motions a law leaves free for the robot's secondary task: the projection operators of the redundancy framework."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import OneOf, spec
from vstestbed.laws.base import FreeMotions
from vstestbed.laws.solve import Solve

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
