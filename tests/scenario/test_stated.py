"""What a seed draws of a robot's body is in the record of a run, which repeats it; what is listed stays."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ScenarioError
from vstestbed.scenario.dump import dump
from vstestbed.scenario.load import parse

WORN = {"robot.wheel_spread": {"sigma": 0.01}, "robot.uneven_floor": {"rms_m": 0.002, "correlation_m": 2.0}}
SETTINGS = {
    "omni_ibvs": WORN | {"detector": "oracle", "stop.duration_s": 0.2},
    "car_pbvs": WORN | {"detector": "oracle", "stop.duration_s": 0.2},
    "arm_ibvs": {"robot.geometry_error": {"sigma_m": 0.001, "sigma_deg": 0.1}, "detector": "oracle", "stop.duration_s": 0.08},
}


@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("start", ["nominal", "random"])
def test_the_record_repeats_the_run_bit_for_bit(name: str, start: str) -> None:
    drawn = vs.load(name, SETTINGS[name], seed=3 if start == "random" else None)
    again = parse(dump(drawn, defaults=True), "record.yaml")
    assert again == drawn == parse(dump(drawn), "short.yaml")
    one, two = (vs.run(s).rows.table() for s in (drawn, again))
    np.testing.assert_array_equal(one, two)


def test_a_record_draws_again_with_another_seed_or_size() -> None:
    text = dump(vs.load("omni_ibvs", WORN, seed=3), defaults=True)
    first, other, wider = (parse(text, "record.yaml", o).robot for o in ({}, {"seed": 4}, {"robot.wheel_spread.sigma": 0.02}))
    assert first.wheel_spread.drawn_errors != other.wheel_spread.drawn_errors
    assert first.uneven_floor.drawn_seed != other.uneven_floor.drawn_seed
    for factor, wide in zip(first.wheel_spread.factors, wider.wheel_spread.factors, strict=True):
        assert math.isclose(wide - 1, 2 * (factor - 1), abs_tol=2e-9)
    none = parse(text, "record.yaml", {"robot.wheel_spread.sigma": 0}).robot.wheel_spread
    assert none.drawn_errors is None and none.factors == (1.0,) * 4


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        (
            "omni_ibvs",
            {"robot.wheel_spread": {"sigma": 0.01, "drawn_errors": [0, 0, 0, 0]}},
            "that stay in robot.wheel_spread.errors",
        ),
        ("omni_ibvs", {"robot.wheel_spread": {"drawn_errors": [0, 0, 0, 0.01]}}, "draws nothing"),
        ("car_pbvs", {"robot.uneven_floor": {"drawn_seed": 5}}, "robot.uneven_floor.seed"),
        ("car_pbvs", {"robot.uneven_floor": {"seed": 3, "drawn_seed": 5}}, "draws nothing"),
        ("arm_ibvs", {"robot.geometry_error": {"sigma_m": 0.001, "drawn_offsets": [{}] * 6}}, "robot.geometry_error.offsets"),
        ("arm_ibvs", {"robot.geometry_error": {"sigma_m": 0.001, "offsets": [{}] * 6}}, "must be empty with sigma_m"),
        ("omni_ibvs", {"robot.wheel_spread": {"sigma": 0.001, "errors": [0, 0, 0, 0.01]}}, "must be none with sigma > 0"),
    ],
)
def test_values_that_would_be_drawn_over_are_refused(name: str, settings: dict[str, object], words: str) -> None:
    with pytest.raises(ScenarioError, match=words):
        vs.load(name, settings)


def test_so_is_a_record_that_was_edited() -> None:
    text = dump(vs.load("omni_ibvs", WORN, seed=3), defaults=True)
    with pytest.raises(ScenarioError, match=r"record\.yaml:\d+:\d+: robot\.wheel_spread\.drawn_errors: states what the seed draws"):
        parse(re.sub(r"drawn_errors: \[[^,]+", "drawn_errors: [0.05", text), "record.yaml")
