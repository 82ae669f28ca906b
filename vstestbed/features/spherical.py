"""Points on the unit sphere around the camera's centre."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.core.geometry import Array, joined
from vstestbed.core.spec import spec
from vstestbed.features.angles import bearing_error, bearing_weight
from vstestbed.features.base import checked


@spec
class Spherical:
    """Colatitude theta = atan2(hypot(X, Y), Z) and longitude phi = atan2(Y, X) of each ray; rows theta1, phi1, theta2, ...

    theta_dot = -cos theta (c vx + s vy)/R + sin theta vz/R + s wx - c wy
    phi_dot   = (s vx - c vy)/(R sin theta) + (c wx + s wy) cos theta/sin theta - wz,   c = cos phi, s = sin phi

    R is the range, not the depth. theta lies in [0, pi]; an arc sine would map points behind the equator to the front.
    On the axis, ahead and behind, phi is undefined, and its row zero.

    Args:
        together: near a half turn, all angles get the same sign (`wrap_together`); else each is wrapped by itself, as in the
            reference, and rounding decides the direction of each.
        centre_weight: the row of phi has the factor w(sin theta)^2 in L and w(sin theta) w(sin theta*) in e, with
            w(r) = min(1, r/0.01) (`bearing_weight`), which is 1 beyond 0.6 degrees. Else w = 1, as in the reference.

    Reference: Corke 2017, Robotics, Vision & Control, eq. 16.15, doi:10.1007/978-3-319-54413-7.
    """

    kind: Literal["spherical"] = "spherical"
    together: bool = True
    centre_weight: bool = True
    inputs: ClassVar[tuple[str, ...]] = ("ray", "range")
    rows_per_marker: ClassVar[int] = 2
    least_markers: ClassVar[int] = 1

    def measure(self, ray: Array) -> Array:
        """The vector s (..., 2N) [rad] of rays (..., N, 3), of any length."""
        ray = np.asarray(ray, dtype=float)
        X, Y, Z = ray[..., 0], ray[..., 1], ray[..., 2]
        s = joined(np.arctan2(np.hypot(X, Y), Z), np.arctan2(Y, X))
        return s.reshape(*ray.shape[:-2], 2 * ray.shape[-2])

    def interaction(self, ray: Array, range_: Array) -> Array:
        """L (..., 2N, 6) of rays (..., N, 3) and the distance of each point from the camera's centre (..., N) [m].

        Raises:
            ParameterError: the shapes do not match, or a range is not positive.
        """
        ray, range_ = checked(ray, range_, self.inputs)
        s = self.measure(ray).reshape(*ray.shape[:-1], 2)
        cosines, sines = np.cos(s), np.sin(s)
        cos_t, cos, sin_t, sin = cosines[..., 0], cosines[..., 1], sines[..., 0], sines[..., 1]
        inv_r, weight = 1 / range_, bearing_weight(sin_t, self.centre_weight) ** 2
        inv_sin = weight / np.where(sin_t > 0, sin_t, 1)  # on the axis the weight is 0, and so is the row
        L = np.zeros((*s.shape, 6))
        L[..., 0, 0], L[..., 0, 1], L[..., 0, 2] = -cos_t * cos * inv_r, -cos_t * sin * inv_r, sin_t * inv_r
        L[..., 0, 3], L[..., 0, 4] = sin, -cos
        L[..., 1, 0], L[..., 1, 1] = sin * inv_sin * inv_r, -cos * inv_sin * inv_r
        L[..., 1, 3], L[..., 1, 4], L[..., 1, 5] = cos * cos_t * inv_sin, sin * cos_t * inv_sin, -weight
        return L.reshape(*ray.shape[:-2], 2 * ray.shape[-2], 6)

    def error(self, s: Array, s_star: Array) -> Array:
        """Error s - s* (..., 2N); theta unchanged, phi wrapped and weighted (`bearing_error`)."""
        s, s_star = np.asarray(s, dtype=float), np.asarray(s_star, dtype=float)
        e = s - s_star
        w, w_star = (bearing_weight(np.sin(theta), self.centre_weight) for theta in (s[..., 0::2], s_star[..., 0::2]))
        e[..., 1::2] = bearing_error(s[..., 1::2], s_star[..., 1::2], w, w_star, self.together)
        return e
