"""Image points in polar coordinates."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.features.angles import bounded_inverse, wrap, wrap_together
from vstestbed.features.base import checked
from vstestbed.geometry import Array
from vstestbed.spec import spec


@spec
class Polar:
    """Radius r = hypot(x, y) and angle phi = atan2(y, x) of each normalised point; rows r1, phi1, r2, phi2, ...

    r_dot   = -(c vx + s vy)/Z + r vz/Z + (1 + r^2) (s wx - c wy)
    phi_dot = (s vx - c vy)/(r Z) + (c wx + s wy)/r - wz,   c = cos phi, s = sin phi

    A point at the principal point has no angle: for r < 1e-3 the factor 1/r falls linearly to zero (`bounded_inverse`),
    so that of the row of phi nothing but -wz stays at r = 0.

    Args:
        together: near a half turn, all angles turn the same way (`wrap_together`); else each is wrapped alone, as in print,
            and rounding sends some one way and some the other.

    Reference: Corke 2017, Robotics, Vision & Control, eq. 16.9, doi:10.1007/978-3-319-54413-7.
    """

    kind: Literal["polar"] = "polar"
    together: bool = True
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 2
    least_markers: ClassVar[int] = 1

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 2N) [1, rad] of xy (..., N, 2)."""
        xy = np.asarray(xy, dtype=float)
        s = np.stack([np.hypot(xy[..., 0], xy[..., 1]), np.arctan2(xy[..., 1], xy[..., 0])], axis=-1)
        return s.reshape(*xy.shape[:-2], 2 * xy.shape[-2])

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 2N, 6) of xy (..., N, 2) and depth (..., N) [m].

        Raises:
            ParameterError: the shapes do not belong together, or a depth is not positive.
        """
        xy, depth = checked(xy, depth, self.inputs)
        s = self.measure(xy).reshape(xy.shape)
        r, cos, sin, inv_z = s[..., 0], np.cos(s[..., 1]), np.sin(s[..., 1]), 1 / depth
        inv_r = bounded_inverse(r)
        L = np.zeros((*xy.shape, 6))
        L[..., 0, 0], L[..., 0, 1], L[..., 0, 2] = -cos * inv_z, -sin * inv_z, r * inv_z
        L[..., 0, 3], L[..., 0, 4] = (1 + r * r) * sin, -(1 + r * r) * cos
        L[..., 1, 0], L[..., 1, 1] = sin * inv_r * inv_z, -cos * inv_r * inv_z
        L[..., 1, 3], L[..., 1, 4], L[..., 1, 5] = cos * inv_r, sin * inv_r, -1
        return L.reshape(*xy.shape[:-2], 2 * xy.shape[-2], 6)

    def error(self, s: Array, s_star: Array) -> Array:
        """Error s - s* (..., 2N); the angles wrapped, all with one sign near a half turn (`wrap_together`)."""
        e = np.subtract(s, s_star, dtype=float)
        e[..., 1::2] = wrap_together(e[..., 1::2]) if self.together else wrap(e[..., 1::2])
        return e
