"""Moments of a shape in the image: where it is, how large, how it is turned and tilted; the ellipse
as the shape of discs and balls.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from itertools import combinations
from math import comb
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.base import (
    MOST_CONDITION,
    Dual,
    Feature,
    angle,
    condition,
    require_plane,
    square,
    wrap,
)
from vstestbed.features.polygon import segments, size, spans_area

# moments are sums over points, or integrals over the region within a closed outline
Of = Literal["points", "region"]
# area of a region in normalised coordinates that counts instead of a smaller one: a thousandth of a
# pixel wide
LEAST_AREA = 1e-12
# ratio of the scatters of points across and along a line under which they do not tell how a plane
# is tilted about it
FLAT = 1e-9


def image_moments(xy: Array, of: Of, order: int) -> Array:
    """Moments m_pq = sum of x^p y^q, or the integral over the region, for p + q <= order: [p, q] of
    (..., order+1, order+1), else 0.

    Of points, or of the vertices of the outline in order, either way round, xy (..., N, 2).
    Green's theorem makes the integral one along the edges: m_pq = 1/(p+q+2) times the sum over the
    edges of x_i y_i+1 - x_i+1 y_i times the mean of x^p y^q on the edge. Gauss-Legendre nodes on
    each edge give that mean without error: the result is exact for polygons.
    Reference: Steger 1996, "On the calculation of arbitrary moments of polygons", Technische
    Universität München, FGBV-96-05.
    """
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
    """Nodes in (0, 1) and their weights, by
    which the mean of a polynomial of this degree is exact.
    """
    t, weight = np.polynomial.legendre.leggauss(order // 2 + 1)
    return (t + 1) / 2, weight / 2


def fitted_plane(xy: Array, depth: Array) -> Array:
    """The plane 1/Z = A x + B y + C (..., 3) that fits the depths (..., N) [m] of points xy (...,
    N, 2) best, in 1/Z.

    Points on one line do not tell the tilt about it, which is then taken as zero.
    """
    inverse = 1 / depth
    middle = xy.mean(axis=-2)
    mean = inverse.mean(axis=-1)
    d = xy - middle[..., None, :]
    scatter = np.swapaxes(d, -1, -2) @ d
    along = np.swapaxes(d, -1, -2) @ (inverse - mean[..., None])[..., None]
    AB = (np.linalg.pinv(scatter, FLAT, hermitian=True) @ along)[..., 0]
    C = mean - np.einsum("...k,...k->...", AB, middle)
    return np.concatenate([AB, C[..., None]], axis=-1)


@dataclass(frozen=True)
class MomentSet:
    """The centroid and the central moments of shapes; with a plane, each quantity comes with its
    rate as a `Dual`, else as an array.

    m_pq_dot = sum of x^p y^q by the flow of its points, which lie in the plane 1/Z = A x + B y + C.
    For central moments mu_pq, with d = 1 and k = 4 for a region, d = 0 and k = 1 for points, n_ij =
    mu_ij/m_00:

    mu_vx = -(p+d) A mu_pq - p B mu_p-1,q+1
    mu_vy = -q A mu_p+1,q-1 - (q+d) B mu_pq
    mu_vz = -A mu_wy + B mu_wx + (p+q+2d) C mu_pq
    mu_wx = (p+q+3d) mu_p,q+1 + p xg mu_p-1,q+1 + (p+2q+3d) yg mu_pq
            - k p n11 mu_p-1,q - k q n02 mu_p,q-1
    mu_wy = -(p+q+3d) mu_p+1,q - (2p+q+3d) xg mu_pq - q yg mu_p+1,q-1
            + k p n20 mu_p-1,q + k q n11 mu_p,q-1
    mu_wz = p mu_p-1,q+1 - q mu_p+1,q-1

    Attributes:
        mu: central moments (..., n+1, n+1) of all orders p + q <= n, element [p, q]; a rate needs
            those of one order more.
        centre: the centroid (..., 2). plane: A, B, C (..., 3); None for values without rates.

    Reference: Chaumette 2004, doi:10.1109/TRO.2004.829463; for points: Tahri & Chaumette 2005,
    doi:10.1109/TRO.2005.853500.
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
    def area(self) -> Any:
        """The area a of a region; of points mu20 + mu02, which changes with the distance as an area
        does.
        """
        if self.of == "points":
            return self.central(2, 0) + self.central(0, 2)
        return self.central(0, 0)

    def central(self, p: int, q: int) -> Any:
        """The moment mu_pq (...)."""
        if (p, q) not in self._known:
            value = self._at(p, q)
            if (p, q) == (0, 0):
                value = np.maximum(value, LEAST_AREA)
            self._known[p, q] = value if self.plane is None else Dual(value, self._rate(p, q))
        return self._known[p, q]

    def complex(self, p: int, q: int) -> Any:
        """The moment c_pq = sum of z^p conj(z)^q with z = x + i y from the centroid; turned by phi,
        it turns by (p - q) phi.

        c_11 = mu20 + mu02,  c_20 = mu20 - mu02 + 2i mu11,  c_21 = mu30 + mu12 + i (mu21 + mu03),
        c_30 = mu30 - 3 mu12 + i (3 mu21 - mu03).
        Reference: Flusser 2000, doi:10.1016/S0031-3203(99)00127-2.
        """
        if ("c", p, q) not in self._known:
            terms = []
            for a in range(p + 1):
                for b in range(q + 1):
                    factor = comb(p, a) * comb(q, b) * 1j ** (p - a) * (-1j) ** (q - b)
                    terms.append(factor * self.central(a + b, p + q - a - b))
            self._known["c", p, q] = sum(terms[1:], start=terms[0])
        return self._known["c", p, q]

    def _at(self, p: int, q: int) -> Array:
        return self.mu[..., p, q] if min(p, q) >= 0 else np.zeros(self.mu.shape[:-2])

    def _normalised(self) -> tuple[Array, Array, Array]:
        """The terms k n20, k n11, k n02, by which the centroid moves otherwise than a
        point would.
        """
        share = (4 if self.of == "region" else 1) / np.maximum(self._at(0, 0), LEAST_AREA)
        return share * self._at(2, 0), share * self._at(1, 1), share * self._at(0, 2)

    def coordinate(self, axis: int) -> Any:
        """The centroid's xg or yg; its rate is the flow of a point there, and terms of second
        order.
        """
        value = self.centre[..., axis]
        if self.plane is None:
            return value
        x, y, A, B, C = self._at_plane()
        n20, n11, n02 = self._normalised()
        inverse = A * x + B * y + C
        rate = np.zeros((*x.shape, 6))
        rate[..., axis] = -inverse
        if axis == 0:
            rate[..., 2] = x * inverse + A * n20 + B * n11
            rate[..., 3] = x * y + n11
            rate[..., 4] = -(1 + x * x + n20)
            rate[..., 5] = y
        else:
            rate[..., 2] = y * inverse + A * n11 + B * n02
            rate[..., 3] = 1 + y * y + n02
            rate[..., 4] = -(x * y + n11)
            rate[..., 5] = -x
        return Dual(value, rate)

    def _at_plane(self) -> Array:
        """The centroid's x and y, and A, B and C of the plane, (5, ...)."""
        assert self.plane is not None
        plane = np.broadcast_to(self.plane, (*self.centre.shape[:-1], 3))
        return np.moveaxis(np.concatenate([self.centre, plane], axis=-1), -1, 0)

    def _rate(self, p: int, q: int) -> Array:
        """The rate (..., 6) of mu_pq by the equations above."""
        mu = self._at
        d = int(self.of == "region")
        x, y, A, B, C = self._at_plane()
        n20, n11, n02 = self._normalised()
        here = mu(p, q)
        over = mu(p - 1, q + 1)
        under = mu(p + 1, q - 1)
        wx = (p + q + 3 * d) * mu(p, q + 1) + p * x * over + (p + 2 * q + 3 * d) * y * here
        wx = wx - p * n11 * mu(p - 1, q) - q * n02 * mu(p, q - 1)
        wy = -(p + q + 3 * d) * mu(p + 1, q) - (2 * p + q + 3 * d) * x * here - q * y * under
        wy = wy + p * n20 * mu(p - 1, q) + q * n11 * mu(p, q - 1)
        vx = -(p + d) * A * here - p * B * over
        vy = -q * A * under - (q + d) * B * here
        vz = -A * wy + B * wx + (p + q + 2 * d) * C * here
        wz = p * over - q * under
        return np.stack([vx, vy, vz, wx, wy, wz], axis=-1)


