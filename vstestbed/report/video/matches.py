"""Overlay of matches: lines from natural features to where the goal's picture has them."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.report.video.overlay import GOAL, INK, SHIFT, UNIT, Color, Overlay
from vstestbed.report.video.writer import Image
from vstestbed.scenario.scenario import Scenario

MEASURED: Final[Color] = (255, 214, 64)


class MatchOverlay(Overlay):
    """Draws each matched point, a ring where the goal's picture has it, and a line between them; no trails: the points come and go.

    Args:
        width, height: image size [px]. rows: number of points. title: text in the lower right corner.
    """

    def __init__(self, width: int, height: int, rows: int, title: str = ""):
        super().__init__(width, height, np.ones((rows, 3)), title)
        self._point, self._ring = max(1.6, height / 140), max(4.0, height / 75)

    def marks(self, image: Image, uv: Array, goal_uv: Array | None) -> None:
        """Draw the matches alone."""
        uv = self._drawable(uv)
        seen = np.isfinite(uv).all(axis=1)
        if goal_uv is not None:
            goal = self._drawable(goal_uv)
            both = seen & np.isfinite(goal).all(axis=1)
            self._ways(image, uv[both], goal[both])
            self._rings(image, goal[both], GOAL, self._stroke)
        self._rings(image, uv[seen], MEASURED, -1)

    def _rings(self, image: Image, uv: Array, color: Color, width: int) -> None:
        """A circle at each pixel, filled where the width is negative, with a dark border."""
        size = self._ring if width > 0 else self._point
        for u, v in np.rint(uv * UNIT).astype(int).tolist():
            border = width + 2 * self._stroke if width > 0 else -1
            cv2.circle(image, (u, v), round((size + (self._stroke if width < 0 else 0)) * UNIT), INK, border, cv2.LINE_AA, SHIFT)
            cv2.circle(image, (u, v), round(size * UNIT), color, width, cv2.LINE_AA, SHIFT)


def overlay_of(scenario: Scenario, size: tuple[int, int], title: str = "") -> Overlay:
    """The overlay for what a scenario's detector reports; size: (width, height) of the image [px]."""
    if scenario.detector.changing:
        return MatchOverlay(*size, scenario.rows, title)
    colors, outlined = scenario.target.colors[: scenario.rows], scenario.target.outlined
    return Overlay(*size, colors, title, outlined, joined=scenario.detector.needs_sheet)
