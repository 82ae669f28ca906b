"""Wide lenses: fisheye, catadioptric and spherical cameras, and the faces of the cube on which
their pictures are drawn.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Literal, Self

import numpy as np
from annotated_types import Ge, Le, Len, Lt

from vstestbed.camera.base import Camera, LensNumbers, Panel
from vstestbed.camera.intrinsics import Intrinsics
from vstestbed.camera.perspective import Perspective, first_root
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, angles, direction, joined
from vstestbed.core.quantity import Coefficient, PositiveAngle, PositivePixels, TighterBounds
from vstestbed.core.spec import spec


# The six directions in which a camera that sees all around is drawn: how the faces of a cube stand
# in the camera.
def _face(x: tuple[int, int, int], y: tuple[int, int, int]) -> Array:
    """R_camera_face (3, 3) from the face's right and down, in camera axes; it looks along right x
    down.
    """
    return np.stack([x, y, np.cross(x, y)], axis=1).astype(float)


CUBE: dict[str, Array] = {
    "front": _face((1, 0, 0), (0, 1, 0)),
    "right": _face((0, 0, -1), (0, 1, 0)),
    "back": _face((-1, 0, 0), (0, 1, 0)),
    "left": _face((0, 0, 1), (0, 1, 0)),
    "up": _face((1, 0, 0), (0, 0, 1)),
    "down": _face((1, 0, 0), (0, 0, -1)),
}
"""R_camera_face (3, 3) by name, in the order of panels: axes x right, y down, z forward as a
camera's. Going right from the front one comes to right, back, left; `up` and `down` stand at the
front's upper and lower border as one looks there.
"""


# Wide lenses with radial symmetry: image radius as a function of the angle from the optical axis,
# up to 180 degrees.
@spec
class Radial(Camera):
    """Lens with a symmetric picture, u = f m(theta) cos(phi) + cx, v = f m(theta) sin(phi) + cy;
    square pixels.

    theta = atan2(hypot(X, Y), Z) is the angle from the optical axis, phi = atan2(Y, X) the one
    about it.

    Args:
        focal_length_px: f [px]; by default such that the image circle, of radius f m(theta_max),
            touches the borders of the picture's shorter side, as seen from its middle: f = min(W,
            H) / 2 / m(theta_max); e.g. `150`.
    """

    focal_length_px: PositivePixels | None = None

    @property
    @abstractmethod
    def reach(self) -> tuple[float, float]:
        """Smallest and largest angle from the axis that the lens sees [rad]."""

    @abstractmethod
    def radius(self, theta: Array) -> Array:
        """Distance m from the principal point in focal lengths [1] of angles theta (...) within the
        lens's reach [rad].
        """

    @abstractmethod
    def angle(self, radius: Array) -> Array:
        """Angles theta (...) [rad] of distances m (...) from the principal point: the inverse of
        `radius`.
        """

    @cached_property
    def ring(self) -> tuple[float, float]:
        """Inner and outer radius of the image circle, in focal lengths [1]."""
        inner, outer = self.radius(np.array(self.reach)).tolist()
        return inner, outer

    @cached_property
    def f(self) -> float:
        """Focal length [px]: pixels a radian on the axis of an equidistant lens."""
        return self.focal_length_px or min(self.width, self.height) / 2 / self.ring[1]

    def miscalibrated(
        self, focal_error: float, principal_px: tuple[float, float], ignores_distortion: bool
    ) -> Self:
        """As `Camera.miscalibrated`; without a distortion to be ignored,
        unless the lens has one.
        """
        if ignores_distortion:
            raise ParameterError.only_for(
                "calibration.ignores_distortion",
                "the lenses perspective and fisheye, which have one",
            )
        return replace(self, focal_length_px=self.f * (1 + focal_error), principal_px=principal_px)

    def project(self, p_camera: Array) -> Array:
        """Pixels uv (..., N, 2) of points (..., N, 3); NaN out of the lens's reach, and at the lens
        itself.
        """
        theta_phi = angles(p_camera)
        m = self.radius(_within(theta_phi[..., 0], self.reach))
        phi = theta_phi[..., 1]
        if isinstance(self.focal, float):
            r = self.focal * m
            return joined(r * np.cos(phi), r * np.sin(phi)) + self.centre
        return joined(m * np.cos(phi), m * np.sin(phi)) * self.focal + self.centre

    def ray(self, uv: Array) -> Array:
        """Unit rays (..., N, 3) of pixels uv (..., N, 2); NaN outside the image circle and in its
        blind middle.
        """
        m = (uv - self.centre) / self.focal
        theta = self.angle(_within(np.hypot(m[..., 0], m[..., 1]), self.ring))
        return direction(joined(theta, np.arctan2(m[..., 1], m[..., 0])))

    def borders(self, uv: Array) -> tuple[Array, Array]:
        """As of any camera, and of the image circle; of the blind middle too, where the lens has
        one.
        """
        distance, inwards = super().borders(uv)
        d = (uv - self.centre) * (self.f / self.focal)
        r = np.linalg.norm(d, axis=1, keepdims=True)
        out = d / np.maximum(r, 1e-9)
        inner, outer = (self.f * m for m in self.ring)
        distance = np.hstack([distance, outer - r])
        inwards = np.hstack([inwards, -out[:, None]])
        if inner > 0:
            distance = np.hstack([distance, r - inner])
            inwards = np.hstack([inwards, out[:, None]])
        return distance, inwards


def _within(value: Array, limits: tuple[float, float]) -> Array:
    """`value` clipped to limits that it exceeds by rounding, NaN where it exceeds them by more."""
    low, high = limits
    slack = 1e-9 * high
    return np.where(
        (value >= low - slack) & (value <= high + slack),
        np.minimum(np.maximum(value, low), high),
        np.nan,
    )


# The fisheye lens: equidistant, or with a calibrated polynomial in the angle (OpenCV's fisheye
# model).
EQUIDISTANT = (0.0,) * 4


@spec
class Fisheye(Radial):
    """Kannala and Brandt's lens, m(theta) = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4
    theta^8).

    The numbers of OpenCV's `fisheye` calibration fit as they are (f = fx = fy; no skew), and here
    they go on beyond 90 degrees.

    Args:
        fov_deg: full field of view [deg]; nothing is seen beyond it. Without focal_length_px it
            also sets the scale.
        coefficients: (k1, k2, k3, k4), such that m rises all the way to fov/2 [1]; all 0: the
            equidistant lens m = theta.
        intrinsics: those of a calibrated lens, in place of these, `focal_length_px` and
            `principal_px`; a block, or the name of a file of ROS or OpenCV (`Intrinsics`); e.g.
            `camera_info.yaml`.

    Reference: Kannala & Brandt 2006, eq. 6 with its first coefficient in f,
    doi:10.1109/TPAMI.2006.153.
    """

    kind: Literal["fisheye"] = "fisheye"
    fov_deg: Annotated[PositiveAngle, TighterBounds(le=360)] = 185.0
    coefficients: Annotated[tuple[Coefficient, ...], Len(4, 4)] = EQUIDISTANT
    intrinsics: LensNumbers | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.intrinsics is not None:
            self._check_intrinsics(self.intrinsics)
        if self.reach[1] >= self.turn:
            words = (
                f"fold the picture over itself within fov_deg = {self.fov_deg:g};"
                " use smaller coefficients or a fov_deg below"
            )
            field = "coefficients" if self.intrinsics is None else "intrinsics.distortion"
            raise ParameterError(
                field, f"{words} {math.degrees(2 * self.turn):.4g}", self.lens_coefficients
            )

    def _check_intrinsics(self, intrinsics: Intrinsics) -> None:
        for name in ("focal_length_px", "principal_px", "coefficients"):
            if getattr(self, name) not in (None, EQUIDISTANT):
                raise ParameterError.conflict(name, "intrinsics, which say it")
        intrinsics.check("fisheye", self.width, self.height, "intrinsics")

    @cached_property
    def lens_coefficients(self) -> tuple[float, ...]:
        """The coefficients (k1, k2, k3, k4), the intrinsics' where there are some."""
        if self.intrinsics is None:
            return self.coefficients
        return self.intrinsics.distortion or EQUIDISTANT

    @cached_property
    def f(self) -> float:
        """As `Radial.f`; of pixels that are no squares the one down the picture, fy."""
        return super().f if self.intrinsics is None else self.intrinsics.focal_px[1]

    def with_intrinsics(self, intrinsics: Intrinsics) -> Fisheye:
        """As `Camera.with_intrinsics`."""
        return replace(
            self,
            focal_length_px=None,
            principal_px=None,
            coefficients=EQUIDISTANT,
            intrinsics=intrinsics,
        )

    def miscalibrated(
        self, focal_error: float, principal_px: tuple[float, float], ignores_distortion: bool
    ) -> Self:
        """As `Camera.miscalibrated`; without its distortion it is the equidistant lens."""
        if self.intrinsics is not None:
            intrinsics = self.intrinsics.scaled(focal_error, principal_px, ignores_distortion)
            return replace(self, intrinsics=intrinsics)
        lens = super().miscalibrated(focal_error, principal_px, ignores_distortion=False)
        return replace(lens, coefficients=EQUIDISTANT) if ignores_distortion else lens

    @property
    def reach(self) -> tuple[float, float]:
        """Smallest and largest angle from the axis that the lens sees [rad]."""
        return 0.0, math.radians(self.fov_deg) / 2

    @cached_property
    def turn(self) -> float:
        """Angle up to which m rises [rad]: the first positive root of dm/dtheta = 1 + 3 k1
        theta^2 + ... + 9 k4 theta^8.
        """
        k1, k2, k3, k4 = self.lens_coefficients
        return math.sqrt(first_root([9 * k4, 7 * k3, 5 * k2, 3 * k1, 1.0]))

    def radius(self, theta: Array) -> Array:
        """Distance m from the principal point in focal lengths [1] of angles theta (...) [rad]."""
        k1, k2, k3, k4 = self.lens_coefficients
        t2 = theta * theta
        return theta * (1 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))

    def angle(self, radius: Array) -> Array:
        """Angles theta (...) [rad] of distances m (...): Newton's method, kept between two knots of
        a table.
        """
        if not any(self.lens_coefficients):
            return radius
        k1, k2, k3, k4 = self.lens_coefficients
        knots, radii = self._table
        after = np.clip(np.searchsorted(radii, radius), 1, len(knots) - 1)
        theta = np.interp(radius, radii, knots)
        # 3 reach rounding, 8 next to an angle where the polynomial has its maximum
        for _ in range(8):
            t2 = theta * theta
            slope = 1 + t2 * (3 * k1 + t2 * (5 * k2 + t2 * (7 * k3 + t2 * 9 * k4)))
            theta = np.clip(
                theta - (self.radius(theta) - radius) / slope, knots[after - 1], knots[after]
            )
        return theta

    @cached_property
    def _table(self) -> tuple[Array, Array]:
        knots = np.linspace(*self.reach, 257)
        return knots, self.radius(knots)