def place(m: MomentSet, row: str) -> Any:
    """The row xg, yg, area, an = 1/sqrt(area), xn = xg an or yn = yg an, as an array (...) or as a
    Dual.
    """
    if row == "area":
        return m.area
    an = m.area**-0.5
    if row == "an":
        return an
    return m.coordinate("xy".index(row[0])) * (an if row[1] == "n" else 1.0)


# Functions of a shape's moments that do not change with its place, size and rotation in the image.
def over(a: Any, b: Any) -> Any:
    """The ratio a/b, and 0/0 as a finite number: of a shape whose moments vanish by symmetry."""
    below = b.value if isinstance(b, Dual) else b
    return a / (b + np.where(below == 0, np.finfo(float).tiny, 0.0))


def _second_order(m: MomentSet) -> dict[str, Any]:
    """With complex moments: c1 = (|c20|^2 - c11^2) / (4 |c20|^2) = (mu11^2 - mu20 mu02) / |c20|^2,
    px = |c20|^2 / c11^2.
    """
    c20 = square(m.complex(2, 0))
    c11 = square(m.complex(1, 1))
    return {"c1": over(0.25 * (c20 - c11), c20), "px": over(c20, c11)}


def _third_order_sizes(m: MomentSet) -> dict[str, Any]:
    """With complex moments: c2 = |c30|^2 / |c21|^2, py = a |c30|^2 / c11^3."""
    c30 = square(m.complex(3, 0))
    return {
        "c2": over(c30, square(m.complex(2, 1))),
        "py": over(m.area * c30, m.complex(1, 1).real ** 3),
    }


