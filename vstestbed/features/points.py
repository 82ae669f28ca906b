"""Image points in Cartesian, polar and spherical coordinates."""

from __future__ import annotations

from typing import Literal

import numpy as np

from vstestbed.core.geometry import Array, joined
from vstestbed.core.quantity import PositiveLength
from vstestbed.core.spec import spec
from vstestbed.features.base import (
    Feature,
    bearing_weight,
    in_one,
    rows_in_one,
    wrap,
    wrap_together,
)


@spec
class Point(Feature):
    """The coordinates (x, y) = (X/Z, Y/Z) of each point; rows x1, y1, x2, y2, ...

    x_dot = -vx/Z + x vz/Z + x y wx - (1 + x^2) wy + y wz
    y_dot = -vy/Z + y vz/Z + (1 + y^2) wx - x y wy - x wz

    Reference: Chaumette & Hutchinson 2006, eq. 11, doi:10.1109/MRA.2006.250573.
    """

    kind: Literal["point"] = "point"
    rows_per_marker = 2

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 2N) of xy (..., N, 2)."""
        return in_one(np.asarray(xy, dtype=float))

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 2N, 6) of xy (..., N, 2) and depth (..., N) [m]."""
        xy, depth = self._checked(xy, depth)
        x = xy[..., 0]
        y = xy[..., 1]
        inv_z = 1.0 / depth
        across = x * y
        ones = 1 + xy * xy
        L = np.zeros((*xy.shape, 6))
        L[..., 0, 0] = -inv_z
        L[..., 1, 1] = -inv_z
        L[..., 2] = xy * inv_z[..., None]
        L[..., 0, 3] = across
        L[..., 1, 3] = ones[..., 1]
        L[..., 0, 4] = -ones[..., 0]
        L[..., 1, 4] = -across
        L[..., 0, 5] = y
        L[..., 1, 5] = -x
        return rows_in_one(L)


_POINT = Point()


@spec
class StereoPoint(Feature):
    """What a pair of parallel cameras shows of each point: (x, y, d) or (x_l, x_r, y), with the
    disparity d = x_l - x_r = b / Z.

    The camera of the law is the left one, and the right one b beside it along x. The depth Z by
    which d is known is that of `law.depth`: with `stereo` the pair measures d itself, also one that
    is not parallel.

    x_dot, y_dot as of `point`; with w = 1/Z:
    d_dot = b w_dot,  w_dot = w^2 vz + w y wx - w x wy,  and x_r = x - d.

    Args:
        form: `disparity`, rows x1, y1, d1, x2, ...; or `pair`, rows x_l1, x_r1, y1, x_l2, ...
        baseline_m: b [m], by which the depth counts against the image coordinates.

    References: Hager, Chang & Morse 1995, doi:10.1109/37.341862 (both pictures of a pair); Cervera,
    del Pobil, Berry & Martinet 2003, doi:10.1177/027836490302210003 (the triple (x_l, x_r, y) and
    the point in space).
    """

    kind: Literal["stereo"] = "stereo"
    form: Literal["disparity", "pair"] = "disparity"
    baseline_m: PositiveLength = 0.1
    inputs = ("xyw", "depth")
    rows_per_marker = 3

    def measure(self, xyw: Array) -> Array:
        """The vector s (..., 3N) of xyw (..., N, 3)."""
        xyw = np.asarray(xyw, dtype=float)
        x = xyw[..., 0]
        y = xyw[..., 1]
        d = self.baseline_m * xyw[..., 2]
        rows = (x, y, d) if self.form == "disparity" else (x, x - d, y)
        return in_one(np.stack(rows, axis=-1))

    def interaction(self, xyw: Array, depth: Array) -> Array:
        """L (..., 3N, 6) of xyw (..., N, 3) and depth (..., N) [m]."""
        xy = np.asarray(xyw, dtype=float)[..., :2]
        x = xy[..., 0]
        y = xy[..., 1]
        w = 1 / np.asarray(depth, dtype=float)
        of_xy = _POINT.interaction(xy, depth)
        of_x = of_xy[..., 0::2, :]
        of_y = of_xy[..., 1::2, :]
        of_w = np.zeros((*x.shape, 6))
        of_w[..., 2] = w * w
        of_w[..., 3] = w * y
        of_w[..., 4] = -w * x
        of_d = self.baseline_m * of_w
        rows = (of_x, of_y, of_d) if self.form == "disparity" else (of_x, of_x - of_d, of_y)
        return rows_in_one(np.stack(rows, axis=-2))


@spec
class Bearings(Feature):
    """A feature of which every second row is a bearing about the optical axis.

    Args:
        together: near a half turn, all angles get the same sign (`wrap_together`); else each is
            wrapped by itself, as in the reference, and rounding decides the direction of each.
        centre_weight: the row of phi has the factor w(r)^2 in L and w(r) w(r*) in e, with r the
            radius, or the sine of theta, and w(r) = min(1, r/0.01) (`bearing_weight`), which is 1
            beyond some 4 to 8 pixels or 0.6 degrees: a marker at the centre of the goal's picture
            then gives no noise. Else w = 1, as in the reference, and the row grows as 1/r.
    """

    together: bool = True
    centre_weight: bool = True
    rows_per_marker = 2

    def error(self, s: Array, s_star: Array) -> Array:
        """Error s - s* (..., 2N); that of bearings is w w* wrap(phi - phi*), whose derivative at
        s* = s is w^2 phi_dot.
        """
        s = np.asarray(s, dtype=float)
        s_star = np.asarray(s_star, dtype=float)
        e = s - s_star
        weight = self._weight(s[..., 0::2]) * self._weight(s_star[..., 0::2])
        turn = e[..., 1::2]
        # near a half turn the markers of full weight in both views decide the sign
        turn = wrap_together(turn, weight >= 1) if self.together else wrap(turn)
        e[..., 1::2] = weight * turn
        return e

    def _weight(self, first: Array) -> Array:
        """The weight of each bearing, by the first row of each point (...)."""
        return bearing_weight(self._off_axis(first), self.centre_weight)

    def _off_axis(self, first: Array) -> Array:
        """The radius at which a bearing is, or the sine of its colatitude, from the first row of
        each point.
        """
        return first


