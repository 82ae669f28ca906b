"""The attitude filter alone: gyro and accelerometer computed from a known motion."""

import math

import numpy as np
import pytest

from vstestbed.core.quantity import GRAVITY
from vstestbed.robots.attitude import Attitude, Filter, heading_rate, level, step, to_body, to_level

DT = 0.001
STILL = (0.0, 0.0, 0.0)


def rotation(roll: float, pitch: float) -> np.ndarray:
    """R_level_body = Ry(pitch) Rx(roll)."""
    c, s, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    return np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array(
        [[1, 0, 0], [0, c, -s], [0, s, c]]
    )


def angle(state: Attitude, up: np.ndarray) -> float:
    """Degrees between the estimated and the true up."""
    return math.degrees(
        math.atan2(float(np.linalg.norm(np.cross(state.up, up))), float(np.dot(state.up, up)))
    )


def still(
    state: Attitude,
    up: np.ndarray,
    duration: float,
    filter: Filter,
    gyro=(0, 0, 0),
    bias=(0, 0, 0),
    rng=None,
) -> Attitude:
    """The filter on a body at rest."""
    for _ in range(round(duration / DT)):
        n = rng.standard_normal(6) * [0.002, 0.002, 0.002, 0.09, 0.09, 0.09] if rng else np.zeros(6)
        state = step(
            state, tuple(np.add(gyro, n[:3])), tuple(GRAVITY * up + bias + n[3:]), STILL, filter, DT
        )
    return state


class TestGeometry:
    @pytest.mark.parametrize(
        ("roll", "pitch"), [(0, 0), (0.3, -0.2), (-1.2, 0.9), (2.8, 0.1), (0.1, 1.5)]
    )
    def test_level_frame(self, roll, pitch):
        R = rotation(roll, pitch)
        attitude = Attitude(up=tuple(R[2].tolist()))
        assert attitude.roll == pytest.approx(roll, abs=1e-12)
        assert attitude.pitch == pytest.approx(pitch, abs=1e-12)
        assert attitude.tilt == pytest.approx(math.acos(R[2, 2]), abs=1e-12)
        found = level(attitude.up)
        np.testing.assert_allclose(np.reshape(found, (3, 3)), R, atol=1e-12)
        v = (0.3, -1.0, 2.0)
        np.testing.assert_allclose(to_level(found, v), R @ v, atol=1e-12)
        np.testing.assert_allclose(to_body(found, v), R.T @ v, atol=1e-12)

    @pytest.mark.parametrize(("roll", "pitch"), [(0, 0), (0.3, -0.2), (-1.0, 0.9)])
    def test_heading_rate_by_finite_differences(self, roll, pitch):
        w, h, R = np.array([0.4, -0.7, 0.9]), 1e-6, rotation(roll, pitch)
        S = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        after, before = R @ (np.eye(3) + h * S), R @ (np.eye(3) - h * S)
        rate = (math.atan2(after[1, 0], after[0, 0]) - math.atan2(before[1, 0], before[0, 0])) / (
            2 * h
        )
        # h^2 and rounding
        assert heading_rate(level(tuple(R[2].tolist())), tuple(w.tolist())) == pytest.approx(
            rate, abs=1e-8
        )

    def test_nose_straight_up_is_finite(self):
        np.testing.assert_allclose(
            np.reshape(level((-1.0, 0.0, 0.0)), (3, 3)), rotation(0, math.pi / 2), atol=1e-12
        )


class TestFilter:
    def test_gyro_alone_follows_a_tumble(self):
        """An accelerometer in free fall says nothing: up turns as -w x up, here a cone whose end is
        known.
        """
        w, up = np.array([1.0, -2.0, 0.7]), rotation(0.4, -0.3)[2]
        state = Attitude(up=tuple(up.tolist()))
        for _ in range(2000):
            state = step(state, tuple(w.tolist()), STILL, STILL, Filter(), DT)
        a, k = np.linalg.norm(w) * 2.0, w / np.linalg.norm(w)
        end = up * np.cos(a) - np.cross(k, up) * np.sin(a) + k * (k @ up) * (1 - np.cos(a))
        # Second order in the step: |w|^3 dt^2 t / 6 = 4e-6 rad.
        assert angle(state, end) < 1e-3

    def test_error_decays_with_its_gain(self):
        up = rotation(0.2, 0.0)[2]
        state = still(Attitude(), up, 2.0, Filter(gain=0.5, bias_gain=0.0))
        # Of first order for small angles; sin(.2) for .2 makes .3 %.
        assert angle(state, up) == pytest.approx(math.degrees(0.2) * math.exp(-1.0), rel=0.01)

    def test_converges_with_bias_and_noise(self):
        up, bias = rotation(-0.3, 0.25)[2], np.array([0.01, -0.02, 0.015])
        state = still(Attitude(), up, 40.0, Filter(), gyro=bias, rng=np.random.default_rng(1))
        # Noise .09 m/s^2 at 1 kHz through k_p = .5 leaves .01 deg.
        assert angle(state, up) < 0.1
        across = bias - (bias @ up) * up  # about the vertical nothing is felt
        found = np.array(state.bias)
        np.testing.assert_allclose(found - (found @ up) * up, across, atol=5e-4)

    def test_accelerometer_bias_is_a_lean(self):
        state = still(Attitude(), np.array([0, 0, 1.0]), 60.0, Filter(), bias=(0.05, 0, 0))
        # No filter can tell: .05 / 9.81 rad.
        assert math.degrees(state.pitch) == pytest.approx(-math.degrees(0.05 / GRAVITY), abs=0.01)

    @pytest.mark.parametrize(("known", "most"), [(True, 1e-6), (False, 60)])
    def test_a_known_acceleration_is_no_tilt(self, known, most):
        """Level, 3 m/s^2 forward for 2 s: unknown it is taken for a nose-up of up to 17 degrees."""
        state = Attitude()
        for _ in range(2000):
            state = step(
                state,
                STILL,
                (3.0, 0.0, GRAVITY),
                (3.0, 0.0, 0.0) if known else STILL,
                Filter(bias_gain=0.0),
                DT,
            )
        off = abs(math.degrees(state.pitch))
        assert off <= most
        if not known:
            # (1 - exp(-k_p t)) of atan(3 / 9.81) = 17 deg
            assert off == pytest.approx(17.0 * (1 - math.exp(-1.0)), rel=0.03)

    def test_shocks_are_not_believed(self):
        state = still(Attitude(), np.array([0, 0, 1.0]), 0.1, Filter(gain=50.0), bias=(40.0, 0, 0))
        assert state.up == (0.0, 0.0, 1.0)
