"""Moments of a shape in the image: where it is, how large, how it is turned, and how it is tilted."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Len

from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.features.angles import wrap
from vstestbed.features.base import checked
from vstestbed.features.image_moments import MomentSet, Of, fitted_plane
from vstestbed.features.invariants import INVARIANTS
from vstestbed.features.rated import Rated, angle

Row = Literal[
    "xg", "yg", "area", "xn", "yn", "an", "alpha", "c1", "c2", "c3", "c4", "c5", "c6", "c7", "c8", "c9", "c10", "sx", "sy", "px", "py"
]
ROUND = 1e-2
"""Elongation |c20|/c11 under which the row of alpha fades: a shape as wide as long has no principal axis."""
DIRECTED = 0.05
"""Skewness over which third-order moments tell the two ends of the principal axis apart."""


@spec
class Moments:
    rows: Annotated[tuple[Row, ...], Len(1, 12)] = ("xn", "yn", "an", "c4", "c6", "alpha")
    kind: Literal["moments"] = "moments"
    of: Of = "points"
    inputs: ClassVar[tuple[str, ...]] = ("xy", "depth")
    rows_per_marker: ClassVar[int] = 0
    least_markers: ClassVar[int] = 3

    def measure(self, xy: Array) -> Array:
        m = MomentSet.measured(xy, self.of, self._order)
        values = [self._row(m, row) for row in self.rows]
        if "alpha" in self.rows:
            skew = skewness(m)
            values += [skew.real, skew.imag]
        return np.stack(values, axis=-1)

    def interaction(self, xy: Array, depth: Array) -> Array:
        xy, depth = checked(xy, depth, self.inputs, self.least_markers)
        m = MomentSet.measured(xy, self.of, self._order + 1).in_plane(fitted_plane(xy, depth))
        return np.stack([self._row(m, row).rate for row in self.rows], axis=-2)

    def error(self, s: Array, s_star: Array) -> Array:
        s, s_star = np.asarray(s, dtype=float), np.asarray(s_star, dtype=float)
        n = len(self.rows)
        e = s[..., :n] - s_star[..., :n]
        if "alpha" in self.rows:
            i = self.rows.index("alpha")
            e[..., i] = turned(e[..., i], s[..., n:], s_star[..., n:])
        return e

    @property
    def _order(self) -> int:
        return max(3 if row == "alpha" else INVARIANTS[row][1] if row in INVARIANTS else 2 for row in self.rows)

    @staticmethod
    def _row(m: MomentSet, row: str) -> Any:
        if row in INVARIANTS:
            return INVARIANTS[row][0](m)
        if row == "alpha":
            c11 = m.complex(1, 1)
            c11 = (c11.value if isinstance(c11, Rated) else c11).real
            return 0.5 * angle(m.complex(2, 0), ROUND * c11)
        size = m.area**-0.5
        return {
            "xg": lambda: m.xg,
            "yg": lambda: m.yg,
            "area": lambda: m.area,
            "xn": lambda: m.xg * size,
            "yn": lambda: m.yg * size,
            "an": lambda: size,
        }[row]()


def skewness(m: MomentSet) -> Any:
    return m.complex(2, 1) * m.central(0, 0) ** 0.5 / m.complex(1, 1).real ** 1.5


def turned(e: Array, t: Array, t_star: Array) -> Array:
    half = wrap(2 * e) / 2
    z, z_star = t[..., 0] + 1j * t[..., 1], t_star[..., 0] + 1j * t_star[..., 1]
    told = np.minimum(np.abs(z), np.abs(z_star)) > DIRECTED
    whole = half + np.pi * np.round((np.angle(z * np.conj(z_star)) - half) / np.pi)
    return np.where(told, whole, half)
