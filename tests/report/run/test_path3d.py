"""The picture of the camera's way: it fills its figure, and its words stand clear of the legend."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from vstestbed.core.geometry import Array, quaternion_wxyz
from vstestbed.report import Setting
from vstestbed.report.html.canvas import style
from vstestbed.report.run import path3d
from vstestbed.report.run.tracks import Tracks

NAMES = ("x", "y", "z", "qw", "qx", "qy", "qz")


def tracks(span: Array) -> Tracks:
    """A camera that goes straight by `span` (3,) [m] from the origin, the target at the way's end."""
    columns = {"t": np.linspace(0, 1, 20)}
    still = [*span, *quaternion_wxyz(np.eye(3))]
    for stem, share in (("cam", np.linspace(0, 1, 20)), ("tgt", np.ones(20))):
        columns |= {f"{stem}_{n}": value * (share if n in "xyz" else 1.0) for n, value in zip(NAMES, still, strict=True)}
    return Tracks(pl.DataFrame(columns), Setting(points=0.1 * np.eye(3), T_camera_target=np.eye(4)))


@pytest.mark.parametrize("span", [(0, 0, 5), (3, 0.2, 0.1), (0.2, 3, 0.1), (1, 1, 1), (0, 0, 1e-4)])
def test_words_stand_clear_of_the_legend_and_inside_the_figure(span: tuple[float, float, float]) -> None:
    with style():
        figure = path3d.camera_path(tracks(np.array(span, dtype=float)))
        assert figure is not None
        figure.draw_without_rendering()
        renderer = figure.canvas.get_renderer()
        legend, axes = figure.legends[0].get_window_extent(renderer), figure.axes[0]
        boxes = [axis.get_tightbbox(renderer) for axis in (axes.xaxis, axes.yaxis, axes.zaxis)]
    low = np.min([box.min for box in boxes], axis=0)
    high = np.max([box.max for box in boxes], axis=0)
    width, height = figure.bbox.size
    assert low[1] > legend.y1
    assert low[0] > 0 and high[0] < width and high[1] < height
    assert high[1] - low[1] > 0.75 * height or high[0] - low[0] > 0.75 * width
