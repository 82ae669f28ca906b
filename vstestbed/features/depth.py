"""Sources of the markers' depth, as a scenario may choose them."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, lengths
from vstestbed.core.quantity import PositiveLength, PositiveTime
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal

__all__ = [
    "AtGoal",
    "Constant",
    "Depth",
    "DepthCues",
    "DepthSource",
    "Estimate",
    "OnFloor",
    "PnP",
    "depth_at",
    "triangulated",
]

# Least depth of a visible marker by an estimated pose, as a share of the distance in the goal view:
# propagated by the camera's motion, a pose may drift through the target.
NEAREST = 0.01


class DepthCues(NamedTuple):
    """What an observer has computed of one frame; a source takes what it needs, and None stands for
    what there is not.

    Attributes:
        goal: the goal view. xy: normalised coordinates, shape (N, 2), NaN where a marker is not
            seen.
        p_estimated, p_true, p_by_size, p_by_pair: markers in the camera frame (N, 3) [m], by the
            estimated pose, in truth (oracle), by their size, triangulated with a second camera.
        by_flow: unit rays (N, 3) and ranges (N,) [m] of the recursive estimate.
        measured: depths by the depth camera (N,) [m], NaN in its holes (`DepthSource.read`).
    """

    goal: Goal
    xy: Array
    p_estimated: Array | None = None
    p_true: Array | None = None
    by_flow: tuple[Array, Array] | None = None
    measured: Array | None = None
    p_by_size: Array | None = None
    p_by_pair: Array | None = None


class DepthSource:
    """Where depths Z (along the optical axis)
    and ranges (along the ray) of the markers come from.
    """

    kind: Any  # the word in a scenario: a field of each
    needs_pose: ClassVar[bool] = False  # the target's pose must be estimated
    needs_size: ClassVar[bool] = False  # the target's known size must tell its place
    true: ClassVar[bool] = False  # depths are the simulator's truth
    on_floor: ClassVar[bool] = (
        False  # that pose is one of a base that stands upright on the floor: three unknowns
    )
    preset: ClassVar[bool] = (
        False  # depths are given numbers, not measured: derotation leaves them as they are
    )
    measured: ClassVar[bool] = (
        False  # depths are read from the picture of a depth camera (`camera.depth_sensor`)
    )
    # name of the further camera with which depths are triangulated; "" where they come from
    # elsewhere
    camera: Any = ""
    # parameters of the recursive estimate from motion (`Estimate`); None where depths come from
    # elsewhere
    estimator: Any = None

    def read(self, depth_image: NDArray[np.float32] | None, uv: Array) -> Array | None:
        """Measured depths (N,) [m] at pixels uv (N, 2) of a depth picture (H, W) [m]; None for a
        source that needs none.
        """
        return None

    def points(self, cues: DepthCues) -> Array | None:
        """The markers in the camera frame (N, 3) [m] by this source, None where it knows none; by
        default by the estimated pose.
        """
        return cues.p_estimated

    def depths(self, cues: DepthCues) -> Array:
        """Depth of each marker, shape (N,) [m], NaN where unknown; by default that of `points`, of
        those seen at least NEAREST.
        """
        p = self.points(cues)
        if p is None:
            return np.full(len(cues.xy), np.nan)
        return np.where(
            np.isfinite(cues.xy[:, 0]), np.maximum(p[:, 2], NEAREST * cues.goal.reach_m), p[:, 2]
        )

    def ranges(self, cues: DepthCues) -> Array:
        """Range of each marker, shape (N,) [m], NaN where unknown; by default that of `points`."""
        p = self.points(cues)
        return np.full(len(cues.xy), np.nan) if p is None else lengths(p)[:, 0]


@spec
class PnP(DepthSource):
    """Depth from the target's pose, solved from its known points and the measured pixels
    (perspective-n-point).
    """

    kind: Literal["pnp"] = "pnp"
    needs_pose: ClassVar[bool] = True


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

    ranges = depths  # which a law of ranges takes for it


@spec
class AtGoal(DepthSource):
    """Each marker's depth in the goal view."""

    kind: Literal["goal"] = "goal"
    preset: ClassVar[bool] = True

    def depths(self, cues: DepthCues) -> Array:
        return cues.goal.depth

    def ranges(self, cues: DepthCues) -> Array:
        return cues.goal.range