def _third_order(m: MomentSet) -> dict[str, Any]:
    """With a = |c30|^2, b = |c21|^2, z = c30 conj(c21)^3 and D = (a + 3 b)^2 - 16 Re z:

    c3 = (a^2 - 6 a b - 3 b^2 + 8 Re z) / D,  c4 = 16 Im z / D,
    c5 = (b - a) (a - 9 b) / D,               c6 = (a - 9 b)^2 / D.
    """
    c30 = m.complex(3, 0)
    c21 = m.complex(2, 1)
    a = square(c30)
    b = square(c21)
    z = c30 * (c21 * c21 * c21).conj()
    above = {
        "c3": a * a - 6 * a * b - 3 * b * b + 8 * z.real,
        "c4": 16 * z.imag,
        "c5": (b - a) * (a - 9 * b),
        "c6": (a - 9 * b) ** 2,
    }
    below = (a + 3 * b) ** 2 - 16 * z.real
    return {row: over(value, below) for row, value in above.items()}


def _fourth_order(m: MomentSet) -> dict[str, Any]:
    """With a = |c40|^2, b = |c31|^2, c = |c22|^2 and D = a - 4 b + 3 c: c7 = (a + 8 b - 9 c) / D,
    c8 = 4 (9 c + 4 b - a) / D.
    """
    a, b, c = (square(m.complex(4 - i, i)) for i in range(3))
    below = a - 4 * b + 3 * c
    return {"c7": over(a + 8 * b - 9 * c, below), "c8": over(4 * (9 * c + 4 * b - a), below)}


def _fifth_order(m: MomentSet) -> dict[str, Any]:
    """With complex moments: c9 = |c32|^2 / |c50|^2, c10 = |c41|^2 / |c50|^2."""
    below = square(m.complex(5, 0))
    return {"c9": over(square(m.complex(3, 2)), below), "c10": over(square(m.complex(4, 1)), below)}


def _tilt(m: MomentSet) -> dict[str, Any]:
    """With S = i c30 conj(c20)^2 sqrt(a) / (|c20|^2 c11^(3/2)), 0 for a symmetric shape, whose rate
    is not: sx = Re S, sy = Im S.
    """
    c20 = m.complex(2, 0)
    S = over(
        1j * m.complex(3, 0) * (c20 * c20).conj() * m.area**0.5,
        square(c20) * m.complex(1, 1).real ** 1.5,
    )
    return {"sx": S.real, "sy": S.imag}


