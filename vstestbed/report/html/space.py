"""Views of space for charts: points (x, y, z) in parallel projection, and a box with the axes' numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.report.html.canvas import INK, RULE
from vstestbed.report.html.chart import ChartPanel
from vstestbed.report.html.ticks import numerals, ticks


class Space:
    """A panel that shows space from a direction, z up and equal scale. Its methods have the names of matplotlib's 3-D axes."""

    def __init__(self, panel: ChartPanel, elev: float, azim: float):
        """`elev`, `azim`: elevation and azimuth of the viewer from the origin [deg]."""
        panel.equal = panel.bare = True
        self.panel, self.elev, self.azim = panel, elev, azim
        (se, sa), (ce, ca) = np.sin(np.radians([elev, azim])), np.cos(np.radians([elev, azim]))
        self.across = np.array([[-sa, ca, 0.0], [-se * ca, -se * sa, ce]])
        """The directions right and up of the picture in space, shape (2, 3)."""

    def plot(self, x: Any, y: Any, z: Any, **look: Any) -> None:
        """Add a line (see `chart.Curve`)."""
        self.panel.plot(*(self.across @ np.stack([x, y, z])), **look)

    def text(self, x: float, y: float, z: float, s: str, color: str = INK, ha: str = "center", va: str = "center") -> None:
        """Add words, vertically centred (`va` is there for matplotlib's axes); `ha`: left, center or right."""
        assert va == "center"
        u, v = self.across @ (x, y, z)
        self.panel.words.append((u, v, s, {"left": "start", "center": "middle", "right": "end"}[ha], color))

    def box(self, low: Array, high: Array, most: int = 5) -> None:
        """The three far sides of a box from `low` to `high` (3,) [m] with a grid, and its numbers; for a viewer at +x, -y and +z."""
        far = np.array([low[0], high[1], low[2]])  # the corner farthest from the viewer
        # per axis the corner of its numbered edge, the direction out of the box there, and the numbers' alignment
        right = np.array([*self.across[0, :2], 0.0])
        edges = (
            (low, np.array([0, -1.0, 0]), "right"),
            (np.array([high[0], low[1], low[2]]), np.array([1.0, 0, 0]), "left"),
            (low, -right, "right"),
        )
        size = float((high - low).max())
        for axis, (corner, out, side) in enumerate(edges):
            at = ticks(low[axis], high[axis], max(2, round(most * (high - low)[axis] / size)))
            for value in (low[axis], *at, high[axis]):
                for other in {0, 1, 2} - {axis}:
                    ends = np.array([far, far])
                    ends[:, axis], ends[:, other] = value, (low[other], high[other])
                    self.plot(*ends.T, color=RULE, linewidth=0.6, alpha=0.45, zorder=0)
            for value, words in zip(at, numerals(at), strict=True):
                self._beside(corner, axis, value, 0.025 * size * out, words, side)
            edge = np.array([corner, corner])
            edge[:, axis] = low[axis], high[axis]
            self.plot(*edge.T, color=RULE, linewidth=0.8, zorder=0)
            self._beside(corner, axis, (low + high)[axis] / 2, (0.17 if axis < 2 else 0.15) * size * out, f"{'xyz'[axis]} [m]", side)

    def _beside(self, corner: Array, axis: int, value: float, shift: Array, words: str, side: str) -> None:
        """Words beside a point of an edge."""
        at = corner + shift
        at[axis] += value - corner[axis]
        x, y, z = at.tolist()
        self.text(x, y, z, words, ha=side)
