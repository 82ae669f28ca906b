"""The inset of a photometric film: its name is whole and legible on any picture, in the smallest
films, too.
"""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.report.video.film import DRAFT, replay_of, rows_of
from vstestbed.report.video.overlay import (
    SHARE,
    WORDS,
    FilmFrame,
    Residual,
    _label,
    text_size,
    text_width,
)


@pytest.mark.parametrize(("width", "height"), [(320, 240), (640, 480), (1280, 720)])
@pytest.mark.parametrize("grey", [255, 0])
def test_the_name_is_whole_on_light_and_dark(width: int, height: int, grey: int) -> None:
    inset = np.full((round(SHARE * height), round(SHARE * width), 3), grey, np.uint8)
    size = text_size(height)
    _label(inset, size)
    assert size // 2 + text_width(WORDS, size) < inset.shape[1]
    strip, below = inset[: round(1.5 * size)], inset[round(1.5 * size) + 1 :]
    # white letters on what is darkened
    assert strip[0, 0].max() <= round(0.35 * grey) and strip.max() > 200
    assert (below == grey).all()
    lit = np.flatnonzero((strip > 200).any(axis=(0, 2)))
    assert lit[0] >= 1 and lit[-1] < inset.shape[1] - 1


def test_the_goals_picture_taken_again_is_that_before_the_target_changed() -> None:
    small = {
        "camera.width": 64,
        "camera.height": 48,
        "camera.renderer": "rays",
        "law.levels": 1,
        "stop.duration_s": 0.1,
    }
    taken = []
    for noise in ({}, {"image_sigma": 40}):
        s = vs.load("camera_photometric", small | {"noise.target": noise})
        with closing(replay_of(s, DRAFT)) as replay:
            frame = FilmFrame.of_row(next(iter(rows_of(vs.run(s).rows))), s)
            residual = Residual(s, replay)
            taken.append(residual._goal_image(frame, 0))
            assert replay.seen(frame.t) is None  # it is no picture of the run
    np.testing.assert_array_equal(*taken)
