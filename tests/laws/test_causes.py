"""Causes that the pages name, each shown: what makes a law weak, slow or exact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Array
from vstestbed.features import Point


def conditions(distance_m: float) -> tuple[Array, Array]:
    """Singular values of the points' matrix for lateral motion and tilt before the square of `partitioned_book`, and the last direction."""
    p = vs.load("partitioned_book").target.points + [0, 0, distance_m]
    L = Point().interaction(p[:, :2] / p[:, 2:], p[:, 2])[:, [0, 1, 3, 4]]
    _, sigma, V = np.linalg.svd(L)
    return sigma, V[-1]


def test_lateral_motion_and_tilt_look_alike_the_more_the_farther_the_target():
    """Their pictures differ by the perspective of the square alone: the condition grows with the square of the distance over its side, and
    the direction that is hardly seen is lateral motion with a turn back of v / Z.
    """
    near, far = conditions(1.0), conditions(6.0)
    assert near[0][0] / near[0][-1] < 40 < 3000 < far[0][0] / far[0][-1]
    for distance, (_, v) in ((1.0, near), (6.0, far)):
        lateral, tilt = v[:2], v[2:]  # (vx, vy), (wx, wy)
        assert np.hypot(*lateral) == pytest.approx(distance * np.hypot(*tilt), rel=0.07)
        assert lateral @ np.array([tilt[1], -tilt[0]]) == pytest.approx(-np.hypot(*lateral) * np.hypot(*tilt), rel=1e-6)


@pytest.mark.study
def test_ten_pictures_a_second_make_the_difference_of_sizes_sway():
    """With exact pixels the three forms of the size go nearly the same way at 25 pictures a second; at 10 the difference does not."""

    def flown(sigma: str, rate_hz: float) -> dict[str, Any]:
        changes = {"law.sigma": sigma, "camera.rate_hz": rate_hz, "detector": "oracle", "stop.duration_s": 200}
        return vs.run(vs.load("partitioned_book", changes)).summary()

    ratios = {(sigma, hz): flown(sigma, hz)["path_ratio"] for sigma in ("ratio", "log", "difference") for hz in (10.0, 25.0)}
    assert all(1.5 < ratios[sigma, hz] < 1.8 for sigma, hz in ratios if (sigma, hz) != ("difference", 10.0))
    assert ratios["difference", 10.0] > 15
