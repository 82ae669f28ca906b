"""Figures over time of vehicles: what they draw of made-up logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from vstestbed.core.geometry import Array
from vstestbed.report import Setting
from vstestbed.report.run import figures
from vstestbed.report.run.tracks import LogArrays

T = np.arange(101) / 10
VEHICLE = Setting(planar=True)


def tracks(setting: Setting = VEHICLE, **columns: Array) -> LogArrays:
    return LogArrays(pl.DataFrame({"t": T} | columns), setting)


def test_wheels_are_shown_by_speed_and_steering_by_angle():
    run = tracks(
        qd_left=3 + 0 * T,
        q_left=3 * T,
        ctrl_drive=3.1 + 0 * T,
        q_steering=0.1 * T,
        qd_steering=0.1 + 0 * T,
        ctrl_steering=0.11 * T,
    )
    chart = figures.wheels(run)
    assert chart is not None
    speeds, angles = chart.panels
    assert [curve.y[-1] for curve in speeds.curves if len(curve.y)] == pytest.approx([3, 3.1])
    assert [curve.y[-1] for curve in angles.curves] == pytest.approx([1.0, 1.1])
    assert list(chart.legend()) == ["left", "drive", "steering"]
    assert figures.joints(run) is None  # no angles that grow without bound
    assert figures.wheels(tracks(Setting(), qd_left=T)) is None


def test_the_base_without_wheel_joints_shows_what_they_were_told():
    chart = figures.wheels(tracks(qd_root_x=T, ctrl_front_left=2 + 0 * T))
    assert chart is not None
    (panel,) = chart.panels
    assert [curve.y[-1] for curve in panel.curves if len(curve.y)] == [2]


def test_errors_of_the_place_are_told_from_the_truth():
    true = {"base_x": T, "base_y": 0 * T, "base_heading": 3.1 + 0 * T}
    # 3 cm ahead and 4 cm to the left; the heading beyond a half turn, 6.2 degrees on.
    chart = figures.localisation_error(
        tracks(
            **true,
            est_x=T + 0.03,
            est_y=0.04 + 0 * T,
            est_heading=3.1 - 2 * np.pi + np.radians(6.2) + 0 * T,
        )
    )
    assert chart is not None
    upper, lower = chart.panels
    assert upper.curves[0].y == pytest.approx(0.05 + 0 * T)
    assert lower.curves[0].y == pytest.approx(6.2 + 0 * T)
    assert figures.localisation_error(tracks(**true)) is None


def test_the_task_has_its_band_and_its_worst_once_settled():
    off = np.where(T < 4, 1.0, 0.02 * np.sin(5 * T))
    chart = figures.task_error(
        tracks(replace(VEHICLE, band_m=0.05, settle_s=4.0), task_error_m=off)
    )
    assert chart is not None
    panel = chart.panels[0]
    assert panel.title == "at most 0.020 m off once settled"
    assert list(chart.legend()) == ["band, 0.05 m to each side"]
    assert figures.task_error(tracks()) is None


def test_slip_is_in_millimetres_and_noise_does_not_fill_the_height():
    chart = figures.slip(tracks(slip_mps=2e-5 + 0 * T))
    assert chart is not None
    assert chart.panels[0].curves[0].y == pytest.approx(0.02 + 0 * T)
    assert chart.panels[0].limits()[1][1] > 0.5
    assert len(chart.panels) == 1  # a log of before the turn was told


def test_slip_in_yaw_stands_below():
    chart = figures.slip(tracks(slip_mps=0 * T, slip_radps=np.radians(3) + 0 * T))
    assert chart is not None
    assert chart.panels[1].curves[0].y == pytest.approx(3 + 0 * T)
    assert chart.panels[1].labels[1] == "in yaw [deg/s]"


def test_changes_of_the_goal_view_are_marked():
    chart = figures.error(
        tracks(error_px=10 + T, view=np.where(T < 3, 0.0, np.where(T < 7, 1.0, 2.0)))
    )
    words = [words.strip() for _, _, words, _, _ in chart.panels[0].words]
    assert words == ["view 2", "view 3"]


def test_a_task_without_an_end_has_no_distance_from_a_goal():
    away = {"position_error_m": 1 + T, "rotation_error_rad": 0.1 + T}
    assert figures.pose_error(tracks(**away)) is not None
    assert figures.pose_error(tracks(replace(VEHICLE, band_m=0.1), **away)) is None
