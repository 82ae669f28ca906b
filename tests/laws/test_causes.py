"""Causes that the pages name, each shown: what makes a law weak, slow or exact."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Array
from vstestbed.features import Point


def conditions(distance_m: float) -> tuple[Array, Array]:
    """Singular values of the points' matrix for lateral motion and tilt before the square of
    `partitioned_book`, and the last direction.
    """
    p = vs.load("partitioned_book").target.points + [0, 0, distance_m]
    L = Point().interaction(p[:, :2] / p[:, 2:], p[:, 2])[:, [0, 1, 3, 4]]
    _, sigma, V = np.linalg.svd(L)
    return sigma, V[-1]


def test_lateral_motion_and_tilt_look_alike_the_more_the_farther_the_target():
    """Their pictures differ by the perspective of the square alone: the condition grows with the
    square of the distance over its side, and the direction that is hardly seen is lateral motion
    with a turn back of v / Z.
    """
    near, far = conditions(1.0), conditions(6.0)
    assert near[0][0] / near[0][-1] < 40 < 3000 < far[0][0] / far[0][-1]
    for distance, (_, v) in ((1.0, near), (6.0, far)):
        lateral, tilt = v[:2], v[2:]  # (vx, vy), (wx, wy)
        assert np.hypot(*lateral) == pytest.approx(distance * np.hypot(*tilt), rel=0.07)
        assert lateral @ np.array([tilt[1], -tilt[0]]) == pytest.approx(
            -np.hypot(*lateral) * np.hypot(*tilt), rel=1e-6
        )


@pytest.mark.study
def test_ten_pictures_a_second_make_the_difference_of_sizes_sway():
    """With exact pixels the three forms of the size go nearly the same way at 25 pictures a second;
    at 10 the difference does not.
    """

    def flown(sigma: str, rate_hz: float) -> dict[str, Any]:
        changes = {
            "law.sigma": sigma,
            "camera.rate_hz": rate_hz,
            "detector": "oracle",
            "stop.duration_s": 200,
        }
        return vs.run(vs.load("partitioned_book", changes)).summary()

    ratios = {
        (sigma, hz): flown(sigma, hz)["path_ratio"]
        for sigma in ("ratio", "log", "difference")
        for hz in (10.0, 25.0)
    }
    assert all(
        1.5 < ratios[sigma, hz] < 1.8 for sigma, hz in ratios if (sigma, hz) != ("difference", 10.0)
    )
    assert ratios["difference", 10.0] > 15


@pytest.mark.study
@pytest.mark.process
@pytest.mark.skipif(
    platform.machine().lower() not in ("x86_64", "amd64"),
    reason="OpenBLAS has these kernels on x86 alone",
)
def test_the_last_bit_of_a_processor_s_linear_algebra_decides_the_way_of_the_difference(
    tmp_path: Path,
):
    """24.92, 26.07 and 24.96 times the straight line by three kernels, and the ratio's way is the
    same to all printed digits.
    """

    def flown(kernel: str, sigma: str) -> dict[str, Any]:
        words = (
            f"run partitioned_book --set detector=oracle --set law.sigma={sigma} --set"
            " stop.duration_s=200 --json --quiet --video none"
        )
        done = subprocess.run(
            [sys.executable, "-m", "vstestbed", *words.split()],
            cwd=tmp_path,
            env={**os.environ, "OPENBLAS_CORETYPE": kernel},
            capture_output=True,
            check=True,
        )
        return json.loads(done.stdout)

    kernels = ("Haswell", "Sandybridge", "Prescott")  # which all processors of today can run
    sway, steady = (
        [flown(kernel, sigma) for kernel in kernels] for sigma in ("difference", "ratio")
    )
    assert np.ptp([one["path_ratio"] for one in sway]) > 0.02
    assert np.ptp([one["path_ratio"] for one in steady]) < 1e-6
    assert len({one["time_to_converge_s"] for one in sway}) == 1
