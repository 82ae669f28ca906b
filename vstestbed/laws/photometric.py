"""Direct visual servoing: the luminance of every pixel is a feature."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, homogeneous
from vstestbed.core.lazy import cv2
from vstestbed.core.quantity import GainOrZero, Pixels, TighterBounds, Time
from vstestbed.core.registry import kind_of
from vstestbed.core.spec import spec
from vstestbed.features.depth import AtGoal, Constant, Depth
from vstestbed.features.observation import Goal, Observation, Sight
from vstestbed.laws.base import Command, ConstantGain, Gain, Law, TwistLimits

# A lamp that changed since the goal's picture was taken: gain and offset of the grey levels.
#
# Near the goal they are fitted together with the camera's motion. Far from it the fit takes errors
# of the motion for the light's, since the columns of both look alike in small pictures that show
# different parts of a scene; there the two pictures get the same mean and contrast.
Light = Literal["same", "gain_offset"]

# M-estimators: weights by which least squares leaves outliers out.
Robust = Literal["none", "huber", "tukey"]
LEAST_SIGMA = 5.0
"""Least scale of grey levels, which are whole numbers: of errors that are nearly all 0, the median
would make an outlier of each 1.
"""


def scale(e: NDArray[np.float32]) -> float:
    """The standard deviation of most of the errors e (n,): 1.4826 times the median of |e -
    median(e)|, at least LEAST_SIGMA.
    """
    # evenly spread: of 300,000 the whole partition would cost as much as the law
    some = e[:: max(1, len(e) // 20_000)]
    if not len(some):
        return LEAST_SIGMA
    return max(1.4826 * float(np.median(np.abs(some - np.median(some)))), LEAST_SIGMA)


def weights(kind: Robust, e: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """Weights (n,) of errors e (n,), with the scale of `scale`; None where all are 1.

    Huber: 1 up to c sigma, c sigma / |e| beyond. Tukey: (1 - (e / (c sigma))^2)^2 up to c sigma, 0
    beyond.

    References: Huber 1981, Robust Statistics; for visual servoing Comport, Marchand & Chaumette
    2006, doi:10.1109/TSMCB.2005.855568.
    """
    if kind == "none":
        return None
    # The tuning constants give either 95 % of the efficiency of least squares on Gaussian errors.
    bound = np.float32((1.345 if kind == "huber" else 4.685) * scale(e))
    if kind == "huber":
        return np.asarray(bound / np.maximum(np.abs(e), bound), np.float32)
    ratio = np.minimum(np.square(e / bound), np.float32(1))
    return np.square(np.float32(1) - ratio)


# Luminance as a feature: the grey levels of all pixels, their interaction matrix, and the normal
# equations that it gives.
Grey = NDArray[np.float32]  # luminance (h, w) [grey levels, 0 to 255]
Gradient = tuple[Grey, Grey]  # (dI/du, dI/dv), (h, w) each [grey levels/px]
Which = Literal["current", "desired", "mean"]
# pixels whose rows of L are held at a time: six float32 columns of them fit into a core's cache
BAND_PX = 16384
DIFFERENCE = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12
ONE = np.array([1.0])
"""Kernels of a central difference of fourth order, and of none."""
# points along each side of the picture by whose mean motion a step of the camera is measured in
# pixels
PROBES = 5
MOTION = np.array([0.01, 0.01, 0.01, *np.radians([1.0, 1.0, 1.0])])
"""Size of the motions by which a picture's structure is measured, along and about each axis: 1 % of
the distance and 1 degree [rad].
"""


def luminance(image: NDArray[np.uint8], smooth_px: float = 0.0) -> Grey:
    """The luminance Y = 0.299 R + 0.587 G + 0.114 B (ITU-R BT.601) of a picture (H, W, 3) RGB,
    shape (H, W).

    smooth_px: standard deviation of a Gaussian that smooths it [px].
    """
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.float32)
    if smooth_px > 0:
        grey = cv2.GaussianBlur(grey, (0, 0), smooth_px)
    return np.asarray(grey, np.float32)


def coarser(grey: Grey) -> Grey:
    """Smoothed by a Gaussian and halved: pixel i of the result lies on pixel 2 i of `grey`."""
    return np.asarray(cv2.pyrDown(grey), np.float32)


def gradient(grey: Grey) -> Gradient:
    """(dI/du, dI/dv) [grey levels/px], by central differences of fourth order.

    Of a rendered picture Sobel's, which smooth across, are 20 to 25 % too small, and plain ones 15
    %; these are within 5 %.
    """
    along = cv2.sepFilter2D(grey, cv2.CV_32F, DIFFERENCE, ONE)
    across = cv2.sepFilter2D(grey, cv2.CV_32F, ONE, DIFFERENCE)
    return np.asarray(along, np.float32), np.asarray(across, np.float32)


def rows(gx: Grey, gy: Grey, x: Grey, y: Grey, inverse_depth: Grey) -> Grey:
    """L_I = -(dI/dx L_x + dI/dy L_y) of pixels, transposed: (6, n), with the rows L_x and L_y of
    image points.

    A point of the scene keeps its luminance, so that at a fixed pixel dI/dt = -(dI/dx x_dot + dI/dy
    y_dot).

    gx, gy: gradient in normalised coordinates (n,). x, y: normalised coordinates. inverse_depth:
    1/Z [1/m].

    Reference: Collewet & Marchand 2011.
    """
    L = np.empty((6, len(gx)), np.float32)
    t = gx * x + gy * y
    np.multiply(gx, inverse_depth, out=L[0])
    np.multiply(gy, inverse_depth, out=L[1])
    np.multiply(t, -inverse_depth, out=L[2])
    np.negative(gy + t * y, out=L[3])
    np.add(gx, t * x, out=L[4])
    np.subtract(gy * x, gx * y, out=L[5])
    return L


@dataclass(frozen=True)
class GoalLevel:
    """One level of the goal's pyramid. All its pixels enter the error but a border, every
    `stride`-th in both directions.

    Attributes:
        grey: the goal's picture at this level.
        at: slices (rows, columns) of the pixels in it that enter the error.
        x, y: their normalised coordinates (h, w).
        slope: du/dx, du/dy, dv/dx, dv/dy of the lens, in pixels of the level, numbers or (h, w).
        inverse_depth: 1/Z of the pixels in the goal view (h, w) [1/m]; 0 where the depth is not
            known, or not set yet.
        light: whether gain and offset of the grey levels are fitted with the motion.
    """

    grey: Grey
    at: tuple[slice, slice]
    x: Grey
    y: Grey
    slope: tuple[Grey | float, ...]
    inverse_depth: Grey
    light: Light = "same"

    @classmethod
    def of(
        cls,
        camera: Perspective,
        grey: Grey,
        level: int,
        margin_px: int,
        stride: int,
        light: Light = "same",
    ) -> GoalLevel:
        """The picture of a camera, halved `level` times, without depths; margin_px: border left out
        [px of the full picture].
        """
        scale = 2**level
        edge = max(len(DIFFERENCE) // 2, math.ceil(margin_px / scale))
        height = math.ceil(camera.height / scale)
        width = math.ceil(camera.width / scale)
        at = slice(edge, height - edge, stride), slice(edge, width - edge, stride)
        v = np.arange(height)[at[0]] * scale
        u = np.arange(width)[at[1]] * scale
        uv = np.stack(np.meshgrid(u, v), axis=-1).astype(float)
        xy = camera.normalise(uv)
        x = np.ascontiguousarray(xy[..., 0], np.float32)
        y = np.ascontiguousarray(xy[..., 1], np.float32)
        return cls(grey, at, x, y, _slope(camera, xy, scale), np.zeros_like(x), light)

    def normalised(self, along: Gradient) -> Gradient:
        """The gradient of these pixels in normalised coordinates, of one in pixels of the level,
        (h, w) each.
        """
        gu = along[0][self.at]
        gv = along[1][self.at]
        ux, uy, vx, vy = self.slope
        if isinstance(ux, float):
            return gu * np.float32(ux), gv * np.float32(vy)
        return np.asarray(gu * ux + gv * vx, np.float32), np.asarray(gu * uy + gv * vy, np.float32)

    def interaction(self, along: Gradient, inverse_depth: Grey) -> Grey:
        """Rows of L transposed, (6, pixels), as `rows` has them, of the gradient (dI/du, dI/dv) of
        the level's picture.
        """
        gx, gy = self.normalised(along)
        return rows(gx.ravel(), gy.ravel(), self.x.ravel(), self.y.ravel(), inverse_depth.ravel())

    @cached_property
    def gradient(self) -> Gradient:
        """Of the goal's picture."""
        return gradient(self.grey)

    @cached_property
    def L(self) -> Grey:
        """The interaction matrix at the goal, transposed, (6, n)."""
        L = self.interaction(self.gradient, self.inverse_depth)
        return np.where(self.inverse_depth.ravel() > 0, L, np.float32(0))

    @cached_property
    def H(self) -> Array:
        """L^T L at the goal, all pixels with weight 1."""
        return _summed(self.L, self.L)

    @cached_property
    def of_light(self) -> Grey:
        """Derivatives (2, n) of I = (1 + a) I* + b by gain a and offset b of the light, of the
        goal's grey levels I* (n,).
        """
        goal = self.grey[self.at].ravel()
        return np.stack([goal, np.ones_like(goal)])

    @cached_property
    def least_change(self) -> float:
        """RMS change [grey levels] by the motion of size S (`MOTION`) with the least: root of the
        least eigenvalue of S H S / n.
        """
        known = self.inverse_depth[self.inverse_depth > 0]
        size = MOTION * np.repeat([1 / float(known.mean()) if len(known) else 1.0, 1.0], 3)
        least = max(np.linalg.eigvalsh(self.H * np.outer(size, size))[0], 0.0)
        return float(np.sqrt(least / max(self.L.shape[1], 1)))

    def normal(
        self, grey: Grey, which: Which, robust: Robust, inverse_depth: Grey | None = None
    ) -> tuple[Array, Array, float]:
        """Normal equations H = L^T W L (6, 6) and b = L^T W e (6,) of the weighted least squares of
        a picture (h, w) against the goal's.

        The third value is the root of the weighted mean of e^2 [grey levels], NaN where no pixel
        counts.

        grey: the picture. which: L of this picture, of the goal's, or the mean of both. robust:
        weights of the pixels. inverse_depth: 1/Z of the pixels in this picture (h, w), 0 where it
        is not known; None: the goal's.
        """
        near = self.inverse_depth if inverse_depth is None else inverse_depth
        e = (grey[self.at] - self.grey[self.at]).ravel()
        known = (near.ravel() > 0) & (self.inverse_depth.ravel() > 0)
        if known.all():
            e = self._unlit(e, None)
            w = weights(robust, e)
        else:  # those whose depth is not known have the weight 0
            e = self._unlit(e, known.astype(np.float32))
            w = np.zeros(len(e), np.float32)
            among = weights(robust, e[known])
            w[known] = 1 if among is None else among
        along = None if which == "desired" else gradient(grey)
        H, b = self._sums(along, which, near, e, w)
        # the Schur complement H_mm - H_ml H_ll^-1 H_lm: the motion that solves it is that of the
        # whole system with light
        if len(b) > 6:
            right = np.column_stack([H[6:, :6], b[6:]])
            of_light = np.linalg.lstsq(H[6:, 6:], right, rcond=1e-9)[0]
            b = b[:6] - H[:6, 6:] @ of_light[:, 6]
            H = H[:6, :6] - H[:6, 6:] @ of_light[:, :6]
        e = self._unlit(e, w)
        squares = e * e if w is None else w * e * e
        total = float(len(e) if w is None else w.sum(dtype=float))
        error = float(np.sqrt(squares.sum(dtype=float) / total)) if total > 0 else math.nan
        return H, b, error

    def _unlit(self, e: Grey, w: Grey | None) -> Grey:
        """Errors (n,) without what gain and offset of a light that may have changed explain of
        them, by weighted least squares.
        """
        if self.light == "same":
            return e
        weighted = self.of_light if w is None else self.of_light * w
        H = weighted @ self.of_light.T
        b = weighted @ e
        found = np.linalg.lstsq(H.astype(float), b.astype(float), rcond=1e-9)[0]
        return np.asarray(e - found.astype(np.float32) @ self.of_light, np.float32)

    def _rows(self, band: slice, columns: list[Grey], which: Which) -> Grey:
        """L of a band of pixels: of the goal's picture, or with the columns of this one."""
        if not columns:
            return self.L[:, band]
        current = rows(*(column[band] for column in columns))
        return np.float32(0.5) * (current + self.L[:, band]) if which == "mean" else current

    def _sums(
        self, along: Gradient | None, which: Which, near: Grey, e: Grey, w: Grey | None
    ) -> tuple[Array, Array]:
        """L^T W L and L^T W e, band by band; of light that may have changed with its two columns,
        (8, 8) and (8,).
        """
        n = 6 if self.light == "same" else 8
        if along is None and w is None and n == 6:
            return self.H, _summed(self.L, e[None])[:, 0]
        H = np.zeros((n, n))
        b = np.zeros(n)
        columns: list[Grey] = []
        if along is not None:
            columns = [g.ravel() for g in (*self.normalised(along), self.x, self.y, near)]
        for start in range(0, self.L.shape[1], BAND_PX):
            band = slice(start, start + BAND_PX)
            L = self._rows(band, columns, which)
            if n > 6:
                L = np.concatenate([L, self.of_light[:, band]])
            weighted = L if w is None else L * w[band]
            H += weighted @ L.T
            b += weighted @ e[band]
        return H, b