INVARIANTS = {
    "c1": (_second_order, 2),
    "c2": (_third_order_sizes, 3),
    **dict.fromkeys(("c3", "c4", "c5", "c6"), (_third_order, 3)),
    **dict.fromkeys(("c7", "c8"), (_fourth_order, 4)),
    **dict.fromkeys(("c9", "c10"), (_fifth_order, 5)),
    **dict.fromkeys(("sx", "sy"), (_tilt, 3)),
    "px": (_second_order, 2),
    "py": (_third_order_sizes, 3),
}
"""By word, the function that gives it and the highest order of the moments in it.

c1 to c10: Chaumette 2004, doi:10.1109/TRO.2004.829463; sx, sy, px, py: Tahri & Chaumette 2005,
doi:10.1109/TRO.2005.853500; here written in complex moments, in which an invariance is seen at
once: the turns of the factors cancel.
"""


Row = Literal[  # fmt: skip - one name a line would hide the groups
    "xn",
    "yn",
    "an",
    "xg",
    "yg",
    "area",
    "alpha",
    "sx",
    "sy",
    "px",
    "py",
    "c1",
    "c2",
    "c3",
    "c4",
    "c5",
    "c6",
    "c7",
    "c8",
    "c9",
    "c10",
]
DIRECTED = 0.1
"""Skewness over which third-order moments tell the two ends of the principal axis apart. A tilt of
some 20 degrees gives a symmetric shape a third of that.
"""
# elongation of a shape in the goal view under which its principal axis counts as undefined
ROUND = 0.05
# share of third-order moments in the goal view under which a shape counts as symmetric about its
# centre
SYMMETRIC = 0.02


