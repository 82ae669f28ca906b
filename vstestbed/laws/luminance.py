"""Luminance as a feature: the grey levels of all pixels, their interaction matrix, and the normal equations that it gives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array
from vstestbed.laws.illumination import Light, eliminated, light_rows, without_light
from vstestbed.laws.robust import Robust, weights

Grey = NDArray[np.float32]
"""Luminance (h, w) [grey levels, 0 to 255]."""
Which = Literal["current", "desired", "mean"]
BAND_PX = 16384
"""Pixels whose rows of L are held at a time: six float32 columns of them fit into a core's cache."""
DIFFERENCE, ONE = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12, np.array([1.0])
"""Kernels of a central difference of fourth order, and of none."""
PROBES = 5
"""Points along each side of the picture by whose mean motion a step of the camera is measured in pixels."""
MOTION = np.array([0.01, 0.01, 0.01, *np.radians([1.0, 1.0, 1.0])])
"""Size of the motions by which a picture's structure is measured, along and about each axis: 10 mm and 1 degree [m, rad]."""
SLOPE_PX = 0.5
"""Step of the finite differences of the lens [px]; the distortion's second derivative cancels in central ones."""


def luminance(image: NDArray[np.uint8], smooth_px: float = 0.0) -> Grey:
    """The luminance Y = 0.299 R + 0.587 G + 0.114 B (ITU-R BT.601) of a picture (H, W, 3) RGB, shape (H, W).

    smooth_px: standard deviation of a Gaussian that smooths it [px].
    """
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.float32)
    return np.asarray(cv2.GaussianBlur(grey, (0, 0), smooth_px), np.float32) if smooth_px > 0 else grey


def coarser(grey: Grey) -> Grey:
    """Smoothed by a Gaussian and halved: pixel i of the result lies on pixel 2 i of `grey`."""
    return np.asarray(cv2.pyrDown(grey), np.float32)


def gradient(grey: Grey) -> tuple[Grey, Grey]:
    """(dI/du, dI/dv) [grey levels/px], by central differences of fourth order.

    Of a rendered picture Sobel's, which smooth across, are 20 to 25 % too small, and plain ones 15 %; these are within 5 %.
    """
    along, across = np.asarray(cv2.sepFilter2D(grey, cv2.CV_32F, DIFFERENCE, ONE)), cv2.sepFilter2D(grey, cv2.CV_32F, ONE, DIFFERENCE)
    return np.asarray(along, np.float32), np.asarray(across, np.float32)


class Normal(NamedTuple):
    """Normal equations of the weighted least squares over the pixels.

    Attributes:
        H: L^T W L (6, 6). b: L^T W e (6,). error_grey: root of the weighted mean of e^2 [grey levels]; NaN where no pixel counts.
        share: mean weight of the pixels, 1 where none is an outlier.
    """

    H: Array
    b: Array
    error_grey: float
    share: float