def _summed(a: Grey, b: Grey) -> Array:
    """Products a b^T of (m, n) and (k, n): in float32 band by band, their sum in float64."""
    bands = [slice(i, i + BAND_PX) for i in range(0, a.shape[1], BAND_PX)]
    return np.sum([a[:, band] @ b[:, band].T for band in bands], axis=0, dtype=float)


def motion_px(camera: Perspective, step: Array, depth: float) -> float:
    """RMS motion in the picture [px] of points at a depth [m] that a small displacement of the
    camera (6,) [m, rad] makes.
    """
    side = (np.arange(PROBES) + 0.5) / PROBES
    u, v = np.meshgrid(side * camera.width, side * camera.height)
    x, y = camera.normalise(np.stack([u.ravel(), v.ravel()], axis=-1)).astype(np.float32).T
    one = np.ones_like(x)
    zero = np.zeros_like(x)
    near = np.full_like(x, 1 / depth)
    moved = np.concatenate([step @ rows(one, zero, x, y, near), step @ rows(zero, one, x, y, near)])
    return camera.f * float(np.sqrt(2 * np.mean(moved**2)))


def _slope(camera: Perspective, xy: Array, scale: int) -> tuple[Grey | float, ...]:
    """du/dx, du/dy, dv/dx, dv/dy of the lens at xy (h, w, 2), in pixels `scale` times as large;
    numbers of a lens without distortion.
    """
    if not camera.resampled:
        return camera.f / scale, 0.0, 0.0, camera.f / scale
    # half a pixel; the distortion's second derivative cancels in central differences
    step = 0.5 / camera.f
    found = []
    for axis in np.eye(2) * step:
        ahead = camera.project(homogeneous(xy + axis))
        behind = camera.project(homogeneous(xy - axis))
        slope = (ahead - behind) / (2 * step * scale)
        found.append(np.ascontiguousarray(slope, np.float32))
    along_x, along_y = found
    return along_x[..., 0], along_y[..., 0], along_x[..., 1], along_y[..., 1]


