"""Motors that differ: drawn from the seed, or as listed."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.effects.rotors import MotorSpread, hover_squares
from vstestbed.robots.quadrotor import Quadrotor
from vstestbed.robots.rotors import X4


def test_a_seed_draws_the_factors_and_always_the_same():
    block = MotorSpread(thrust_sigma=0.03, limit_sigma=0.02)
    found = [block.drawn(np.random.default_rng(seed)) for seed in range(400)]
    assert found[5] == block.drawn(np.random.default_rng(5)) and found[5] != found[6]
    thrust, limit = np.array([f for f, _ in found]), np.array([m for _, m in found])
    assert abs(thrust.std() - 0.03) < 0.003 and abs(thrust.mean() - 1) < 0.003
    assert limit.max() <= 1.0 and abs((1 - limit).mean() - 0.02 * np.sqrt(2 / np.pi)) < 0.002


def test_listed_factors_are_kept_and_shift_no_others():
    rng = np.random.default_rng
    listed = MotorSpread(thrust=(1.1, 1, 1, 0.9)).drawn(rng(2))
    assert listed[0] == (1.1, 1.0, 1.0, 0.9) and listed[1] == MotorSpread().drawn(rng(2))[1]


def test_hover_of_unlike_rotors_has_no_torque_and_the_weight():
    f = (1.04, 1.02, 0.96, 1.0)
    front, right, back, left = W = hover_squares(f, X4)
    assert f[0] * front == pytest.approx(f[2] * back) and f[1] * right == pytest.approx(f[3] * left)
    assert front + back == pytest.approx(right + left)
    assert np.dot(f, W) == pytest.approx(4 * X4.hover)


def test_a_craft_that_could_not_hover_is_refused():
    for block, field, words in (
        (
            {"motors": {"thrust": (0.5, 1, 1, 1)}},
            "motors.thrust",
            "makes the front rotor turn at .* rad/s to hover",
        ),
        (
            {"motors": {"thrust": (1, 1, 1, 1), "limit": (1, 0.7, 1, 1)}},
            "motors.thrust",
            "the right rotor",
        ),
        (
            {"battery": {"charge": 0.0}},
            "battery.charge",
            "leaves 0.45 of the ordered thrust at the start",
        ),
    ):
        with pytest.raises(ParameterError, match=words) as told:
            Quadrotor(**block)
        assert told.value.field == field
