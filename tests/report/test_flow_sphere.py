"""The picture of the optical flow on the sphere: what lies on the far side is left out, nothing
leaves the picture.
"""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.report.canvas import style
from vstestbed.report.marks import INK, RULE
from vstestbed.report.optical_flow import MOTIONS, draw_sphere
from vstestbed.report.run.space import drawn, towards_viewer


@pytest.mark.filterwarnings("error")
def test_flow_on_the_sphere() -> None:
    with style():
        figure = draw_sphere(2.0)
        figure.draw_without_rendering()
    assert [axes.get_title() for axes in figure.axes] == list(MOTIONS)
    renderer, picture = figure.canvas.get_renderer(), figure.bbox
    for axes in figure.axes:
        assert [word.get_text() for word in axes.texts] == ["z", "x", "y"]
        viewer = drawn(towards_viewer(axes))
        on_ball = [
            np.array(line.get_data_3d())
            for line in axes.lines
            if line.get_color() in (RULE, INK) and len(line.get_xdata()) > 2
        ]
        for p in on_ball:
            np.testing.assert_allclose(np.linalg.norm(p, axis=0)[np.isfinite(p[0])], 1, atol=1e-9)
            assert np.nanmin(viewer @ p, initial=1) >= 0
        for line in axes.lines:
            box = line.get_window_extent(renderer)
            assert (
                picture.x0 <= box.x0
                and box.x1 <= picture.x1
                and picture.y0 <= box.y0
                and box.y1 <= picture.y1
            )
