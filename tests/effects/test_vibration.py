"""Tones of the rotors at the IMU: amplitudes, and how they grow with the speed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vstestbed.effects.rotors import Vibration
from vstestbed.robots.rotors import X4

STILL = [0.0] * 6
ONE = Vibration(
    imbalance_mps2=2.0,
    blade_pass_mps2=3.0,
    gyro_radps=0.1,
    accel_sigma_mps2=0.0,
    gyro_sigma_radps=0.0,
)


def test_one_rotor_at_hover_has_the_stated_amplitudes():
    W = (X4.hover, 0.0, 0.0, 0.0)
    turn = np.linspace(0, 2 * math.pi, 36, endpoint=False)
    shaken = np.array([sum(ONE.at((phi, 0.0, 0.0, 0.0), W, X4.hover, STILL), ()) for phi in turn])
    np.testing.assert_allclose(shaken[:, 0], 2.0 * np.cos(turn), atol=1e-12)
    np.testing.assert_allclose(shaken[:, 1], 2.0 * np.sin(turn), atol=1e-12)
    np.testing.assert_allclose(shaken[:, 2], 3.0 * np.cos(2 * turn), atol=1e-12)
    np.testing.assert_allclose(np.hypot(shaken[:, 3], shaken[:, 4]), 0.1)


def test_an_imbalance_grows_with_the_squared_speed_and_rotors_at_rest_are_quiet():
    at = (0.0, 0.0, 0.0, 0.0)
    slow, fast = (
        ONE.at(at, (w, 0.0, 0.0, 0.0), X4.hover, STILL)[0][0] for w in (250_000.0, 1_000_000.0)
    )
    assert fast == pytest.approx(4 * slow)
    assert ONE.at(at, (0.0, 0.0, 0.0, 0.0), X4.hover, STILL) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_the_default_is_within_what_autopilots_call_normal():
    """ArduPilot: a standard deviation under 15 m/s^2 on each axis."""
    rng = np.random.default_rng(0)
    W, block = (X4.hover,) * 4, Vibration()
    angles, noise = rng.uniform(0, 2 * math.pi, (4000, 4)), rng.standard_normal((4000, 6))
    felt = np.array(
        [
            block.at(tuple(a), W, X4.hover, n)[0]
            for a, n in zip(angles.tolist(), noise.tolist(), strict=True)
        ]
    )
    assert felt.std(axis=0) == pytest.approx([2.9, 2.9, 3.6], rel=0.06)
