"""Orders: how long a setpoint is in force, and what is in force after it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vstestbed.core.geometry import Array
from vstestbed.robots.allocation import Order
from vstestbed.timing.setpoints import REFRESH_S, SetpointBuffer, Stop

STEP_S, LASTS = 0.002, 10
U = np.array([1.0, -2.0])


def ramp(setpoint: Array, elapsed_s: float) -> Array:
    return setpoint * max(0.0, 1.0 - elapsed_s / 0.1)


def orders(first: Array | None = None, lasts: float = LASTS) -> SetpointBuffer:
    return SetpointBuffer(ramp, first, lasts, STEP_S)


def test_an_order_lasts_its_time_and_then_the_robot_stops():
    given = orders()
    assert given.at(0) is None
    given.give(5, U)
    assert given.at(5) is U and given.at(15) is U
    np.testing.assert_allclose(given.at(16), U * (1 - STEP_S / 0.1))
    assert not given.at(15 + 50).any()
    given.give(70, U)
    assert given.at(80) is U


def test_without_a_limit_it_lasts_for_ever():
    given = orders(lasts=math.inf)
    given.give(0, U)
    assert given.at(10**9) is U and given.unchanged(3, 10**9) == 10**9


def test_a_stop_order_acts_at_once_and_only_once():
    given = orders()
    given.give(0, U)
    given.give(4, U, "stop")
    np.testing.assert_allclose(given.at(4), U * (1 - STEP_S / 0.1))
    given.give(8, U, "stop")  # the ramp goes on
    np.testing.assert_allclose(given.at(8), U * (1 - 5 * STEP_S / 0.1))


def test_a_stop_order_after_the_order_has_lapsed_does_not_begin_again():
    given = orders()
    given.give(0, U)
    given.give(20, U, "stop")
    np.testing.assert_allclose(given.at(20), U * (1 - 10 * STEP_S / 0.1))


def test_before_the_first_order_there_is_the_first_setpoint_or_none():
    given = orders(first=U)
    assert given.at(LASTS) is U and not given.at(1000).any()
    nothing = orders()
    nothing.give(0, U, "stop")
    assert nothing.at(1) is None and nothing.unchanged(0, 7) == 7


def test_off_is_a_setpoint_that_no_finite_one_can_be_mistaken_for():
    given = orders()
    given.give(0, U, "off")
    setpoint = given.at(1)
    assert setpoint is not None and np.isneginf(setpoint).all()


@pytest.mark.parametrize("how", ["stop", "off"])
def test_a_stop_is_at_rest_and_says_why(how: Stop):
    moving = Order(U, np.arange(6.0), U)
    assert not moving.stopped and moving.reason == ""
    stop = moving.halted("no marker was in sight", latched=True, stop=how)
    assert (
        stop.stopped
        and stop.latched
        and stop.stop == how
        and stop.reason == "no marker was in sight"
    )
    assert not stop.setpoint.any() and not stop.twist.any() and stop.rates is None


def test_it_says_for_how_long_the_setpoint_stays():
    given = orders()
    given.give(0, U)
    assert (
        given.unchanged(0, 11) == 11
        and given.unchanged(0, 12) == 11
        and given.unchanged(8, 100) == 3
    )
    refresh = round(REFRESH_S / STEP_S)
    assert given.unchanged(11, 100) == refresh and given.unchanged(11, 2) == 2
