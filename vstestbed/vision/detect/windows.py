"""Search windows around tracked objects in the next picture."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vstestbed.camera import Camera, Window

Move = tuple[float, float]
"""Displacement (du, dv) of an object from one picture to the next [px]."""
MOST_WINDOWED = 0.3
"""Share of the image area that the windows may cover together; beyond it a search of the whole image is faster."""


def window_round(box: Window, move: Move, lens: Camera, margin: float) -> Window | None:
    """The window around an object's predicted box, clipped to the image; None outside of the image.

    The box is predicted at constant velocity; the window has `margin` [px] and half of the last move around it.
    """
    (left, top, right, bottom), (du, dv) = box, move
    grow_u, grow_v = margin + abs(du) / 2, margin + abs(dv) / 2
    left, top = max(0, int(left + du - grow_u)), max(0, int(top + dv - grow_v))
    right, bottom = min(lens.width, math.ceil(right + du + grow_u)), min(lens.height, math.ceil(bottom + dv + grow_v))
    return (left, top, right, bottom) if left < right and top < bottom else None


def windows_round(
    boxes: Sequence[Window | None], moves: Sequence[Move], panels: Sequence[int], camera: Camera, margin: float
) -> list[Window] | None:
    """A window around each object's predicted box, in its panel; None where an object is lost or a whole search is faster.

    Args:
        boxes: bounding boxes in the last picture [px]; None for a lost object.
        moves: displacements since the picture before [px].
        panels: index of the camera's panel in which each object is.
        margin: margin around the predicted box [px].
    """
    out: list[Window] = []
    for box, move, panel in zip(boxes, moves, panels, strict=True):
        window = window_round(box, move, camera.panels[panel].lens, margin) if box else None
        if window is None:
            return None
        out.append(window)
    covered = sum((w[2] - w[0]) * (w[3] - w[1]) for w in out)
    return out if out and covered <= MOST_WINDOWED * sum(p.lens.width * p.lens.height for p in camera.panels) else None