@spec
class Moments(Feature):
    """Functions of the moments of all markers together, or of the region that they enclose; the
    rows of e and L are `rows`.

    m_pq is the sum of x^p y^q over the points, or its integral over the region; mu_pq the same
    about the centroid (xg, yg).

    xg, yg     the centroid, m10/m00 and m01/m00
    area       a = m00 of a region, mu20 + mu02 of points
    xn, yn     xg/sqrt(a) and yg/sqrt(a)
    an         1/sqrt(a)
    alpha      angle of the principal axis, atan2(2 mu11, mu20 - mu02)/2
    sx to c10  ratios that tell the tilt; `features/moments.py` has their equations

    Where the target faces the camera at the depth Z, xn, yn and an move by 1/(Z sqrt(a)) times the
    camera's motion along x, y and z, a factor that does not depend on Z. (In print they have the
    factor Z* sqrt(a*) of the goal, which makes them metres.)

    Which pair suits for the tilt depends on the shape; one that hardly tells it is refused, with
    the pair that is conditioned best. sx and sy suit an L, a rectangle and other shapes that are
    symmetric about their centre; c4 and c6 a whale or an arrow, of which sx and sy are nearly
    functions of the other rows. px and py, c1 and c2, c4 and c6 need a shape without that symmetry,
    and px, py and c1, c2 one that is not its own mirror image. Of an L px and py converge from
    farther away than sx and sy, and are some four times as sensitive to noise. All four converge
    from the most starts with the mean of the matrices (`law.interaction`). An ellipse needs the
    feature `ellipse`.

    alpha is an axis without a direction. Where third-order moments are large enough in both views,
    they tell its two ends apart, and its error is within half a turn, else within a quarter. To
    this end s has t = c21 sqrt(m00)/c11^(3/2) behind the rows where alpha is one.

    L is that of the moments (`MomentSet`), with the plane 1/Z = A x + B y + C that fits the depths
    of the markers, which must lie in one.

    Args:
        of: `points`, sums over the markers; `region`, integrals over the region whose outline the
            markers are, in order, either way round. It is the polygon of the markers, integrated
            without error (Green's theorem).
        rows: features, in this order. Six determine all motions of a camera: three places, two for
            the tilt, alpha.

    References: Chaumette 2004, doi:10.1109/TRO.2004.829463; Tahri & Chaumette 2005,
    doi:10.1109/TRO.2005.853500.
    """

    kind: Literal["moments"] = "moments"
    of: Of = "points"
    rows: Annotated[tuple[Row, ...], Len(1, 12)] = ("xn", "yn", "an", "sx", "sy", "alpha")
    least_markers = 3

    def __post_init__(self) -> None:
        if twice := [row for i, row in enumerate(self.rows) if row in self.rows[:i]]:
            raise ParameterError.twice("rows", twice[0], list(self.rows))

    def measure(self, xy: Array) -> Array:
        """The vector s (..., rows), with t (2) behind the rows where alpha is one of them, of xy
        (..., N, 2).
        """
        m = MomentSet.measured(xy, self.of, self._order)
        values = [self._row(m, row) for row in self.rows]
        if "alpha" in self.rows:
            # It turns with the shape, and does not change with its size and place.
            t = m.complex(2, 1) * m.central(0, 0) ** 0.5 / m.complex(1, 1).real ** 1.5
            values += [t.real, t.imag]
        return np.stack(values, axis=-1)

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., rows, 6) of xy (..., N, 2) and depth (..., N) [m]."""
        xy, depth = self._checked(xy, depth)
        m = MomentSet.measured(xy, self.of, self._order + 1).in_plane(fitted_plane(xy, depth))
        return np.stack([self._row(m, row).rate for row in self.rows], axis=-2)

    def error(self, s: Array, s_star: Array) -> Array:
        """Error e (..., rows): s - s*, with alpha's in (-pi, pi] rad where its axis has a
        direction, else in (-pi/2, pi/2].
        """
        s = np.asarray(s, dtype=float)
        s_star = np.asarray(s_star, dtype=float)
        n = len(self.rows)
        e = s[..., :n] - s_star[..., :n]
        if "alpha" in self.rows:
            i = self.rows.index("alpha")
            half = wrap(2 * e[..., i]) / 2
            # Where both vectors t are long enough, half a turn more if that is nearer to the angle
            # between them.
            z = s[..., n] + 1j * s[..., n + 1]
            z_star = s_star[..., n] + 1j * s_star[..., n + 1]
            whole = wrap(half + np.pi * np.round((np.angle(z * np.conj(z_star)) - half) / np.pi))
            e[..., i] = np.where(np.minimum(np.abs(z), np.abs(z_star)) > DIRECTED, whole, half)
        return e

    def check_goal(self, xy: Array, depth: Array) -> None:
        """Refuse a goal view, xy (N, 2) and depth (N,) [m], that leaves a row undefined or the rows
        dependent on one another.
        """
        require_plane(xy, depth, self.kind)
        if self.of == "region" and not spans_area(size(xy), segments(xy)):
            words = (
                "encloses no area in the goal view, which moments {of: region} need;"
                " its markers must be in order around an outline"
            )
            raise ParameterError("target", words)
        m = MomentSet.measured(xy, self.of, 3)
        if words := self._symmetry(m):
            raise ParameterError("law.feature.rows", words)
        found = self._condition(m, xy, depth)
        if found > MOST_CONDITION:
            limit = f"the condition {found:.2g} (at most {MOST_CONDITION:g} is accepted)"
            if found >= 1e12:  # what rounding has made of a singular L
                limit = "no inverse"
            why = (
                f"they depend on one another in the goal view, where L has {limit};"
                f" {self._advice(m, xy, depth)}"
            )
            raise ParameterError.excluded("law.feature.rows", ", ".join(self.rows), why=why)

    def _condition(self, m: MomentSet, xy: Array, depth: Array) -> float:
        units = {"area": m.area, **dict.fromkeys(("xn", "yn", "an"), place(m, "an"))}
        scale = np.abs([units.get(row, 1.0) for row in self.rows])
        return condition(self.interaction(xy, depth), scale, depth)

    def _advice(self, m: MomentSet, xy: Array, depth: Array) -> str:
        """Which two ratios would work best in place of these; where none would, that the shape may
        be an ellipse.
        """
        before = [row for row in self.rows if row in INVARIANTS]
        kept = tuple(row for row in self.rows if row not in INVARIANTS)
        best = MOST_CONDITION
        pair = ()
        for names in combinations(INVARIANTS, 2) if before else ():
            other = replace(self, rows=kept + names)
            if other._symmetry(m):
                continue
            found = other._condition(m, xy, depth)
            if found < best:
                best = found
                pair = names
        if not pair:
            return (
                "the target may be an ellipse; use fewer rows, feature ellipse, or another target"
            )
        return (
            f"use {' and '.join(pair)} in place of {' and '.join(before)},"
            f" which have the condition {best:.2g}"
        )

    def _symmetry(self, m: MomentSet) -> str:
        """Why a symmetry of the shape leaves rows undefined; "" where it does not."""
        c11 = m.complex(1, 1).real
        axial = self._named("alpha", "sx", "sy", "c1")
        if axial and np.abs(m.complex(2, 0)) < ROUND * c11:
            return (
                f"may not have {axial}: the target is as wide as long in the goal view"
                " (a disc, a square, a regular polygon), and has no principal axis;"
                " leave them out, or use an elongated target"
            )
        odd = self._named("py", "c2", "c3", "c4", "c5", "c6", "c9", "c10")
        skew = max(abs(m.complex(3, 0)), abs(m.complex(2, 1)))
        if odd and skew < SYMMETRIC * c11**1.5 / m.central(0, 0) ** 0.5:
            return (
                f"may not have {odd}: the target is symmetric about its centre in the goal view,"
                " where moments of odd order vanish; use sx and sy"
            )
        return ""

    @property
    def _order(self) -> int:
        orders = {"alpha": 3} | {row: order for row, (_, order) in INVARIANTS.items()}
        return max(orders.get(row, 2) for row in self.rows)

    def _named(self, *words: str) -> str:
        return ", ".join(word for word in words if word in self.rows)

    def _row(self, m: MomentSet, row: str) -> Any:
        if row in INVARIANTS:
            return INVARIANTS[row][0](m)[row]
        if row == "alpha":
            # fades under an elongation |c20|/c11 of .01
            return 0.5 * angle(m.complex(2, 0), 0.01 * (m.mu[..., 2, 0] + m.mu[..., 0, 2]))
        return place(m, row)


# distance of a marker from the fitted ellipse, as a share of its half axes, from which the outline
# counts as something else
OFF = 0.02


@spec
class Ellipse(Feature):
    """Functions of the ellipse through the markers, which lie on its outline; the rows of e and L
    are `rows`.

    xg, yg         the centre
    n20, n11, n02  second central moments of the region within, by its area a: for half axes A and
                   B, the first at the angle t,
                   n20 = (A^2 cos^2 t + B^2 sin^2 t)/4,
                   n11 = (A^2 - B^2) sin t cos t/4,
                   n02 = (A^2 sin^2 t + B^2 cos^2 t)/4
    xn, yn, an     xg/sqrt(a), yg/sqrt(a), 1/sqrt(a),
                   a = pi A B = 4 pi sqrt(n20 n02 - n11^2), as those of `moments`

    The ellipse is the conic that fits the markers best. L is that of the region's moments
    (`MomentSet`), whose third order vanishes, with the plane of the outline, 1/Z = A x + B y + C,
    from the depths of the markers; of a ball with centre P and radius R, whose outline is a circle,
    1/Z = P . (x, y, 1) / (|P|^2 - R^2).

    A ball tells three motions, and so does a disc that is seen face on: rows [xn, yn, an]. A disc
    tells five only where the goal view is at a slant to it. On a robot with more motions than that,
    `law.redundant` leaves the others alone.

    Args:
        rows: features, in this order.

    Reference: Espiau, Chaumette & Rives 1992, doi:10.1109/70.143350; with these moments: Chaumette
    2004, doi:10.1109/TRO.2004.829463.
    """

    kind: Literal["ellipse"] = "ellipse"
    rows: Annotated[
        tuple[Literal["xg", "yg", "n20", "n11", "n02", "xn", "yn", "an"], ...], Len(1, 8)
    ] = ("xg", "yg", "n20", "n11", "n02")
    least_markers = 5

    def measure(self, xy: Array) -> Array:
        """The vector s (..., rows) of points xy (..., N, 2) on the outline; NaN where the conic
        that fits them is no ellipse.
        """
        xy = np.asarray(xy, dtype=float)
        if xy.shape[-2] < self.least_markers:
            raise ParameterError.count(
                "xy", "at least five", "markers", xy.shape, why="fewer do not determine an ellipse"
            )
        m = ellipse_moments(fitted_ellipse(xy))
        return np.stack([_row(m, row) for row in self.rows], axis=-1)

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., rows, 6) of points xy (..., N, 2) on the outline and their depth (..., N) [m]."""
        xy, depth = self._checked(xy, depth)
        m = ellipse_moments(fitted_ellipse(xy)).in_plane(fitted_plane(xy, depth))
        return np.stack([_row(m, row).rate for row in self.rows], axis=-2)

    def check_goal(self, xy: Array, depth: Array) -> None:
        """Refuse a goal view, xy (N, 2) and depth (N,) [m], without an ellipse, or with one that
        does not tell what the rows say.
        """
        require_plane(xy, depth, self.kind)
        s = fitted_ellipse(xy)
        if not _on_outline(xy, s):
            words = (
                "must have its markers on the outline of an ellipse for the feature ellipse"
                " (a disc, or a ball); use moments or point"
            )
            raise ParameterError("target", words)
        units = {
            **dict.fromkeys(("n20", "n11", "n02"), s[2] + s[4]),
            **dict.fromkeys(("xn", "yn", "an"), place(ellipse_moments(s), "an")),
        }
        scale = np.array([units.get(row, 1.0) for row in self.rows])
        if condition(self.interaction(xy, depth), scale, depth) > MOST_CONDITION:
            words = (
                f"may not be {', '.join(self.rows)} at this goal, where they depend on one another:"
                " a ball, and a disc seen face on, tell three motions;"
                " use [xn, yn, an], or a goal at a slant to a disc"
            )
            raise ParameterError("law.feature.rows", words)


