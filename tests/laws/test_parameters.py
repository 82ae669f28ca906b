"""Every law's numbers: the defaults that scenarios rely on, and the limits of what is accepted."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.laws import IBVS, PBVS, Hybrid, LawBase, LineFollowing, Partitioned, PoseController, Pursuit, Uncalibrated
from vstestbed.laws.base import AdaptiveGain, ConstantGain, TwistLimits
from vstestbed.laws.error_law import CARRY_S
from vstestbed.laws.feedforward import AlphaBeta, Integral, KalmanCA, KalmanCV
from vstestbed.laws.points import Visibility
from vstestbed.laws.solve import Solve
from vstestbed.laws.uncalibrated import Broyden, Excitation, RecursiveLeastSquares

OF_ERRORS = {"gain": ConstantGain(value=0.5), "smooth_start_s": 0.0, "smoothing_s": 0.0, "keep_last": False}
NUMBERS: dict[type, dict[str, Any]] = {
    IBVS: OF_ERRORS | {"redundant": False},
    Partitioned: OF_ERRORS
    | {
        "gain_z": 1.0,
        "gain_turn": 0.5,
        "gain_xy": 0.5,
        "axes": ("z", "wz"),
        "turn_limits_deg": None,
    },
    PBVS: OF_ERRORS,
    Hybrid: OF_ERRORS,
    Uncalibrated: {
        "gain": ConstantGain(value=0.5),
        "step_px": 3.0,
        "most_pxps": 200.0,
        "trust_px": 1000.0,
        "predict": True,
        "dynamic": False,
        "patience_s": 3.0,
        "settled_px": 0.2,
    },
    Broyden: {"rate": 0.5},
    RecursiveLeastSquares: {"forgetting": 0.8},
    Excitation: {"amplitude_px": 20.0, "time_s": 0.4, "speed_share": 0.2},
    PoseController: {"k_rho": 1.0, "k_alpha": 5.0, "k_beta": -2.0, "rest_m": 0.02, "pass_m": 0.1, "speed_mps": 1.0},
    Pursuit: {"gain": 1.0, "filter_s": 0.5, "coast_s": 0.5},
    LineFollowing: {"gain": 3.0, "cruise_mps": 0.8, "approach_deg": 25.0, "coast_s": 0.2},
    ConstantGain: {"value": 0.5},
    AdaptiveGain: {"at_zero": 4.0, "at_infinity": 0.4, "slope_at_zero": 30.0},
    TwistLimits: {"speed_mps": None, "rate_radps": None},
    Visibility: {"margin_px": 0.0, "strength_pxps": 20.0},
    Solve: {"cutoff": 1e-6, "damping": 0.0, "levenberg_marquardt": 0.0, "fades_below": 0.0},
    AlphaBeta: {"alpha": 0.8, "predict_s": 0.0},
    KalmanCV: {"bandwidth_hz": 5.0, "predict_s": 0.0},
    KalmanCA: {"bandwidth_hz": 2.0, "predict_s": 0.0},
    Integral: {"rate_per_s2": 0.25},
}
NO_NUMBERS = {
    "kind",
    "feature",
    "interaction",
    "depth",
    "limits",
    "visibility",
    "feedforward",
    "solve",
    "sigma",
    "source",
    "translation",
    "direction",
    "projection",
    "estimator",
    "excitation",
}


@pytest.mark.parametrize("cls", NUMBERS, ids=lambda cls: cls.__name__)
def test_the_defaults_are_the_documented_ones(cls: type):
    made = cls()
    assert {name: getattr(made, name) for name in NUMBERS[cls]} == NUMBERS[cls]
    assert {f.name for f in fields(cls)} - set(NUMBERS[cls]) <= NO_NUMBERS


def test_the_constants_of_a_law():
    base = LawBase()
    assert (base.cruise_mps, base.rest_m, base.tasks, base.inputs) == (None, 0.0, ("view",), ("xy", "depth"))
    assert CARRY_S == 0.3


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


@pytest.mark.parametrize(("cls", "name"), POSITIVE, ids=str)
def test_zero_is_refused_and_little_is_not(cls: type, name: str):
    # Small against every limit; an adaptive gain's must stay over the gain far away.
    little = 0.41 if (cls, name) == (AdaptiveGain, "at_zero") else 1e-3
    assert getattr(cls(**{name: little}), name) == little
    for wrong in (0.0, -1e-3):
        with pytest.raises(ParameterError, match=name):
            cls(**{name: wrong})


@pytest.mark.parametrize(("cls", "name"), FROM_ZERO, ids=str)
def test_zero_is_accepted_and_less_is_not(cls: type, name: str):
    assert getattr(cls(**{name: 0.0}), name) == 0.0
    with pytest.raises(ParameterError, match=name):
        cls(**{name: -1e-9})


@pytest.mark.parametrize(
    ("cls", "name", "most", "too_much"),
    [
        (AlphaBeta, "alpha", 1.0, 1.001),
        (AlphaBeta, "predict_s", 2.0, 2.001),
        (KalmanCV, "bandwidth_hz", 100.0, 100.1),
        (KalmanCA, "predict_s", 2.0, 2.001),
        (LineFollowing, "approach_deg", 79.99, 80.0),
        (Solve, "cutoff", 0.999, 1.0),
        (AdaptiveGain, "at_infinity", 3.999, 4.0),
        (Broyden, "rate", 1.0, 1.001),
        (RecursiveLeastSquares, "forgetting", 1.0, 1.001),
    ],
)
def test_the_largest_that_is_accepted(cls: type, name: str, most: float, too_much: float):
    assert getattr(cls(**{name: most}), name) == most
    with pytest.raises(ParameterError, match=name):
        cls(**{name: too_much})


@pytest.mark.parametrize(("limits", "right"), [((0, 90), True), ((-90, 0), True), ((-90, -1), False), ((1, 90), False), ((0, 0), True)])
def test_turn_limits_hold_the_start(limits: tuple[float, float], right: bool):
    if right:
        assert Partitioned(turn_limits_deg=limits).turn_limits_deg == limits
        return
    with pytest.raises(ParameterError, match="low <= 0 <= high"):
        Partitioned(turn_limits_deg=limits)


@pytest.mark.parametrize("length", [(-10.0,), (-10.0, 0.0, 10.0)])
def test_turn_limits_are_two(length: tuple[float, ...]):
    with pytest.raises(ParameterError, match="turn_limits_deg"):
        Partitioned(turn_limits_deg=length)


class TestPolarGains:
    @pytest.mark.parametrize(
        "wrong", [{"k_rho": 0.0}, {"k_beta": 0.0}, {"k_alpha": 1.0}, {"k_rho": math.nan}], ids=["rho", "beta", "alpha", "nan"]
    )
    def test_the_borders_of_stability_are_refused(self, wrong: dict[str, float]):
        with pytest.raises(ParameterError, match=next(iter(wrong))):
            PoseController(**wrong)

    def test_next_to_them_they_are_accepted(self):
        assert PoseController(k_rho=1e-3, k_alpha=1.1e-3, k_beta=-1e-3).gains.alpha == 1.1e-3


class TestTwistLimits:
    TWIST = np.array([3.0, 0, 4, 0, 1, 0])

    @pytest.mark.parametrize(
        ("limits", "factor"),
        [
            ({}, 1.0),
            ({"speed_mps": 5.0}, 1.0),
            ({"speed_mps": 2.5}, 0.5),
            ({"rate_radps": 0.25}, 0.25),
            ({"speed_mps": 2.5, "rate_radps": 0.25}, 0.25),
            ({"speed_mps": 1.0, "rate_radps": 0.25}, 0.2),
            ({"rate_radps": 2.0}, 1.0),
        ],
    )
    def test_one_and_many_alike(self, limits: dict[str, float], factor: float):
        made = TwistLimits(**limits)
        assert made.scale(self.TWIST) == pytest.approx(factor, rel=1e-15)
        many = made.within(np.stack([self.TWIST, 0.01 * self.TWIST, np.zeros(6)]))
        np.testing.assert_allclose(many, [factor * self.TWIST, 0.01 * self.TWIST, np.zeros(6)], rtol=1e-14)
        basis = np.diag([2.0, 1, 1, 1, 1, 1])
        command = made.command(self.TWIST / [2, 1, 1, 1, 1, 1], basis)
        assert command.scale == pytest.approx(factor) and not command.free and not command.rest_reason
        np.testing.assert_allclose(command.twist, factor * self.TWIST, rtol=1e-14)
        np.testing.assert_allclose(basis @ command.u, command.twist, rtol=1e-14)


def test_the_adaptive_gain_of_many_is_that_of_each():
    gain, errors = AdaptiveGain(at_zero=3.0, at_infinity=1.0, slope_at_zero=8.0), np.array([[0.0, 0.0], [0.1, -0.5], [-0.2, 0.1]])
    found = gain.at(errors)
    # (l0 - linf) exp(-slope x / (l0 - linf)) + linf
    np.testing.assert_allclose(found, [[3.0], [2 * math.exp(-4 * 0.5) + 1], [2 * math.exp(-4 * 0.2) + 1]], rtol=1e-14)
    h = 1e-7
    assert (gain.at(np.array([h])) - gain.at(np.array([0.0])))[0] / h == pytest.approx(-8.0, rel=1e-5)
