"""The depth of a point as a logarithm."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.base import checked


@spec
class LogDepth:
    """log Z of each point, so that the error is log(Z/Z*): one row per point, with the depth as a measurement.

    (log Z)_dot = -vz/Z - y wx + x wy

    Reference: Malis, Chaumette & Boudet 1999, doi:10.1109/70.760345.
    """

    kind: Literal["log_depth"] = "log_depth"
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 1
    least_markers: ClassVar[int] = 1

    def measure(self, depth: Array) -> Array:
        """The vector s (..., N) of depth (..., N) [m]; ParameterError where one is not positive."""
        if not (np.asarray(depth) > 0).all():
            raise ParameterError("depth", "must be > 0 m for every point")
        return np.log(depth)

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., N, 6) of xy (..., N, 2) and depth (..., N) [m].

        Raises:
            ParameterError: the shapes do not match, or a depth is not positive.
        """
        xy, depth = checked(xy, depth, self.inputs)
        L = np.zeros((*depth.shape, 6))
        L[..., 2], L[..., 3], L[..., 4] = -1 / depth, -xy[..., 1], xy[..., 0]
        return L

    def error(self, s: Array, s_star: Array) -> Array:
        """log(Z/Z*) (..., N) as the difference s - s*."""
        return np.subtract(s, s_star, dtype=float)
