"""The error that decided a run, by who measured it: made-up logs whose answers are plain, and
bundled scenarios.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.tasks.judged import at_the_end, at_worst, by_convergence
from vstestbed.tasks.stop import Converged


def log(**columns: list[float]) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in columns.items()}


def test_pixels_decide_by_default_and_level_pixels_of_a_craft_that_tilts():
    flat = log(t=[0, 1], error_px=[9, 0.1])
    assert by_convergence(flat, Converged()) == (0.1, "px", 0.2, "pixels")
    assert by_convergence(flat | log(level_error_px=[9, 0.15]), Converged()) == (
        0.15,
        "px",
        0.2,
        "level pixels",
    )


def test_of_several_conditions_the_one_nearest_its_limit():
    converged = Converged(error_px=1.0, position_m=0.1, rotation_deg=10.0)
    columns = log(t=[0.0], error_px=[0.5], est_position_m=[0.09], est_rotation_rad=[0.1])
    assert by_convergence(columns, converged) == (0.09, "m", 0.1, "estimate")
    turned = columns | log(est_rotation_rad=[0.2])  # over its limit: the run cannot have converged
    assert by_convergence(turned, converged) == (
        0.2,
        "rad",
        pytest.approx(math.radians(10)),
        "estimate",
    )


def test_an_unknown_error_decides_before_any_other():
    columns = log(t=[0.0], error_px=[math.nan], est_position_m=[5.0])
    assert by_convergence(columns, Converged(error_px=1.0, position_m=0.1)).summary() == {
        "judged_error": None,
        "judged_unit": "px",
        "judged_limit": 1.0,
        "judged_by": "pixels",
    }
    # a run without a frame
    assert math.isnan(by_convergence(log(t=[], error_px=[]), Converged()).value)


def test_the_truth_of_a_band_counts_once_settled_and_by_magnitude():
    columns = log(t=[0, 1, 2, 3], task_error_m=[-9, 0.1, -0.3, 0.2])
    assert at_worst(columns, "task_error_m", 0.5, 1.0) == (0.3, "m", 0.5, "truth")
    assert math.isnan(at_worst(columns, "task_error_m", 0.5, 4.0).value)  # never settled
    assert at_the_end(columns, "task_error_m", 0.25) == (0.2, "m", 0.25, "truth")


@pytest.mark.parametrize(
    ("name", "overrides", "unit", "by"),
    one_quick(
        ("ibvs_book", {}, "px", "pixels"),
        ("car_pbvs", {"stop.duration_s": 0.2}, "m", "estimate"),
        ("car_line", {"stop.duration_s": 0.2}, "m", "truth"),
        ("quadrotor_hover", {"stop.duration_s": 0.2}, "px", "level pixels"),
        ("quadrotor_land", {"stop.duration_s": 0.2}, "m", "truth"),
    ),
)
def test_each_kind_of_task_says_who_measured(
    name: str, overrides: dict[str, object], unit: str, by: str
):
    summary = vs.run(vs.load(name, overrides)).summary()
    assert (summary["judged_unit"], summary["judged_by"]) == (unit, by)
    if summary["outcome"] == "converged":
        assert summary["judged_error"] < summary["judged_limit"]
