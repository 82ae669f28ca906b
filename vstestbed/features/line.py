"""Lines in the image through consecutive markers."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.angles import bounded_inverse, wrap, wrap_together
from vstestbed.features.base import checked


@spec
class LineFeature:
    """Distance rho and angle theta of the lines x cos theta + y sin theta - rho = 0; rows rho1, theta1, rho2, ...

    Line i goes through the markers i and i + 1, the last one through the last marker and the first; two markers define one line,
    so two rows.
    (rho, theta) and (-rho, theta + pi) are the same line. `measure` takes its direction from marker i to i + 1 and returns the
    pair whose normal (cos theta, sin theta) is this direction rotated by +90 degrees from x to y. So rho may be
    negative and passes zero continuously, and a rotation of the camera by any angle is unambiguous.

    Args:
        directed: the error compares directed lines, as `measure` gives them. False for a goal from another source, with
            either pair for a line: then the pair for s* that is nearer in angle, at most 90 degrees off.

    Reference: Espiau, Chaumette & Rives 1992, doi:10.1109/70.143350.
    """

    kind: Literal["line"] = "line"
    directed: bool = True
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 2
    least_markers: ClassVar[int] = 2

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 2 lines) [1, rad] of xy (..., N, 2); ParameterError for fewer than two markers."""
        xy = np.asarray(xy, dtype=float)
        if xy.shape[-2] < self.least_markers:
            raise ParameterError("xy", "must hold at least two markers: a line needs two", xy.shape)
        start, end = _ends(xy)
        d = end - start
        theta = np.arctan2(d[..., 0], -d[..., 1])
        # cos theta = -dy/|d| and sin theta = dx/|d| are known without evaluating a cosine
        length = np.maximum(np.hypot(d[..., 0], d[..., 1]), np.finfo(float).tiny)
        rho = (start[..., 1] * d[..., 0] - start[..., 0] * d[..., 1]) / length
        return np.stack([rho, theta], axis=-1).reshape(*xy.shape[:-2], 2 * theta.shape[-1])

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 2 lines, 6) of xy (..., N, 2) and depth (..., N) [m] of the markers.

        Raises:
            ParameterError: the shapes do not match, there is only one marker, or a depth is not positive.
        """
        xy, depth = checked(xy, depth, self.inputs, self.least_markers)
        points = np.concatenate([xy, np.ones_like(depth)[..., None]], axis=-1) * depth[..., None]
        s = self.measure(xy)
        L = line_interaction(s[..., 0::2], s[..., 1::2], _plane(*_ends(points)))
        return L.reshape(*s.shape, 6)

    def error(self, s: Array, s_star: Array) -> Array:
        """Error s - s* (..., 2 lines) with theta wrapped, all with one sign near a half turn (`wrap_together`)."""
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
    """L (..., 2, 6) of lines rho, theta (...) in the planes A X + B Y + C Z + D = 0, plane (..., 4), in the camera frame.

    rho_dot   = (c vx + s vy - rho vz) l_rho + (1 + rho^2) (s wx - c wy),      l_rho = (A rho c + B rho s + C)/D
    theta_dot = (c vx + s vy - rho vz) l_theta - rho (c wx + s wy) - wz,       l_theta = (A s - B c)/D
    c = cos theta, s = sin theta; any plane that contains the line but not the camera's centre gives the same L.

    Raises:
        ParameterError: D = 0, a plane through the camera's centre.

    Reference: Espiau, Chaumette & Rives 1992, doi:10.1109/70.143350.
    """
    rho, theta, plane = (np.asarray(v, dtype=float) for v in (rho, theta, plane))
    if (plane[..., 3] == 0).any():
        raise ParameterError("plane", "must not contain the camera's centre: D must not be 0")
    cos, sin = np.cos(theta), np.sin(theta)
    A, B, C = np.moveaxis(plane[..., :3] / plane[..., 3:], -1, 0)
    along = np.stack([cos, sin, -rho], axis=-1)
    L = np.zeros((*rho.shape, 2, 6))
    L[..., 0, :3] = along * (A * rho * cos + B * rho * sin + C)[..., None]
    L[..., 1, :3] = along * (A * sin - B * cos)[..., None]
    L[..., 0, 3], L[..., 0, 4] = (1 + rho * rho) * sin, -(1 + rho * rho) * cos
    L[..., 1, 3], L[..., 1, 4], L[..., 1, 5] = -rho * cos, -rho * sin, -1
    return L


def _ends(points: Array) -> tuple[Array, Array]:
    """The first and the second point (..., lines, k) of each line through points (..., N, k)."""
    if points.shape[-2] == 2:
        return points[..., :1, :], points[..., 1:, :]
    return points, np.concatenate([points[..., 1:, :], points[..., :1, :]], axis=-2)


def _plane(start: Array, end: Array) -> Array:
    """The plane (..., 4) through two points (..., 3) [m] that is farthest from the camera's centre, scaled to D = -1.

    Its normal is the foot m of the perpendicular from the centre to the line through both: m X/|m|^2 - 1 = 0. A line through the
    centre is a point in the image and has no such plane; nearer than 1 mm the normal goes to 0 continuously.
    """
    way = end - start
    way = way / np.maximum(np.sqrt(_dot(way, way)), np.finfo(float).tiny)
    # Of the planes through both points, which all give the same L, the one farthest from the centre is the best conditioned.
    foot = start - _dot(start, way) * way
    normal = foot * bounded_inverse(np.sqrt(_dot(foot, foot))) ** 2
    return np.concatenate([normal, np.full_like(normal[..., :1], -1)], axis=-1)


def _dot(a: Array, b: Array) -> Array:
    """Inner products (..., 1) of vectors (..., k)."""
    return np.einsum("...i,...i->...", a, b)[..., None]
