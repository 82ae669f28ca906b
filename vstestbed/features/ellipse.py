"""The ellipse that a disc, a ball or any other ellipse on a plane has as its image."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.base import checked
from vstestbed.features.image_moments import MomentSet, fitted_plane, require_plane


@spec
class Ellipse:
    """Centre and normalised second moments s = (xg, yg, n20, n11, n02) of the ellipse through the markers, which lie on an outline.

    n_ij = mu_ij / area of the region within: n20 = (a^2 cos^2 t + b^2 sin^2 t)/4, n11 = (a^2 - b^2) sin t cos t/4, n02 = (a^2 sin^2 t +
    b^2 cos^2 t)/4 for half axes a, b and the first axis at the angle t. The ellipse is the conic that fits the markers best
    (`fitted_ellipse`): where all lie on one ellipse, it is exact, wherever they lie on it.

    L is that of the region's moments (`MomentSet`), whose third-order moments vanish, with the plane of the outline, 1/Z = A x + B y + C,
    from the markers' depths. The outline of a ball is the circle in which the cone of its tangents touches it: for its centre P and radius
    R, 1/Z = P . (x, y, 1) / (|P|^2 - R^2).

    A disc determines five motions and a ball three: no rotation about its centre changes its image. On a robot with more motions than that,
    `law.redundant` leaves the others alone.

    Reference: Espiau, Chaumette & Rives 1992, doi:10.1109/70.143350; with these moments: Chaumette 2004, doi:10.1109/TRO.2004.829463.
    """

    kind: Literal["ellipse"] = "ellipse"
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 0
    least_markers: ClassVar[int] = 5

    def measure(self, xy: Array) -> Array:
        """The vector s (..., 5) of points xy (..., N, 2) on the outline; NaN where the conic that fits them is no ellipse.

        Raises:
            ParameterError: there are fewer than five.
        """
        xy = np.asarray(xy, dtype=float)
        if xy.shape[-2] < self.least_markers:
            raise ParameterError("xy", "must hold at least five markers: fewer do not determine an ellipse", xy.shape)
        return fitted_ellipse(xy)

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., 5, 6) of points xy (..., N, 2) on the outline and their depth (..., N) [m].

        Raises:
            ParameterError: the shapes do not match, there are fewer than five markers, or a depth is not positive.
        """
        xy, depth = checked(xy, depth, self.inputs, self.least_markers)
        return ellipse_interaction(fitted_ellipse(xy), fitted_plane(xy, depth))

    def error(self, s: Array, s_star: Array) -> Array:
        """The difference s - s* (..., 5)."""
        return np.subtract(s, s_star, dtype=float)

    def check_goal(self, xy: Array, depth: Array) -> None:
        """Refuse a goal view whose markers do not lie on an ellipse of one plane.

        Raises:
            ParameterError: it names the target.
        """
        require_plane(xy, depth, self.kind)
        s = fitted_ellipse(xy)
        off = np.abs(_level(s, xy)).max() if np.isfinite(s).all() else np.inf
        if off > OFF:
            words = "must have its markers on the outline of an ellipse for the feature ellipse (a disc, or a ball); use moments or point"
            raise ParameterError("target", words)


OFF = 0.02
"""Distance of a marker from the fitted ellipse, as a share of its half axes, from which the outline counts as something else."""


def ellipse_interaction(s: Array, plane: Array) -> Array:
    """L (..., 5, 6) of an ellipse s = (xg, yg, n20, n11, n02) (..., 5) in the plane 1/Z = A x + B y + C, (..., 3)."""
    s = np.asarray(s, dtype=float)
    mu = np.zeros((*s.shape[:-1], 4, 4))  # of area 1: n_ij = mu_ij, and of third order all 0
    mu[..., 0, 0], mu[..., 2, 0], mu[..., 1, 1], mu[..., 0, 2] = 1, s[..., 2], s[..., 3], s[..., 4]
    m = MomentSet(mu, s[..., :2], "region", np.asarray(plane, dtype=float))
    rows = [m.xg, m.yg, *(m.central(p, q) / m.central(0, 0) for p, q in ((2, 0), (1, 1), (0, 2)))]
    return np.stack([row.rate for row in rows], axis=-2)


def fitted_ellipse(xy: Array) -> Array:
    """The ellipse (..., 5), as (xg, yg, n20, n11, n02), that fits points xy (..., N, 2) best; NaN where the conic is no ellipse.

    About the points' mean and in units of their distance from it, the least squares of x^2 + y^2 + a (x^2 - y^2) + 2 b x y + c x + d y + e:
    any ellipse has such an equation, which needs no eigenvalues.
    """
    xy = np.asarray(xy, dtype=float)
    middle = xy.mean(axis=-2)
    d = xy - middle[..., None, :]
    unit = np.sqrt(np.square(d).sum(axis=-1).mean(axis=-1))
    x, y = np.moveaxis(d / np.maximum(unit, np.finfo(float).tiny)[..., None, None], -1, 0)
    design = np.stack([x * x - y * y, 2 * x * y, x, y, np.ones_like(x)], axis=-1)
    a, b, c, e, f = np.moveaxis((np.linalg.pinv(design) @ -(x * x + y * y)[..., None])[..., 0], -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        det = np.where(1 - a * a - b * b > 0, 1 - a * a - b * b, np.nan)
        xc, yc = -0.5 * ((1 - a) * c - b * e) / det, -0.5 * ((1 + a) * e - b * c) / det
        quarter = -0.25 * (f + 0.5 * (c * xc + e * yc))
        n = np.stack([(1 - a), -b, (1 + a)], axis=-1) * (np.where(quarter > 0, quarter, np.nan) / det * unit**2)[..., None]
    return np.concatenate([middle + np.stack([xc, yc], axis=-1) * unit[..., None], n], axis=-1)


def _level(s: Array, xy: Array) -> Array:
    """Distances (N,) of points xy (N, 2) from an ellipse s (5,) along their rays from its centre, as a share of that to the ellipse."""
    d, n = xy - s[:2], np.array([[s[2], s[3]], [s[3], s[4]]])
    return np.sqrt(np.einsum("ni,ij,nj->n", d, np.linalg.inv(4 * n), d)) - 1