def _on_outline(xy: Array, s: Array) -> bool:
    """Whether points xy (N, 2) are on an ellipse s (5,), within OFF of its half axes."""
    if not np.isfinite(s).all():
        return False
    d = xy - s[:2]
    n = np.array([[s[2], s[3]], [s[3], s[4]]])
    # distance from the centre, by that of the ellipse in this direction
    reach = np.sqrt(np.einsum("ni,ij,nj->n", d, np.linalg.inv(4 * n), d))
    return np.abs(reach - 1).max() < OFF


def _row(m: MomentSet, row: str) -> Any:
    return m.central(int(row[1]), int(row[2])) / m.central(0, 0) if row[0] == "n" else place(m, row)


def ellipse_moments(s: Array) -> MomentSet:
    """The moments of the region in an ellipse s = (xg, yg, n20, n11, n02) (..., 5), up to third
    order.
    """
    n20, n11, n02 = np.moveaxis(s[..., 2:], -1, 0)
    area = 4 * np.pi * np.sqrt(n20 * n02 - n11 * n11)
    mu = np.zeros((*s.shape[:-1], 4, 4))
    mu[..., 0, 0] = area
    mu[..., 2, 0] = n20 * area
    mu[..., 1, 1] = n11 * area
    mu[..., 0, 2] = n02 * area
    return MomentSet(mu, s[..., :2], "region")


