"""Lines in the image and on the floor, and segments between two points."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, homogeneous
from vstestbed.core.spec import spec
from vstestbed.features.base import (
    FLOOR,
    Dual,
    Feature,
    angle,
    at_least,
    bounded_inverse,
    in_one,
    square,
    wrap,
    wrap_together,
)
from vstestbed.features.points import Point


@spec
class LineFeature(Feature):
    """Distance rho and angle theta of the lines x cos theta + y sin theta - rho = 0; rows rho1,
    theta1, rho2, ...

    Line i goes through the markers i and i + 1, the last one through the last marker and the first;
    two markers define one line. (rho, theta) and (-rho, theta + pi) are the same line. `measure`
    takes its direction from marker i to i + 1 and returns the pair whose normal (cos theta, sin
    theta) is this direction rotated by +90 degrees from x to y. So rho may be negative and passes
    zero continuously, and a rotation of the camera by any angle is unambiguous.

    Args:
        directed: the error compares directed lines, as `measure` gives them. False for a goal from
            another source, with either pair for a line: then the pair for s* that is nearer in
            angle, at most 90 degrees off.

    Reference: Espiau, Chaumette & Rives 1992, doi:10.1109/70.143350.
    """

    kind: Literal["line"] = "line"
    directed: bool = True
    rows_per_marker = 2
    least_markers = 2

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 2 lines) [1, rad] of xy (..., N, 2)."""
        xy = np.asarray(xy, dtype=float)
        if xy.shape[-2] < self.least_markers:
            raise ParameterError.count(
                "xy", "at least two", "markers", xy.shape, why="a line needs two"
            )
        start, end = _ends(xy)
        d = end - start
        theta = np.arctan2(d[..., 0], -d[..., 1])
        # cos theta = -dy/|d| and sin theta = dx/|d| are known without evaluating a cosine
        length = np.maximum(np.hypot(d[..., 0], d[..., 1]), np.finfo(float).tiny)
        rho = (start[..., 1] * d[..., 0] - start[..., 0] * d[..., 1]) / length
        return in_one(np.stack([rho, theta], axis=-1))

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 2 lines, 6) of xy (..., N, 2) and depth (..., N) [m] of the markers."""
        xy, depth = self._checked(xy, depth)
        points = homogeneous(xy) * depth[..., None]
        s = self.measure(xy)
        L = line_interaction(s[..., 0::2], s[..., 1::2], _plane(*_ends(points)))
        return L.reshape(*s.shape, 6)

    def error(self, s: Array, s_star: Array) -> Array:
        """Error s - s* (..., 2 lines) with theta wrapped, all with one sign near a half turn
        (`wrap_together`).
        """
        e = np.subtract(s, s_star, dtype=float)
        if self.directed:
            e[..., 1::2] = wrap_together(e[..., 1::2])
            return e
        turned = wrap(e[..., 1::2])
        other = np.abs(turned) > np.pi / 2  # the other pair for s*, not for s, to which L belongs
        e[..., 1::2] = np.where(other, wrap(turned + np.pi), turned)
        e[..., 0::2] += np.where(other, 2 * np.asarray(s_star)[..., 0::2], 0)
        return e


def line_interaction(rho: Array, theta: Array, plane: Array) -> Array:
    """L (..., 2, 6) of lines rho, theta (...) in the planes A X + B Y + C Z + D = 0, plane (...,
    4), in the camera frame.

    rho_dot   = (c vx + s vy - rho vz) l_rho + (1 + rho^2) (s wx - c wy),
                l_rho = (A rho c + B rho s + C)/D
    theta_dot = (c vx + s vy - rho vz) l_theta - rho (c wx + s wy) - wz,
                l_theta = (A s - B c)/D
    c = cos theta, s = sin theta; any plane that contains the line but not the camera's centre
    (D = 0, a ParameterError) gives the same L.

    Reference: Espiau, Chaumette & Rives 1992, doi:10.1109/70.143350.
    """
    if (plane[..., 3] == 0).any():
        raise ParameterError("plane", "must not contain the camera's centre: D must not be 0")
    cos = np.cos(theta)
    sin = np.sin(theta)
    A, B, C = np.moveaxis(plane[..., :3] / plane[..., 3:], -1, 0)
    along = np.stack([cos, sin, -rho], axis=-1)
    L = np.zeros((*rho.shape, 2, 6))
    L[..., 0, :3] = along * (A * rho * cos + B * rho * sin + C)[..., None]
    L[..., 1, :3] = along * (A * sin - B * cos)[..., None]
    L[..., 0, 3] = (1 + rho * rho) * sin
    L[..., 0, 4] = -(1 + rho * rho) * cos
    L[..., 1, 3] = -rho * cos
    L[..., 1, 4] = -rho * sin
    L[..., 1, 5] = -1
    return L


def _ends(points: Array) -> tuple[Array, Array]:
    """The first and the second point (..., lines, k) of each line through points (..., N, k)."""
    if points.shape[-2] == 2:
        return points[..., :1, :], points[..., 1:, :]
    return points, np.concatenate([points[..., 1:, :], points[..., :1, :]], axis=-2)


def _plane(start: Array, end: Array) -> Array:
    """The plane (..., 4) through two points (..., 3) [m] that is farthest from the camera's centre,
    scaled to D = -1.

    Its normal is the foot m of the perpendicular from the centre to the line through both: m
    X/|m|^2 - 1 = 0. A line through the centre is a point in the image and has no such plane; nearer
    than a thousandth of `start`, the normal goes to 0 continuously.
    """
    way = end - start
    way = way / np.maximum(np.sqrt(_dot(way, way)), np.finfo(float).tiny)
    # Of the planes through both points, which all give the same L, the one farthest from the centre
    # is the best conditioned.
    foot = start - _dot(start, way) * way
    # a power of two, which costs no digit
    unit = np.exp2(np.ceil(np.log2(np.sqrt(_dot(start, start)))))
    normal = foot * (bounded_inverse(np.sqrt(_dot(foot, foot)) / unit) / unit) ** 2
    return np.concatenate([normal, np.full_like(normal[..., :1], -1)], axis=-1)


def _dot(a: Array, b: Array) -> Array:
    return np.einsum("...i,...i->...", a, b)[..., None]


# Lines in the image as lines on the floor, for a camera with a known mount on a vehicle.
def floor_plane(T_base_camera: Array) -> Array:
    """The floor as the plane A X + B Y + C Z + D = 0 in the camera frame, for a mount (4, 4) above
    it, shape (4,).
    """
    # The third row of T_base_camera gives the height Z_base of a point (X, Y, Z, 1), which is 0 on
    # the floor.
    return T_base_camera[2].copy()


def floor_point(xy: Array, T_base_camera: Array) -> Array:
    """Intersections (..., 2) of rays with normalised coordinates xy (..., 2) with the floor, in the
    base frame [m]; NaN where they rise.
    """
    d = homogeneous(xy) @ T_base_camera[:3, :3].T
    t = T_base_camera[:3, 3]
    reach = t[2] / np.where(d[..., 2] < 0, -d[..., 2], np.nan)
    return t[:2] + reach[..., None] * d[..., :2]


def line_on_floor(
    rho: Array, theta: Array, T_base_camera: Array, ahead: Array | float
) -> tuple[Array, Array]:
    """A line (rho, theta) (...) [1, rad] of the image projected on the floor, s = (y, phi) (..., 2)
    [m, rad], and J = ds/d(rho, theta).

    The line x cos theta + y sin theta - rho = 0 and the camera's centre t span a plane with the
    normal N = R (cos theta, sin theta, -rho) in the base frame, which meets the floor in
    N_x X + N_y Y = N . t:

        y    = (N . t - N_x X) / N_y         lateral position (left positive) at X = `ahead` (...)
                                             [m]
        phi  = atan(-N_x / N_y)              direction, in (-pi/2, pi/2)
        dy   = -dN . ((X, y, 0) - t) / N_y,  dphi = (N_x dN_y - N_y dN_x) / (N_x^2 + N_y^2)

    The interaction matrix of (y, phi) is J L, with J (..., 2, 2) and L (..., 2, 6) that of (rho,
    theta).
    """
    rho, theta, ahead = np.broadcast_arrays(rho, theta, ahead)
    R = T_base_camera[:3, :3]
    t = T_base_camera[:3, 3]
    cos = np.cos(theta)
    sin = np.sin(theta)
    none = np.zeros_like(theta)
    # not normalised: y, phi and their derivatives are ratios of its components
    N = np.stack([cos, sin, -rho], axis=-1) @ R.T
    by_rho = np.stack([none, none, none - 1], axis=-1)
    by_theta = np.stack([-sin, cos, none], axis=-1)
    dN = np.stack([by_rho, by_theta], axis=-2) @ R.T
    y = (N @ t - N[..., 0] * ahead) / N[..., 1]
    phi = np.arctan(-N[..., 0] / N[..., 1])
    lever = np.stack([ahead, y, none], axis=-1) - t
    dy = -np.einsum("...ij,...j->...i", dN, lever) / N[..., 1:2]
    size2 = N[..., :1] ** 2 + N[..., 1:2] ** 2
    dphi = (N[..., :1] * dN[..., 1] - N[..., 1:2] * dN[..., 0]) / size2
    return np.stack([y, phi], axis=-1), np.stack([dy, dphi], axis=-2)


_POINT = Point()


@spec
class Segment(Feature):
    """Midpoint (xc, yc), length l and angle alpha of the segment between two markers; rows in this
    order.

    With (x1, y1) and (x2, y2) the first two of the markers in sight:

    xc = (x1 + x2)/2,  yc = (y1 + y2)/2,  l = hypot(x1 - x2, y1 - y2),
    alpha = atan2(y1 - y2, x1 - x2),  s = (xc, yc, l, alpha)

    and normalised s = (xc/l, yc/l, 1/l, alpha): where the segment faces the camera, xc/l and yc/l
    do not change with the distance. The segment has a direction, so that a rotation by any angle is
    unambiguous. Under l = 0.001 the rows of alpha and of the normalised form fade. Two markers
    leave two of six motions open (`law.redundant`).

    Args:
        normalised: s = (xc/l, yc/l, 1/l, alpha).

    Reference: Chaumette 1990, "La relation vision-commande", thesis, Université de Rennes 1,
    chapter 3.
    """

    kind: Literal["segment"] = "segment"
    normalised: bool = False
    least_markers = 2

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 4) [1, 1, 1, rad] of xy (..., N, 2)."""
        xy = np.asarray(xy, dtype=float)
        if xy.shape[-2] < self.least_markers:
            raise ParameterError.count(
                "xy", "at least two", "markers", xy.shape, why="a segment has two ends"
            )
        rows = self._rows(xy[..., 0, 0], xy[..., 0, 1], xy[..., 1, 0], xy[..., 1, 1])
        return np.stack(rows, axis=-1)

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 4, 6) of xy (..., N, 2) and depth (..., N) [m]."""
        xy, depth = self._checked(xy, depth)
        L = _POINT.interaction(xy[..., :2, :], depth[..., :2])
        ends = [Dual(xy[..., i // 2, i % 2], L[..., i, :]) for i in range(4)]
        return np.stack([row.rate for row in self._rows(*ends)], axis=-2)

    def error(self, s: Array, s_star: Array) -> Array:
        """Error s - s* (..., 4) with alpha wrapped to (-pi, pi] rad."""
        e = np.subtract(s, s_star, dtype=float)
        e[..., 3] = wrap(e[..., 3])
        return e

    def _rows(self, x1: Any, y1: Any, x2: Any, y2: Any) -> list[Any]:
        along = (x1 - x2) + 1j * (y1 - y2)
        xc = 0.5 * (x1 + x2)
        yc = 0.5 * (y1 + y2)
        alpha = angle(along, FLOOR)
        length = at_least(square(along), FLOOR**2) ** 0.5
        if self.normalised:
            return [xc / length, yc / length, length**-1, alpha]
        return [xc, yc, length, alpha]
