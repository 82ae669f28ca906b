"""Depth cameras: what an RGB-D camera measures of the true depth of each pixel, with noise, steps,
holes and limits of range.

The depth picture has the pixels of the colour picture, as the maker's driver aligns it (see
`lens`), and holds Z along the optical axis.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from vstestbed.core.geometry import Array, DepthImage
from vstestbed.core.quantity import (
    Distance,
    GainOrZero,
    Pixels,
    PositiveLength,
    TighterBounds,
    check_ordered,
)
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec

EDGE = 0.03
"""Depths of neighbouring pixels that differ by more than this share belong to two surfaces: one
surface is seen at over 85 degrees then.
"""
# what is nearer casts a shadow as from here [m]: the width of a shadow has no bound otherwise
NEAREST_M = 0.05
# Largest angle for which a noise is computed: the formulas grow without bound towards 90 degrees
# [rad]
STEEPEST = math.radians(89.9)


@spec
class DepthLens:
    """The pinhole lens of a depth camera whose pictures are not aligned with the colour camera's;
    both look from the same place.

    Args:
        width, height: of its picture, at least the colour picture's [px].
        fovx_deg: its horizontal field of view [deg].
    """

    width: Annotated[int, Ge(8), Le(8192)] = 1280
    height: Annotated[int, Ge(8), Le(8192)] = 720
    fovx_deg: Annotated[float, Gt(1), Le(150)] = 85.0

    @property
    def f(self) -> float:
        """Focal length [px]."""
        return self.width / 2 / math.tan(math.radians(self.fovx_deg) / 2)

    @property
    def centre(self) -> Array:
        """Principal point (2,) [px]."""
        return np.array([self.width - 1.0, self.height - 1.0]) / 2


Grazing = Annotated[float, Gt(0), Le(90)]
Blur = Annotated[Pixels, TighterBounds(le=10)]
Window = Annotated[int, Ge(1), Le(32)]
Baseline = Annotated[Distance, TighterBounds(le=2)]
Quantum = Annotated[Pixels, TighterBounds(le=4)]


@spec
class DepthSensor(ABC):
    """What all depth cameras have in common. From the true depth Z of each pixel, inf where there
    is nothing, comes the measured one:

    1. At an edge between two surfaces a pixel shows the depth of one `lateral_px` away (standard
       deviation), so that edges are ragged.
    2. Z + sigma(Z, theta) n, theta the angle between the ray and the surface's normal, and n
       Gaussian noise of variance 1, the mean of `correlation_px` x `correlation_px` independent
       numbers times that side.
    3. The disparity d = f baseline_m / Z, f the camera's focal length [px], is rounded to a
       multiple of `quantum_px`.
    4. There are holes beyond `near_m` and `far_m`, where theta is over `grazing_deg`, and in the
       shadow of what is nearer: the second view (the projector's, or the second camera's) stands at
       `baseline_m` along the camera's x axis. Beside the left border of a surface at Z1 before one
       at Z2 the hole is f baseline_m (1 / Z1 - 1 / Z2) px wide.

    Args:
        near_m, far_m: limits of the range [m].
        grazing_deg: largest angle between a ray and the normal of a surface that is measured [deg].
        lateral_px: standard deviation of the place of an edge [px].
        correlation_px: side of the square over which the noise is correlated [px]: the window that
            is matched.
        baseline_m: distance of the second view [m]; 0 for no shadows.
        quantum_px: step of the disparity [px]; 0 for no steps, and without a baseline.
        lens: of a depth picture that nobody has aligned with the colour picture: its pixel (u, v)
            is taken for that of the colour picture, though it looks elsewhere; None for an aligned
            one.
    """

    kind: Any
    near_m: Distance = 0.0
    far_m: PositiveLength = 100.0
    grazing_deg: Grazing = 90.0
    lateral_px: Blur = 0.0
    correlation_px: Window = 1
    baseline_m: Baseline = 0.0
    quantum_px: Quantum = 0.0
    lens: DepthLens | None = None
    two_pictures: ClassVar[bool] = False
    """Both views are pictures of one size: what the second one does not hold is not measured (a
    band at the left border).
    """
    # Pixels at an edge see both surfaces, and measure a depth between
    flies: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_ordered(self, "near_m", "far_m", equal=False)

    @abstractmethod
    def sigma(self, z: DepthImage, theta: DepthImage, f: float) -> DepthImage | None:
        """Standard deviation of the noise (H, W) [m] at depths z (H, W) [m] and angles theta (H, W)
        [rad]; None for no noise.

        f: focal length [px].
        """

    @property
    def draws(self) -> bool:
        """Whether a seed makes a difference."""
        one = np.ones((1, 1), np.float32)
        return self.flies or self.lateral_px > 0 or self.sigma(one, 0 * one, 500.0) is not None

    def measured(
        self, z: DepthImage, xy: Array, f: float, rng: np.random.Generator | None
    ) -> DepthImage:
        """The depth picture (H, W) [m], NaN in holes.

        z: true depths (H, W) [m], inf where there is nothing. xy: normalised coordinates of the
            pixels, (H, W, 2).
        f: focal length [px]. rng: of this picture; None for its holes and steps without noise.
        """
        with np.errstate(invalid="ignore", divide="ignore"):
            theta = incidence(z, xy, f)
            hole = self._unseen(z, f) | (theta > math.radians(self.grazing_deg))
            if rng is not None:
                z = self._ragged(z, rng)
            z = np.asarray(z, np.float32)
            # of the true depth, too: noise must not bring what is far beyond the range back into it
            hole |= self._out_of_range(z)
            if rng is not None:
                if self.flies:
                    z = _flying(z, rng)
                sigma = self.sigma(z, np.minimum(theta, STEEPEST), f)
                if sigma is not None:
                    noise = sigma * correlated(z.shape, self.correlation_px, rng)
                    z = np.asarray(z + noise, np.float32)
            if self.quantum_px and self.baseline_m:
                unit = np.float32(f * self.baseline_m / self.quantum_px)
                z = np.asarray(unit / np.round(unit / z), np.float32)
            hole |= self._out_of_range(z)
        return np.where(hole, np.float32(np.nan), z)

    def _out_of_range(self, z: DepthImage) -> NDArray[np.bool_]:
        return ~((z >= self.near_m) & (z <= self.far_m))

    def _unseen(self, z: DepthImage, f: float) -> NDArray[np.bool_]:
        """Pixels (H, W) that the second view does not see."""
        if not self.baseline_m:
            return np.zeros(z.shape, bool)
        disparity = np.asarray(f * self.baseline_m / np.maximum(z, NEAREST_M), np.float32)
        behind = shadowed(disparity)
        return behind | (np.arange(z.shape[1]) < disparity) if self.two_pictures else behind

    def _ragged(self, z: DepthImage, rng: np.random.Generator) -> DepthImage:
        if not self.lateral_px:
            return z
        away = self.lateral_px * rng.standard_normal((2, *z.shape), dtype=np.float32)
        v, u = np.indices(z.shape) + np.rint(away).astype(np.int32)
        height, width = z.shape
        beside = z[v.clip(0, height - 1), u.clip(0, width - 1)]
        return np.where(_apart(z, beside), beside, z)


@spec
class Ideal(DepthSensor):
    """Without imperfections. Each of them can be switched on by itself.

    Args:
        sigma_m: standard deviation of the noise, the same at each depth [m].
    """

    kind: Literal["ideal"] = "ideal"
    sigma_m: Distance = 0.0

    def sigma(self, z: DepthImage, theta: DepthImage, f: float) -> DepthImage | None:
        return np.full_like(z, self.sigma_m) if self.sigma_m else None


@spec
class Stereo(DepthSensor):
    """Two infrared cameras (Intel RealSense D435): sigma = Z^2 subpixel_px / (f baseline_m).

    References: Keselman, Woodfill, Grunnet-Jepsen & Bhowmik 2017, doi:10.1109/CVPRW.2017.167
    (disparities in steps of 1/32 px); the maker's paper on the tuning of its D400 series for the
    formula, and a subpixel error under 0.1 px on a textured surface.

    Args:
        subpixel_px: standard deviation of the disparity [px].
    """

    kind: Literal["stereo"] = "stereo"
    near_m: Distance = 0.2
    far_m: PositiveLength = 10.0
    grazing_deg: Grazing = 80.0
    lateral_px: Blur = 1.0
    correlation_px: Window = 5
    baseline_m: Annotated[PositiveLength, TighterBounds(le=2)] = 0.05
    quantum_px: Quantum = 0.03125
    subpixel_px: Blur = 0.08
    two_pictures: ClassVar[bool] = True

    def sigma(self, z: DepthImage, theta: DepthImage, f: float) -> DepthImage | None:
        """Z^2 subpixel_px / (f baseline_m), whatever the angle."""
        if not self.subpixel_px:
            return None
        return np.asarray(z * z * (self.subpixel_px / (f * self.baseline_m)), np.float32)


@spec
class StructuredLight(DepthSensor):
    """A camera and a projector of a pattern (the first Kinect).

    With Z and sigma in metres and theta in radians

    sigma = 0.0012 + 0.0019 (Z - 0.4)^2 + 0.0001 theta^2 / (sqrt(Z) (pi/2 - theta)^2),

    an edge's place has a standard deviation of 0.8 px, and disparities have steps of 1/8 px (its
    own focal length is 580 px).

    References: Nguyen, Izadi & Lovell 2012, doi:10.1109/3DIMPVT.2012.84 (sigma and the edges);
    Khoshelham & Elberink 2012, doi:10.3390/s120201437 (steps, baseline).

    Args:
        noise_scale: factor on sigma [1].
    """

    kind: Literal["structured_light"] = "structured_light"
    near_m: Distance = 0.4
    far_m: PositiveLength = 5.0
    grazing_deg: Grazing = 80.0
    lateral_px: Blur = 0.8
    correlation_px: Window = 3
    baseline_m: Baseline = 0.075
    quantum_px: Quantum = 0.125
    noise_scale: GainOrZero = 1.0

    def sigma(self, z: DepthImage, theta: DepthImage, f: float) -> DepthImage | None:
        steep = theta / (np.float32(math.pi / 2) - theta)
        sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2 + 0.0001 / np.sqrt(z) * steep * steep
        return np.asarray(self.noise_scale * sigma, np.float32) if self.noise_scale else None


@spec
class TimeOfFlight(DepthSensor):
    """The phase of modulated light (the second Kinect), from one point of view.

    With Z in metres, theta in radians and sigma in millimetres

    sigma = 1.5 - 0.5 Z + 0.3 Z^2 + 0.1 Z^(3/2) theta^2 / (pi/2 - theta)^2.

    A pixel at an edge receives light of both surfaces: its depth lies anywhere between (flying
    pixels). Light that arrives over several reflections, and the harmonic error of the phase, are
    left out.

    Reference: Fankhauser, Bloesch, Rodriguez, Kaestner, Hutter & Siegwart 2015,
    doi:10.1109/ICAR.2015.7251485 (sigma).

    Args:
        noise_scale: factor on sigma [1].
    """

    kind: Literal["time_of_flight"] = "time_of_flight"
    near_m: Distance = 0.5
    far_m: PositiveLength = 4.5
    grazing_deg: Grazing = 80.0
    noise_scale: GainOrZero = 1.0
    flies: ClassVar[bool] = True

    def sigma(self, z: DepthImage, theta: DepthImage, f: float) -> DepthImage | None:
        steep = theta / (np.float32(math.pi / 2) - theta)
        sigma = 1.5 - 0.5 * z + 0.3 * z * z + 0.1 * z * np.sqrt(z) * steep * steep
        return np.asarray(1e-3 * self.noise_scale * sigma, np.float32) if self.noise_scale else None


DEPTH_SENSORS = Registry("depth_sensor", Ideal, Stereo, StructuredLight, TimeOfFlight)


def incidence(z: DepthImage, xy: Array, f: float) -> DepthImage:
    """Angle (H, W) [rad] between each pixel's ray and the normal of the surface that it meets.

    On a plane 1 / Z is linear in x and y: with its gradient (a, b) the normal is along (a, b, 1 /
    Z - a x - b y), whose product with the ray (x, y, 1) is 1 / Z. Of the differences to both
    neighbours the smaller counts: the other one may be of another surface.

    z: depths (H, W) [m], inf where there is nothing. xy: normalised coordinates (H, W, 2). f: focal
    length [px].
    """
    w, x, y = (np.asarray(part, np.float32) for part in (1 / z, xy[..., 0], xy[..., 1]))
    a, b = (np.float32(f) * _slope(w, axis) for axis in (1, 0))
    c = w - a * x - b * y
    return np.arccos(np.minimum(w / np.sqrt((a * a + b * b + c * c) * (1 + x * x + y * y)), 1.0))


def _slope(w: DepthImage, axis: int) -> DepthImage:
    """The difference (H, W) to the next or from the last pixel along an axis, whichever is smaller
    in size.
    """
    step = np.diff(w, axis=axis)
    before, after = (
        np.insert(step, at, np.take(step, at, axis), axis) for at in (0, step.shape[axis] - 1)
    )
    return np.where(np.abs(after) < np.abs(before), after, before)


def shadowed(disparity: DepthImage) -> NDArray[np.bool_]:
    """Which pixels (H, W) a second view on the right does not see: a nearer surface covers the
    column u - d in which they lie there.
    """
    height, width = disparity.shape
    at = np.arange(width, dtype=np.float32) - disparity
    low = np.floor(at).astype(np.int32)
    first = int(low.min())
    last = int(low.max()) + 2
    nearest = np.zeros((2, height, last - first), np.float32)
    rows = np.arange(height)[:, None]
    # Of the pixels in one column of the second view the rightmost is the nearest, and it is written
    # last.
    nearest[0, rows, low - first] = disparity
    nearest[1, rows, low + 1 - first] = disparity
    covers = nearest.max(axis=0)[rows, np.rint(at).astype(np.int32) - first]
    return covers - disparity > 1


def correlated(shape: tuple[int, ...], side: int, rng: np.random.Generator) -> DepthImage:
    """Gaussian noise (H, W) of variance 1: sums over squares of `side` px, divided by it, of
    independent numbers.
    """
    grown = shape[0] + side - 1, shape[1] + side - 1
    noise = rng.standard_normal(grown, dtype=np.float32)
    noise = np.add.reduce([noise[k : k + shape[0]] for k in range(side)])
    noise = np.add.reduce([noise[:, k : k + shape[1]] for k in range(side)])
    return noise / np.float32(side)


def _apart(z: DepthImage, other: DepthImage) -> NDArray[np.bool_]:
    return np.maximum(z, other) > (1 + EDGE) * np.minimum(z, other)


def _flying(z: DepthImage, rng: np.random.Generator) -> DepthImage:
    """The depths with pixels beside another surface anywhere between both; inf where one of both is
    nothing.
    """
    around = np.lib.stride_tricks.sliding_window_view(np.pad(z, 1, mode="edge"), (3, 3))
    near = around.min(axis=(2, 3))
    far = around.max(axis=(2, 3))
    share = rng.random(z.shape, dtype=np.float32)
    return np.where(_apart(near, far), near + share * (far - near), z)
