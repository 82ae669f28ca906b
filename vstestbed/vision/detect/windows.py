"""Windows round things that are tracked: where the next picture is looked at."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vstestbed.camera import Camera, Window

Move = tuple[float, float]
"""By how much a thing moved from one picture to the next [px]."""
MOST_WINDOWED = 0.3
"""Share of all pictures that windows may cover together; beyond it, one search of the whole pictures is quicker."""


def window_round(box: Window, move: Move, lens: Camera, margin: float) -> Window | None:
    """A window round a thing's predicted box, with `margin` [px] and half of the move about it; None outside of the picture."""
    (left, top, right, bottom), (du, dv) = box, move
    grow_u, grow_v = margin + abs(du) / 2, margin + abs(dv) / 2
    window = (
        max(0, int(left + du - grow_u)),
        max(0, int(top + dv - grow_v)),
        min(lens.width, math.ceil(right + du + grow_u)),
        min(lens.height, math.ceil(bottom + dv + grow_v)),
    )
    return window if window[0] < window[2] and window[1] < window[3] else None


def windows_round(
    boxes: Sequence[Window | None], moves: Sequence[Move], panels: Sequence[int], camera: Camera, margin: float
) -> list[Window] | None:
    """A window round each thing's predicted box in its panel of the camera; None where one is lost or the whole is quicker.

    Args:
        boxes: where the things were [px], None: lost. moves: by how much each had moved since the picture before.
        panels: in which of the camera's panels each is. margin: what a window has round the predicted box [px].
    """
    out: list[Window] = []
    for box, move, panel in zip(boxes, moves, panels, strict=True):
        window = window_round(box, move, camera.panels[panel].lens, margin) if box else None
        if window is None:
            return None
        out.append(window)
    covered = sum((w[2] - w[0]) * (w[3] - w[1]) for w in out)
    return out if out and covered <= MOST_WINDOWED * sum(p.lens.width * p.lens.height for p in camera.panels) else None