@spec
class Catadioptric(Radial):
    """Central mirror camera: a point P is projected to the unit sphere, (Xs, Ys, Zs) = P/|P|, then
    to (Xs, Ys) / (Zs + xi).

    In angles, m(theta) = sin(theta) / (cos(theta) + xi), inverted in closed form by theta = atan(m)
    + asin(xi m / sqrt(1 + m^2)). f is the generalised focal length (mirror and lens together). xi =
    0 is a pinhole; 0 < xi < 1 a hyperbolic mirror; xi = 1 a parabolic one under an orthographic
    lens, m = tan(theta/2); xi > 1 fits fisheyes. The model is valid for Zs > -xi (for xi > 1: Zs >
    -1/xi). The z axis points from the mirror to the lens; the mirror's reversal of the image is
    taken as undone (u rises with X).

    Args:
        xi: the mirror's parameter [1].
        fov_deg: full field of view [deg], within the model's validity; without focal_length_px it
            also sets the scale.
        blind_deg: angle from the axis [deg] within which the mirror shows only the camera itself:
            NaN.

    References: Geyer & Daniilidis 2000, doi:10.1007/3-540-45053-X_29; Mei & Rives 2007,
    doi:10.1109/ROBOT.2007.364084.
    """

    kind: Literal["catadioptric"] = "catadioptric"
    xi: Annotated[float, Ge(0), Le(100)] = 1.0
    fov_deg: Annotated[PositiveAngle, TighterBounds(lt=360)] = 200.0
    blind_deg: Annotated[float, Ge(0), Lt(180)] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        end = 2 * math.degrees(math.acos(-self.xi if self.xi <= 1 else -1 / self.xi))
        if self.fov_deg >= end:
            raise ParameterError.bound(
                "fov_deg", "below", f"{end:.4g} with xi = {self.xi:g}", self.fov_deg
            )
        if self.blind_deg >= self.fov_deg / 2:
            words = (
                "hides the whole field of view;"
                f" it must be below fov_deg / 2 = {self.fov_deg / 2:g}"
            )
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
        # sin(theta_m) of the closed form; rounding may take it above 1 at the edge of the field of
        # view.
        sine = self.xi * radius / np.hypot(1.0, radius)
        return np.arctan(radius) + np.arcsin(np.minimum(sine, 1.0))


