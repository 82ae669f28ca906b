"""Rotors near the ground and in a cross wind, against the published equations; the wake's
statistics.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from vstestbed.effects.airframe import AIR, Airframe, Downwash, FlightBlocks, GroundEffect, nearness
from vstestbed.robots.rotors import X4

R = 0.165


@pytest.mark.parametrize(
    ("z_over_r", "gain"),
    [(0.5, 4 / 3), (1.0, 16 / 15), (2.0, 64 / 63), (0.3, 4 / 3), (math.inf, 1.0)],
)
def test_the_gain_over_the_ground(z_over_r, gain):
    """Cheeseman & Bennett's values; under half a radius, where the equation does not hold, that of
    half a radius.
    """
    assert GroundEffect().gain(nearness(z_over_r * R, R), R, 10.0, 0.0) == pytest.approx(gain)


def test_in_forward_flight_it_fades_as_the_wake_is_left_behind():
    thrust = 10.0
    induced = math.sqrt(thrust / (2 * AIR * math.pi * R * R))
    gain = GroundEffect().gain(1.0, R, thrust, induced)  # v = v_i: half of the term
    assert gain == pytest.approx(1 / (1 - 0.5 / 16))


def test_rotors_that_stand_still_lift_nothing():
    assert GroundEffect().gain(4.0, R, 0.0, 3.0) == 1.0


def test_the_returning_wake_has_its_size_and_its_correlation():
    z, s = 0.3, 0.05
    airframe = Airframe(
        X4,
        FlightBlocks(downwash=Downwash(turbulence=s, turbulence_s=0.02)),
        np.random.default_rng(1),
    )
    still, W = (0.0, 0.0, 0.0), (X4.hover,) * 4
    lift = np.array(
        [airframe.act(still, still, W, (z,) * 16, W, 0.001)[0][2] for _ in range(20_000)]
    )
    one = X4.thrust_coefficient * X4.hover * s * (R / z) ** 2
    assert lift.std() == pytest.approx(2 * one, rel=0.1)  # four independent rotors
    lagged = np.corrcoef(lift[:-20], lift[20:])[0, 1]
    assert lagged == pytest.approx(math.exp(-1), abs=0.08)
    assert abs(lift.mean()) < 0.2 * lift.std()
