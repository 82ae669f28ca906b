"""The ellipse that a disc, a ball or any other ellipse on a plane has as its image."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.base import MOST_CONDITION, checked, condition, require_plane
from vstestbed.features.image_moments import MomentSet, fitted_plane, place

OFF = 0.02
"""Distance of a marker from the fitted ellipse, as a share of its half axes, from which the outline counts as something else."""
Row = Literal["xg", "yg", "n20", "n11", "n02", "xn", "yn", "an"]


@spec
class Ellipse:
    """Functions of the ellipse through the markers, which lie on its outline; the rows of e and L are `rows`.

    xg, yg         the centre
    n20, n11, n02  second central moments of the region within, by its area a: for half axes A and B, the first at the angle t,
                   n20 = (A^2 cos^2 t + B^2 sin^2 t)/4, n11 = (A^2 - B^2) sin t cos t/4, n02 = (A^2 sin^2 t + B^2 cos^2 t)/4
    xn, yn, an     xg/sqrt(a), yg/sqrt(a), 1/sqrt(a), a = pi A B = 4 pi sqrt(n20 n02 - n11^2), as those of `moments`

    The ellipse is the conic that fits the markers best (`fitted_ellipse`). Where all lie on one ellipse, it is exact, wherever they are
    on it.

    L is that of the region's moments (`MomentSet`), whose third order vanishes, with the plane of the outline, 1/Z = A x + B y + C,
    from the depths of the markers. The outline of a ball is the circle in which the cone of its tangents touches it: for its centre P
    and radius R 1/Z = P . (x, y, 1) / (|P|^2 - R^2).

    A ball tells three motions, and so does a disc that is seen face on: rows [xn, yn, an]. A disc tells five only where the goal view is at
    a slant to it. On a robot with more motions than that, `law.redundant` leaves the others alone.

    Args:
        rows: features, in this order.

    Reference: Espiau, Chaumette & Rives 1992, doi:10.1109/70.143350; with these moments: Chaumette 2004, doi:10.1109/TRO.2004.829463.
    """

    kind: Literal["ellipse"] = "ellipse"
    rows: Annotated[tuple[Row, ...], Len(1, 8)] = ("xg", "yg", "n20", "n11", "n02")
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 0
    least_markers: ClassVar[int] = 5

    def measure(self, xy: Array) -> Array:
        """The vector s (..., rows) of points xy (..., N, 2) on the outline; NaN where the conic that fits them is no ellipse.

        Raises:
            ParameterError: there are fewer than five.
        """
        xy = np.asarray(xy, dtype=float)
        if xy.shape[-2] < self.least_markers:
            raise ParameterError("xy", "must hold at least five markers: fewer do not determine an ellipse", xy.shape)
        m = ellipse_moments(fitted_ellipse(xy))
        return np.stack([_row(m, row) for row in self.rows], axis=-1)

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., rows, 6) of points xy (..., N, 2) on the outline and their depth (..., N) [m].

        Raises:
            ParameterError: the shapes do not match, there are fewer than five markers, or a depth is not positive.
        """
        xy, depth = checked(xy, depth, self.inputs, self.least_markers)
        m = ellipse_moments(fitted_ellipse(xy)).in_plane(fitted_plane(xy, depth))
        return np.stack([_row(m, row).rate for row in self.rows], axis=-2)

    def error(self, s: Array, s_star: Array) -> Array:
        """The difference s - s* (..., rows)."""
        return np.subtract(s, s_star, dtype=float)

    def check_goal(self, xy: Array, depth: Array) -> None:
        """Refuse a goal view, xy (N, 2) and depth (N,) [m], without an ellipse, or with one that does not tell what the rows say.

        Raises:
            ParameterError: it names the target or the rows, and what would work.
        """
        require_plane(xy, depth, self.kind)
        s = fitted_ellipse(xy)
        if not (np.isfinite(s).all() and np.abs(_distance(s, xy) - 1).max() < OFF):
            words = "must have its markers on the outline of an ellipse for the feature ellipse (a disc, or a ball); use moments or point"
            raise ParameterError("target", words)
        m = ellipse_moments(s)
        scale = np.array([s[2] + s[4] if row[0] == "n" else place(m, "an") if row[1] == "n" else 1.0 for row in self.rows])
        if condition(self.interaction(xy, depth), scale, depth) > MOST_CONDITION:
            words = (
                f"may not be {', '.join(self.rows)} at this goal, where they depend on one another: a ball, and a disc seen face on, tell"
            )
            raise ParameterError("law.feature.rows", f"{words} three motions; use [xn, yn, an], or a goal at a slant to a disc")


def _row(m: MomentSet, row: str) -> Any:
    """One row as an array (...), or as a Rated."""
    return m.central(int(row[1]), int(row[2])) / m.central(0, 0) if row[0] == "n" else place(m, row)


def ellipse_moments(s: Array) -> MomentSet:
    """The moments of the region in an ellipse s = (xg, yg, n20, n11, n02) (..., 5), up to third order."""
    s = np.asarray(s, dtype=float)
    n20, n11, n02 = np.moveaxis(s[..., 2:], -1, 0)
    area = 4 * np.pi * np.sqrt(n20 * n02 - n11 * n11)
    mu = np.zeros((*s.shape[:-1], 4, 4))
    mu[..., 0, 0], mu[..., 2, 0], mu[..., 1, 1], mu[..., 0, 2] = area, n20 * area, n11 * area, n02 * area
    return MomentSet(mu, s[..., :2], "region")


def fitted_ellipse(xy: Array) -> Array:
    """The ellipse (xg, yg, n20, n11, n02) (..., 5) that fits points xy (..., N, 2) best; NaN where the conic is no ellipse.

    About the points' mean, in units of their distance from it, it is the least squares of

    x^2 + y^2 + a (x^2 - y^2) + 2 b x y + c x + d y + e = 0;

    any ellipse has such an equation.
    """
    xy = np.asarray(xy, dtype=float)
    middle = xy.mean(axis=-2)
    about = xy - middle[..., None, :]
    unit = np.maximum(np.sqrt(np.square(about).sum(axis=-1).mean(axis=-1)), np.finfo(float).tiny)
    x, y = np.moveaxis(about / unit[..., None, None], -1, 0)
    design = np.stack([x * x - y * y, 2 * x * y, x, y, np.ones_like(x)], axis=-1)
    a, b, c, d, e = np.moveaxis((np.linalg.pinv(design) @ -(x * x + y * y)[..., None])[..., 0], -1, 0)
    det = 1 - a * a - b * b  # of the quadratic form [[1 + a, b], [b, 1 - a]]
    det = np.where(det > 0, det, np.nan)
    xc, yc = -0.5 * ((1 - a) * c - b * d) / det, -0.5 * ((1 + a) * d - b * c) / det
    level = -(e + 0.5 * (c * xc + d * yc))  # the quadratic form at the ellipse, about its centre
    n = np.stack([1 - a, -b, 1 + a], axis=-1) * (0.25 * np.where(level > 0, level, np.nan) / det * unit**2)[..., None]
    return np.concatenate([middle + np.stack([xc, yc], axis=-1) * unit[..., None], n], axis=-1)


def _distance(s: Array, xy: Array) -> Array:
    """Distances (N,) of points xy (N, 2) from the centre of an ellipse s (5,), by that of the ellipse in their direction."""
    d, n = xy - s[:2], np.array([[s[2], s[3]], [s[3], s[4]]])
    return np.sqrt(np.einsum("ni,ij,nj->n", d, np.linalg.inv(4 * n), d))
