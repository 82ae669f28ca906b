"""The perspective camera, with OpenCV's radial-tangential distortion."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Len
from numpy.typing import NDArray

from vstestbed.camera.base import LARGEST_PX, Camera, LensNumbers
from vstestbed.camera.intrinsics import Intrinsics
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, lengths
from vstestbed.core.quantity import Coefficient, PositiveAngle, PositiveLength, TighterBounds
from vstestbed.core.spec import spec

# 8 mm lens on a 10.24 mm sensor, the textbook's default camera (Corke 2017, section 11.1.2) at 4:3
DEFAULT_FOVY_DEG = 64.0
X_AXIS = np.array([1.0, 0.0, 0.0])
Y_AXIS = np.array([0.0, 1.0, 0.0])


def first_root(coefficients: list[float]) -> float:
    """The first positive root of a polynomial, its highest power first;
    infinite where it has none.
    """
    roots = np.roots(np.trim_zeros(coefficients, "f"))
    real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)]
    return float(real.min()) if len(real) else math.inf


@spec
class Perspective(Camera):
    """Pinhole with square pixels: u = f x_d + cx, v = f y_d + cy; those of `intrinsics` may be
    rectangles, with fx and fy.

    (x_d, y_d) is (X/Z, Y/Z) after the distortion k = (k1, k2, p1, p2, k3), r^2 = x^2 + y^2:
    x_d = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2), y_d alike with p1 and p2
    exchanged. The rational model of `intrinsics` divides the bracket by 1 + k4 r^2 + k5 r^4 + k6
    r^6.

    Args:
        fovy_deg: full vertical field of view [deg], f = (H/2) / tan(fovy/2); default 64.
        focal_length_m, pixel_size_m: instead of fovy_deg, lens and pixel pitch [m], f =
            focal_length / pixel_size.
        distortion: (k1, k2, p1, p2, k3), applied to the rendered picture [1]; e.g.
            `[-0.2, 0.05, 0, 0, 0]`.
        intrinsics: those of a calibrated lens, in place of all these and of `principal_px`; a
            block, or the name of a file of ROS or OpenCV (`Intrinsics`); e.g. `camera_info.yaml`.

    Reference: Brown 1971; OpenCV's calibration module for the order of the coefficients.
    """

    kind: Literal["perspective"] = "perspective"
    fovy_deg: Annotated[PositiveAngle, TighterBounds(lt=175)] | None = None
    focal_length_m: PositiveLength | None = None
    pixel_size_m: PositiveLength | None = None
    distortion: Annotated[tuple[Coefficient, ...], Len(5, 5)] | None = None
    intrinsics: LensNumbers | None = None
    sees_all: ClassVar[bool] = True
    with_depth: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.intrinsics is not None:
            self._check_intrinsics(self.intrinsics)
        if (self.focal_length_m is None) != (self.pixel_size_m is None):
            missing = "pixel_size_m" if self.pixel_size_m is None else "focal_length_m"
            why = "a lens is given by focal_length_m and pixel_size_m together"
            raise ParameterError.missing(missing, why)
        if self.focal_length_m is None:
            if self.fovy_deg is None and self.intrinsics is None:
                # so that the scenario as run states it
                object.__setattr__(self, "fovy_deg", DEFAULT_FOVY_DEG)
        elif self.fovy_deg is not None:
            raise ParameterError.conflict("fovy_deg", "focal_length_m")
        if self.resampled:
            self._check_distortion()

    def _check_intrinsics(self, intrinsics: Intrinsics) -> None:
        for name in ("fovy_deg", "focal_length_m", "distortion", "principal_px"):
            if getattr(self, name) is not None:
                raise ParameterError.conflict(name, "intrinsics, which say it")
        intrinsics.check("perspective", self.width, self.height, "intrinsics")

    def _check_distortion(self) -> None:
        """Refuse a lens that folds its picture, and one for which too large a picture is needed."""
        u = self.width - 0.5
        v = self.height - 0.5
        half = np.array([[-0.5, v / 2], [u, v / 2], [u / 2, -0.5], [u / 2, v]])
        border = np.concatenate([half, [[-0.5, -0.5], [u, -0.5], [u, v], [-0.5, v]]])
        xy = self.normalise(border)
        back = self._distort(xy) * self.focal + self.centre
        field = "distortion" if self.intrinsics is None else "intrinsics.distortion"
        if not np.allclose(back, border, atol=1e-3) or not (lengths(xy) ** 2 < self.reach2).all():
            words = "folds the picture over itself before its corners; use smaller coefficients"
            raise ParameterError(field, words, self.lens_coefficients)
        # The pinhole picture from which the distorted one is resampled covers the undistorted
        # border.
        side = float(np.ptp(xy, axis=0).max()) * self.f
        most = 2 * LARGEST_PX
        if side > most:
            words = f"a rendered picture of {side:.4g} px, and {most} are the most"
            works = "smaller coefficients or a smaller picture"
            raise ParameterError.needs(field, words, self.lens_coefficients, works=works)

    @cached_property
    def resampled(self) -> bool:
        """Only with distortion, or pixels that are no squares: a pinhole image is rendered
        directly.
        """
        return bool(self.lens_coefficients) or not isinstance(self.focal, float)

    @cached_property
    def lens_coefficients(self) -> tuple[float, ...]:
        """Coefficients of the distortion in OpenCV's order, 5 or, of the rational model, 8; ()
        without distortion.
        """
        if self.intrinsics is None:
            return self.distortion or ()
        k = self.intrinsics.distortion
        return (*k, 0.0) if len(k) == 4 else k

    @cached_property
    def f(self) -> float:
        """Focal length [px]; of pixels that are no squares the one down the picture, fy."""
        if self.intrinsics is not None:
            return self.intrinsics.focal_px[1]
        if self.focal_length_m is not None and self.pixel_size_m is not None:
            return self.focal_length_m / self.pixel_size_m
        return self.height / 2 / math.tan(math.radians(self.fovy_deg or DEFAULT_FOVY_DEG) / 2)

    def miscalibrated(
        self, focal_error: float, principal_px: tuple[float, float], ignores_distortion: bool
    ) -> Perspective:
        if self.intrinsics is not None:
            intrinsics = self.intrinsics.scaled(focal_error, principal_px, ignores_distortion)
            return replace(self, intrinsics=intrinsics)
        f = self.f * (1 + focal_error)
        pixel = self.pixel_size_m
        given: dict[str, float | None] = {
            "fovy_deg": math.degrees(2 * math.atan(self.height / 2 / f))
        }
        if pixel is not None:
            given = {"fovy_deg": None, "focal_length_m": f * pixel}
        elif not focal_error:
            given = {}
        return replace(
            self,
            **given,
            principal_px=principal_px,
            distortion=None if ignores_distortion else self.distortion,
        )

    def with_intrinsics(self, intrinsics: Intrinsics) -> Perspective:
        given: dict[str, Any] = dict.fromkeys(
            ("fovy_deg", "focal_length_m", "pixel_size_m", "distortion", "principal_px")
        )
        return replace(self, **given, intrinsics=intrinsics)

    @cached_property
    def K(self) -> Array:
        """Intrinsic matrix (3, 3) in pixels."""
        fx, fy = np.broadcast_to(self.focal, 2)
        return np.array([[fx, 0, self.centre[0]], [0, fy, self.centre[1]], [0, 0, 1.0]])

    @cached_property
    def reach2(self) -> float:
        """Largest x^2 + y^2 up to which the distorted radius rises: the first positive root of 1 +
        3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6. Of the rational model, r N/D, that of N D + 2 r^2 (N' D - N
        D') with derivatives by r^2, unless D has one before.
        """
        k1, k2, _, _, k3, *below = self.lens_coefficients or (0.0,) * 5
        if not any(below):
            return first_root([7 * k3, 5 * k2, 3 * k1, 1.0])
        N = np.poly1d([k3, k2, k1, 1.0])
        D = np.poly1d([*below[::-1], 1.0])
        rises = N * D + np.poly1d([2.0, 0.0]) * (N.deriv() * D - N * D.deriv())
        return min(first_root(rises.coeffs.tolist()), first_root(D.coeffs.tolist()))

    def project(self, p_camera: Array) -> Array:
        """Pixels uv (..., N, 2) of points (..., N, 3); NaN at or behind the lens (Z <= 0), and
        beyond the distortion's reach.
        """
        z = p_camera[..., 2:]
        # Short cut for the usual case, all points in front of a pinhole: no NaN to be placed.
        if not self.resampled and np.logical_and.reduce(z > 0, axis=None):
            return p_camera[..., :2] / z * self.f + self.centre
        with np.errstate(divide="ignore", invalid="ignore"):
            xy = np.where(z > 0, p_camera[..., :2] / z, np.nan)
            if self.lens_coefficients:
                inside = (xy * xy).sum(axis=-1, keepdims=True) < self.reach2
                xy = self._distort(np.where(inside, xy, np.nan))
        return xy * self.focal + self.centre

    def across(self, p_camera: Array) -> tuple[Array, Array]:
        """The camera's x and y (3,), whatever the point: in a plane picture a marker extends along
        the plane.
        """
        return X_AXIS, Y_AXIS

    def whole(self, p_camera: Array, radius: float, margin: float = 0.0) -> NDArray[np.bool_]:
        """As `Camera.whole`, for points (..., N, 3); without distortion a radius is f radius/Z
        pixels on all sides.
        """
        if self.resampled:
            return super().whole(p_camera, radius, margin)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = np.where(p_camera[..., 2] > 0, self.f / p_camera[..., 2], np.nan)
            half = radius * scale + margin
            clear = True
            for i, size in enumerate((self.width, self.height)):
                at = p_camera[..., i] * scale + self.centre[i]
                clear &= (at + 0.5 >= half) & (size - 0.5 - at >= half)
            return np.asarray(clear)

    def normalise(self, uv: Array) -> Array:
        """Normalised, undistorted coordinates xy (..., N, 2) of pixels uv (..., N, 2)."""
        xy_d = (uv - self.centre) / self.focal
        return self._undistort(xy_d) if self.lens_coefficients else xy_d

    def ray(self, uv: Array) -> Array:
        """Unit rays (..., N, 3) of pixels uv (..., N, 2)."""
        p = np.empty((*uv.shape[:-1], 3))
        p[..., :2] = self.normalise(uv)
        p[..., 2] = 1.0
        p /= lengths(p)
        return p

    def _distort(self, xy: Array) -> Array:
        _, _, p1, p2, *_ = self.lens_coefficients or (0.0,) * 5
        x = xy[..., 0]
        y = xy[..., 1]
        r2 = x * x + y * y
        radial, _ = self._radial(r2)
        x_d = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        y_d = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        return np.stack([x_d, y_d], axis=-1)

    def _radial(self, r2: Array) -> tuple[Array, Array]:
        """The factor on a radius whose square is r2 (...), and twice its derivative by r2."""
        k1, k2, _, _, k3, *below = self.lens_coefficients or (0.0,) * 5
        N = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))
        if not any(below):
            return N, slope
        k4, k5, k6 = below
        D = 1 + r2 * (k4 + r2 * (k5 + r2 * k6))
        return N / D, (slope - 2 * N / D * (k4 + r2 * (2 * k5 + r2 * 3 * k6))) / D

    def _undistort(self, xy_d: Array) -> Array:
        """Invert `_distort` by Newton's method with the analytic Jacobian (quadratic: 10 rounds
        reach rounding).
        """
        _, _, p1, p2, *_ = self.lens_coefficients
        xy = xy_d.copy()
        for _ in range(10):
            x = xy[..., 0]
            y = xy[..., 1]
            r2 = x * x + y * y
            radial, slope = self._radial(r2)
            a = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
            b = slope * x * y + 2 * p1 * x + 2 * p2 * y
            d = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
            residual = self._distort(xy) - xy_d
            det = a * d - b * b
            step = np.stack(
                [
                    d * residual[..., 0] - b * residual[..., 1],
                    a * residual[..., 1] - b * residual[..., 0],
                ],
                axis=-1,
            )
            xy = xy - step / det[..., None]
        return xy