@spec
class Polar(Bearings):
    """Radius r = hypot(x, y) and angle phi = atan2(y, x) of each normalised point; rows r1, phi1,
    r2, phi2, ...

    r_dot   = -(c vx + s vy)/Z + r vz/Z + (1 + r^2) (s wx - c wy)
    phi_dot = (s vx - c vy)/(r Z) + (c wx + s wy)/r - wz,   c = cos phi, s = sin phi

    At the principal point phi is undefined, and its row zero. (The row of r has no direction there,
    either. If the goal has a marker at the centre, the matrix at the desired view lacks this
    information: with few other markers, use the current matrix or the mean.)

    Reference: Corke 2017, Robotics, Vision & Control, eq. 16.9, doi:10.1007/978-3-319-54413-7.
    """

    kind: Literal["polar"] = "polar"

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 2N) [1, rad] of xy (..., N, 2)."""
        xy = np.asarray(xy, dtype=float)
        r = np.hypot(xy[..., 0], xy[..., 1])
        return in_one(joined(r, np.arctan2(xy[..., 1], xy[..., 0])))

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 2N, 6) of xy (..., N, 2) and depth (..., N) [m]."""
        xy, depth = self._checked(xy, depth)
        s = self.measure(xy).reshape(xy.shape)
        r = s[..., 0]
        phi = s[..., 1]
        cos = np.cos(phi)
        sin = np.sin(phi)
        inv_z = 1 / depth
        weight = self._weight(r) ** 2
        inv_r = weight / np.where(r > 0, r, 1)  # at r = 0 the weight is 0, and so is the row
        L = np.zeros((*xy.shape, 6))
        L[..., 0, 0] = -cos * inv_z
        L[..., 0, 1] = -sin * inv_z
        L[..., 0, 2] = r * inv_z
        L[..., 0, 3] = (1 + r * r) * sin
        L[..., 0, 4] = -(1 + r * r) * cos
        L[..., 1, 0] = sin * inv_r * inv_z
        L[..., 1, 1] = -cos * inv_r * inv_z
        L[..., 1, 3] = cos * inv_r
        L[..., 1, 4] = sin * inv_r
        L[..., 1, 5] = -weight
        return rows_in_one(L)


@spec
class Spherical(Bearings):
    """Colatitude theta = atan2(hypot(X, Y), Z) and longitude phi = atan2(Y, X) of each ray; rows
    theta1, phi1, theta2, ...

    theta_dot = -cos theta (c vx + s vy)/R + sin theta vz/R + s wx - c wy
    phi_dot   = (s vx - c vy)/(R sin theta) + (c wx + s wy) cos theta/sin theta - wz,
    c = cos phi, s = sin phi

    R is the range, not the depth. theta lies in [0, pi]; an arc sine would map points behind the
    equator to the front. On the axis, ahead and behind, phi is undefined, and its row zero.

    Reference: Corke 2017, Robotics, Vision & Control, eq. 16.15, doi:10.1007/978-3-319-54413-7.
    """

    kind: Literal["spherical"] = "spherical"
    inputs = ("ray", "range")

    def measure(self, ray: Array) -> Array:
        """The vector s (..., 2N) [rad] of rays (..., N, 3), of any length."""
        ray = np.asarray(ray, dtype=float)
        X = ray[..., 0]
        Y = ray[..., 1]
        Z = ray[..., 2]
        return in_one(joined(np.arctan2(np.hypot(X, Y), Z), np.arctan2(Y, X)))

    def interaction(self, ray: Array, range_: Array) -> Array:
        """L (..., 2N, 6) of rays (..., N, 3) and the distance of each point from the camera's
        centre (..., N) [m].
        """
        ray, range_ = self._checked(ray, range_)
        s = self.measure(ray).reshape(*ray.shape[:-1], 2)
        cosines = np.cos(s)
        sines = np.sin(s)
        cos_t = cosines[..., 0]
        cos = cosines[..., 1]
        sin_t = sines[..., 0]
        sin = sines[..., 1]
        inv_r = 1 / range_
        weight = bearing_weight(sin_t, self.centre_weight) ** 2
        # on the axis the weight is 0, and so is the row
        inv_sin = weight / np.where(sin_t > 0, sin_t, 1)
        L = np.zeros((*s.shape, 6))
        L[..., 0, 0] = -cos_t * cos * inv_r
        L[..., 0, 1] = -cos_t * sin * inv_r
        L[..., 0, 2] = sin_t * inv_r
        L[..., 0, 3] = sin
        L[..., 0, 4] = -cos
        L[..., 1, 0] = sin * inv_sin * inv_r
        L[..., 1, 1] = -cos * inv_sin * inv_r
        L[..., 1, 3] = cos * cos_t * inv_sin
        L[..., 1, 4] = sin * cos_t * inv_sin
        L[..., 1, 5] = -weight
        return rows_in_one(L)

    def _off_axis(self, first: Array) -> Array:
        return np.sin(first)
