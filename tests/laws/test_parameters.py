"""Every law's numbers: the limits of what is accepted."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.laws import IBVS, LineFollowing, Partitioned, PoseController, Pursuit, Uncalibrated
from vstestbed.laws.base import AdaptiveGain, ConstantGain, TwistLimits
from vstestbed.laws.feedforward import AlphaBeta, Integral, KalmanCA, KalmanCV
from vstestbed.laws.points import Visibility
from vstestbed.laws.solve import Solve
from vstestbed.laws.uncalibrated import Broyden, Excitation, RecursiveLeastSquares

POSITIVE = [
    (Partitioned, "gain_z"),
    (Partitioned, "gain_turn"),
    (Partitioned, "gain_xy"),
    (PoseController, "rest_m"),
    (PoseController, "speed_mps"),
    (Pursuit, "gain"),
    (Pursuit, "filter_s"),
    (LineFollowing, "gain"),
    (LineFollowing, "cruise_mps"),
    (LineFollowing, "approach_deg"),
    (ConstantGain, "value"),
    (AdaptiveGain, "at_zero"),
    (AdaptiveGain, "at_infinity"),
    (AdaptiveGain, "slope_at_zero"),
    (TwistLimits, "speed_mps"),
    (TwistLimits, "rate_radps"),
    (Visibility, "strength_pxps"),
    (AlphaBeta, "alpha"),
    (KalmanCV, "bandwidth_hz"),
    (KalmanCA, "bandwidth_hz"),
    (Integral, "rate_per_s2"),
    (Broyden, "rate"),
    *((Uncalibrated, name) for name in ("step_px", "most_pxps", "trust_px", "settled_px")),
    *((Excitation, name) for name in ("amplitude_px", "time_s", "speed_share")),
]
FROM_ZERO = [
    (IBVS, "smooth_start_s"),
    (IBVS, "smoothing_s"),
    (PoseController, "pass_m"),
    (Pursuit, "coast_s"),
    (LineFollowing, "coast_s"),
    (Uncalibrated, "patience_s"),
    (Visibility, "margin_px"),
    (Solve, "cutoff"),
    (Solve, "damping"),
    (Solve, "levenberg_marquardt"),
    (Solve, "fades_below"),
    *((kind, "predict_s") for kind in (AlphaBeta, KalmanCV, KalmanCA)),
]


def test_zero_is_refused_and_little_is_not():
    for cls, name in POSITIVE:
        # Small against every limit; an adaptive gain's must stay over the gain far away.
        little = 0.41 if (cls, name) == (AdaptiveGain, "at_zero") else 1e-3
        assert getattr(cls(**{name: little}), name) == little
        for wrong in (0.0, -1e-3):
            with pytest.raises(ParameterError, match=name):
                cls(**{name: wrong})


def test_zero_is_accepted_and_less_is_not():
    for cls, name in FROM_ZERO:
        assert getattr(cls(**{name: 0.0}), name) == 0.0
        with pytest.raises(ParameterError, match=name):
            cls(**{name: -1e-9})


def test_the_largest_that_is_accepted():
    for cls, name, most, too_much in (
        (AlphaBeta, "alpha", 1.0, 1.001),
        (AlphaBeta, "predict_s", 2.0, 2.001),
        (KalmanCV, "bandwidth_hz", 100.0, 100.1),
        (KalmanCA, "predict_s", 2.0, 2.001),
        (LineFollowing, "approach_deg", 79.99, 80.0),
        (Solve, "cutoff", 0.999, 1.0),
        (AdaptiveGain, "at_infinity", 3.999, 4.0),
        (Broyden, "rate", 1.0, 1.001),
        (RecursiveLeastSquares, "forgetting", 1.0, 1.001),
    ):
        assert getattr(cls(**{name: most}), name) == most
        with pytest.raises(ParameterError, match=name):
            cls(**{name: too_much})


def test_turn_limits_are_two_and_hold_the_start():
    for limits in ((0, 90), (-90, 0), (0, 0)):
        assert Partitioned(turn_limits_deg=limits).turn_limits_deg == limits
    for limits, words in (
        ((-90, -1), "low <= 0 <= high"),
        ((1, 90), "low <= 0 <= high"),
        ((-10,), "turn_limits_deg"),
        ((-10, 0, 10), "turn_limits_deg"),
    ):
        with pytest.raises(ParameterError, match=words):
            Partitioned(turn_limits_deg=limits)


def test_polar_gains_at_the_borders_of_stability_are_refused():
    for wrong in ({"k_rho": 0.0}, {"k_beta": 0.0}, {"k_alpha": 1.0}, {"k_rho": math.nan}):
        with pytest.raises(ParameterError, match=next(iter(wrong))):
            PoseController(**wrong)
    assert PoseController(k_rho=1e-3, k_alpha=1.1e-3, k_beta=-1e-3).k_alpha == 1.1e-3


class TestTwistLimits:
    TWIST = np.array([3.0, 0, 4, 0, 1, 0])

    def test_one_and_many_alike(self):
        for limits, factor in (
            ({}, 1.0),
            ({"speed_mps": 5.0}, 1.0),
            ({"speed_mps": 2.5}, 0.5),
            ({"rate_radps": 0.25}, 0.25),
            ({"speed_mps": 2.5, "rate_radps": 0.25}, 0.25),
            ({"speed_mps": 1.0, "rate_radps": 0.25}, 0.2),
            ({"rate_radps": 2.0}, 1.0),
        ):
            made = TwistLimits(**limits)
            assert made.scale(self.TWIST) == pytest.approx(factor, rel=1e-15)
            many = made.within(np.stack([self.TWIST, 0.01 * self.TWIST, np.zeros(6)]))
            np.testing.assert_allclose(
                many, [factor * self.TWIST, 0.01 * self.TWIST, np.zeros(6)], rtol=1e-14
            )
            basis = np.diag([2.0, 1, 1, 1, 1, 1])
            command = made.command(self.TWIST / [2, 1, 1, 1, 1, 1], basis)
            assert (
                command.scale == pytest.approx(factor)
                and not command.free
                and not command.rest_reason
            )
            np.testing.assert_allclose(command.twist, factor * self.TWIST, rtol=1e-14)
            np.testing.assert_allclose(basis @ command.u, command.twist, rtol=1e-14)


def test_the_adaptive_gain_of_many_is_that_of_each():
    gain, errors = (
        AdaptiveGain(at_zero=3.0, at_infinity=1.0, slope_at_zero=8.0),
        np.array([[0.0, 0.0], [0.1, -0.5], [-0.2, 0.1]]),
    )
    found = gain.at(errors)
    # (l0 - linf) exp(-slope x / (l0 - linf)) + linf
    np.testing.assert_allclose(
        found, [[3.0], [2 * math.exp(-4 * 0.5) + 1], [2 * math.exp(-4 * 0.2) + 1]], rtol=1e-14
    )
    h = 1e-7
    assert (gain.at(np.array([h])) - gain.at(np.array([0.0])))[0] / h == pytest.approx(
        -8.0, rel=1e-5
    )
