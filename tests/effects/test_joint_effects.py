"""What encoders read: whole counts, the error of an eccentric graduation, speeds of a window."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vstestbed.effects.joints import Encoders
from vstestbed.robots import Puma560

TURNING = np.zeros(1, dtype=bool)


class TestEncoders:
    def test_angles_come_in_whole_counts(self) -> None:
        q = np.linspace(0, 0.01, 2001)
        read = np.array(
            [Encoders(counts=(4096,)).read(np.array([a]), np.zeros(1), TURNING)[0][0] for a in q]
        )
        step = 2 * math.pi / 4096
        np.testing.assert_allclose(read / step, np.round(read / step), atol=1e-9)
        assert np.abs(read - q).max() <= step / 2 + 1e-12
        assert np.diff(np.unique(np.round(read / step))) == pytest.approx(1.0)

    def test_its_error_over_a_turn_is_uniform(self) -> None:
        """Variance c^2 / 12 of a quantisation by c."""
        q, encoders = np.random.default_rng(0).uniform(-3, 3, 4000), Encoders(counts=(1000,))
        error = np.array([encoders.read(np.array([a]), np.zeros(1), TURNING)[0][0] for a in q]) - q
        assert np.var(error) == pytest.approx((2 * math.pi / 1000) ** 2 / 12, rel=0.05)

    def test_speeds_are_counts_of_a_window(self) -> None:
        quantum = 2 * math.pi / 1000 / 0.01
        speeds = [
            Encoders(counts=(1000,)).read(np.zeros(1), np.array([v]), TURNING)[1][0]
            for v in (0.4 * quantum, 0.6 * quantum)
        ]
        assert speeds == pytest.approx([0.0, quantum])

    def test_eccentricity_is_an_error_of_once_a_turn(self) -> None:
        encoders = Encoders(eccentricity_deg=(0.1,), turns=(3.0,))
        q = np.linspace(0, 2 * math.pi, 360, endpoint=False)
        error = np.array([encoders.read(np.array([a]), np.zeros(1), TURNING)[0][0] for a in q]) - q
        waves = np.abs(np.fft.rfft(error)) / 180
        assert np.argmax(waves) == 3 and math.degrees(waves[3]) == pytest.approx(0.1)
        assert np.delete(waves, 3).max() == pytest.approx(0.0, abs=1e-12)

    def test_its_speed_is_the_rate_of_its_angle(self) -> None:
        encoders, q, h = Encoders(eccentricity_deg=(0.5,), turns=(7.0,)), 0.3, 1e-6
        (after,), (before,) = (
            encoders.read(np.array([q + s * 2.0 * h]), np.zeros(1), TURNING)[0] for s in (1, -1)
        )
        assert encoders.read(np.array([q]), np.array([2.0]), TURNING)[1][0] == pytest.approx(
            (after - before) / (2 * h), rel=1e-7
        )

    def test_joints_that_slide_are_read_exactly(self) -> None:
        q, qd = Encoders(counts=(100,)).read(
            np.array([0.123, 0.123]), np.array([0.1, 0.1]), np.array([False, True])
        )
        assert q[0] != 0.123 and (q[1], qd[1]) == (0.123, 0.1)

    def test_the_controller_reads_them_and_the_log_has_the_truth(self) -> None:
        robot = Puma560(encoders=Encoders(counts=(1000,)))
        q = np.full(6, 0.1)
        assert robot.instruments(np.random.default_rng(0))(q, q, {}).q == pytest.approx(
            2 * math.pi / 1000 * 16
        )