@spec
class Estimate(DepthSource):
    """Each marker's inverse range by recursive least squares on the flow of its ray under the
    camera's own motion.

    The motion is what the robot measures of itself: an arm's encoders; the ideal camera moves as
    commanded.

    Args:
        initial_m: depth assumed until the camera has moved enough to tell [m].
        forget_s: time constant with which old frames lose their weight [s].
    """

    kind: Literal["estimate"] = "estimate"
    initial_m: PositiveLength = 1.0
    forget_s: PositiveTime = 0.5

    @property
    def estimator(self) -> Estimate:
        """These parameters."""
        return self

    def depths(self, cues: DepthCues) -> Array:
        ray, reach = self._by_flow(cues)
        return reach * ray[:, 2]

    def ranges(self, cues: DepthCues) -> Array:
        return self._by_flow(cues)[1]

    def _by_flow(self, cues: DepthCues) -> tuple[Array, Array]:
        if cues.by_flow is None:
            raise ParameterError(
                "state", "does not belong to this depth; begin with Observer.init()"
            )
        return cues.by_flow


@spec
class BySize(DepthSource):
    """For a ball: depth from its known radius. The rays that touch it lie on a cone whose angle is
    the ball's distance.
    """

    kind: Literal["size"] = "size"
    needs_size: ClassVar[bool] = True

    def points(self, cues: DepthCues) -> Array | None:
        return cues.p_by_size


@spec
class OracleDepth(DepthSource):
    """The simulator's true depth; only with `detector: {kind: oracle}`."""

    kind: Literal["oracle"] = "oracle"
    true: ClassVar[bool] = True

    def points(self, cues: DepthCues) -> Array:
        if cues.p_true is None:
            raise ParameterError.excluded(
                "depth",
                "oracle without detector oracle",
                works="pnp, constant, goal, estimate or sensor",
            )
        return cues.p_true

    def depths(self, cues: DepthCues) -> Array:
        """True depths, also of a marker behind the camera."""
        return self.points(cues)[:, 2]


@spec
class OnFloor(DepthSource):
    """For a vehicle: depth from its place on the floor, solved from two or more landmarks of known
    height.

    The mount is known, the vehicle stands upright (one that pitches on its suspension is off by as
    much): three unknowns, where `pnp` has six and needs three markers. Of a single landmark the
    heading stays as it was.
    """

    kind: Literal["floor"] = "floor"
    needs_pose: ClassVar[bool] = True
    on_floor: ClassVar[bool] = True


@spec
class Sensed(DepthSource):
    """Each marker's depth as the depth camera measures it: the median of the valid pixels in a
    square round the marker's pixel.

    It is the depth of the surface that is seen, of a ball that of its front. Where fewer than half
    of the square's pixels are valid there is none: the law does without that marker, unless
    `missing_m` says which to take. The markers' depths in the goal view are those of its geometry;
    only points that a detector finds in the goal's picture have theirs from its depth picture.

    Args:
        window_px: side of the square, odd [px].
        missing_m: depth of a marker that was not measured [m]; None leaves it out; e.g. `100`.
    """

    kind: Literal["sensor"] = "sensor"
    window_px: Annotated[int, Ge(1), Le(31)] = 5
    missing_m: PositiveLength | None = None
    measured: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if self.window_px % 2 == 0:
            raise ParameterError.fixed(
                "window_px", "odd", self.window_px, why="the marker's pixel is in the middle"
            )

    def read(self, depth_image: NDArray[np.float32] | None, uv: Array) -> Array | None:
        """The medians (N,) [m]; NaN where too few pixels are valid, and for markers that are not
        seen.
        """
        return None if depth_image is None else depth_at(depth_image, uv, self.window_px)

    def depths(self, cues: DepthCues) -> Array:
        """The measured depths; `missing_m` for markers that are seen and not measured."""
        z = np.full(len(cues.xy), np.nan) if cues.measured is None else cues.measured
        if self.missing_m is None:
            return z
        return np.where(np.isnan(z) & np.isfinite(cues.xy[:, 0]), self.missing_m, z)

    def ranges(self, cues: DepthCues) -> Array:
        """Ranges at these depths, Z sqrt(1 + x^2 + y^2)."""
        return self.depths(cues) * np.sqrt(1 + (cues.xy**2).sum(axis=1))


