"""The spherical camera: every direction at once."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated, Literal

from annotated_types import Ge, Le

from vstestbed.camera.base import Panel
from vstestbed.camera.cube import CUBE
from vstestbed.camera.perspective import Perspective
from vstestbed.camera.radial import Radial
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec

FACE_DEG = 100.0
"""Field of view of each of the six pictures [deg]: 10 more than a cube's face, so that a marker at a seam, up to 5 degrees
in radius, is whole in one of the two. More would cost pixels in the middle: a face has face_px / 2 / tan(FACE_DEG / 2) to
the radian there."""


@spec
class SphericalCamera(Radial):
    """The full sphere; its own picture is the azimuthal equidistant map about the optical axis, m(theta) = theta.

    What lies ahead is nearly undistorted, what lies behind is a ring; the direction straight back, theta = pi, is that
    ring's whole border, and is projected to its point at phi = 0. By default f = min(W, H) / 2 / pi.

    Args:
        face_px: side of the six square pictures [px], the panels, in which markers are found and from which films are made.

    Reference: Snyder 1987, Map Projections: a Working Manual, section 25, doi:10.3133/pp1395.
    """

    kind: Literal["spherical"] = "spherical"
    face_px: Annotated[int, Ge(8), Le(4096)] = 256

    @cached_property
    def panels(self) -> tuple[Panel, ...]:
        """The six pictures in which markers are looked for, FACE_DEG wide each, in the order of `CUBE`."""
        lens = Perspective(
            width=self.face_px,
            height=self.face_px,
            fovy_deg=FACE_DEG,
            rate_hz=self.rate_hz,
            multisampling=self.multisampling,
            anisotropy=self.anisotropy,
            shadows=self.shadows,
        )
        return tuple(Panel(lens, R) for R in CUBE.values())

    def miscalibrated(self, focal_error: float, principal_px: tuple[float, float], ignores_distortion: bool) -> SphericalCamera:
        """Refused: markers are found in the panels, whose rays are known; the map of the sphere is only what is shown of them."""
        raise ParameterError("calibration", "may have no lens errors with camera spherical, which has no one lens; mount_error it may")

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