NO_PICTURE = "the law has no picture"
BLANK = "the picture shows next to nothing of what the goal's shows"
NO_STRUCTURE = (
    "the goal's picture has too little structure"
    " (1 % of the distance, or 1 degree, change it by under 0.05 grey levels)"
)
NO_DEPTH = "the depth camera measured no pixel: all is nearer than its near_m or beyond its far_m"
LEAST_CHANGE = 0.05
"""Least RMS change of the goal's picture [grey levels] by a motion as `MOTION`, whichever changes
it least. With structure it is some 0.4; a wall with 0.01 was once taken as the goal's from 0.26 m
away.
"""
LEAST_SIDE = 12  # least height and width of the coarsest level, without its border [px]


@spec
class LevenbergMarquardt:
    """Damping of the least squares, (H + mu diag(H))^-1: from steepest descent with large mu to
    Gauss-Newton with small mu.

    Args:
        mu: at first [1].
        mu_then: from after_s on [1].
        after_s: time of the change, from the law's first picture on [s]; the printed example has 90
            pictures at 25 Hz.

    Reference: Collewet & Marchand 2011.
    """

    mu: GainOrZero = 0.01
    mu_then: GainOrZero = 0.0001
    after_s: Time = 3.6

    def at(self, since_s: float) -> float:
        """The damping at a time after the first picture [s]."""
        return self.mu if since_s < self.after_s else self.mu_then


