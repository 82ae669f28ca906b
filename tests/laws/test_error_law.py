"""The state of a feedforward between frames: integral, anti-windup, what is dead-reckoned for how
long, horizons before and after now.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Pose, exp, transform
from vstestbed.features.observation import EgoMotion, Goal, Observation
from vstestbed.laws import IBVS, PBVS
from vstestbed.laws.base import TwistLimits, inputs_of
from vstestbed.laws.error_law import (
    DEAD_RECKON_S,
    ErrorState,
    integrated,
    usable_markers,
    usable_pose,
)
from vstestbed.laws.feedforward import (
    AlphaBeta,
    Integral,
    KalmanCA,
    KalmanCV,
    NoFeedforward,
    TargetEstimate,
    look_ahead,
)
from vstestbed.laws.points import TOO_FEW
from vstestbed.targets import Square
from vstestbed.vision.homography import relative_view

NOTHING = ErrorState(np.zeros(0))
SIX, X = np.eye(6), np.array([1.0, 2, 3, 4, 5, 6])
CAMERA, POINTS = Perspective(), Square(side=0.5, pose=Pose()).points
AWAY = Pose(xyz=(0.1, -0.05, 1.2), rpy_deg=(5, -8, 20)).T


def seen(t: float, motion: EgoMotion | None = None) -> Observation:
    uv = np.zeros((4, 2))
    return Observation(t, uv, uv, np.ones(4), motion=motion)


def own(
    since_s: float = 0.04, age_s: float = 0.0, moved: float = 0.0, commanded: float = 0.0
) -> EgoMotion:
    return EgoMotion(np.zeros(6), since_s, np.full(6, moved), age_s, np.full(6, commanded))


def moving(rate: float, change: float | None = None) -> TargetEstimate:
    rows = [0.0, rate] if change is None else [0.0, rate, change]
    return TargetEstimate(np.outer(rows, np.ones(6)), np.zeros(6), np.eye(len(rows)))


class TestIntegral:
    KIND = Integral(rate_per_s2=0.5)

    def test_it_grows_by_the_time_since_the_last_frame(self):
        first, term = integrated(self.KIND, NOTHING, seen(2.0), X)
        assert not term.any()
        second, term = integrated(self.KIND, first, seen(2.3), X)
        np.testing.assert_allclose(term, 0.5 * 0.3 * X)
        _, term = integrated(self.KIND, second, seen(2.4), 2 * X)
        np.testing.assert_allclose(term, 0.5 * (0.3 * X + 0.1 * 2 * X))

    def test_it_does_not_grow_while_the_limits_scale_the_command(self):
        view, goal = (
            Goal.from_view(CAMERA, POINTS, AWAY),
            Goal.from_view(CAMERA, POINTS, Pose(xyz=(0, 0, 1)).T),
        )
        frames = [Observation(0.1 * i, view.uv, view.xy, view.depth) for i in range(3)]
        for speed, grows in ((None, True), (0.01, False)):
            law = IBVS(feedforward=self.KIND, limits=TwistLimits(speed_mps=speed))
            states, state = [], law.init(goal)
            for frame in frames:
                state, command = law.step(state, frame, goal, SIX)
                states.append(state)
                assert (command.scale < 1) is not grows
            assert [each.seen for each in states] == frames
            assert (states[2].integral is not None and bool(states[2].integral.any())) is grows


def test_without_feedforward_or_without_the_cameras_motion_nothing_is_added():
    view, goal = (
        Goal.from_view(CAMERA, POINTS, AWAY),
        Goal.from_view(CAMERA, POINTS, Pose(xyz=(0, 0, 1)).T),
    )
    plain = IBVS()
    for kind, motion in ((NoFeedforward(), own()), (KalmanCV(), None)):
        law = IBVS(feedforward=kind)
        state = law.init(goal)
        after, command = law.step(
            state, Observation(0.0, view.uv, view.xy, view.depth, motion=motion), goal, SIX
        )
        assert after is state
        expected = plain.step(state, Observation(0.0, view.uv, view.xy, view.depth), goal, SIX)[1]
        np.testing.assert_array_equal(command.twist, expected.twist)


def test_only_estimators_ask_for_the_cameras_motion():
    kinds = NoFeedforward(), Integral(), AlphaBeta(), KalmanCV(), KalmanCA()
    assert ["motion" in inputs_of(PBVS(feedforward=kind)) for kind in kinds] == [
        False,
        False,
        True,
        True,
        True,
    ]


class TestDeadReckoning:
    """What is not seen goes on by the camera's motion and the target's, for both kinds of laws."""

    KIND, LONG = KalmanCV(), 5.0
    GOAL = Goal.from_view(
        Perspective(), Square(side=0.5, pose=Pose()).points, Pose(xyz=(0, 0, 1)).T
    )
    T = Pose(xyz=(0.1, -0.05, 1.2), rpy_deg=(5, -8, 20)).T
    TWIST, RATE = (
        np.array([0.1, -0.2, 0.05, 0.1, 0.05, -0.1]),
        np.array([-0.05, 0.1, 0.1, 0.02, 0.0, 0.05]),
    )
    POINTS = Square(side=0.5, pose=Pose()).points

    def view(
        self,
        T: np.ndarray,
        t: float,
        motion: EgoMotion,
        gone: tuple[int, ...] = (),
        rays: bool = False,
    ) -> Observation:
        p = transform(T, self.POINTS)
        uv = self.GOAL.camera.project(p)
        uv[list(gone)] = np.nan
        xy, ray = self.GOAL.camera.normalise(uv), self.GOAL.camera.ray(uv)
        relative = None if gone else relative_view(self.GOAL.xy, xy, self.GOAL.normal)
        depth = np.where(np.isnan(uv[:, 0]), np.nan, p[:, 2])
        around = (
            {"ray": ray, "range": np.where(np.isnan(uv[:, 0]), np.nan, np.linalg.norm(p, axis=1))}
            if rays
            else {}
        )
        return Observation(
            t, uv, xy, depth, None if gone else T, relative=relative, motion=motion, **around
        )

    def frames(
        self, gone: tuple[int, ...], dt: float = 0.04, rays: bool = False
    ) -> tuple[ErrorState, Observation, Observation]:
        """The state after a frame with all markers, the next with some gone, and what it would be
        with all.
        """
        motion = EgoMotion(self.TWIST, dt, np.zeros(6), 0.0, np.zeros(6))
        T = exp(-(self.TWIST + self.RATE) * dt) @ self.T
        target = TargetEstimate(np.stack([np.zeros(6), self.RATE]), np.zeros(6), np.eye(2))
        seen = self.view(self.T, self.LONG, motion, rays=rays)
        state = replace(
            NOTHING, seen=seen, known_t=self.LONG, marker_t=np.full(4, self.LONG), target=target
        )
        now = self.LONG + dt
        return state, self.view(T, now, motion, gone, rays), self.view(T, now, motion, rays=rays)

    @pytest.mark.parametrize("rays", [False, True], ids=["plane", "sphere"])
    @pytest.mark.parametrize("gone", [(0,), (1, 3), (0, 1, 2, 3)], ids=str)
    def test_all_that_was_seen(self, gone: tuple[int, ...], rays: bool):
        state, seen, whole = self.frames(gone, rays=rays)
        inputs = ("ray", "range") if rays else ("xy", "depth")
        known, rows, why = usable_markers(self.KIND, state, seen, SIX, inputs, 3)
        assert rows == slice(None) and bool(why) == (len(gone) > 1)
        for name in (*inputs, "xy", "depth"):
            np.testing.assert_allclose(getattr(known, name), getattr(whole, name), atol=1e-12)
        np.testing.assert_array_equal(known.seen, seen.seen)  # what the picture shows stays
        pose = usable_pose(self.KIND, state, seen, self.GOAL, SIX)
        assert (
            pose is not None
            and pose.T_camera_target is not None
            and pose.relative is not None
            and whole.relative is not None
        )
        np.testing.assert_allclose(pose.T_camera_target, whole.T_camera_target, atol=1e-12)
        np.testing.assert_allclose(pose.relative[0], whole.relative[0], atol=1e-9)
        np.testing.assert_allclose(pose.relative[1], whole.relative[1], atol=1e-9)

    def test_one_that_is_hidden_for_long_moves_with_the_others(self):
        """The target turns aside of what is estimated: three markers tell, and the fourth must fit
        to them.
        """
        state, seen, _ = self.frames((0,))
        state = replace(state, marker_t=np.array([self.LONG - 0.2, *[self.LONG] * 3]))
        aside = (
            exp(np.array([0.003, -0.002, 0.001, 0.002, -0.003, 0.004]))
            @ exp(-(self.TWIST + self.RATE) * 0.04)
            @ self.T
        )
        assert seen.motion is not None
        known, _, why = usable_markers(
            self.KIND, state, self.view(aside, seen.t, seen.motion, (0,)), SIX, ("xy", "depth"), 3
        )
        assert not why
        expected = self.view(aside, seen.t, seen.motion).xy[0]
        assert np.abs(known.xy[0] - expected).max() < 1e-4
        unmoved = usable_markers(self.KIND, state, seen, SIX, ("xy", "depth"), 3)[0].xy[0]
        assert np.abs(unmoved - expected).max() > 2e-3

    def test_it_ends(self):
        for dt, goes_on in ((DEAD_RECKON_S - 0.01, True), (DEAD_RECKON_S + 0.01, False)):
            state, seen, _ = self.frames((1, 2), dt)
            rows = usable_markers(self.KIND, state, seen, SIX, ("xy", "depth"), 3)[1]
            assert isinstance(rows, str) != goes_on
            assert (usable_pose(self.KIND, state, seen, self.GOAL, SIX) is not None) == goes_on
        state, seen, _ = self.frames((1,), DEAD_RECKON_S + 0.01)  # enough markers without it
        known, rows, why = usable_markers(self.KIND, state, seen, SIX, ("xy", "depth"), 3)
        assert (
            not why
            and np.array_equal(rows, [True, False, True, True])
            and np.isnan(known.xy[1]).all()
        )

    def test_it_needs_an_estimator_an_estimate_and_the_own_motion(self):
        state, seen, whole = self.frames((1, 2))
        lacking = (
            (Integral(), state, seen),
            (self.KIND, replace(state, target=None), seen),
            (self.KIND, state, replace(seen, motion=None)),
            (self.KIND, NOTHING, seen),
        )
        for kind, given, observation in lacking:
            assert isinstance(
                usable_markers(kind, given, observation, SIX, ("xy", "depth"), 3)[1], str
            )
            assert usable_pose(kind, given, observation, self.GOAL, SIX) is None
        assert usable_markers(self.KIND, state, whole, SIX, ("xy", "depth"), 3)[0] is whole

    def test_the_estimate_learns_nothing_from_a_frame_without_enough(self):
        state, seen, whole = self.frames((1, 2))
        law = IBVS(feedforward=self.KIND)
        after = law.step(state, seen, self.GOAL, SIX)[0]
        assert after.target is not None and after.known_t == self.LONG
        np.testing.assert_allclose(after.target.rate, self.RATE)
        np.testing.assert_array_equal(after.marker_t, [seen.t, self.LONG, self.LONG, seen.t])
        assert law.step(state, whole, self.GOAL, SIX)[0].known_t == seen.t

    def test_a_command_says_what_is_lacking(self):
        state, seen, whole = self.frames((1, 2))
        for law, why in (
            (IBVS(feedforward=self.KIND), TOO_FEW),
            (PBVS(feedforward=self.KIND), TOO_FEW),
        ):
            command = law.step(state, seen, self.GOAL, SIX)[1]
            assert command.rest_reason == why and command.twist.any()
            assert not law.step(state, whole, self.GOAL, SIX)[1].rest_reason


class TestHorizon:
    def test_before_at_and_after_now(self):
        for predict_s, expected in (
            # Half of the way that the camera has gone in .1 s since the exposure; all of it; and .1
            # s more as commanded.
            (0.05, 0.3 * 0.05 + 0.02),
            (0.1, 0.3 * 0.1 + 0.04),
            (0.2, 0.3 * 0.2 + 0.04 + 0.5 * 0.1),
        ):
            shift, rate = look_ahead(
                KalmanCV(predict_s=predict_s),
                moving(0.3),
                SIX,
                own(age_s=0.1, moved=0.04, commanded=0.5),
            )
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
        still = TargetEstimate(np.zeros((2, 1)), np.zeros(1), np.eye(2))
        shift, _ = look_ahead(KalmanCV(predict_s=0.1), still, 2 * SIX[:, :1], own(commanded=0.5))
        np.testing.assert_allclose(shift, [0.5 * 0.1 / 2])


class TestAlphaBeta:
    def test_one_step_by_hand(self):
        kind = AlphaBeta(alpha=0.5)
        first = kind.update(None, X, 0.1, 6)
        assert not first.state.any() and not first.moved.any() and first.P.shape == (2, 2)
        second = kind.update(first, X, 0.1, 6)
        # beta = alpha^2 / (2 - alpha) = 1/6; r is the whole displacement.
        np.testing.assert_allclose(second.state, [0.5 * X, X / 6 / 0.1])
        third = kind.update(second, None, 0.1, 6)
        np.testing.assert_allclose(third.state, [0.5 * X + 0.1 * X / 0.6, X / 0.6])
        np.testing.assert_allclose(third.moved, third.state[0])


def test_the_first_frames_set_a_kalman_filters_rate():
    target = KalmanCV(bandwidth_hz=1.0).update(None, None, 0.04, 2)
    corner = 2 * np.pi
    np.testing.assert_allclose(target.P, np.diag([corner, 1e3 * corner**3]))
    np.testing.assert_allclose(
        KalmanCA(bandwidth_hz=1.0).update(None, None, 0.04, 2).P,
        np.diag([corner, 1e3 * corner**3, 1e3 * corner**5]),
    )
