"""Image points in polar coordinates."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.core.geometry import Array, joined
from vstestbed.core.spec import spec
from vstestbed.features.angles import bearing_error, bearing_weight
from vstestbed.features.base import checked


@spec
class Polar:
    """Radius r = hypot(x, y) and angle phi = atan2(y, x) of each normalised point; rows r1, phi1, r2, phi2, ...

    r_dot   = -(c vx + s vy)/Z + r vz/Z + (1 + r^2) (s wx - c wy)
    phi_dot = (s vx - c vy)/(r Z) + (c wx + s wy)/r - wz,   c = cos phi, s = sin phi

    At the principal point phi is undefined, and its row zero. (The row of r has no direction there, either. If the goal has a marker
    at the centre, the matrix at the desired view lacks this information: with few other markers, use the current matrix or the mean.)

    Args:
        together: near a half turn, all angles get the same sign (`wrap_together`); else each is wrapped by itself, as in the
            reference, and rounding decides the direction of each.
        centre_weight: the row of phi has the factor w(r)^2 in L and w(r) w(r*) in e, with w(r) = min(1, r/0.01) (`bearing_weight`),
            which is 1 beyond some 4 to 8 pixels: a marker at the centre of the goal's picture then gives no noise. Else w = 1, as in
            the reference, and the row grows as 1/r.

    Reference: Corke 2017, Robotics, Vision & Control, eq. 16.9, doi:10.1007/978-3-319-54413-7.
    """

    kind: Literal["polar"] = "polar"
    together: bool = True
    centre_weight: bool = True
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 2
    least_markers: ClassVar[int] = 1

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 2N) [1, rad] of xy (..., N, 2)."""
        xy = np.asarray(xy, dtype=float)
        s = joined(np.hypot(xy[..., 0], xy[..., 1]), np.arctan2(xy[..., 1], xy[..., 0]))
        return s.reshape(*xy.shape[:-2], 2 * xy.shape[-2])

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 2N, 6) of xy (..., N, 2) and depth (..., N) [m].

        Raises:
            ParameterError: the shapes do not match, or a depth is not positive.
        """
        xy, depth = checked(xy, depth, self.inputs)
        s = self.measure(xy).reshape(xy.shape)
        r, cos, sin, inv_z = s[..., 0], np.cos(s[..., 1]), np.sin(s[..., 1]), 1 / depth
        weight = bearing_weight(r, self.centre_weight) ** 2
        inv_r = weight / np.where(r > 0, r, 1)  # at r = 0 the weight is 0, and so is the row
        L = np.zeros((*xy.shape, 6))
        L[..., 0, 0], L[..., 0, 1], L[..., 0, 2] = -cos * inv_z, -sin * inv_z, r * inv_z
        L[..., 0, 3], L[..., 0, 4] = (1 + r * r) * sin, -(1 + r * r) * cos
        L[..., 1, 0], L[..., 1, 1] = sin * inv_r * inv_z, -cos * inv_r * inv_z
        L[..., 1, 3], L[..., 1, 4], L[..., 1, 5] = cos * inv_r, sin * inv_r, -weight
        return L.reshape(*xy.shape[:-2], 2 * xy.shape[-2], 6)

    def error(self, s: Array, s_star: Array) -> Array:
        """Error s - s* (..., 2N); the angles wrapped and weighted (`bearing_error`)."""
        s, s_star = np.asarray(s, dtype=float), np.asarray(s_star, dtype=float)
        e = s - s_star
        w, w_star = (bearing_weight(r, self.centre_weight) for r in (s[..., 0::2], s_star[..., 0::2]))
        e[..., 1::2] = bearing_error(s[..., 1::2], s_star[..., 1::2], w, w_star, self.together)
        return e
