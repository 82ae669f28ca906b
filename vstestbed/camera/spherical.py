"""The spherical camera: every direction at once."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from annotated_types import Ge, Le

from vstestbed.camera.radial import Radial
from vstestbed.geometry import Array
from vstestbed.spec import spec


@spec
class Spherical(Radial):
    """The full sphere; its own picture is the azimuthal equidistant map about the optical axis, m(theta) = theta.

    What lies ahead is nearly undistorted, what lies behind is a ring; the direction straight back, theta = pi, is that
    ring's whole border, and is projected to its point at phi = 0. By default f = min(W, H) / 2 / pi.

    Args:
        face_px: side of the six square pictures [px] from which the picture is made.

    Reference: Snyder 1987, Map Projections: a Working Manual, section 25, doi:10.3133/pp1395.
    """

    kind: Literal["spherical"] = "spherical"
    face_px: Annotated[int, Ge(8), Le(4096)] = 256

    @property
    def reach(self) -> tuple[float, float]:
        """Smallest and largest angle from the axis: all of them [rad]."""
        return 0.0, math.pi

    def radius(self, theta: Array) -> Array:
        """Distance from the principal point in focal lengths [1], theta (...) [rad] itself."""
        return theta

    def angle(self, radius: Array) -> Array:
        """Angles theta (...) [rad], the distances (...) themselves."""
        return radius
