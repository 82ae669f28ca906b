"""Wide lenses with radial symmetry: image radius as a function of the angle from the optical axis, up to 180 degrees."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import replace
from functools import cached_property

import numpy as np

from vstestbed.camera.base import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, angles, direction, joined
from vstestbed.core.quantity import PositivePixels
from vstestbed.core.spec import spec

RIM = 1e-9
"""Relative tolerance for rounding at the border of the image circle."""


@spec
class Radial(Camera):
    """Lens with a symmetric picture, u = f m(theta) cos(phi) + cx, v = f m(theta) sin(phi) + cy; square pixels.

    theta = atan2(hypot(X, Y), Z) is the angle from the optical axis, phi = atan2(Y, X) the one about it. A lens defines m
    (`radius`), its inverse (`angle`) and the range of theta that it sees (`reach`).

    Args:
        focal_length_px: f [px]; by default such that the image circle, of radius f m(theta_max), touches the borders of the
            picture's shorter side, as seen from its middle: f = min(W, H) / 2 / m(theta_max); e.g. `150`.
    """

    focal_length_px: PositivePixels | None = None

    @property
    @abstractmethod
    def reach(self) -> tuple[float, float]:
        """Smallest and largest angle from the axis that the lens sees [rad]."""

    @abstractmethod
    def radius(self, theta: Array) -> Array:
        """Distance m from the principal point in focal lengths [1] of angles theta (...) within the lens's reach [rad]."""

    @abstractmethod
    def angle(self, radius: Array) -> Array:
        """Angles theta (...) [rad] of distances m (...) from the principal point: the inverse of `radius`."""

    @cached_property
    def ring(self) -> tuple[float, float]:
        """Inner and outer radius of the image circle, in focal lengths [1]."""
        inner, outer = self.radius(np.array(self.reach)).tolist()
        return inner, outer

    @cached_property
    def f(self) -> float:
        """Focal length [px]: pixels a radian on the axis of an equidistant lens."""
        return self.focal_length_px or min(self.width, self.height) / 2 / self.ring[1]

    def miscalibrated(self, focal_error: float, principal_px: tuple[float, float], ignores_distortion: bool) -> Radial:
        """As `Camera.miscalibrated`; without a distortion to be ignored, unless the lens has one."""
        if ignores_distortion:
            raise ParameterError("calibration.ignores_distortion", "is for the lenses perspective and fisheye, which have one")
        return replace(self, focal_length_px=self.f * (1 + focal_error), principal_px=principal_px)

    def project(self, p_camera: Array) -> Array:
        """Pixels uv (..., N, 2) of points (..., N, 3); NaN out of the lens's reach, and at the lens itself."""
        theta_phi = angles(p_camera)
        r = self.f * self.radius(_within(theta_phi[..., 0], self.reach))
        phi = theta_phi[..., 1]
        return joined(r * np.cos(phi), r * np.sin(phi)) + self.centre

    def ray(self, uv: Array) -> Array:
        """Unit rays (..., N, 3) of pixels uv (..., N, 2); NaN outside the image circle and in its blind middle."""
        m = (uv - self.centre) / self.f
        theta = self.angle(_within(np.hypot(m[..., 0], m[..., 1]), self.ring))
        return direction(joined(theta, np.arctan2(m[..., 1], m[..., 0])))

    def borders(self, uv: Array) -> tuple[Array, Array]:
        """As of any camera, and of the image circle; of the blind middle too, where the lens has one."""
        distance, inwards = super().borders(uv)
        d = uv - self.centre
        r = np.linalg.norm(d, axis=1, keepdims=True)
        out, (inner, outer) = d / np.maximum(r, 1e-9), (self.f * m for m in self.ring)
        distance, inwards = np.hstack([distance, outer - r]), np.hstack([inwards, -out[:, None]])
        return (distance, inwards) if inner == 0 else (np.hstack([distance, r - inner]), np.hstack([inwards, out[:, None]]))


def _within(value: Array, limits: tuple[float, float]) -> Array:
    """`value` clipped to limits that it exceeds by rounding, NaN where it exceeds them by more."""
    low, high = limits
    slack = RIM * high
    return np.where((value >= low - slack) & (value <= high + slack), np.minimum(np.maximum(value, low), high), np.nan)