def fitted_ellipse(xy: Array) -> Array:
    """The ellipse (xg, yg, n20, n11, n02) (..., 5) that fits points xy (..., N, 2) best; NaN where
    the conic is no ellipse.

    About the points' mean, in units of their distance from it: the least squares of
    x^2 + y^2 + a (x^2 - y^2) + 2 b x y + c x + d y + e = 0, an equation that any ellipse has.
    """
    middle = xy.mean(axis=-2)
    about = xy - middle[..., None, :]
    unit = np.maximum(np.sqrt(np.square(about).sum(axis=-1).mean(axis=-1)), np.finfo(float).tiny)
    x, y = np.moveaxis(about / unit[..., None, None], -1, 0)
    design = np.stack([x * x - y * y, 2 * x * y, x, y, np.ones_like(x)], axis=-1)
    found = np.linalg.pinv(design) @ -(x * x + y * y)[..., None]
    a, b, c, d, e = np.moveaxis(found[..., 0], -1, 0)
    det = 1 - a * a - b * b  # of the quadratic form [[1 + a, b], [b, 1 - a]]
    det = np.where(det > 0, det, np.nan)
    xc = -0.5 * ((1 - a) * c - b * d) / det
    yc = -0.5 * ((1 + a) * d - b * c) / det
    level = -(e + 0.5 * (c * xc + d * yc))  # the quadratic form at the ellipse, about its centre
    level = np.where(level > 0, level, np.nan)
    n = np.stack([1 - a, -b, 1 + a], axis=-1) * (0.25 * level / det * unit**2)[..., None]
    return np.concatenate([middle + np.stack([xc, yc], axis=-1) * unit[..., None], n], axis=-1)