@dataclass(frozen=True)
class LevelPixels:
    """The pixels of one level of the pyramid that enter the error: all but a border, every `stride`-th in both directions.

    Attributes:
        at: slices (rows, columns) of the level's picture.
        x, y: their normalised coordinates (h, w).
        slope: du/dx, du/dy, dv/dx, dv/dy of the lens, in pixels of the level, numbers or (h, w).
    """

    at: tuple[slice, slice]
    x: Grey
    y: Grey
    slope: tuple[Grey | float, ...]

    @classmethod
    def of(cls, camera: Perspective, level: int, margin_px: int, stride: int) -> LevelPixels:
        """The pixels of a camera's picture, halved `level` times; margin_px: border left out [px of the full picture]."""
        scale = 2**level
        edge = max(len(DIFFERENCE) // 2, -(-margin_px // scale))
        h, w = (-(-n // scale) for n in (camera.height, camera.width))
        at = slice(edge, h - edge, stride), slice(edge, w - edge, stride)
        v, u = np.meshgrid(np.arange(h)[at[0]] * scale, np.arange(w)[at[1]] * scale, indexing="ij")
        uv = np.stack([u, v], axis=-1).astype(float)
        xy = camera.normalise(uv)
        x, y = (np.ascontiguousarray(xy[..., i], np.float32) for i in (0, 1))
        return cls(at, x, y, _slope(camera, xy, scale))

    def normalised(self, along: tuple[Grey, Grey]) -> tuple[Grey, Grey]:
        """The gradient of these pixels in normalised coordinates, of one in pixels of the level, (h, w) each."""
        gu, gv = along[0][self.at], along[1][self.at]
        ux, uy, vx, vy = self.slope
        if isinstance(ux, float):
            return gu * np.float32(ux), gv * np.float32(vy)
        return np.asarray(gu * ux + gv * vx, np.float32), np.asarray(gu * uy + gv * vy, np.float32)

    def interaction(self, along: tuple[Grey, Grey], inverse_depth: Grey) -> Grey:
        """Rows of L transposed, (6, pixels), as `rows` has them, of the gradient (dI/du, dI/dv) of the level's picture."""
        gx, gy = self.normalised(along)
        return rows(gx.ravel(), gy.ravel(), self.x.ravel(), self.y.ravel(), inverse_depth.ravel())


def rows(gx: Grey, gy: Grey, x: Grey, y: Grey, inverse_depth: Grey) -> Grey:
    """L_I = -(dI/dx L_x + dI/dy L_y) of pixels, transposed: (6, n), with the rows L_x and L_y of image points.

    A point of the scene keeps its luminance, so that at a fixed pixel dI/dt = -(dI/dx x_dot + dI/dy y_dot).

    Args:
        gx, gy: gradient in normalised coordinates (n,). x, y: normalised coordinates. inverse_depth: 1/Z [1/m].

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
    """One level of the goal's pyramid.

    Attributes:
        pixels: those that enter the error. grey: the goal's picture at this level (h, w).
        inverse_depth: 1/Z of the pixels in the goal view (h, w) [1/m]; 0 where the depth is not known.
        light: whether gain and offset of the grey levels are fitted with the motion.
    """

    pixels: LevelPixels
    grey: Grey
    inverse_depth: Grey
    light: Light = "same"

    @cached_property
    def gradient(self) -> tuple[Grey, Grey]:
        """Of the goal's picture."""
        return gradient(self.grey)

    @cached_property
    def L(self) -> Grey:
        """The interaction matrix at the goal, transposed, (6, n)."""
        return np.where(self.inverse_depth.ravel() > 0, self.pixels.interaction(self.gradient, self.inverse_depth), np.float32(0))

    @cached_property
    def H(self) -> Array:
        """L^T L at the goal, all pixels with weight 1."""
        return _summed(self.L, self.L)

    @cached_property
    def of_light(self) -> Grey:
        """Derivatives of the pixels by gain and offset of the light, (2, n)."""
        return light_rows(self.grey[self.pixels.at].ravel())

    @cached_property
    def least_change(self) -> float:
        """RMS change of the picture [grey levels] by that motion of the size S of `MOTION` which changes it least.

        The root of the least eigenvalue of S H S / n.
        """
        return float(np.sqrt(max(np.linalg.eigvalsh(self.H * np.outer(MOTION, MOTION))[0], 0.0) / max(self.L.shape[1], 1)))

    def normal(self, grey: Grey, which: Which, robust: Robust, inverse_depth: Grey | None = None) -> Normal:
        """The normal equations of a picture (h, w) of this level against the goal's.

        Args:
            grey: the picture. which: L of this picture, of the goal's, or the mean of both. robust: weights of the pixels.
            inverse_depth: 1/Z of the pixels in this picture (h, w), 0 where it is not known; None: the goal's.
        """
        near = self.inverse_depth if inverse_depth is None else inverse_depth
        e = (grey[self.pixels.at] - self.grey[self.pixels.at]).ravel()
        known = (near.ravel() > 0) & (self.inverse_depth.ravel() > 0)
        e = self._unlit(e, None if known.all() else known.astype(np.float32))
        w = _weights(robust, e, known)
        H, b = self._sums(None if which == "desired" else gradient(grey), which, near, e, w)
        if len(b) > 6:
            H, b = eliminated(H, b)
        e = self._unlit(e, w)
        squares = e * e if w is None else w * e * e
        n, total = len(e), float(len(e) if w is None else w.sum(dtype=float))
        error = float(np.sqrt(squares.sum(dtype=float) / total)) if total > 0 else float("nan")
        return Normal(H, b, error, total / max(n, 1))

    def _unlit(self, e: Grey, w: Grey | None) -> Grey:
        """Errors (n,) without what a light that may have changed explains of them."""
        return e if self.light == "same" else without_light(e, self.of_light, w)

    def _sums(self, along: tuple[Grey, Grey] | None, which: Which, near: Grey, e: Grey, w: Grey | None) -> tuple[Array, Array]:
        """L^T W L and L^T W e, band by band; of light that may have changed with its two columns, (8, 8) and (8,)."""
        n = 6 if self.light == "same" else 8
        if along is None and w is None and n == 6:
            return self.H, _summed(self.L, e[None])[:, 0]
        H, b = np.zeros((n, n)), np.zeros(n)
        for band, L in self._banded(along, which, near):
            L = L if n == 6 else np.concatenate([L, self.of_light[:, band]])
            weighted = L if w is None else L * w[band]
            H += weighted @ L.T
            b += weighted @ e[band]
        return H, b

    def _banded(self, along: tuple[Grey, Grey] | None, which: Which, near: Grey) -> Iterator[tuple[slice, Grey]]:
        """Bands of pixels with their rows of L transposed, (6, band), of a picture's gradient; of the goal's for None."""
        columns = None if along is None else [g.ravel() for g in (*self.pixels.normalised(along), self.pixels.x, self.pixels.y, near)]
        for start in range(0, self.L.shape[1], BAND_PX):
            band = slice(start, start + BAND_PX)
            L = self.L[:, band] if columns is None else rows(*(column[band] for column in columns))
            yield band, np.float32(0.5) * (L + self.L[:, band]) if columns is not None and which == "mean" else L


def _weights(robust: Robust, e: Grey, known: NDArray[np.bool_]) -> Grey | None:
    """Weights (n,) of the errors, 0 where the depth is not known; None where all are 1."""
    if known.all():
        return weights(robust, e)
    among, spread = weights(robust, e[known]), np.zeros(len(e), np.float32)
    spread[known] = 1 if among is None else among
    return spread


def _summed(a: Grey, b: Grey) -> Array:
    """Products a b^T of (m, n) and (k, n): in float32 band by band, their sum in float64."""
    return np.sum([a[:, i : i + BAND_PX] @ b[:, i : i + BAND_PX].T for i in range(0, a.shape[1], BAND_PX)], axis=0, dtype=float)


def motion_px(camera: Perspective, step: Array, depth: float) -> float:
    """RMS motion in the picture [px] of points at a depth [m] that a small displacement of the camera (6,) [m, rad] makes."""
    side = (np.arange(PROBES) + 0.5) / PROBES
    u, v = np.meshgrid(side * camera.width, side * camera.height)
    x, y = camera.normalise(np.stack([u.ravel(), v.ravel()], axis=-1)).astype(np.float32).T
    one, zero, near = np.ones_like(x), np.zeros_like(x), np.full_like(x, 1 / depth)
    moved = np.concatenate([step @ rows(one, zero, x, y, near), step @ rows(zero, one, x, y, near)])
    return camera.f * float(np.sqrt(2 * np.mean(moved**2)))


def _slope(camera: Perspective, xy: Array, scale: int) -> tuple[Grey | float, ...]:
    """du/dx, du/dy, dv/dx, dv/dy of the lens at xy (h, w, 2), in pixels `scale` times as large; numbers of a lens without distortion."""
    if camera.distortion is None:
        return camera.f / scale, 0.0, 0.0, camera.f / scale
    step = SLOPE_PX / camera.f
    found = []
    for axis in np.eye(2) * step:
        ahead, behind = (camera.project(np.concatenate([xy + s * axis, np.ones((*xy.shape[:2], 1))], axis=-1)) for s in (1, -1))
        found.append((ahead - behind) / (2 * step * scale))
    along_x, along_y = (np.ascontiguousarray(d, np.float32) for d in found)
    return along_x[..., 0], along_y[..., 0], along_x[..., 1], along_y[..., 1]
