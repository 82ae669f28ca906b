"""The fisheye lens: equidistant, or with a calibrated polynomial in the angle (OpenCV's fisheye model)."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Len

from vstestbed.camera.radial import Radial
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Coefficient, Narrower, PositiveAngle
from vstestbed.core.spec import spec

KNOTS, ROUNDS = 257, 8
"""Size of the inverse's table, and Newton iterations: 3 reach rounding, 8 next to an angle where the polynomial has its maximum."""


@spec
class Fisheye(Radial):
    """Kannala and Brandt's lens, m(theta) = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8).

    With k = 0 it is the equidistant lens m = theta. The numbers of OpenCV's `fisheye` calibration fit as they are
    (f = fx = fy; no skew), and here they go on beyond 90 degrees.

    Args:
        fov_deg: full field of view [deg]; nothing is seen beyond it. Without focal_length_px it also sets the scale.
        coefficients: (k1, k2, k3, k4), such that m rises all the way to fov/2 [1].

    Raises (from the constructor): ParameterError for coefficients that fold the picture over itself within fov_deg.

    Reference: Kannala & Brandt 2006, eq. 6 with its first coefficient in f, doi:10.1109/TPAMI.2006.153.
    """

    kind: Literal["fisheye"] = "fisheye"
    fov_deg: Annotated[PositiveAngle, Narrower(le=360)] = 185.0
    coefficients: Annotated[tuple[Coefficient, ...], Len(4, 4)] = (0.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        """Refuse a polynomial that turns back within the field of view."""
        super().__post_init__()
        if self.reach[1] >= self.turn:
            words = f"fold the picture over itself within fov_deg = {self.fov_deg:g}; use smaller coefficients or a fov_deg below"
            raise ParameterError("coefficients", f"{words} {math.degrees(2 * self.turn):.4g}", self.coefficients)

    def miscalibrated(self, focal_error: float, principal_px: tuple[float, float], ignores_distortion: bool) -> Radial:
        """As `Camera.miscalibrated`; without its distortion it is the equidistant lens."""
        lens = super().miscalibrated(focal_error, principal_px, ignores_distortion=False)
        return replace(lens, coefficients=(0.0,) * 4) if isinstance(lens, Fisheye) and ignores_distortion else lens

    @property
    def reach(self) -> tuple[float, float]:
        """Smallest and largest angle from the axis that the lens sees [rad]."""
        return 0.0, math.radians(self.fov_deg) / 2

    @cached_property
    def turn(self) -> float:
        """Angle up to which m rises [rad]: the first positive root of dm/dtheta = 1 + 3 k1 theta^2 + ... + 9 k4 theta^8."""
        k1, k2, k3, k4 = self.coefficients
        roots = np.roots(np.trim_zeros([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0], "f"))
        real = roots.real[(np.abs(roots.imag) < 1e-12) & (roots.real > 0)]
        return math.sqrt(real.min()) if len(real) else math.inf

    def radius(self, theta: Array) -> Array:
        """Distance m from the principal point in focal lengths [1] of angles theta (...) [rad]."""
        k1, k2, k3, k4 = self.coefficients
        t2 = theta * theta
        return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))

    def angle(self, radius: Array) -> Array:
        """Angles theta (...) [rad] of distances m (...): Newton's method, kept between two knots of a table."""
        if not any(self.coefficients):
            return radius
        k1, k2, k3, k4 = self.coefficients
        knots, radii = self._table
        after = np.clip(np.searchsorted(radii, radius), 1, KNOTS - 1)
        theta = np.interp(radius, radii, knots)
        for _ in range(ROUNDS):
            t2 = theta * theta
            slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
            theta = np.clip(theta - (self.radius(theta) - radius) / slope, knots[after - 1], knots[after])
        return theta

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        knots = np.linspace(*self.reach, KNOTS)
        return knots, self.radius(knots)
