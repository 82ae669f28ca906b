"""Sources of the markers' depth, as a scenario may choose them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, lengths
from vstestbed.core.quantity import PositiveLength, PositiveTime
from vstestbed.core.spec import OneOf, spec
from vstestbed.features.observation import Goal

NEAREST_M = 0.01
"""Least depth of a visible marker by an estimated pose [m]: propagated by the camera's motion, a pose may drift through the target."""


class DepthCues(NamedTuple):
    """What an observer has computed of one frame; a source takes what it needs.

    Attributes:
        goal: the goal view.
        xy: normalised coordinates, shape (N, 2), NaN where a marker is not seen.
        p_estimated: markers in the camera frame by the estimated pose, shape (N, 3) [m]; None without a pose.
        p_true: true markers in the camera frame, shape (N, 3) [m]; None without the oracle.
        by_flow: unit rays (N, 3) and ranges (N,) [m] of the recursive estimate; None where there is none.
        p_by_size: markers in the camera frame by the target's known size, shape (N, 3) [m]; None where that is not asked for.
    """

    goal: Goal
    xy: Array
    p_estimated: Array | None = None
    p_true: Array | None = None
    by_flow: tuple[Array, Array] | None = None
    p_by_size: Array | None = None


class DepthSource(ABC):
    """Where depths Z (along the optical axis) and ranges (along the ray) of the markers come from."""

    kind: Any  # the word in a scenario: a field of each
    needs_pose: ClassVar[bool] = False
    """The target's pose must be estimated."""
    needs_size: ClassVar[bool] = False
    """The target's known size must tell its place."""
    true: ClassVar[bool] = False
    """Depths are the simulator's truth."""
    on_floor: ClassVar[bool] = False
    """That pose is one of a base that stands upright on the floor: three unknowns."""
    preset: ClassVar[bool] = False
    """Depths are given numbers, not measured: derotation leaves them as they are."""

    @property
    def estimator(self) -> Estimate | None:
        """Parameters of the recursive estimate from motion; None where depths come from elsewhere."""
        return None

    @abstractmethod
    def depths(self, cues: DepthCues) -> Array:
        """Depth of each marker, shape (N,) [m], NaN where unknown."""

    @abstractmethod
    def ranges(self, cues: DepthCues) -> Array:
        """Range of each marker, shape (N,) [m], NaN where unknown."""


class FromPose(DepthSource):
    """Depth from the estimated pose of the target."""

    needs_pose: ClassVar[bool] = True

    def depths(self, cues: DepthCues) -> Array:
        """Z of the markers under the estimated pose, at least NEAREST_M for those that are seen."""
        if cues.p_estimated is None:
            return np.full(len(cues.xy), np.nan)
        z = cues.p_estimated[:, 2]
        return np.where(np.isfinite(cues.xy[:, 0]), np.maximum(z, NEAREST_M), z)

    def ranges(self, cues: DepthCues) -> Array:
        """Distance of the markers under the estimated pose."""
        return np.full(len(cues.xy), np.nan) if cues.p_estimated is None else lengths(cues.p_estimated)[:, 0]


@spec
class PnP(FromPose):
    """Depth from the target's pose, solved from its known points and the measured pixels (perspective-n-point)."""

    kind: Literal["pnp"] = "pnp"


@spec
class Constant(DepthSource):
    """One fixed depth for all markers.

    Args:
        depth_m: the depth [m].
    """

    kind: Literal["constant"] = "constant"
    depth_m: PositiveLength = 1.0
    preset: ClassVar[bool] = True

    def depths(self, cues: DepthCues) -> Array:
        """The same number for all."""
        return np.full(len(cues.xy), self.depth_m)

    def ranges(self, cues: DepthCues) -> Array:
        """The same number again: a law of ranges takes it for the range."""
        return np.full(len(cues.xy), self.depth_m)


@spec
class AtGoal(DepthSource):
    """Each marker's depth in the goal view."""

    kind: Literal["goal"] = "goal"
    preset: ClassVar[bool] = True

    def depths(self, cues: DepthCues) -> Array:
        """Depths of the goal view."""
        return cues.goal.depth

    def ranges(self, cues: DepthCues) -> Array:
        """Ranges of the goal view."""
        return cues.goal.range


@spec
class Estimate(DepthSource):
    """Each marker's inverse range by recursive least squares on the flow of its ray under the camera's own motion.

    The motion is what the robot measures of itself: an arm's encoders; the ideal camera moves as commanded. (The commanded
    twist of an arm would not do: its servos lag, and the first frame's command has not moved anything yet.)

    Args:
        initial_m: depth assumed until the camera has moved enough to tell [m].
        forget_s: time constant with which old frames lose their weight [s].
    """

    kind: Literal["estimate"] = "estimate"
    initial_m: PositiveLength = 1.0
    forget_s: PositiveTime = 0.5

    @property
    def estimator(self) -> Estimate | None:
        """These parameters."""
        return self

    def depths(self, cues: DepthCues) -> Array:
        """Z of the markers at their estimated ranges."""
        ray, reach = self._by_flow(cues)
        return reach * ray[:, 2]

    def ranges(self, cues: DepthCues) -> Array:
        """The estimated ranges."""
        return self._by_flow(cues)[1]

    def _by_flow(self, cues: DepthCues) -> tuple[Array, Array]:
        if cues.by_flow is None:
            raise ParameterError("memory", "does not belong to this depth; begin with Observer.init()")
        return cues.by_flow


@spec
class BySize(DepthSource):
    """For a ball: depth from its known radius. The rays that touch it lie on a cone whose angle is the ball's distance."""

    kind: Literal["size"] = "size"
    needs_size: ClassVar[bool] = True

    def depths(self, cues: DepthCues) -> Array:
        """Z of the points of the outline."""
        return np.full(len(cues.xy), np.nan) if cues.p_by_size is None else cues.p_by_size[:, 2]

    def ranges(self, cues: DepthCues) -> Array:
        """Distance of the points of the outline."""
        return np.full(len(cues.xy), np.nan) if cues.p_by_size is None else lengths(cues.p_by_size)[:, 0]


@spec
class OracleDepth(DepthSource):
    """The simulator's true depth; only with `detector: {kind: oracle}`."""

    kind: Literal["oracle"] = "oracle"
    true: ClassVar[bool] = True

    def depths(self, cues: DepthCues) -> Array:
        """True depths."""
        return self._true(cues)[:, 2]

    def ranges(self, cues: DepthCues) -> Array:
        """True ranges."""
        return np.linalg.norm(self._true(cues), axis=1)

    def _true(self, cues: DepthCues) -> Array:
        if cues.p_true is None:
            raise ParameterError("depth", "oracle is only with detector {kind: oracle}; valid here: pnp, constant, goal, estimate")
        return cues.p_true


@spec
class OnFloor(FromPose):
    """For a vehicle: depth from its place on the floor, solved from two or more landmarks of known height.

    The mount is known, the vehicle stands upright: three unknowns, where `pnp` has six and needs three markers. A vehicle
    that pitches on its suspension is off by as much. Of a single landmark the heading stays as it was.
    """

    kind: Literal["floor"] = "floor"
    on_floor: ClassVar[bool] = True


DEPTHS = OneOf("depth", PnP, Constant, AtGoal, Estimate, OnFloor, BySize, OracleDepth)
Depth = Annotated[DepthSource, DEPTHS]
