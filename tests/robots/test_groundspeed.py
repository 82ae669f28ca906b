"""The velocity estimate alone: known velocities, accelerations, tilts and noise."""

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import GRAVITY
from vstestbed.robots.attitude import level, to_body
from vstestbed.robots.flight import Instruments
from vstestbed.robots.flight_sensors import AT_REST, READING_S, VELOCITIES, Filtered, Flow, step

DT, STILL = 0.001, (0.0, 0.0, 0.0)
FLAT = level((0.0, 0.0, 1.0))


def run(source, velocity, force, duration, R=FLAT, yaw_rate=0.0, rng=None, state=None):
    """Estimates (n, 3) for a velocity of time, a constant reading of the accelerometer; both in
    body axes.
    """
    state, rows = state or AT_REST, []
    for k in range(round(duration / DT)):
        noise = (
            rng.standard_normal(3) * source.sigma_mps * np.sqrt(READING_S / DT)
            if rng
            else np.zeros(3)
        )
        measured = tuple(np.add(velocity((k + 1) * DT), noise))
        reading = Instruments((0, 0, 0), force, measured, 0.0)
        state = step(state, R, reading, yaw_rate, source, DT)
        rows.append(state[0])
    return np.array(rows), state


@pytest.mark.parametrize("source", [Flow(), Filtered()])
def test_finds_a_constant_velocity(source):
    rows, _ = run(source, lambda t: (1.0, -0.5, 0.2), (0, 0, GRAVITY), 8.0)
    np.testing.assert_allclose(rows[-1], [1.0, -0.5, 0.2], atol=1e-4)  # exp(-16) and its polynomial


def test_flow_follows_an_acceleration_without_lag():
    rows, state = run(Flow(), lambda t: (2 * t, 0, -t), (2.0, 0, GRAVITY - 1.0), 2.0)
    # The reading is that of the step's end: a step of dt, 2 mm/s.
    np.testing.assert_allclose(rows[-1], [4, 0, -2], atol=0.0025)
    np.testing.assert_allclose(state[2], [2, 0, -1], atol=0.002)


def test_filtered_lags_by_its_time_constant():
    rows, _ = run(Filtered(tau_s=0.1), lambda t: (2 * t, 0, 0), (2.0, 0, GRAVITY), 2.0)
    assert rows[-1, 0] == pytest.approx(2 * (2.0 - 0.1), abs=0.003)  # a step of dt


def test_flow_learns_a_wrong_accelerometer():
    _, state = run(Flow(), lambda t: (0.3, 0, 0), (0.4, 0, GRAVITY + 0.1), 8.0)
    np.testing.assert_allclose(state[0], [0.3, 0, 0], atol=1e-4)
    np.testing.assert_allclose(state[1], [-0.4, 0, -0.1], atol=1e-3)
    np.testing.assert_allclose(state[2], 0, atol=1e-3)


def test_a_turning_level_frame():
    """A world-fixed velocity seen from a frame that turns at .8 rad/s."""
    r = 0.8
    rows, _ = run(
        Flow(),
        lambda t: (np.cos(r * t), -np.sin(r * t), 0),
        (0, 0, GRAVITY),
        6.0,
        yaw_rate=r,
        state=((1.0, 0, 0), *AT_REST[1:]),
    )
    t = np.arange(1, len(rows) + 1) * DT
    # Forward Euler: r^2 dt / (4 w) or so.
    np.testing.assert_allclose(rows[:, 0], np.cos(r * t), atol=1e-3)


def test_tilted_readings_are_levelled():
    up = (-0.2, 0.3, np.sqrt(1 - 0.13))
    R = level(up)
    rows, _ = run(
        Flow(), lambda t: to_body(R, (1.0, 0.5, -0.2)), tuple(GRAVITY * np.array(up)), 8.0, R=R
    )
    np.testing.assert_allclose(rows[-1], [1.0, 0.5, -0.2], atol=1e-4)


def test_noise_is_taken_down_as_theory_says():
    source = Flow(sigma_mps=0.05)
    rows, _ = run(source, lambda t: (0, 0, 0), (0, 0, GRAVITY), 60.0, rng=np.random.default_rng(3))
    # White noise of power sigma^2 T through (2 w s + w^2) / (s + w)^2: variance sigma^2 T w 5 / 4.
    expected = 0.05 * np.sqrt(READING_S * 2.0 * 1.25)
    # 60 s hold some 60 independent values an axis, three axes: 10 %.
    assert np.sqrt(np.mean(rows[3000:] ** 2)) == pytest.approx(expected, rel=0.2)


def test_kinds():
    assert set(VELOCITIES.members) == {"flow", "filtered"}
    with pytest.raises(ParameterError, match="sigma_mps"):
        Flow(sigma_mps=-1)
