"""The state of a feedforward between frames: integral and its anti-windup, coasting and its end, horizons before and after now."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vstestbed.features.observation import Observation, OwnMotion
from vstestbed.laws.base import Command
from vstestbed.laws.feedforward import AlphaBeta, Integral, KalmanCA, KalmanCV, NoFeedforward, Trend, look_ahead
from vstestbed.laws.following import NOTHING, Followed, anti_windup, coast, feedforward_term, inputs_of

SIX, X = np.eye(6), np.array([1.0, 2, 3, 4, 5, 6])


def seen(t: float, motion: OwnMotion | None = None) -> Observation:
    uv = np.zeros((4, 2))
    return Observation(t, uv, uv, np.ones(4), motion=motion)


def own(since_s: float = 0.04, age_s: float = 0.0, moved: float = 0.0, commanded: float = 0.0) -> OwnMotion:
    return OwnMotion(np.zeros(6), since_s, np.full(6, moved), age_s, np.full(6, commanded))


def moving(rate: float, change: float | None = None) -> Trend:
    rows = [0.0, rate] if change is None else [0.0, rate, change]
    return Trend(np.outer(rows, np.ones(6)), np.zeros(6), np.eye(len(rows)))


class TestIntegral:
    KIND = Integral(rate_per_s2=0.5)

    def test_it_grows_by_the_time_since_the_last_frame(self):
        first, solved, term = feedforward_term(self.KIND, NOTHING, seen(2.0), X, None, SIX)
        assert solved is X and not term.any()
        second, _, term = feedforward_term(self.KIND, first, seen(2.3), X, None, SIX)
        np.testing.assert_allclose(term, 0.5 * 0.3 * X)
        _, _, term = feedforward_term(self.KIND, second, seen(2.4), 2 * X, None, SIX)
        np.testing.assert_allclose(term, 0.5 * (0.3 * X + 0.1 * 2 * X))

    def test_it_does_not_grow_while_the_limits_scale_the_command(self):
        before, after = Followed(integral=X), Followed(integral=2 * X, t=1.0)
        for scale, kept in ((1.0, 2 * X), (0.999, X)):
            made = anti_windup(before, after, Command(u=X, twist=X, scale=scale))
            np.testing.assert_array_equal(made.integral, kept)
            assert made.t == 1.0


def test_without_feedforward_or_without_the_cameras_motion_nothing_is_added():
    for kind, motion in ((NoFeedforward(), own()), (KalmanCV(), None)):
        after, solved, term = feedforward_term(kind, NOTHING, seen(0.0, motion), X, None, SIX)
        assert after is NOTHING and solved is X and not term.any()


def test_only_estimators_ask_for_the_cameras_motion():
    assert [inputs_of(kind) for kind in (NoFeedforward(), Integral(), AlphaBeta(), KalmanCV(), KalmanCA())] == [(), (), *[("motion",)] * 3]


class TestCoasting:
    KIND = KalmanCV()

    def memory(self, t: float = 5.0) -> Followed:
        return Followed(seen=seen(t), t=t, trend=moving(0.2))

    def test_the_estimated_motion_goes_on_for_a_second(self):
        for t, moves in ((5.04, True), (6.0, True), (6.001, False)):
            found = coast(self.KIND, self.memory(), seen(t, own()), SIX)
            assert (found is not None) == moves
            if found is not None:
                after, u = found
                np.testing.assert_allclose(u, -0.2)
                assert after.seen is None and after.t == 5.0

    def test_it_needs_an_estimator_an_estimate_and_the_own_motion(self):
        assert coast(Integral(), self.memory(), seen(5.1, own()), SIX) is None
        assert coast(self.KIND, replace(self.memory(), trend=None), seen(5.1, own()), SIX) is None
        assert coast(self.KIND, self.memory(), seen(5.1), SIX) is None
        assert coast(self.KIND, replace(self.memory(), t=np.nan), seen(5.1, own()), SIX) is None


class TestHorizon:
    @pytest.mark.parametrize(
        ("predict_s", "expected"),
        [
            # Half of the way that the camera has gone in .1 s since the exposure; all of it; and .1 s more as commanded.
            (0.05, 0.3 * 0.05 + 0.02),
            (0.1, 0.3 * 0.1 + 0.04),
            (0.2, 0.3 * 0.2 + 0.04 + 0.5 * 0.1),
        ],
    )
    def test_before_at_and_after_now(self, predict_s: float, expected: float):
        shift, rate = look_ahead(KalmanCV(predict_s=predict_s), moving(0.3), SIX, own(age_s=0.1, moved=0.04, commanded=0.5))
        np.testing.assert_allclose(shift, expected)
        np.testing.assert_allclose(rate, 0.3)

    def test_of_a_picture_that_is_not_late(self):
        shift, _ = look_ahead(KalmanCV(predict_s=0.0), moving(0.3), SIX, own(age_s=0.0, moved=0.04))
        np.testing.assert_allclose(shift, 0.04)

    def test_an_acceleration_counts(self):
        shift, rate = look_ahead(KalmanCA(predict_s=0.2), moving(0.3, 0.5), SIX, own())
        np.testing.assert_allclose(shift, 0.3 * 0.2 + 0.5 * 0.02)
        np.testing.assert_allclose(rate, 0.3 + 0.5 * 0.2)

    def test_in_a_smaller_motion_space(self):
        shift, _ = look_ahead(KalmanCV(predict_s=0.1), Trend(np.zeros((2, 1)), np.zeros(1), np.eye(2)), 2 * SIX[:, :1], own(commanded=0.5))
        np.testing.assert_allclose(shift, [0.5 * 0.1 / 2])


class TestAlphaBeta:
    def test_one_step_by_hand(self):
        kind = AlphaBeta(alpha=0.5)
        first = kind.update(None, X, 0.1, 6)
        assert not first.state.any() and not first.way.any() and first.P.shape == (2, 2)
        second = kind.update(first, X, 0.1, 6)
        # beta = alpha^2 / (2 - alpha) = 1/6; r is the whole displacement.
        np.testing.assert_allclose(second.state, [0.5 * X, X / 6 / 0.1])
        third = kind.update(second, None, 0.1, 6)
        np.testing.assert_allclose(third.state, [0.5 * X + 0.1 * X / 0.6, X / 0.6])
        np.testing.assert_allclose(third.way, third.state[0])


def test_the_first_frames_set_a_kalman_filters_rate():
    trend = KalmanCV(bandwidth_hz=1.0).update(None, None, 0.04, 2)
    corner = 2 * np.pi
    np.testing.assert_allclose(trend.P, np.diag([corner, 1e3 * corner**3]))
    np.testing.assert_allclose(
        KalmanCA(bandwidth_hz=1.0).update(None, None, 0.04, 2).P, np.diag([corner, 1e3 * corner**3, 1e3 * corner**5])
    )
