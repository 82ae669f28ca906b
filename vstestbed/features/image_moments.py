"""Moments of points and of regions in the image, and how they change as the camera moves."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from math import comb
from typing import Any, Literal

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.features.rated import Rated

Of = Literal["points", "region"]
"""Moments are sums over points, or integrals over the region within a closed outline."""
LEAST_AREA = 1e-12
"""Area of a region in normalised coordinates that counts instead of a smaller one: a thousandth of a pixel wide."""
FLAT = 1e-9
"""Ratio of the scatters of points across and along a line under which they do not tell how a plane is tilted about it."""


def image_moments(xy: Array, of: Of, order: int) -> Array:
    """Moments m_pq = sum of x^p y^q, or the integral over the region, for p + q <= order: element [p, q] of (..., order+1, order+1).

    Args:
        xy: points, or the vertices of the outline in order, either way round (..., N, 2). of: which of the two.
        order: highest p + q; elements beyond are 0.

    Green's theorem makes the integral one along the edges: m_pq = 1/(p+q+2) times the sum over the edges of x_i y_i+1 - x_i+1 y_i times the
    mean of x^p y^q on the edge. Gauss-Legendre nodes on each edge give that mean without error: the result is exact for polygons.

    Reference: Steger 1996, "On the calculation of arbitrary moments of polygons", Technische Universität München, FGBV-96-05.
    """
    xy = np.asarray(xy, dtype=float)
    if of == "region":
        t, share = _nodes(order)
        after = np.roll(xy, -1, axis=-2)
        cross = xy[..., 0] * after[..., 1] - after[..., 0] * xy[..., 1]
        # (..., N, nodes) as one axis
        weight = (cross[..., None] * share).reshape(*cross.shape[:-1], -1)
        xy = (xy[..., None, :] + t[:, None] * (after - xy)[..., None, :]).reshape(*weight.shape, 2)
    else:
        weight = np.ones(xy.shape[:-1])
    powers = xy[..., None, :] ** np.arange(order + 1)[:, None]
    m = np.swapaxes(weight[..., None] * powers[..., 0], -1, -2) @ powers[..., 1]
    degree = np.add.outer(np.arange(order + 1), np.arange(order + 1))
    if of == "region":
        m = m * np.sign(m[..., :1, :1]) / (degree + 2)
    return np.where(degree <= order, m, 0.0)


@cache
def _nodes(order: int) -> tuple[Array, Array]:
    """Nodes in (0, 1) and their weights, by which the mean of a polynomial of this degree is exact."""
    t, weight = np.polynomial.legendre.leggauss(order // 2 + 1)
    return (t + 1) / 2, weight / 2


def fitted_plane(xy: Array, depth: Array) -> Array:
    """The plane 1/Z = A x + B y + C (..., 3) that fits the depths (..., N) [m] of points xy (..., N, 2) best, in 1/Z.

    Points on one line do not tell the tilt about it, which is then taken as zero.
    """
    xy, inverse = np.asarray(xy, dtype=float), 1 / np.asarray(depth, dtype=float)
    middle, mean = xy.mean(axis=-2), inverse.mean(axis=-1)
    d = xy - middle[..., None, :]
    scatter = np.swapaxes(d, -1, -2) @ d
    AB = np.linalg.pinv(scatter, FLAT, hermitian=True) @ (np.swapaxes(d, -1, -2) @ (inverse - mean[..., None])[..., None])
    C = mean - np.einsum("...k,...k->...", AB[..., 0], middle)
    return np.concatenate([AB[..., 0], C[..., None]], axis=-1)


@dataclass(frozen=True)
class MomentSet:
    """The centroid and the central moments of shapes; with a plane, each quantity comes with its rate as a `Rated`, else as an array.

    m_pq_dot = sum of x^p y^q by the flow of its points, which lie in the plane 1/Z = A x + B y + C. For central moments mu_pq, with
    d = 1 and k = 4 for a region, d = 0 and k = 1 for points, n_ij = mu_ij/m_00:

    mu_vx = -(p+d) A mu_pq - p B mu_p-1,q+1
    mu_vy = -q A mu_p+1,q-1 - (q+d) B mu_pq
    mu_vz = -A mu_wy + B mu_wx + (p+q+2d) C mu_pq
    mu_wx = (p+q+3d) mu_p,q+1 + p xg mu_p-1,q+1 + (p+2q+3d) yg mu_pq - k p n11 mu_p-1,q - k q n02 mu_p,q-1
    mu_wy = -(p+q+3d) mu_p+1,q - (2p+q+3d) xg mu_pq - q yg mu_p+1,q-1 + k p n20 mu_p-1,q + k q n11 mu_p,q-1
    mu_wz = p mu_p-1,q+1 - q mu_p+1,q-1

    Attributes:
        mu: central moments (..., n+1, n+1) of all orders p + q <= n, element [p, q]; a rate needs those of one order more.
        centre: the centroid (..., 2). of: points or region.
        plane: A, B, C (..., 3); None for values without rates.

    Reference: Chaumette 2004, doi:10.1109/TRO.2004.829463; for points: Tahri & Chaumette 2005, doi:10.1109/TRO.2005.853500.
    """

    mu: Array
    centre: Array
    of: Of
    plane: Array | None = None
    _known: dict[tuple[Any, ...], Any] = field(default_factory=dict)

    @classmethod
    def measured(cls, xy: Array, of: Of, order: int) -> MomentSet:
        """Those of points, or of the vertices of an outline, xy (..., N, 2)."""
        xy = np.asarray(xy, dtype=float)
        # First about the mean of the points: differences of large numbers would cost digits.
        middle = xy.mean(axis=-2)
        m = image_moments(xy - middle[..., None, :], of, 1)
        first = np.stack([m[..., 1, 0], m[..., 0, 1]], axis=-1)
        centre = middle + first / np.maximum(m[..., 0, 0], LEAST_AREA)[..., None]
        return cls(image_moments(xy - centre[..., None, :], of, order), centre, of)

    def in_plane(self, plane: Array) -> MomentSet:
        """The same with the plane (..., 3): quantities come with their rates."""
        return replace(self, plane=plane, _known={})

    @property
    def xg(self) -> Any:
        """The centroid's x."""
        return self._coordinate(0)

    @property
    def yg(self) -> Any:
        """The centroid's y."""
        return self._coordinate(1)

    @property
    def area(self) -> Any:
        """The area a of a region; of points mu20 + mu02, which changes with the distance as an area does."""
        if self.of == "points":
            return self.central(2, 0) + self.central(0, 2)
        return self.central(0, 0)

    def central(self, p: int, q: int) -> Any:
        """The moment mu_pq (...)."""
        if (p, q) not in self._known:
            value = self._at(p, q)
            if (p, q) == (0, 0):
                value = np.maximum(value, LEAST_AREA)
            self._known[p, q] = value if self.plane is None else Rated(value, self._rate(p, q))
        return self._known[p, q]

    def complex(self, p: int, q: int) -> Any:
        """The moment c_pq = sum of z^p conj(z)^q with z = x + i y from the centroid; turned by phi, it turns by (p - q) phi.

        c_11 = mu20 + mu02,  c_20 = mu20 - mu02 + 2i mu11,  c_21 = mu30 + mu12 + i (mu21 + mu03),
        c_30 = mu30 - 3 mu12 + i (3 mu21 - mu03).

        Reference: Flusser 2000, doi:10.1016/S0031-3203(99)00127-2.
        """
        if ("c", p, q) not in self._known:
            terms = [
                comb(p, a) * comb(q, b) * 1j ** (p - a) * (-1j) ** (q - b) * self.central(a + b, p + q - a - b)
                for a in range(p + 1)
                for b in range(q + 1)
            ]
            self._known["c", p, q] = sum(terms[1:], start=terms[0])
        return self._known["c", p, q]

    def _at(self, p: int, q: int) -> Array:
        return self.mu[..., p, q] if min(p, q) >= 0 else np.zeros(self.mu.shape[:-2])

    def _normalised(self) -> tuple[Array, Array, Array]:
        """The terms k n20, k n11, k n02, by which the centroid moves otherwise than a point would."""
        share = (4 if self.of == "region" else 1) / np.maximum(self._at(0, 0), LEAST_AREA)
        return share * self._at(2, 0), share * self._at(1, 1), share * self._at(0, 2)

    def _coordinate(self, axis: int) -> Any:
        """The centroid's xg or yg; its rate is the flow of a point there, and terms of second order."""
        value = self.centre[..., axis]
        if self.plane is None:
            return value
        x, y = self.centre[..., 0], self.centre[..., 1]
        A, B, C = np.moveaxis(np.broadcast_to(self.plane, (*x.shape, 3)), -1, 0)
        n20, n11, n02 = self._normalised()
        inverse = A * x + B * y + C
        rate = np.zeros((*x.shape, 6))
        rate[..., axis] = -inverse
        if axis == 0:
            rate[..., 2], rate[..., 5] = x * inverse + A * n20 + B * n11, y
            rate[..., 3], rate[..., 4] = x * y + n11, -(1 + x * x + n20)
        else:
            rate[..., 2], rate[..., 5] = y * inverse + A * n11 + B * n02, -x
            rate[..., 3], rate[..., 4] = 1 + y * y + n02, -(x * y + n11)
        return Rated(value, rate)

    def _rate(self, p: int, q: int) -> Array:
        """The rate (..., 6) of mu_pq by the equations above."""
        assert self.plane is not None
        mu, d = self._at, int(self.of == "region")
        x, y = self.centre[..., 0], self.centre[..., 1]
        A, B, C = np.moveaxis(np.broadcast_to(self.plane, (*x.shape, 3)), -1, 0)
        n20, n11, n02 = self._normalised()
        here, over, under = mu(p, q), mu(p - 1, q + 1), mu(p + 1, q - 1)
        wx = (p + q + 3 * d) * mu(p, q + 1) + p * x * over + (p + 2 * q + 3 * d) * y * here
        wx = wx - p * n11 * mu(p - 1, q) - q * n02 * mu(p, q - 1)
        wy = -(p + q + 3 * d) * mu(p + 1, q) - (2 * p + q + 3 * d) * x * here - q * y * under
        wy = wy + p * n20 * mu(p - 1, q) + q * n11 * mu(p, q - 1)
        vx, vy = -(p + d) * A * here - p * B * over, -q * A * under - (q + d) * B * here
        return np.stack([vx, vy, -A * wy + B * wx + (p + q + 2 * d) * C * here, wx, wy, p * over - q * under], axis=-1)


def place(m: MomentSet, row: str) -> Any:
    """The row xg, yg, area, an = 1/sqrt(area), xn = xg an or yn = yg an, as an array (...) or as a Rated."""
    plain = {"g": 1.0, "n": m.area**-0.5}
    if row in ("area", "an"):
        return m.area if row == "area" else plain["n"]
    return (m.xg if row[0] == "x" else m.yg) * plain[row[1]]
