"""The catadioptric camera: a lens facing a curved mirror, both modelled by one unit sphere (unified central model)."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le, Lt

from vstestbed.camera.radial import Radial
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Narrower, PositiveAngle
from vstestbed.core.spec import spec


@spec
class Catadioptric(Radial):
    """Central mirror camera: a point P is projected to the unit sphere, (Xs, Ys, Zs) = P/|P|, then to (Xs, Ys) / (Zs + xi).

    In angles, m(theta) = sin(theta) / (cos(theta) + xi), inverted in closed form by
    theta = atan(m) + asin(xi m / sqrt(1 + m^2)). f is the generalised focal length (mirror and lens together).
    xi = 0 is a pinhole; 0 < xi < 1 a hyperbolic mirror; xi = 1 a parabolic one under an orthographic lens, m = tan(theta/2);
    xi > 1 fits fisheyes. The model is valid for Zs > -xi (for xi > 1: Zs > -1/xi, where m has its maximum).
    The z axis points from the mirror to the lens; the mirror's reversal of the image is taken as undone (u rises with X).

    Args:
        xi: the mirror's parameter [1].
        fov_deg: full field of view [deg], within the model's validity; without focal_length_px it also sets the scale.
        blind_deg: angle from the axis [deg] within which the mirror shows only the camera itself: NaN.

    Raises (from the constructor): ParameterError for a field of view that the mirror cannot have, or none that is left.

    References: Geyer & Daniilidis 2000, doi:10.1007/3-540-45053-X_29; Mei & Rives 2007, doi:10.1109/ROBOT.2007.364084.
    """

    kind: Literal["catadioptric"] = "catadioptric"
    xi: Annotated[float, Ge(0), Le(100)] = 1.0
    fov_deg: Annotated[PositiveAngle, Narrower(lt=360)] = 200.0
    blind_deg: Annotated[float, Ge(0), Lt(180)] = 0.0

    def __post_init__(self) -> None:
        """Refuse a field of view beyond the model's validity, and a blind spot as large as the field of view."""
        super().__post_init__()
        end = 2 * math.degrees(math.acos(-self.xi if self.xi <= 1 else -1 / self.xi))
        if self.fov_deg >= end:
            raise ParameterError("fov_deg", f"must be below {end:.4g} with xi = {self.xi:g}", self.fov_deg)
        if self.blind_deg >= self.fov_deg / 2:
            words = f"hides the whole field of view; it must be below fov_deg / 2 = {self.fov_deg / 2:g}"
            raise ParameterError("blind_deg", words, self.blind_deg)

    @property
    def reach(self) -> tuple[float, float]:
        """Smallest and largest angle from the axis that the camera sees [rad]."""
        return math.radians(self.blind_deg), math.radians(self.fov_deg) / 2

    def radius(self, theta: Array) -> Array:
        """Distance m from the principal point in focal lengths [1] of angles theta (...) [rad]."""
        return np.sin(theta) / (np.cos(theta) + self.xi)

    def angle(self, radius: Array) -> Array:
        """Angles theta (...) [rad] of distances m (...) from the principal point."""
        # sin(theta_m) of the closed form; rounding may take it above 1 at the edge of the field of view.
        sine = self.xi * radius / np.hypot(1.0, radius)
        return np.arctan(radius) + np.arcsin(np.minimum(sine, 1.0))
