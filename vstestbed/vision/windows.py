"""Windows round things that are tracked: where the next picture is looked at."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vstestbed.vision.find import Window

MOST_WINDOWED = 0.3
"""Share of the picture that windows may cover together; beyond it, one search of the whole picture is quicker."""


def windows_round(
    boxes: Sequence[Window | None], moves: Sequence[tuple[float, float]], width: int, height: int, margin: float
) -> list[Window] | None:
    """A window round each thing's predicted box, within the picture; None where one is lost or the whole is quicker.

    Args:
        boxes: where the things were, None: lost.
        moves: by how much each had moved since the picture before [px].
        width, height: of the picture.
        margin: what a window has round the predicted box, besides half of the last move [px].
    """
    windows: list[Window] = []
    for box, (du, dv) in zip(boxes, moves, strict=True):
        if box is None:
            return None
        left, top, right, bottom = box
        grow_u, grow_v = margin + abs(du) / 2, margin + abs(dv) / 2
        window = (
            max(0, int(left + du - grow_u)),
            max(0, int(top + dv - grow_v)),
            min(width, math.ceil(right + du + grow_u)),
            min(height, math.ceil(bottom + dv + grow_v)),
        )
        if window[0] >= window[2] or window[1] >= window[3]:
            return None
        windows.append(window)
    covered = sum((w[2] - w[0]) * (w[3] - w[1]) for w in windows)
    return windows if windows and covered <= MOST_WINDOWED * width * height else None
