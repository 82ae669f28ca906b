"""Moments of a shape in the image: where it is, how large, how it is turned, and how it is tilted."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.angles import wrap
from vstestbed.features.base import MOST_CONDITION, checked, condition, require_plane
from vstestbed.features.image_moments import MomentSet, Of, fitted_plane, place
from vstestbed.features.invariants import INVARIANTS
from vstestbed.features.polygon import segments, size, spans_area
from vstestbed.features.rated import angle

Row = Literal[  # fmt: skip - one name a line would hide the groups
    "xn", "yn", "an", "xg", "yg", "area", "alpha", "sx", "sy", "px", "py", "c1", "c2", "c3", "c4", "c5", "c6", "c7", "c8", "c9", "c10"
]
FADES = 0.01
"""Elongation |c20|/c11 under which the row of alpha fades."""
DIRECTED = 0.1
"""Skewness over which third-order moments tell the two ends of the principal axis apart. A tilt of some 20 degrees gives a symmetric shape
a third of that."""
ROUND = 0.05
"""Elongation of a shape in the goal view under which its principal axis counts as undefined."""
SINGULAR = 1e12
"""Condition over which L counts as singular, whatever rounding has made of it."""
SYMMETRIC = 0.02
"""Share of third-order moments in the goal view under which a shape counts as symmetric about its centre."""


@spec
class Moments:
    """Functions of the moments of all markers together, or of the region that they enclose; the rows of e and L are `rows`.

    m_pq is the sum of x^p y^q over the points, or its integral over the region; mu_pq the same about the centroid (xg, yg).

    xg, yg     the centroid, m10/m00 and m01/m00
    area       a = m00 of a region, mu20 + mu02 of points
    xn, yn     xg/sqrt(a) and yg/sqrt(a)
    an         1/sqrt(a)
    alpha      angle of the principal axis, atan2(2 mu11, mu20 - mu02)/2
    sx to c10  ratios that tell the tilt; `features/invariants.py` has their equations

    Where the target faces the camera at the depth Z, xn, yn and an move by 1/(Z sqrt(a)) times the camera's motion along x, y and z, a
    factor that does not depend on Z. (In print they have the factor Z* sqrt(a*) of the goal, which makes them metres.)

    Which pair suits for the tilt depends on the shape. One that hardly tells it makes L ill-conditioned at the goal, and is refused there
    with the pair that is conditioned best. sx and sy suit an L and a rectangle, also other shapes that are symmetric about their centre.
    They do not suit every elongated shape: those of a whale, or of an arrow, are nearly functions of the other rows, and there c4 and c6
    suit. px and py, c1 and c2, c4 and c6 need a shape without that symmetry, and px, py and c1, c2 one that is not its own mirror image
    either. Of an L px and py converge from farther away than sx and sy, and are some four times as sensitive to noise; all four of them
    converge from the most starts, and so does, of the matrices, the mean (`law.interaction`): at some views the current one is singular,
    and six rows can vanish at another pose than the goal. An ellipse tells less than six motions: use the feature `ellipse`.

    alpha is an axis without a direction. Where third-order moments are large enough in both views, they tell its two ends apart, and its
    error is within half a turn, else within a quarter. To this end s has t = c21 sqrt(m00)/c11^(3/2) behind the rows where alpha is one.

    L follows from that of the moments (`MomentSet`), with the plane 1/Z = A x + B y + C that fits the depths of the markers best. They must
    lie in one plane.

    Args:
        of: `points`, sums over the markers; `region`, integrals over the region whose outline the markers are, in order, either way
            round. It is the polygon of the markers, integrated without error (Green's theorem).
        rows: features, in this order. Six determine all motions of a camera: three places, two for the tilt, alpha.

    References: Chaumette 2004, doi:10.1109/TRO.2004.829463; Tahri & Chaumette 2005, doi:10.1109/TRO.2005.853500.
    """

    kind: Literal["moments"] = "moments"
    of: Of = "points"
    rows: Annotated[tuple[Row, ...], Len(1, 12)] = ("xn", "yn", "an", "sx", "sy", "alpha")
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 0
    least_markers: ClassVar[int] = 3

    def __post_init__(self) -> None:
        """Refuse a row that is there twice."""
        if twice := [row for i, row in enumerate(self.rows) if row in self.rows[:i]]:
            raise ParameterError("rows", f"has {twice[0]} twice; name each row once", list(self.rows))

    def measure(self, xy: Array) -> Array:
        """The vector s (..., rows), with t (2) behind the rows where alpha is one of them, of xy (..., N, 2)."""
        m = MomentSet.measured(xy, self.of, self._order)
        values = [self._row(m, row) for row in self.rows]
        if "alpha" in self.rows:
            t = skewness(m)
            values += [t.real, t.imag]
        return np.stack(values, axis=-1)

    def interaction(self, xy: Array, depth: Array) -> Array:
        """L (..., rows, 6) of xy (..., N, 2) and depth (..., N) [m].

        Raises:
            ParameterError: the shapes do not match, there are fewer than three markers, or a depth is not positive.
        """
        xy, depth = checked(xy, depth, self.inputs, self.least_markers)
        m = MomentSet.measured(xy, self.of, self._order + 1).in_plane(fitted_plane(xy, depth))
        return np.stack([self._row(m, row).rate for row in self.rows], axis=-2)

    def error(self, s: Array, s_star: Array) -> Array:
        """Error e (..., rows): s - s*, with alpha's in (-pi, pi] rad where its axis has a direction, else in (-pi/2, pi/2]."""
        s, s_star, n = np.asarray(s, dtype=float), np.asarray(s_star, dtype=float), len(self.rows)
        e = s[..., :n] - s_star[..., :n]
        if "alpha" in self.rows:
            i = self.rows.index("alpha")
            e[..., i] = axis_error(e[..., i], s[..., n:], s_star[..., n:])
        return e

    def check_goal(self, xy: Array, depth: Array) -> None:
        """Refuse a goal view, xy (N, 2) and depth (N,) [m], that leaves a row undefined or the rows dependent on one another.

        Raises:
            ParameterError: it names the target or the rows, and what would work.
        """
        require_plane(xy, depth, self.kind)
        if self.of == "region" and not spans_area(size(xy), segments(xy)):
            words = "encloses no area in the goal view, which moments {of: region} need; its markers must be in order around an outline"
            raise ParameterError("target", words)
        m = MomentSet.measured(xy, self.of, 3)
        if words := self._symmetry(m):
            raise ParameterError("law.feature.rows", words)
        found = self._condition(m, xy, depth)
        if found > MOST_CONDITION:
            words = f"may not be {', '.join(self.rows)}: they depend on one another in the goal view, where L has"
            limit = f"the condition {found:.2g} (at most {MOST_CONDITION:g} is accepted)" if found < SINGULAR else "no inverse"
            raise ParameterError("law.feature.rows", f"{words} {limit}; {self._advice(m, xy, depth)}")

    def _condition(self, m: MomentSet, xy: Array, depth: Array) -> float:
        """The condition of L at a view."""
        scale = np.abs([place(m, row) if row in ("an", "area") else place(m, "an") if row in ("xn", "yn") else 1.0 for row in self.rows])
        return condition(self.interaction(xy, depth), scale, depth)

    def _advice(self, m: MomentSet, xy: Array, depth: Array) -> str:
        """Which two ratios would work best in place of these, of all pairs; where none would, that the shape may be an ellipse."""
        before = [row for row in self.rows if row in INVARIANTS]
        best, pair = MOST_CONDITION, ()
        for names in combinations(INVARIANTS, 2) if before else ():
            other = replace(self, rows=tuple(row for row in self.rows if row not in INVARIANTS) + names)
            if other._symmetry(m):
                continue
            found = other._condition(m, xy, depth)
            if found < best:
                best, pair = found, names
        if not pair:
            return "the target may be an ellipse; use fewer rows, feature ellipse, or another target"
        return f"use {' and '.join(pair)} in place of {' and '.join(before)}, which have the condition {best:.2g}"

    def _symmetry(self, m: MomentSet) -> str:
        """Why a symmetry of the shape leaves rows undefined; "" where it does not."""
        c11 = m.complex(1, 1).real
        axial = self._named("alpha", "sx", "sy", "c1")
        if axial and np.abs(m.complex(2, 0)) < ROUND * c11:
            words = (
                f"may not have {axial}: the target is as wide as long in the goal view (a disc, a square, a regular polygon), and has no"
            )
            return f"{words} principal axis; leave them out, or use an elongated target"
        odd = self._named("py", "c2", "c3", "c4", "c5", "c6", "c9", "c10")
        if odd and max(abs(m.complex(3, 0)), abs(m.complex(2, 1))) < SYMMETRIC * c11**1.5 / m.central(0, 0) ** 0.5:
            words = f"may not have {odd}: the target is symmetric about its centre in the goal view, where moments of odd order vanish"
            return f"{words}; use sx and sy"
        return ""

    @property
    def _order(self) -> int:
        """The highest order of moments in the rows."""
        orders = {row: order for row, (_, order) in INVARIANTS.items()} | {"alpha": 3}
        return max(orders.get(row, 2) for row in self.rows)

    def _named(self, *words: str) -> str:
        """Those of the words that are rows, for a message; "" for none."""
        return ", ".join(word for word in words if word in self.rows)

    def _row(self, m: MomentSet, row: str) -> Any:
        """One row as an array (...), or as a Rated."""
        if row in INVARIANTS:
            return INVARIANTS[row][0](m)
        if row == "alpha":
            return 0.5 * angle(m.complex(2, 0), FADES * (m.mu[..., 2, 0] + m.mu[..., 0, 2]))
        return place(m, row)


def skewness(m: MomentSet) -> Any:
    """The vector t = c21 sqrt(m00)/c11^(3/2), complex: it turns with the shape, and does not change with its size and place."""
    return m.complex(2, 1) * m.central(0, 0) ** 0.5 / m.complex(1, 1).real ** 1.5


def axis_error(e: Array, t: Array, t_star: Array) -> Array:
    """Error (...) [rad] of a principal axis from a difference e of angles, and the vectors t and t* (..., 2) of both views.

    In (-pi/2, pi/2]; or, where both vectors are longer than DIRECTED, by half a turn more if that is nearer to the angle between them.
    """
    half = wrap(2 * e) / 2
    z, z_star = t[..., 0] + 1j * t[..., 1], t_star[..., 0] + 1j * t_star[..., 1]
    whole = wrap(half + np.pi * np.round((np.angle(z * np.conj(z_star)) - half) / np.pi))
    return np.where(np.minimum(np.abs(z), np.abs(z_star)) > DIRECTED, whole, half)
