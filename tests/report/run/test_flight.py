"""Figures over time of a flight: what they draw of a short real one."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from vstestbed.loop.recording import Recording
from vstestbed.report import Setting
from vstestbed.report.chart import ChartPanel
from vstestbed.report.run import figures
from vstestbed.report.run.tracks import LogArrays


@pytest.fixture(scope="module")
def step() -> Recording:
    """A second and a half of a large step: the craft leans and turns."""
    return vs.run(
        vs.load(
            "quadrotor_aggressive",
            {"detector": "oracle", "stop.duration_s": 1.5, "world.wind.mean_mps": [2, 0, 0]},
        )
    )


@pytest.fixture(scope="module")
def tracks(step: Recording) -> LogArrays:
    return LogArrays(
        pl.DataFrame({name: step[name] for name in step.columns}),
        Setting(camera=step.scenario.camera),
    )


def lines(panel: ChartPanel) -> list[np.ndarray]:
    """Plotted curves, without the rule at zero."""
    return [curve.y for curve in panel.curves if len(curve.y) > 2]


def test_velocity_follows_what_is_ordered(tracks: LogArrays):
    chart = figures.velocity(tracks)
    assert chart is not None and len(chart.panels) == 3
    flown, commanded = max(
        (lines(panel) for panel in chart.panels[:2]), key=lambda pair: np.abs(pair[1]).max()
    )
    assert np.abs(commanded).max() > 1.0 and abs(flown[0]) < 0.1  # a step from rest
    assert abs(flown[12]) < 0.7 * abs(commanded[12])  # .5 s later it is on its way
    assert flown[-1] == pytest.approx(commanded[-1], rel=0.25)


def test_attitude_follows_what_the_velocity_loop_asks(tracks: LogArrays, step: Recording):
    chart = figures.tilt(tracks)
    assert chart is not None
    true, told, asked = lines(chart.panels[0])[:3]  # roll
    assert np.abs(true - told).max() < 1.5  # degrees; the estimate under noise and bias
    assert np.abs(asked).max() > 10
    delayed = [np.abs(true[k:] - asked[: len(asked) - k]).mean() for k in range(12)]
    # .2 s of attitude loop and rotors at 25 Hz, never ahead of its order
    assert 2 <= int(np.argmin(delayed)) <= 9
    assert np.degrees(step["ref_roll"]) == pytest.approx(asked)


def test_rates_follow_what_the_attitude_loop_asks(tracks: LogArrays):
    chart = figures.rates(tracks)
    assert chart is not None
    assert [panel.labels[1] for panel in chart.panels] == [
        "roll [deg/s]",
        "pitch [deg/s]",
        "yaw [deg/s]",
    ]
    flown, asked = lines(chart.panels[0])
    delayed = [np.abs(flown[k:] - asked[: len(asked) - k]).mean() for k in range(12)]
    assert 1 <= int(np.argmin(delayed)) <= 5  # .11 s
    assert np.abs(asked).max() > 20


def test_rotors_with_their_limit_and_the_wind(tracks: LogArrays):
    chart = figures.rotors(tracks)
    assert chart is not None
    speeds, wind = chart.panels
    assert len(lines(speeds)) == 4
    assert max(curve.y[0] for curve in speeds.curves) == 1000
    assert lines(wind)[0] == pytest.approx(2.0)


def test_the_error_that_counts_is_that_of_the_level_picture(tracks: LogArrays, step: Recording):
    chart = figures.error(tracks)
    seen, level = (curve.y for curve in chart.panels[0].curves[:2])
    assert level == pytest.approx(step["level_error_px"])
    assert np.abs(seen - level).max() > 5  # it leans by 20 degrees
    assert "turned level, which counts" in chart.legend()


def test_what_does_not_fly_has_none(tracks: LogArrays):
    bare = LogArrays(pl.DataFrame({"t": np.arange(3.0)}), tracks.setting)
    assert [
        make(bare) for make in (figures.velocity, figures.tilt, figures.rates, figures.rotors)
    ] == [None] * 4
