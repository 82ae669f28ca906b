"""The target's motion: filters against steady-state theory, the law against targets that move, on
the ideal camera.
"""

from __future__ import annotations

import functools
import json
import math

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.features.observation import EgoMotion
from vstestbed.laws.feedforward import (
    AlphaBeta,
    KalmanCA,
    KalmanCV,
    follow,
    look_ahead,
    white_noise,
)

DT = 0.04
STILL = EgoMotion(np.zeros(6), DT, np.zeros(6), 0.0, np.zeros(6))
B = np.eye(6)


def followed(kind, ways):
    """The trend after the target's displacements ways (K,) along x, seen by a camera that stands
    still.
    """
    trend = None
    for before, now in zip([ways[0], *ways[:-1]], ways, strict=True):
        trend = follow(kind, trend, (np.eye(6)[0] * (now - before), np.eye(6)), B, STILL)
    return trend


@pytest.mark.parametrize(
    ("kind", "order"),
    [(KalmanCV(bandwidth_hz=2), 2), (KalmanCA(bandwidth_hz=2), 3)],
    ids=["cv", "ca"],
)
def test_the_filters_settle_to_the_solution_of_the_riccati_equation(kind, order):
    F = np.array(
        [
            [DT ** (j - i) / math.factorial(j - i) if j >= i else 0 for j in range(order)]
            for i in range(order)
        ]
    )
    Q, H = white_noise(order, DT, (2 * np.pi * 2) ** (2 * order)), np.eye(order)[:1]
    steady = solve_discrete_are(F.T, H.T, Q, np.array([[1 / DT]]))
    expected = steady - steady @ H.T @ H @ steady / (steady[0, 0] + 1 / DT)
    assert np.allclose(followed(kind, np.zeros(200)).P, expected, rtol=1e-6)


def test_a_kalman_filter_of_constant_velocity_is_an_alpha_beta_filter():
    # Kalata 1984 has beta = 2 (2 - alpha) - 4 sqrt(1 - alpha) for acceleration that is constant in
    # each period; ours is white within it.
    trend = followed(KalmanCV(bandwidth_hz=2), np.zeros(200))
    predicted = np.array([[1, DT], [0, 1]]) @ trend.P @ np.array([[1, DT], [0, 1]]).T + white_noise(
        2, DT, (4 * np.pi) ** 4
    )
    alpha, beta = predicted[:, 0] / (predicted[0, 0] + 1 / DT) * [1, DT]
    assert beta == pytest.approx(2 * (2 - alpha) - 4 * math.sqrt(1 - alpha), rel=0.05)


def test_white_noise_by_summing_small_steps():
    small, F = (
        DT / 2000,
        np.array([[1, DT / 2000, (DT / 2000) ** 2 / 2], [0, 1, DT / 2000], [0, 0, 1]]),
    )
    P = np.zeros((3, 3))
    for _ in range(2000):
        P = F @ P @ F.T + np.diag([0, 0, 5.0 * small])
    assert np.allclose(P, white_noise(3, DT, 5.0), rtol=2e-3)  # steps of a two-thousandth


@pytest.mark.parametrize("kind", [AlphaBeta(), KalmanCV(), KalmanCA()], ids=lambda k: k.kind)
def test_a_constant_speed_is_known_exactly(kind):
    trend = followed(kind, 0.1 * DT * np.arange(200))
    assert trend.rate[0] == pytest.approx(0.1, rel=1e-6)
    assert np.allclose(trend.rate[1:], 0)


def test_the_lag_of_a_changing_speed():
    # Behind a ramp of speed a t, a Butterworth filter of two poles lags by sqrt 2 / (2 pi f); one
    # of three poles does not.
    ways = 0.5 * 0.2 * (DT * np.arange(300)) ** 2
    speed = 0.2 * DT * 299
    slow = followed(KalmanCV(bandwidth_hz=1), ways)
    # to half a period of sampling
    assert (speed - slow.rate[0]) / 0.2 == pytest.approx(math.sqrt(2) / (2 * math.pi), abs=DT / 2)
    assert followed(KalmanCA(bandwidth_hz=1), ways).rate[0] == pytest.approx(speed, rel=1e-3)


def test_the_cameras_own_motion_is_taken_out():
    twist = np.array([0.1, -0.2, 0.3, 0.1, 0.2, -0.1])
    L = np.random.default_rng(0).normal(size=(8, 6))
    trend, motion = None, EgoMotion(twist, DT, np.zeros(6), 0.0, twist)
    for _ in range(50):
        trend = follow(KalmanCV(), trend, (L @ twist * DT, L), B, motion)
    assert np.allclose(trend.rate, 0, atol=1e-12)


def test_a_picture_without_enough_markers_is_bridged():
    trend = followed(KalmanCV(), 0.1 * DT * np.arange(100))
    for _ in range(5):
        trend = follow(KalmanCV(), trend, None, B, STILL)
    assert trend.rate[0] == pytest.approx(0.1, rel=1e-6)
    assert trend.P[1, 1] > followed(KalmanCV(), np.zeros(100)).P[1, 1]


