"""Lines in the picture through markers that follow each other."""

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

    Line i goes through the markers i and i + 1, the last through the last and the first; two markers have one line, so two
    rows in all.
    (rho, theta) and (-rho, theta + pi) are the same line. `measure` knows which way it runs, from marker i to i + 1, and
    gives the one whose normal (cos theta, sin theta) is that way turned by +90 degrees from x to y; so rho may be
    negative and passes zero without a jump, and a camera turned by any angle knows where it came from.

    Args:
        directed: the error is between lines that run one way, as `measure` gives them; false where a goal comes from
            elsewhere and either name of a line may stand: then the nearer of both names of s*, at most 90 degrees off.

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
        # cos theta = -dy/|d|, sin theta = dx/|d|: the distance without a cosine
        length = np.maximum(np.hypot(d[..., 0], d[..., 1]), np.finfo(float).tiny)
        rho = (start[..., 1] * d[..., 0] - start[..., 0] * d[..., 1]) / length
        return np.stack([rho, theta], axis=-1).reshape(*xy.shape[:-2], 2 * theta.shape[-1])

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 2 lines, 6) of xy (..., N, 2) and depth (..., N) [m] of the markers.

        Raises:
            ParameterError: the shapes do not belong together, there is one marker only, or a depth is not positive.
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
        other = np.abs(turned) > np.pi / 2  # the goal's name is changed, not that of s, to which L belongs
        e[..., 1::2] = np.where(other, wrap(turned + np.pi), turned)
        e[..., 0::2] += np.where(other, 2 * np.asarray(s_star)[..., 0::2], 0)
        return e


def line_interaction(rho: Array, theta: Array, plane: Array) -> Array:
    """L (..., 2, 6) of lines rho, theta (...) in the planes A X + B Y + C Z + D = 0, plane (..., 4), in the camera frame.

    rho_dot   = (c vx + s vy - rho vz) l_rho + (1 + rho^2) (s wx - c wy),      l_rho = (A rho c + B rho s + C)/D
    theta_dot = (c vx + s vy - rho vz) l_theta - rho (c wx + s wy) - wz,       l_theta = (A s - B c)/D
    c = cos theta, s = sin theta; any plane that holds the line will do, as long as the camera's centre is not on it.

    Raises:
        ParameterError: D = 0, a plane through the camera's centre.

    Reference: Espiau, Chaumette & Rives 1992, doi:10.1109/70.143350.
    """
    rho, theta, plane = (np.asarray(v, dtype=float) for v in (rho, theta, plane))
    if (plane[..., 3] == 0).any():
        raise ParameterError("plane", "must not hold the camera's centre: D must not be 0")
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
    """Where each line of points (..., N, k) starts and ends, (..., lines, k)."""
    if points.shape[-2] == 2:
        return points[..., :1, :], points[..., 1:, :]
    return points, np.concatenate([points[..., 1:, :], points[..., :1, :]], axis=-2)


def _plane(start: Array, end: Array) -> Array:
    """The plane (..., 4) through two points (..., 3) [m] that is farthest from the camera's centre, scaled to D = -1.

    Its normal is the foot m of the perpendicular on the line through both: m X/|m|^2 - 1 = 0. A line through the
    camera's centre is a point in the picture and has none; nearer than 1 mm the plane fades to (0, 0, 0, -1).
    """
    way = end - start
    way = way / np.maximum(np.sqrt(_dot(way, way)), np.finfo(float).tiny)
    foot = start - _dot(start, way) * way
    normal = foot * bounded_inverse(np.sqrt(_dot(foot, foot))) ** 2
    return np.concatenate([normal, np.full_like(normal[..., :1], -1)], axis=-1)


def _dot(a: Array, b: Array) -> Array:
    """Inner products (..., 1) of vectors (..., k)."""
    return np.einsum("...i,...i->...", a, b)[..., None]
