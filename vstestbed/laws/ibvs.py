"""Image-based visual servoing with any feature."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Gt, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import check_ordered
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec
from vstestbed.features import FEATURES, LineFeature, Point
from vstestbed.features.base import Feature
from vstestbed.features.depth import Depth, PnP
from vstestbed.features.observation import Goal
from vstestbed.laws.base import Motions
from vstestbed.laws.error_law import Equations, ErrorLaw
from vstestbed.laws.points import check_goal
from vstestbed.laws.solve import Solve


@spec
class Classical:
    """P = I - pinv(L B) L B: the motions that leave all features as they are."""

    kind: Literal["classical"] = "classical"

    def free(self, solve: Solve, A: Array, e: Array, solved: Array, basis: Array) -> Motions:
        """The free motions, for A = L B (m, n), e (m,), the remaining motion solved (n,) and the
        robot's motions basis (6, n).
        """
        return ((1.0, basis @ solve.null_space(A)),)


@spec
class Large:
    """P = share P_|e| + (1 - share) P_e: away from the goal, all motions are free that leave the
    norm of the error as it is.

    P_e is the classical projection, and with A = L B

    P_|e| = I - A^T e e^T A / (e^T A A^T e)

    that of the task |e|, of rank n - 1: even where the features determine all n motions, all but
    one of them are free, and |e| decreases as it does without a secondary task. The single features
    do not: the camera takes another way. `share` goes from 0, where the largest component x of the
    remaining motion pinv(L B) e is `near`, by a logistic function of x to 1 at `far`. Without P_e
    near the goal, where A^T e vanishes, the motion would not settle.

    The projections are orthogonal in the joint space of the robot, which takes its secondary task
    as near as it can to the one wanted.

    Args:
        near: remaining motion under which the operator is the classical one [rad; m for
            translations].
        far: remaining motion above which it is P_|e| alone, over `near` [rad; m for translations].

    Reference: Marey & Chaumette 2010, doi:10.1109/ROBOT.2010.5509296 (the operator; there the share
    is a function of |e|) and doi:10.1109/IROS.2010.5650967 (for joint limits).
    """

    kind: Literal["large"] = "large"
    near: Annotated[float, Gt(0), Le(10)] = 0.02
    far: Annotated[float, Gt(0), Le(10)] = 0.1

    def __post_init__(self) -> None:
        """Refuse a share that would decrease with the error."""
        check_ordered(self, "near", "far", equal=False)

    def share(self, solved: Array) -> float:
        """The weight of P_|e|, 0 to 1, at a remaining motion (n,) [m, rad]."""
        x = (float(np.abs(solved).max(initial=0.0)) - self.near) / (self.far - self.near)
        along = min(max(x, 0.0), 1.0) - 0.5
        # The paper's logistic function 1 / (1 + exp(-12 x + 6)) of x from 0 to 1, stretched to be 0
        # and 1 at its ends.
        return (1 + math.tanh(6 * along) / math.tanh(3)) / 2

    def free(self, solve: Solve, A: Array, e: Array, solved: Array, basis: Array) -> Motions:
        """The free motions; see `Classical.free`."""
        share = self.share(solved)
        gradient = A.T @ e
        classical = basis @ solve.null_space(A)
        if share == 0 or not gradient.any():
            return ((1.0, classical),)
        return (1 - share, classical), (share, basis @ solve.null_space(gradient[None]))


PROJECTIONS = Registry("projection", Classical, Large)
Projection = Annotated[Classical | Large, PROJECTIONS]


@spec
class IBVS(ErrorLaw):
    """u = -lambda pinv(L B) e with e = s - s*, camera twist v = B u.

    Errata. Chapter 16 of Corke 2017 has polar and spherical features as here (eqs 16.9, 16.15), but
    theta = asin(r) in eq. 16.11, which is wrong behind the camera's equator; see the docstrings of
    the features. With an exact half turn the matrix at the current view makes points diverge, the
    one at the goal drives the camera through the target, and their mean does not move: these are
    properties of the law. Three markers have the same image from up to four poses, and with points
    (`point`, `polar`, `spherical`) e is zero at each: the law may converge to another one than the
    goal. Four in one plane have one.

    Args:
        feature: the feature s.
        interaction: L at the current view, at the desired one, or the mean of both matrices.
        depth: source of Z (for `spherical`, of the range) in L.
        redundant: accept fewer markers than determine all of the robot's motions, such as two on an
            arm. Motions in the null space of the task are not made, unless the robot has a
            secondary task (`robot.avoid_limits`).
        projection: which motions are left to that task: `classical`, the null space, or `large`,
            which keeps only the norm of e, so that also features that determine all motions leave
            some free.

    References: Chaumette & Hutchinson 2006, eqs 3-5, doi:10.1109/MRA.2006.250573; mean matrix:
    Malis 2004, doi:10.1109/ROBOT.2004.1308092.
    """

    kind: Literal["ibvs"] = "ibvs"
    tasks = ("view", "path", "landing")
    feature: Annotated[Feature, FEATURES] = Point()
    interaction: Literal["current", "desired", "mean"] = "current"
    depth: Depth = PnP()
    redundant: bool = False
    projection: Projection = Classical()

    def __post_init__(self) -> None:
        """Refuse a projection without a use."""
        if self.projection != Classical() and not self.redundant:
            raise ParameterError.only_for(
                "projection",
                "law.redundant: true, which leaves motions to the robot",
                self.projection.kind,
            )

    @property
    def inputs(self) -> tuple[str, ...]:
        """Those of the feature."""
        return self.feature.inputs

    @property
    def needs_same_markers(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """The features that describe the markers as a set do, and lines, which are made of two
        each.
        """
        return self.feature.rows_per_marker == 0 or isinstance(self.feature, LineFeature)

    def check(self, points: Array, goal: Goal) -> None:
        check_goal(self.feature, goal)

    def markers_needed(self, basis: Array) -> int:
        """As many markers as give one equation for each of the robot's motions, basis (6, n)."""
        # A polygon's two rows belong to the set (rows_per_marker 0): no number of markers gives it
        # more.
        rows = 0 if self.redundant else self.feature.rows_per_marker
        return max(self.feature.least_markers, math.ceil(basis.shape[1] / rows) if rows else 0)

    def free_motions(self, J: Array, e: Array, x: Array | None, basis: Array) -> Motions:
        if not self.redundant or x is None:
            return ()
        return self.projection.free(self.solve, J @ basis, e, x, basis)

    def equations(self, view: Any, goal: Any) -> Equations:
        """E = s - s* (..., rows), and L at the views that `interaction` names (..., rows, 6),
        (rows, 6) for `desired`.
        """
        feature = self.feature
        what, distance = feature.inputs
        x = getattr(view, what)
        goal_x = getattr(goal, what)
        s = feature.measure(x)
        if self.interaction == "current":
            e = feature.error(s, feature.measure(goal_x))
            return e, feature.interaction(x, getattr(view, distance))
        s_star, L_star = _at_goal(feature, goal_x.tobytes(), getattr(goal, distance).tobytes())
        e = feature.error(s, s_star)
        if self.interaction == "desired":
            return e, L_star
        return e, 0.5 * (feature.interaction(x, getattr(view, distance)) + L_star)


@lru_cache(maxsize=256)
def _at_goal(feature: Feature, x: bytes, distance: bytes) -> tuple[Array, Array]:
    """The feature s* and its L* in the goal view, the same at most frames; its inputs as bytes,
    which can be hashed.
    """
    of_points = np.frombuffer(distance)
    at = np.frombuffer(x).reshape(len(of_points), -1)
    return feature.measure(at), feature.interaction(at, of_points)