@dataclass(frozen=True, slots=True)
class PhotometricState:
    """What the law keeps.

    Attributes:
        pyramid: the goal's picture, from the finest level to the coarsest; None before the first
            picture.
        level: number of the current level.
        t0: time of the first picture [s].
        goal: whose pyramid it is.
    """

    pyramid: tuple[GoalLevel, ...] | None = None
    level: int = 0
    t0: float = 0.0
    goal: Sight | None = None


@spec
class Photometric(Law[PhotometricState]):
    """u = -lambda (H + mu diag(H))^-1 (L_I B)^T W (I - I*), H = (L_I B)^T W L_I B, camera twist v =
    B u.

    I and I* are the luminance of the current picture and of the goal's, pixel by pixel: nothing is
    detected, matched or tracked. L_I follows from the gradient of the picture (`rows`). Grey levels
    are linear in the camera's motion over few pixels only, so that the basin of attraction is
    small; `levels` widens it. What changes the picture other than by motion (a lamp, a shadow, a
    hand before the camera) is an error to this law; `robust` leaves out what fits least.

    Args:
        gain: lambda [1/s], a number or an adaptive gain of the remaining motion.
        interaction: L of the current picture, of the goal's (the matrix of the printed example), or
            the mean of both, whose steps are of second order (Malis 2004).
        damping: mu.
        robust: W, the weights of an M-estimator with the scale of the median absolute deviation, at
            the finest level: `none`, `huber` or `tukey`.
        light: `same` as when the goal's picture was taken, or `gain_offset`: I = (1 + a) I* + b,
            with a and b fitted in each picture together with the motion at the finest level, while
            at coarser ones the picture gets the mean and the contrast of the goal's; a lamp that
            became brighter is then no error, and needs some structure more.
        depth: Z of the pixels: `goal`, the markers' plane as seen at the goal; `constant`; or
            `sensor`, a depth camera's.
        smooth_px: standard deviation of the Gaussian that smooths both pictures first [px]; 0:
            none. It widens the basin, and makes L the true one of the pictures, whose differences
            from pixel to pixel are then small.
        levels: levels of a Gaussian pyramid, from coarse to fine; 1: full pictures alone.
        margin_px: border of the picture that is left out [px].
        stride: every how many-th pixel of a row and column of a level counts [1].
        limits: largest speed and rate of the commanded twist.

    References: Collewet, Marchand & Chaumette 2008, https://inria.hal.science/inria-00261398;
    Collewet & Marchand 2011, https://inria.hal.science/inria-00629834; mean matrix: Malis 2004,
    doi:10.1109/ROBOT.2004.1308092.
    """

    kind: Literal["photometric"] = "photometric"
    gain: Gain = ConstantGain()
    interaction: Which = "desired"
    damping: LevenbergMarquardt = LevenbergMarquardt()
    robust: Robust = "none"
    light: Light = "same"
    depth: Depth = AtGoal()
    smooth_px: Annotated[Pixels, TighterBounds(le=50)] = 1.5
    levels: Annotated[int, Ge(1), Le(8)] = 1
    margin_px: Annotated[int, Ge(0), Le(1000)] = 10
    stride: Annotated[int, Ge(1), Le(64)] = 1
    limits: TwistLimits = TwistLimits()
    inputs = ("image",)

    def __post_init__(self) -> None:
        """Refuse sources of depth that know nothing of a pixel."""
        if not (self.depth.measured or isinstance(self.depth, AtGoal | Constant)):
            words = (
                "is of markers, and law photometric needs it of pixels;"
                " use goal, constant or sensor (a depth camera)"
            )
            raise ParameterError("depth", words, self.depth.kind)

    def markers_needed(self, basis: Array) -> int:
        """None: pixels do."""
        return 0

    def check(self, points: Array, goal: Goal) -> None:
        """Refuse a lens that is not perspective, and a border or levels that leave no picture."""
        camera = goal.camera
        if not isinstance(camera, Perspective):
            raise ParameterError.fixed(
                "camera", "of kind perspective", kind_of(type(camera)), where="for law photometric"
            )
        least = min(camera.width, camera.height)
        inner = (least - 2 * self.margin_px) / 2 ** (self.levels - 1) / self.stride
        if inner < LEAST_SIDE:
            given = f"margin_px {self.margin_px}, levels {self.levels} and stride {self.stride}"
            words = (
                f"leaves {max(inner, 0):.3g} px of the picture's {least} at the coarsest level with"
                f" {given}, and {LEAST_SIDE} are needed; make one of them smaller"
            )
            raise ParameterError("law", words)

    def init(self, goal: Goal) -> PhotometricState:
        return PhotometricState()

    def step(
        self, state: PhotometricState, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[PhotometricState, Command]:
        """One frame: the picture against the goal's."""
        sight = observation.image
        if sight is None:
            return state, Command.rest(basis, NO_PICTURE)
        pyramid = state.pyramid
        if pyramid is None or state.goal is not goal.image:
            pyramid = self._pyramid(goal)
            state = PhotometricState(pyramid, len(pyramid) - 1, observation.t, goal.image)
        level = pyramid[state.level]
        grey = luminance(sight.image, self.smooth_px)
        for _ in range(state.level):
            grey = coarser(grey)
        near = None
        if self._reads_depth:
            near = _inverse(sight, level, state.level)
        why = _unfit(pyramid[0], level, grey, near)
        if why:
            return state, Command.rest(basis, why)
        robust = self.robust
        if state.level > 0:
            # Far from the goal most pixels differ, and those that differ most tell where it is:
            # only near it are they outliers.
            robust = "none"
            # at the finest level the light is fitted with the motion
            if self.light == "gain_offset":
                # a picture without any structure is divided by the bound
                spread = np.float32(level.grey.std() / max(float(grey.std()), 1e-3))
                grey = np.asarray((grey - grey.mean()) * spread + level.grey.mean(), np.float32)
        H, b, error_grey = level.normal(grey, self.interaction, robust, near)
        mu = self.damping.at(observation.t - state.t0)
        step = self._solved(basis.T @ H @ basis, basis.T @ b, mu)
        if step is None:
            return state, Command.rest(basis, "no pixel of the picture fits the goal's")
        command = self.limits.command(-self.gain.at(step) * step, basis)
        state = replace(state, level=self._next_level(state, basis @ step, goal))
        return state, replace(command, error_grey=error_grey)

    @property
    def _reads_depth(self) -> bool:
        """Whether L is at the depths of this picture, not of the goal's."""
        return self.depth.measured and self.interaction != "desired"

    def _solved(self, H: Array, b: Array, mu: float) -> Array | None:
        """The remaining motion (n,) by normal equations (n, n) and (n,) [m, rad]; None where the
        pixels do not determine it.
        """
        scale = np.sqrt(np.diag(H))
        if not (scale > 0).all():
            return None
        # Scaled to a unit diagonal, to which mu is then added: the condition of metres against
        # radians is not in the matrix.
        scaled = H / np.outer(scale, scale) + mu * np.eye(len(H))
        try:
            return np.linalg.solve(scaled, b / scale) / scale
        except np.linalg.LinAlgError:
            return None

    def _next_level(self, state: PhotometricState, step: Array, goal: Goal) -> int:
        """The level for the next picture, after a step (6,) [m, rad] of the camera that would reach
        the goal.
        """
        assert state.pyramid is not None and isinstance(goal.camera, Perspective)
        near = state.pyramid[-1].inverse_depth
        moved = motion_px(goal.camera, step, 1 / float(near[near > 0].mean())) / 2**state.level
        if moved < 0.25:  # pixels of its own: linear are grey levels over about one
            return max(state.level - 1, 0)
        return min(state.level + 1, len(state.pyramid) - 1) if moved > 4 else state.level

    def _pyramid(self, goal: Goal) -> tuple[GoalLevel, ...]:
        """The goal's picture, level by level. Raises ParameterError: the goal has no picture."""
        if goal.image is None or not isinstance(goal.camera, Perspective):
            raise ParameterError.missing(
                "goal.image", "law photometric compares with it; give goal_images to the Controller"
            )
        made = []
        grey = luminance(goal.image.image, self.smooth_px)
        for number in range(self.levels):
            light = self.light if number == 0 else "same"
            level = GoalLevel.of(goal.camera, grey, number, self.margin_px, self.stride, light)
            made.append(replace(level, inverse_depth=self._inverse_depth(level, goal, number)))
            grey = coarser(grey)
        return tuple(made)

    def _inverse_depth(self, level: GoalLevel, goal: Goal, number: int) -> Grey:
        """1/Z of the pixels of a level in the goal view [1/m], 0 where it is not known."""
        depth: Any = self.depth
        if isinstance(depth, Constant):
            return np.full(level.x.shape, 1 / depth.depth_m, np.float32)
        if isinstance(depth, AtGoal):
            # 1/Z = n . (x, y, 1) / (n . p) of a plane through p
            nx, ny, nz = goal.normal / float(goal.normal @ goal.middle)
            return np.maximum(nx * level.x + ny * level.y + nz, 0).astype(np.float32)
        return _inverse(goal.image, level, number)


def _unfit(finest: GoalLevel, level: GoalLevel, grey: Grey, near: Grey | None) -> str:
    """Why the law rests before a picture (h, w) of a level, with 1/Z of its pixels where it is
    measured; "" where it does not.
    """
    if not (finest.inverse_depth.any() and (near is None or near.any())):
        return NO_DEPTH
    if finest.least_change < LEAST_CHANGE:
        return NO_STRUCTURE
    # a wall or the floor fills the picture
    return BLANK if float(grey.std()) < 0.1 * float(level.grey.std()) else ""


def _inverse(sight: Sight | None, level: GoalLevel, number: int) -> Grey:
    """1/Z of the pixels of a level by a depth picture [1/m], 0 in its holes."""
    if sight is None or sight.depth is None:
        raise ParameterError.excluded(
            "law.depth", "sensor without camera.depth_sensor", works="goal or constant"
        )
    depth = sight.depth[:: 2**number, :: 2**number][level.at]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(depth > 0, 1 / depth, 0).astype(np.float32)
