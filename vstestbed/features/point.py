"""Image points in normalised Cartesian coordinates."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.base import checked


@spec
class Point:
    """The coordinates (x, y) = (X/Z, Y/Z) of each point; rows x1, y1, x2, y2, ...

    x_dot = -vx/Z + x vz/Z + x y wx - (1 + x^2) wy + y wz
    y_dot = -vy/Z + y vz/Z + (1 + y^2) wx - x y wy - x wz

    Reference: Chaumette & Hutchinson 2006, eq. 11, doi:10.1109/MRA.2006.250573.
    """

    kind: Literal["point"] = "point"
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 2
    least_markers: ClassVar[int] = 1

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 2N) of xy (..., N, 2)."""
        xy = np.asarray(xy, dtype=float)
        return xy.reshape(*xy.shape[:-2], 2 * xy.shape[-2])

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 2N, 6) of xy (..., N, 2) and depth (..., N) [m].

        Raises:
            ParameterError: the shapes do not match, or a depth is not positive.
        """
        xy, depth = checked(xy, depth, self.inputs)
        x, y, inv_z = xy[..., 0], xy[..., 1], 1.0 / depth
        L = np.zeros((*xy.shape, 6))
        L[..., 0, 0] = L[..., 1, 1] = -inv_z
        L[..., 0, 2], L[..., 1, 2] = x * inv_z, y * inv_z
        L[..., 0, 3], L[..., 1, 3] = x * y, 1 + y * y
        L[..., 0, 4], L[..., 1, 4] = -(1 + x * x), -x * y
        L[..., 0, 5], L[..., 1, 5] = y, -x
        return L.reshape(*xy.shape[:-2], 2 * xy.shape[-2], 6)

    def error(self, s: Array, s_star: Array) -> Array:
        """The difference s - s*, shape (..., 2N)."""
        return np.subtract(s, s_star, dtype=float)
