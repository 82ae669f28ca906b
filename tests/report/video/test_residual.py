"""The inset of a photometric film: its name is whole and legible on any picture, in the smallest films, too."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.report.video.overlay import text_size, text_width
from vstestbed.report.video.residual import SHARE, WORDS, _label


@pytest.mark.parametrize(("width", "height"), [(320, 240), (640, 480), (1280, 720)])
@pytest.mark.parametrize("grey", [255, 0])
def test_the_name_is_whole_on_light_and_dark(width: int, height: int, grey: int) -> None:
    inset = np.full((round(SHARE * height), round(SHARE * width), 3), grey, np.uint8)
    size = text_size(height)
    _label(inset, size)
    assert size // 2 + text_width(WORDS, size) < inset.shape[1]
    strip, below = inset[: round(1.5 * size)], inset[round(1.5 * size) + 1 :]
    assert strip[0, 0].max() <= round(0.35 * grey) and strip.max() > 200  # white letters on what is darkened
    assert (below == grey).all()
    lit = np.flatnonzero((strip > 200).any(axis=(0, 2)))
    assert lit[0] >= 1 and lit[-1] < inset.shape[1] - 1
