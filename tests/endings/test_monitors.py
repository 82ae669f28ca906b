"""Rules of published protocols, and the metric of what is left of the start's error: by frames and
logs that are known.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.tasks.frames import PERIOD_S, frame
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.outcome import Outcome
from vstestbed.endings.monitors import EARLY_PICTURES, AfterPictures, Settles
from vstestbed.tasks.frame import Frame, ImageError
from vstestbed.tasks.metrics import StartShares
from vstestbed.tasks.stop import Stop


def frames(
    distances: Iterable[float], speeds: Iterable[float] | None = None, turn: float = 1.0
) -> list[Frame]:
    """A camera behind its goal (1 m before the target) by these distances [m], turned by `turn` rad
    per metre, at these speeds [m/s].
    """
    distances = list(distances)
    speeds = [0.0] * len(distances) if speeds is None else list(speeds)
    return [
        frame(
            PERIOD_S * i,
            T_world_camera=Pose(xyz=(0, 0, -1 - d), rpy_deg=(0, 0, math.degrees(turn * d))).T,
            speed_mps=v,
        )
        for i, (d, v) in enumerate(zip(distances, speeds, strict=True))
    ]


SETUP = vs.load("arm_ibvs").setup


def ended(
    rule: Settles | AfterPictures, run: Iterable[Frame], rest_after_s: float | None = 2.0
) -> tuple[Outcome, int]:
    """The outcome, and after how many pictures."""
    monitor = rule.monitor(replace(SETUP, stop=Stop(rest_after_s=rest_after_s)))
    for n, one in enumerate(run, 1):
        if found := monitor.update(one):
            assert found[1]
            return found[0], n
    raise AssertionError("no verdict")


QUICK = Settles(window=3, least=8, most=20)


class TestSettles:
    @pytest.mark.parametrize(
        ("end_m", "outcome"),
        [(0.049, Outcome.converged), (0.051, Outcome.local_minimum)],
        ids=["a tenth", "over a tenth"],
    )
    def test_ends_when_the_speed_no_longer_falls(self, end_m: float, outcome: Outcome):
        """The windows of 3: the first has a mean under 1 mm/s from picture 9 on, and the second is
        no smaller from picture 11 on.
        """
        speeds = [0.5, 0.1, 0.02, 0.0015, 0.0008, 0.0006, 0.0004, 0.0003, 0.0002, *[0.001] * 11]
        run = frames([0.5, *[end_m] * 19], speeds)
        assert ended(QUICK, run) == (outcome, 11)
        if outcome is Outcome.local_minimum:  # a rest that is no end
            assert ended(QUICK, run, rest_after_s=None) == (Outcome.timed_out, 20)

    def test_two_windows_of_pictures_are_needed(self):
        """At rest from the first picture on: both windows of 6 are full at the twelfth, whatever
        the least number of pictures.
        """
        run = frames([0.5, *[0.01] * 19], [0.0] * 20)
        assert ended(Settles(window=6, least=4, most=20), run) == (Outcome.converged, 12)

    def test_is_judged_at_the_latest_after_most_pictures(self):
        fast = [1.0] * 20
        assert ended(QUICK, frames([0.5] * 20, fast)) == (Outcome.timed_out, 20)
        assert ended(QUICK, frames([0.5] * 19 + [0.01], fast)) == (Outcome.converged, 20)

    def test_both_errors_count(self):
        """At a twentieth of the distance, and at a fifth of the angle."""
        run = frames([0.5] * 19, [1.0] * 19) + frames([0.025], [1.0], turn=4.0)
        assert ended(QUICK, run) == (Outcome.timed_out, 20)
        near = Settles(window=3, least=8, most=20, or_position_m=0.03, or_rotation_deg=6.0)
        assert ended(near, run) == (Outcome.converged, 20)
        # within 6 degrees, but 25 mm are over 20 mm
        assert ended(replace(near, or_position_m=0.02), run) == (Outcome.timed_out, 20)

    def test_diverges_beyond_five_times_the_start(self):
        assert ended(QUICK, frames([0.1, 0.3, 0.5, 0.51])) == (Outcome.diverged, 4)

    def test_ends_early_where_the_verdict_is_certain(self):
        """0.5 m, then under a tenth of a tenth of it."""
        run = frames([0.5, 0.004, 0.5, *[0.004] * 20], [1.0] * 23)
        assert ended(Settles(early=0.1), run) == (Outcome.converged, 3 + EARLY_PICTURES)

    def test_ends_where_it_comes_no_nearer(self):
        """The smallest distance in picture 3; one
        that is no more than 2 % smaller counts as none.
        """
        run = frames([0.5, 0.4, 0.2, 0.3, *[0.197] * 20], [1.0] * 24)
        assert ended(Settles(stuck=6), run) == (Outcome.timed_out, 3 + 6)
        assert ended(Settles(stuck=6, least=3, most=20), run, rest_after_s=None) == (
            Outcome.timed_out,
            20,
        )

    def test_what_is_refused(self):
        with pytest.raises(ParameterError, match="or_rotation_deg is missing"):
            Settles(or_position_m=0.01)
        with pytest.raises(ParameterError, match="least must be at most most = "):
            Settles(least=100, most=50)


class TestAfterPictures:
    @pytest.mark.parametrize(
        ("end_m", "turn", "outcome"),
        [
            (0.09, 1.0, Outcome.converged),
            (0.11, 1.0, Outcome.timed_out),
            (0.09, 2.0, Outcome.timed_out),
        ],
        ids=["near", "too far", "turned"],
    )
    def test_is_judged_by_the_distance_at_the_goal(
        self, end_m: float, turn: float, outcome: Outcome
    ):
        """A goal 1 m before the target: 0.1 m and 10 degrees."""
        assert ended(
            AfterPictures(pictures=5), frames([0.5, 0.01, 0.5, 0.5, end_m], turn=turn)
        ) == (outcome, 5)

    def test_ends_early_where_the_verdict_is_certain(self):
        assert ended(AfterPictures(early=0.1), frames([0.5, *[0.009] * 20])) == (
            Outcome.converged,
            1 + EARLY_PICTURES,
        )

    def test_is_judged_once_the_points_have_come_to_rest(self):
        """Under 5 px from picture 3 on, falling by more than a tenth until picture 5, and within
        noise of it from there on; a jump to 4 px at picture 8 begins it anew.
        """
        px = [9.0, 6.0, 4.0, 3.0, 2.0, 2.1, 2.2, 4.0, *[2.05] * 30]
        run = [
            replace(one, error=ImageError(False, True, e))
            for one, e in zip(frames([0.05] * len(px)), px, strict=True)
        ]
        rest = math.floor(0.2 / PERIOD_S + 1e-9) + 1  # pictures over more than rest_s
        assert ended(AfterPictures(rest_px=5, rest_s=0.2), run) == (Outcome.converged, 8 + rest)
        assert ended(AfterPictures(rest_px=5, rest_s=0.2, pictures=9), run) == (
            Outcome.converged,
            9,
        )
        gone = [replace(one, error=ImageError(True, False, math.nan)) for one in run]
        assert ended(AfterPictures(rest_px=5, rest_s=0.2, pictures=30), gone) == (
            Outcome.converged,
            30,
        )


def test_shares_of_the_start():
    """A camera that turns by 1 rad and back to 0.05, 0.5 m to 0.02 m: the last picture over a tenth
    of the start's errors is the fifth.
    """
    distance, angle = (
        np.array([0.5, 0.04, 0.3, 0.04, 0.06, 0.02]),
        np.array([1.0, 0.5, 0.0, 0.2, 0.05, 0.05]),
    )
    log = {
        "position_error_m": distance,
        "rotation_error_rad": angle,
        "cam_qw": np.cos(angle / 2),
        "cam_qx": np.sin(angle / 2),
    }
    log |= {name: np.zeros(6) for name in ("cam_qy", "cam_qz")}
    setup: Any = None  # it needs nothing of the experiment
    expected = {
        "position_share": 0.04,
        "rotation_share": 0.05,
        "pictures_to_share": 6,
        "rotation_path_ratio": 1.35,
    }
    assert StartShares().figures(log, setup) == pytest.approx(expected)
    at_goal = log | {"position_error_m": 0 * distance}
    assert set(StartShares().figures(at_goal, setup).values()) == {None}