def test_looking_ahead_adds_the_targets_way_and_the_cameras():
    trend = followed(KalmanCA(), 0.1 * DT * np.arange(100))
    motion = EgoMotion(
        np.zeros(6), DT, np.array([0.01, 0, 0, 0, 0, 0]), 0.05, np.array([0.2, 0, 0, 0, 0, 0])
    )
    ahead, rate = look_ahead(KalmanCA(predict_s=0.08), trend, B, motion)
    # moved until now, commanded from there on
    assert ahead[0] == pytest.approx(0.1 * 0.08 + 0.01 + 0.2 * 0.03, rel=1e-6)
    assert rate[0] == pytest.approx(0.1, rel=1e-6)


CIRCLE = {"kind": "circle", "radius_m": 0.1, "frequency_hz": 0.2}
WANDER = {"kind": "random_walk", "rms_m": [0.07, 0.07, 0.03], "corner_hz": 0.2}


def tracking(feedforward, motion=CIRCLE, **settings):
    """The true tracking error [m], RMS after 5 s, of the ideal camera with a picture 40 ms late and
    .05 px of noise.
    """
    return flown(json.dumps([feedforward, motion, settings]))


@functools.cache
def flown(words):
    """`tracking` of its arguments; several tests compare with the same run."""
    feedforward, motion, settings = json.loads(words)
    setting = {
        "robot": {
            "kind": "free",
            "start": {"nominal": {"xyz": [0.55, 0.05, 0.7], "rpy_deg": [0, 90, 0]}},
        },
        "detector": "oracle",
        "noise.pixel_sigma_px": 0.05,
        "target.motion": motion,
        "stop.duration_s": 15,
    }
    if feedforward:
        setting["law.feedforward"] = feedforward
    return vs.run(vs.load("arm_track_circle", setting | settings)).summary()["tracking_rms_m"]


class TestOnTheIdealCamera:
    def test_alone_it_lags_as_theory_says(self):
        # e' = u - target's speed with u = -g e(t - T): |e| = w r / |j w + g exp(-j w T)|, T the
        # latency and half a period of holding.
        w, g, T = 2 * math.pi * 0.2, 1.0, 0.04 + DT / 2
        assert tracking({"kind": "none"}) == pytest.approx(
            0.1 * w / abs(1j * w + g * np.exp(-1j * w * T)), rel=0.02
        )

    def test_feedforward_cuts_the_error_by_five_and_prediction_by_more(self):
        alone, ahead = tracking({"kind": "none"}), tracking({"kind": "kalman_cv"})
        predicted = tracking({"kind": "kalman_ca", "predict_s": 0.06})
        assert ahead < alone / 5
        assert predicted < ahead / 2

    def test_a_target_that_never_repeats(self):
        assert (
            tracking({"kind": "kalman_ca", "predict_s": 0.06}, WANDER)
            < tracking({"kind": "none"}, WANDER) / 3.5
        )

    def test_a_law_of_poses_follows_as_well(self):
        alone, ahead, predicted = (
            tracking(None, law={"kind": "pbvs", "gain": 1.0, "feedforward": kind})
            for kind in (
                {"kind": "none"},
                {"kind": "kalman_cv"},
                {"kind": "kalman_ca", "predict_s": 0.06},
            )
        )
        assert alone == pytest.approx(0.083, rel=0.06)  # as with points: the lag is the loop's
        assert ahead < alone / 5
        assert predicted < ahead / 2

    @pytest.mark.parametrize(("law", "torn"), one_quick(("hybrid", 3), ("partitioned", 1.5)))
    def test_laws_of_both_follow_as_well(self, law, torn):
        short = {
            "law": {
                "kind": law,
                "gain": 1.0,
                "feedforward": {"kind": "kalman_ca", "predict_s": 0.06},
            },
            "stop.duration_s": 8,
        }
        whole = tracking(None, **short)
        assert whole < 0.083 / 12
        # a homography needs all four
        assert tracking(None, **short, **{"noise.dropout": 0.1}) < torn * whole

    @pytest.mark.study
    def test_integral_action_of_a_partitioned_law(self):
        law = {
            "kind": "partitioned",
            "gain": 1.0,
            "feedforward": {"kind": "integral", "rate_per_s2": 0.5},
        }
        assert tracking(None, {"kind": "line", "velocity_mps": [0.03, 0, 0]}, law=law) < 0.03 / 5

    def test_integral_action_follows_a_constant_speed_without_an_error(self):
        line = {"kind": "line", "velocity_mps": [0.03, 0, 0]}
        alone, integral = (
            tracking(f, line) for f in ({"kind": "none"}, {"kind": "integral", "rate_per_s2": 0.5})
        )
        assert alone == pytest.approx(0.03, rel=0.1)  # speed over gain
        assert integral < alone / 5

    def test_markers_that_drop_out_do_little(self):
        whole, torn, shreds = (
            tracking({"kind": "kalman_cv"}, **{"noise.dropout": p}) for p in (0.0, 0.1, 0.3)
        )
        assert torn < 1.3 * whole and shreds < 2 * whole
