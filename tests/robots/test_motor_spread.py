"""Motors that differ: drawn from the seed, or as listed."""

from __future__ import annotations

import numpy as np

from vstestbed.robots.motor_spread import MotorSpread


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
