"""Figures over time: noise does not fill their height; errors in the image are shown in the unit
that they are measured in.
"""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

from vstestbed.core.geometry import Array
from vstestbed.report import Setting
from vstestbed.report.run import figures, space
from vstestbed.report.run.tracks import LogArrays

T = 50
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


def tracks(depth: Array, twist: Array) -> LogArrays:
    """One marker's depth (T,) [m], and all components of the commanded and the true twist (T,) [m/s
    or rad/s].
    """
    t = np.arange(T) / 10
    columns = {"t": t, "t_cmd": t, "u_0": 0 * t, "v_0": 0 * t, "depth_0": depth}
    return LogArrays(
        pl.DataFrame(columns | {f"{kind}_{a}": twist for kind in ("cmd", "act") for a in TWIST}),
        Setting(),
    )


@pytest.mark.parametrize("depth", [1.0, -3.0])
def test_noise_does_not_fill_the_height(depth: float) -> None:
    noise = np.random.default_rng(0).normal(0, 1e-5, T)
    run = tracks(depth + noise, noise)
    low, high = figures.depth(run).panels[0].limits()[1]
    assert high - low == pytest.approx(0.02 * abs(depth), rel=1e-3)
    assert low < depth < high
    for panel in figures.twist(run).panels:
        low, high = panel.limits()[1]
        assert high - low == pytest.approx(2e-3) and low < 0 < high


def test_real_changes_have_the_axis_that_fits_them() -> None:
    s = np.linspace(0, 1, T)
    run = tracks(1 + s, 0.1 * s)
    low, high = figures.depth(run).panels[0].limits()[1]
    assert 0.9 < low < 1 and 2 < high < 2.1
    low, high = figures.twist(run).panels[0].limits()[1]
    assert -0.01 < low < 0 and 0.1 < high < 0.11


def test_of_a_region_the_outlines_at_start_end_and_goal_are_drawn() -> None:
    corners, s = [(100.0, 50.0), (160.0, 50.0), (160.0, 90.0)], np.linspace(0, 40, T)
    columns = {"t": np.arange(T) / 10}
    for i, corner in enumerate(corners):
        for name, x, way in zip("uv", corner, (s, 0 * s), strict=True):
            columns |= {
                f"{name}_{i}": x + way,
                f"{name}_true_{i}": x + way,
                f"{name}_goal_{i}": x + 0 * s,
            }
    chart = space.features(LogArrays(pl.DataFrame(columns), Setting(outlined=True)))
    assert chart is not None
    lines = {
        line.label: line
        for line in chart.panels[0].curves
        if line.label in ("start", "end", "goal")
    }
    for label, way in (("start", 0.0), ("end", 40.0), ("goal", 0.0)):
        np.testing.assert_allclose(
            np.column_stack([lines[label].x, lines[label].y]),
            np.array([*corners, corners[0]]) + [way, 0],
        )


@pytest.mark.parametrize(
    ("measured", "labels"),
    [(("grey",), ["grey levels"]), (("px",), ["px"]), (("px", "grey"), ["grey levels", "px"])],
)
def test_the_error_in_the_image_is_in_the_unit_that_is_measured(
    measured: tuple[str, ...], labels: list[str]
) -> None:
    t = np.arange(T) / 10
    columns = {"t": t} | {
        f"error_{unit}": (100 if unit in measured else np.nan) * np.exp(-t)
        for unit in ("px", "grey")
    }
    panels = figures.error(LogArrays(pl.DataFrame(columns), Setting(threshold_grey=0.4))).panels
    # first the one that decides
    assert [panel.labels[1].partition("[")[2].rstrip("]") for panel in panels] == labels
    for panel, unit in zip(panels, measured[::-1], strict=True):
        assert not panel.title
        assert any(np.array_equal(curve.y, columns[f"error_{unit}"]) for curve in panel.curves)
        assert [c.label for c in panel.curves if c.label] == ["threshold 0.4 grey levels"] * (
            unit == "grey"
        )
