"""The picture of the camera's way: it fills its figure, and its words stand clear of the legend."""

from __future__ import annotations

import re

import numpy as np
import polars as pl
import pytest

from vstestbed.core.geometry import Array, quaternion_wxyz
from vstestbed.report import Setting
from vstestbed.report.chart import ChartPanel, Space
from vstestbed.report.run import space as path3d
from vstestbed.report.run.tracks import LogArrays

NAMES = ("x", "y", "z", "qw", "qx", "qy", "qz")


def tracks(span: Array) -> LogArrays:
    """A camera that goes straight by `span` (3,) [m] from the origin,
    the target at the way's end.
    """
    columns = {"t": np.linspace(0, 1, 20)}
    still = [*span, *quaternion_wxyz(np.eye(3))]
    for stem, share in (("cam", np.linspace(0, 1, 20)), ("tgt", np.ones(20))):
        columns |= {
            f"{stem}_{n}": value * (share if n in "xyz" else 1.0)
            for n, value in zip(NAMES, still, strict=True)
        }
    return LogArrays(
        pl.DataFrame(columns), Setting(points=0.1 * np.eye(3), T_camera_target=np.eye(4))
    )


@pytest.mark.parametrize("span", [(0, 0, 5), (3, 0.2, 0.1), (0.2, 3, 0.1), (1, 1, 1), (0, 0, 1e-4)])
def test_words_stand_inside_the_figure_and_the_drawing_fills_it(
    span: tuple[float, float, float],
) -> None:
    chart = path3d.camera_path(tracks(np.array(span, dtype=float)))
    assert chart is not None
    drawing = chart.svg("Camera path")
    width, height = (
        float(n) for n in re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)" font-size', drawing)[0]
    )
    words = re.findall(
        r'<text x="([\d.-]+)" y="([\d.-]+)" dy=".35em" text-anchor="(\w+)">([^<]*)<', drawing
    )
    # the letters, and two numbers on each axis
    assert {"x [m]", "y [m]", "z [m]"} <= {text for *_, text in words} and len(words) >= 9
    for x, y, anchor, text in words:
        # letters of 9.5 pt are about 6 pt wide
        left = float(x) - {"start": 0, "middle": 0.5, "end": 1}[anchor] * 6 * len(text)
        assert left > 0 and left + 6 * len(text) < width and 5 < float(y) < height - 5
    box = re.findall(r'<svg x="[\d.]+" y="[\d.]+" width="([\d.]+)" height="([\d.]+)"', drawing)[0]
    assert float(box[0]) > 0.75 * width or float(box[1]) > 0.75 * height


def test_the_view_is_as_long_in_all_directions_of_the_picture() -> None:
    space = Space(ChartPanel(), 22, -62)
    np.testing.assert_allclose(space.across @ space.across.T, np.eye(2), atol=1e-12)
    # z is up
    np.testing.assert_allclose(space.across @ [0, 0, 1], [0, np.cos(np.radians(22))], atol=1e-12)
