"""Minimum speeds: distances are watched over two seconds, from the time to settle on."""

import pytest

from vstestbed.tasks.continuing import SpeedMonitor

CRUISE = "the vehicle", 0.8, 0.64  # m/s: commanded, and the least that counts


def watched(speed, until_s=10.0, from_s=4.0, dt=0.04):
    """When a speed monitor first found somebody too slow, and the reason, in a run whose speed is a
    function of time.
    """
    monitor, travelled, n = SpeedMonitor((CRUISE,), from_s), 0.0, round(until_s / dt)
    for k in range(n + 1):
        monitor.update(k * dt, (travelled,), at_the_end=k == n)
        travelled += speed(k * dt) * dt
    return monitor.slow


def test_a_steady_drive_is_fine_and_so_is_a_start_from_standstill():
    assert watched(lambda t: 0.8) is None
    assert watched(lambda t: min(0.8, 1.5 * t), from_s=0.0) is None  # the car's acceleration


def test_who_is_slow_is_told_when_and_how_much():
    for speed, when, made in (
        (lambda t: 0.3, 4.0, "made 0.30 m/s"),  # creeps
        (lambda t: -0.8, 4.0, "made -0.80 m/s"),  # the wrong way
        # stands: under .64 over 2 s after .4 s
        (lambda t: 0.8 if t < 7 else 0.0, 7.44, "made 0.62 m/s"),
    ):
        t, reason = watched(speed)
        assert t == pytest.approx(when, abs=0.05)
        assert made in reason and "0.8 m/s were commanded" in reason


def test_what_happens_before_the_time_to_settle_does_not_count():
    assert watched(lambda t: 0.8 if t > 2 else -0.5) is None


def test_a_run_shorter_than_the_window_is_judged_as_a_whole():
    assert watched(lambda t: 0.8, until_s=1.0, from_s=0.0) is None
    assert watched(lambda t: 0.1, until_s=1.0, from_s=0.0) is not None