def depth_at(depth_image: NDArray[np.float32], uv: Array, side: int = 1) -> Array:
    """Median (N,) [m] of the valid pixels in squares of odd `side` [px] round pixels uv (N, 2) of a
    picture (H, W).

    NaN where under half of a square is valid; what lies outside of the picture is not.
    """
    half = side // 2
    (height, width) = depth_image.shape
    known = np.isfinite(uv[:, 0]) & np.isfinite(uv[:, 1])
    at = np.rint(np.clip(np.where(known[:, None], uv, -1e6), -1e6, 1e6)).astype(int)
    v, u = (at[:, i, None] + np.arange(-half, half + 1) for i in (1, 0))
    inside = ((v >= 0) & (v < height))[:, :, None] & ((u >= 0) & (u < width))[:, None, :]
    values = depth_image[
        np.clip(v, 0, height - 1)[:, :, None], np.clip(u, 0, width - 1)[:, None, :]
    ].astype(float)
    # NaN last
    values = np.sort(np.where(inside, values, np.nan).reshape(len(uv), side * side), axis=1)
    n = np.isfinite(values).sum(axis=1)
    rows = np.arange(len(uv))
    enough = 2 * n > side * side
    middle = values[rows, np.maximum(n - 1, 0) // 2] + values[rows, n // 2]
    return np.where(enough, middle / 2, np.nan)


@spec
class Triangulated(DepthSource):
    """Each marker's depth by a second camera (stereo): the middle of the shortest line between the
    rays of both.

    Of a pair side by side, the baseline b apart, this is Z = b / d with the disparity d = x_l -
    x_r. A marker that one of the two does not see has no depth, and the law does without it.

    Args:
        camera: name of the second camera (`cameras`), which takes its pictures at the same times;
            e.g. `right`.

    Reference: Beardsley, Zisserman & Murray 1997, doi:10.1023/A:1007923216416 (midpoint method);
    against others: Hartley & Sturm 1997, doi:10.1006/cviu.1997.0547.
    """

    kind: Literal["stereo"] = "stereo"
    camera: str

    def points(self, cues: DepthCues) -> Array | None:
        return cues.p_by_pair


def triangulated(ray: Array, ray_other: Array, T_camera_other: Array) -> Array:
    """Middles (N, 3) [m], in the first camera's frame, of the shortest lines between rays (N, 3) of
    two cameras; NaN where one is NaN, where the rays are parallel, or meet behind a camera.

    T_camera_other: pose (4, 4) of the second camera in the frame of the first.
    """
    a = ray
    b = ray_other @ T_camera_other[:3, :3].T
    t = T_camera_other[:3, 3]
    c = np.einsum("ni,ni->n", a, b)
    at = a @ t
    bt = b @ t
    with np.errstate(divide="ignore", invalid="ignore"):
        s, r = (at - c * bt) / (1 - c * c), (c * at - bt) / (1 - c * c)  # ranges along both rays
    p = (a * s[:, None] + t + b * r[:, None]) / 2
    return np.where(((s > 0) & (r > 0))[:, None], p, np.nan)


DEPTHS = Registry(
    "depth", PnP, Constant, AtGoal, Estimate, OnFloor, BySize, Sensed, Triangulated, OracleDepth
)
Depth = Annotated[DepthSource, DEPTHS]
