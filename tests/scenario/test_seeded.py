"""A seed draws what is random, also from a fixed start; `Scenario.draws` says whether it draws
anything.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.loop.session import run
from vstestbed.scenario.load import load, seeded
from vstestbed.scenario.scenario import Scenario

QUIET_CRAFT: dict[str, Any] = {
    "robot.imu": {"gyro_sigma_radps": 0, "accel_sigma_mps2": 0},
    "robot.velocity": {"kind": "flow", "sigma_mps": 0},
    "robot.range_sigma_m": 0,
}
WALK = {"kind": "random_walk", "rms_m": [0.05, 0.05, 0.05]}
LISTED = {"thrust": [1, 1, 1, 1.01], "limit": [1, 1, 1, 1]}
SETTINGS: list[tuple[str, dict[str, Any]]] = [
    ("ibvs_book", {}),
    ("ibvs_book", {"noise.dropout": 0.3}),
    ("ibvs_book", {"noise.pixel_sigma_px": 0.1}),
    ("ibvs_book", {"noise.image_sigma": 5, "detector": "oracle"}),
    ("ibvs_book", {"timing.link": {"enter_probability": 0.5}}),
    ("ibvs_book", {"timing.link": {"enter_probability": 0}}),
    ("ibvs_book", {"timing.camera_clock": {"jitter_s": 0.005}}),
    ("ibvs_book", {"calibration.depth_spread": 0.2}),
    ("ibvs_book", {"target.motion": WALK}),
    ("ibvs_book", {"world.plates": [{"pose": {"xyz": [1, 0, 3]}, "motion": WALK}]}),
    # nothing fixes its place, for which alone its compass is read
    ("car_line", {"detector": "oracle"}),
    ("car_pbvs", {"detector": "oracle"}),
    ("car_pbvs", {"detector": "oracle", "robot.compass.sigma_deg": 0}),
    ("omni_ibvs", {"detector": "oracle", "robot.realism": "field"}),
    ("quadrotor_hover", {"detector": "oracle"}),
    ("quadrotor_hover", {"detector": "oracle", **QUIET_CRAFT}),
    ("quadrotor_hover", {"detector": "oracle", **QUIET_CRAFT, "world.wind.turbulence_mps": 1}),
    ("quadrotor_hover", {"detector": "oracle", **QUIET_CRAFT, "robot.motors": {}}),
    ("quadrotor_hover", {"detector": "oracle", **QUIET_CRAFT, "robot.motors": LISTED}),
]
PICTURES: list[tuple[str, dict[str, Any]]] = [
    ("arm_photometric", {"noise.image_sigma": 5}),
    ("arm_photometric", {"noise.pixel_sigma_px": 0.5}),  # no points are measured
    ("arm_photometric", {"camera.sensor": {}}),
    ("arm_photometric", {"goal.picture": {"image_sigma": 5}}),
    ("arm_picture", {"noise.target": {"image_sigma": 9}}),
    ("arm_ibvs", {"noise.image_sigma": 5}),
    ("arm_ibvs", {"noise.perturb": [{"kind": "erasing"}]}),
    ("arm_ibvs", {"noise.drift.brightness": 0.2}),
]


def same_runs(scenario: Scenario) -> bool:
    """Whether two seeds give the same log, bit by bit."""
    one, other = (run(scenario.with_seed(seed)) for seed in (1, 2))
    return one.columns == other.columns and np.array_equal(one.table, other.table, equal_nan=True)


@pytest.mark.parametrize(
    "settings",
    [
        {"timing.link": {}},
        {"timing.latency_jitter_s": 0.01},
        {"robot.realism": "field"},
        {"robot.geometry_error": {"sigma_m": 0.001}},
    ],
    ids=str,
)
def test_a_seed_draws_what_is_random_from_a_fixed_start(settings: dict[str, object]) -> None:
    fixed = load("arm_ibvs", {"robot.start.random": None, "detector": "oracle", **settings})
    again = seeded(fixed, 7)
    assert (
        again.seed == 7
        and again.robot.configuration().tolist() == fixed.robot.configuration().tolist()
    )


def test_a_seed_of_nothing_random_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"robot\.start\.random"):
        seeded(
            load(
                "arm_ibvs",
                {
                    "robot.start.random": None,
                    "detector": "oracle",
                    "robot.payload": {"mass_kg": 1.0},
                },
            ),
            7,
        )


@pytest.mark.parametrize(("name", "settings"), one_quick(*SETTINGS, every=3), ids=str)
def test_a_scenario_draws_where_two_seeds_give_two_runs(
    name: str, settings: dict[str, Any]
) -> None:
    scenario = load(name, {"robot.start.random": None, "stop.duration_s": 0.12, **settings})
    assert scenario.draws is not same_runs(scenario)


@pytest.mark.study
@pytest.mark.parametrize(("name", "settings"), PICTURES, ids=str)
def test_a_scenario_with_pictures_draws_where_two_seeds_give_two_runs(
    name: str, settings: dict[str, Any]
) -> None:
    scenario = load(name, {"robot.start.random": None, "stop.duration_s": 0.12, **settings})
    assert scenario.draws is not same_runs(scenario)


@pytest.mark.study
@pytest.mark.parametrize("name", bundled_scenarios())
def test_each_bundled_scenario_draws_where_two_seeds_give_two_runs(name: str) -> None:
    given = load(name, {"robot.start.random": None})
    scenario = load(
        name, {"robot.start.random": None, "stop.duration_s": max(1.0, 3 * given.camera.period)}
    )
    assert scenario.draws is not same_runs(scenario)
