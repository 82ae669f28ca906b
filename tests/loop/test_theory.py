"""The discrete loop on paper: limits, poles, lag, against closed forms and plain iteration."""

import math

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.loop.stability import (
    closed_form,
    gain_limit,
    loop_shares,
    roots,
    swing_frames,
)


def iterated(g: float, d: int, shares: tuple[float, ...], steps: int = 4000) -> float:
    """How the loop s(k+1) = s(k) - g sum b_j s(k-d-j) grows in a step, late, from 1 and zeros
    before.
    """
    s = np.zeros(steps + 1 + d + len(shares))
    s[d + len(shares)] = 1.0
    for k in range(d + len(shares), len(s) - 1):
        s[k + 1] = s[k] - g * sum(b * s[k - d - j] for j, b in enumerate(shares))
        if abs(s[k + 1]) > 1e100:
            return math.inf
    size = np.abs(s)
    return float(size[-200:].max() / max(size[-1200:-1000].max(), 1e-300)) ** 1e-3


@pytest.mark.parametrize(("d", "limit"), list(enumerate([2, 1, 0.618, 0.445, 0.347, 0.285])))
def test_limits_of_pure_delay(d, limit):
    assert closed_form(d) == pytest.approx(limit, abs=5e-4)  # as in print, three digits
    assert gain_limit(d) == pytest.approx(closed_form(d), rel=1e-8)
    poles = roots(closed_form(d), d)
    assert abs(poles[0]) == pytest.approx(1, abs=1e-9)
    assert 2 * math.pi / abs(np.angle(poles[0])) == pytest.approx(swing_frames(d), rel=1e-9)


def led_form(d: int) -> float:
    """The limit of commands that are led to, b = (1/2, 1/2), in closed form."""
    return 2 * math.tan(math.pi / (4 * (d + 1)))


@pytest.mark.parametrize("d", [1, 2, 5, 20])
def test_to_lead_to_a_command_costs_half_a_period(d: int):
    assert gain_limit(d, (0.5, 0.5)) == pytest.approx(led_form(d), rel=1e-8)
    # Both are (pi / 2) / delay to the first order: of half a frame more.
    assert math.pi / 2 / led_form(d) - math.pi / 2 / closed_form(d) == pytest.approx(
        0.5, abs=0.4 / (d + 1)
    )


def test_without_delay_to_lead_costs_no_gain():
    """The loop of held commands alternates at its limit, which the other averages out."""
    assert led_form(0) == pytest.approx(2) == pytest.approx(closed_form(0))
    assert gain_limit(0, (0.5, 0.5)) == pytest.approx(2, rel=1e-8)


@pytest.mark.parametrize(
    ("d", "shares"), [(0, (1.0,)), (2, (1.0,)), (1, (0.4, 0.6)), (3, (0.7, 0.2, 0.1))]
)
def test_a_loop_iterated_goes_unstable_where_its_poles_say(d, shares):
    limit = gain_limit(d, shares)
    assert iterated(0.99 * limit, d, shares) < 1 < iterated(1.01 * limit, d, shares)


@pytest.mark.parametrize(("tau_ms", "higher"), [(1, 0.05), (2, 0.11), (5, 0.33)])
def test_a_servos_lag_without_delay(tau_ms, higher):
    # First-order servo, tau much under the period T = 40 ms: b = (1 - tau/T, tau/T), and z = -1 is
    # a pole at g = 2/(1 - 2 tau/T).
    a = tau_ms / 40
    assert (
        gain_limit(0, (1 - a, a))
        == pytest.approx(2 / (1 - 2 * a), rel=1e-8)
        == pytest.approx(2 * (1 + higher), rel=0.01)
    )


def test_a_servo_that_goes_backwards_is_refused():
    with pytest.raises(ParameterError, match="must be > 0 in sum"):
        gain_limit(1, (0.5, -0.7))


@pytest.mark.parametrize("d", [1, 2, 4])
def test_led_commands_and_late_pictures_shift_the_limit(d: int) -> None:
    """A ramp is the closed form of led commands; a picture older by a whole frame is one frame of
    delay; by a part, in between.
    """
    assert gain_limit(d, loop_shares(True, 0.0)) == pytest.approx(led_form(d), abs=1e-6)
    assert gain_limit(d, loop_shares(False, 1.0)) == pytest.approx(closed_form(d + 1), abs=1e-6)
    assert closed_form(d + 1) < gain_limit(d, loop_shares(False, 0.4)) < closed_form(d)
    assert loop_shares(False, 0.0) == (1.0,)
