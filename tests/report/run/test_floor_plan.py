"""The way on the floor: equal scale, all of it shown, told in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, quaternion_wxyz
from vstestbed.core.planar import pose_on_ground
from vstestbed.report import Setting
from vstestbed.report.run import space
from vstestbed.report.run.tracks import LogArrays

ARC = np.linspace(0, np.pi / 2, 60)
PLACES = np.stack([3 * np.sin(ARC), 3 - 3 * np.cos(ARC), ARC], axis=1)
"""A quarter turn to the left on a circle of 3 m, from the origin along x."""
MOUNT = np.array([[0, 0, 1.0, 0.2], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])
POINTS = np.array([[5, 4, 2], [-1, 4.5, 1.5]])
VEHICLE = Setting(
    points=POINTS, camera=Perspective(), planar=True, goals=np.array([[3, 3, np.pi / 2]])
)


def tracks(setting: Setting = VEHICLE, places: Array = PLACES, moving: bool = False) -> LogArrays:
    """A vehicle at these places, whose odometry drifts by 1 cm along x, landmarks standing or
    carried along.
    """
    n = len(places)
    T = pose_on_ground(places) @ MOUNT
    columns = {"t": np.arange(n) / 25}
    shift = np.linspace(0, 0.01, n)
    for stem, more in (("base", 0.0), ("est", 0.0), ("odo", shift)):
        columns |= {
            f"{stem}_x": places[:, 0] + more,
            f"{stem}_y": places[:, 1],
            f"{stem}_heading": places[:, 2],
        }
    columns |= dict(zip(("cam_x", "cam_y", "cam_z"), T[:, :3, 3].T, strict=True))
    columns |= dict(
        zip(("cam_qw", "cam_qx", "cam_qy", "cam_qz"), quaternion_wxyz(T[:, :3, :3]).T, strict=True)
    )
    target = np.c_[places[:, :2] + 1, np.zeros(n)] if moving else np.zeros((n, 3))
    columns |= dict(zip(("tgt_x", "tgt_y", "tgt_z"), target.T, strict=True)) | {
        "tgt_qw": np.ones(n)
    }
    columns |= {f"tgt_q{a}": np.zeros(n) for a in "xyz"}
    return LogArrays(pl.DataFrame(columns), setting)


def test_a_metre_is_as_long_both_ways_and_everything_is_inside():
    chart = space.plane(tracks())
    assert chart is not None
    (panel,) = chart.panels
    assert panel.equal
    (x0, x1), (y0, y1) = panel.limits()
    points = np.concatenate([PLACES[:, :2], POINTS[:, :2]])
    assert (points > [x0, y0]).all() and (points < [x1, y1]).all()
    words = list(chart.legend())
    assert {
        "start",
        "end",
        "goal",
        "landmarks",
        "true way",
        "as estimated",
        "by odometry alone",
    } == set(words)


def test_headings_point_where_the_vehicle_did():
    chart = space.plane(tracks())
    assert chart is not None
    darts = [
        np.stack([c.x, c.y], axis=1)
        for c in chart.panels[0].curves
        if len(c.x) == len(space.DART) + 1
    ]
    assert len(darts) > 8
    for xy in darts:
        tip, notch = xy[0], xy[2]
        foot = notch + (tip - notch) * 0.35 / 1.35  # the place itself
        heading = np.arctan2(*(tip - notch)[::-1])
        at = int(np.argmin(np.linalg.norm(PLACES[:, :2] - foot, axis=1)))
        assert heading == pytest.approx(PLACES[at, 2], abs=0.03)  # places are .027 rad apart


def test_the_difference_from_the_ideal_is_told_in_words():
    ideal = np.stack([3.05 * np.sin(ARC), 3 - 3.05 * np.cos(ARC)], axis=1)  # 5 cm outside all along
    chart = space.plane(tracks(replace(VEHICLE, expected_path=ideal)))
    assert chart is not None
    words = list(chart.legend())
    assert "ideal bicycle: at most 50.0 mm off" in words


def test_a_route_and_a_target_that_moves_are_drawn():
    chart = space.plane(
        tracks(
            replace(VEHICLE, goals=np.empty((0, 3)), reference_path=PLACES[:, :2] + 1), moving=True
        )
    )
    assert chart is not None
    words = list(chart.legend())
    assert {"route", "target"} <= set(words) and "goal" not in words


def test_a_vehicle_that_stands_and_one_that_is_lost_are_drawn_too():
    still = space.plane(tracks(VEHICLE, np.tile(PLACES[:1], (5, 1))))
    assert still is not None and still.svg("Way").startswith("<svg")
    gone = PLACES.copy()
    gone[20:30] = np.nan
    broken = space.plane(tracks(VEHICLE, gone))
    assert broken is not None and broken.svg("Way").startswith("<svg")


def test_vehicles_have_the_plane_and_others_the_space():
    other = tracks(Setting(points=POINTS))
    assert space.plane(other) is None and space.camera_path(other) is not None
    assert space.camera_path(tracks()) is None
