"""Matches in the servo film: a point, a ring where it belongs, a line between; charts that do not
join two points.
"""

from __future__ import annotations

import numpy as np
import polars as pl

import vstestbed as vs
from vstestbed.report.run.space import features
from vstestbed.report.run.tracks import LogArrays, Setting
from vstestbed.report.video.overlay import GOAL, MEASURED, MatchOverlay, Overlay, overlay_of


def test_a_match_is_a_point_a_ring_and_a_line():
    image = np.full((240, 320, 3), 128, np.uint8)
    uv = np.array([[100.0, 100.0], [np.nan, np.nan], [40.0, 180.0]])
    goal = np.array([[180.0, 100.0], [60.0, 60.0], [np.nan, np.nan]])
    MatchOverlay(320, 240, 3).marks(image, uv, goal)
    assert tuple(image[100, 100]) == MEASURED and tuple(image[180, 40]) == MEASURED
    assert image[100, 140].min() > 200
    # a ring is open in its middle
    assert np.abs(image[100, 184].astype(int) - GOAL).max() < 40 and tuple(image[98, 181]) != GOAL
    assert (image[55:66, 55:66] == 128).all()  # where nothing is seen nothing is drawn


def test_the_overlay_is_that_of_what_the_detector_reports():
    assert isinstance(overlay_of(vs.load("arm_keypoints"), (320, 240)), MatchOverlay)
    assert type(overlay_of(vs.load("arm_ibvs"), (320, 240))) is Overlay


def test_the_chart_does_not_join_two_points_of_one_row():
    goal = [100.0, 100.0, 50.0, 50.0]
    log = pl.DataFrame(
        {"t": [0.0, 0.1, 0.2, 0.3], "u_0": [10.0, 20.0, 200.0, 210.0], "v_0": [5.0] * 4}
    )
    log = log.with_columns(
        pl.Series("u_goal_0", goal),
        pl.Series("v_goal_0", goal),
        u_true_0=pl.col("u_0"),
        v_true_0=pl.col("v_0"),
    )

    def steps(changing: bool) -> float:
        chart = features(LogArrays.of(log, Setting(changing=changing)))
        assert chart is not None
        return max(
            float(np.nanmax(np.abs(np.diff(line.x))))
            for line in chart.panels[0].curves
            if len(line.x) == 4
        )

    assert steps(changing=False) == 180.0 and steps(changing=True) == 10.0