@spec
class SphericalCamera(Radial):
    """The full sphere; its own picture is the azimuthal equidistant map about the optical axis,
    m(theta) = theta.

    What lies straight behind, theta = pi, is the map's whole border, and is projected to its point
    at phi = 0. By default f = min(W, H) / 2 / pi.

    Args:
        face_px: side of the six square pictures [px], the panels, in which markers are found and
            from which films are made.

    Reference: Snyder 1987, Map Projections: a Working Manual, section 25, doi:10.3133/pp1395.
    """

    kind: Literal["spherical"] = "spherical"
    face_px: Annotated[int, Ge(8), Le(4096)] = 256

    @cached_property
    def panels(self) -> tuple[Panel, ...]:
        """The six pictures in which markers are looked for, in the order of `CUBE`.

        Each is 10 degrees wider than a cube's face, so that a marker at a seam, up to 5 degrees in
        radius, is whole in one of the two. More would cost pixels in the middle: a face has
        face_px / 2 / tan(50 deg) to the radian there.
        """
        same = {
            name: getattr(self, name)
            for name in ("rate_hz", "multisampling", "anisotropy", "shadows")
        }
        lens = Perspective(width=self.face_px, height=self.face_px, fovy_deg=100.0, **same)
        return tuple(Panel(lens, R) for R in CUBE.values())

    def miscalibrated(
        self, focal_error: float, principal_px: tuple[float, float], ignores_distortion: bool
    ) -> Self:
        """Refused: markers are found in the panels, whose rays are known; the map of the sphere is
        only what is shown of them.
        """
        raise ParameterError(
            "calibration",
            (
                "may have no lens errors with camera spherical,"
                " which has no one lens; mount_error it may"
            ),
        )

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
