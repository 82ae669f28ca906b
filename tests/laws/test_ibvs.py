"""The image-based law: convergence on the ideal plant, its known failures, gains, limits, and what
it does when it sees little.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, adjoint, transform
from vstestbed.features import Point
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import IBVS
from vstestbed.laws.base import AdaptiveGain, ConstantGain, TwistLimits
from vstestbed.targets.base import Square

GOLDEN = json.loads(
    (Path(__file__).parents[1] / "golden" / "interaction_matrices.json").read_text()
)
CAMERA, POINTS = Perspective(), Square(side=0.5, pose=Pose()).points
GOAL = Goal.from_view(CAMERA, POINTS, Pose(xyz=(0, 0, 1)).T)
SIX = np.eye(6)
AWAY = Pose(xyz=(0.2, -0.1, 1.6), rpy_deg=(10, -15, 30)).T


def look(
    T_camera_target: Array = AWAY, t: float = 0.0, unseen: tuple[int, ...] = ()
) -> Observation:
    """A perfect observation from a pose."""
    p = transform(T_camera_target, POINTS)
    uv = CAMERA.project(p)
    uv[list(unseen)] = np.nan
    return Observation(t=t, uv=uv, xy=CAMERA.normalise(uv), depth=p[:, 2])


def command(law: IBVS, observation: Observation, basis: Array = SIX) -> Array:
    return law.step(law.init(GOAL), observation, GOAL, basis)[1].u


def ideal(rz_deg: float = 40, **overrides: object) -> vs.Recording:
    """A flight of the ideal camera with the oracle; the book's camera, goal 1 m before the square,
    25 Hz.
    """
    changes = {
        "robot.start": {"nominal": {"xyz": [0.3, 0.3, 1], "rpy_deg": [0, 0, rz_deg]}},
        "camera.rate_hz": 25,
        "detector": {"kind": "oracle", "field_of_view": "unlimited"},
        "law.depth": "oracle",
        "law.gain": 0.5,
    }
    return vs.run(vs.load("ibvs_book", changes | overrides))


class TestOnTheIdealPlant:
    @pytest.mark.parametrize("interaction", ["current", "desired", "mean"])
    def test_converges(self, interaction: str):
        r = ideal(
            **{"law.interaction": interaction, "stop.converged": {"error_px": 0.01, "hold_s": 0}}
        )
        assert r.outcome is vs.Outcome.converged
        # .01 px at 800 px and 1 m: 12 um sideways; the tilt's direction is the weakest, some ten
        # times that.
        assert r["position_error_m"][-1] < 2e-4 and r["rotation_error_rad"][-1] < 2e-4

    def test_the_error_decays_with_the_gain(self):
        r = ideal(**{"stop.converged": {"error_px": 0.01, "hold_s": 0}})
        e = r["error_px"]
        # Current L and true depth: e(t) = e(0) exp(-gain t) at every frame; steps of 40 ms bend it
        # by gain dt = 2 %, more where the camera is far and moves fast (first second left out).
        rate = -np.diff(np.log(e)) / np.diff(r["t"])
        np.testing.assert_allclose(rate[25:], 0.5, rtol=0.04)

    def test_half_turn_retreats_for_ever_with_the_current_matrix(self):
        r = ideal(**{"robot.start": {"nominal": {"xyz": [0, 0, 2], "rpy_deg": [0, 0, 180]}}})
        assert r.outcome is vs.Outcome.diverged and not r.outcome.success

    def test_half_turn_crosses_the_target_with_the_desired_one(self):
        r = ideal(
            **{
                "robot.start": {"nominal": {"xyz": [0, 0, 2], "rpy_deg": [0, 0, 180]}},
                "law.interaction": "desired",
            }
        )
        assert r.outcome is vs.Outcome.target_lost

    def test_smooth_start_arrives_where_the_plain_law_does(self):
        end = {"stop.converged": {"error_px": 0.05, "hold_s": 0}}
        plain, smooth = ideal(**end), ideal(**end, **{"law.smooth_start_s": 0.5})
        assert smooth.outcome is vs.Outcome.converged
        assert smooth["cmd_vz"][0] == 0 < abs(plain["cmd_vz"][0])
        # It starts tau late and makes up for nothing: tau later, give or take half of it.
        assert smooth["t"][-1] - plain["t"][-1] == pytest.approx(0.5, abs=0.25)


class TestGains:
    @pytest.mark.parametrize("case", GOLDEN["adaptive_gain_4_0p4_30"]["cases"])
    def test_adaptive_golden(self, case):
        gain = AdaptiveGain(at_zero=4, at_infinity=0.4, slope_at_zero=30)
        # the norm is the largest component's size
        for e in (np.array([case["in"][0]]), np.array([0.0, -case["in"][0], 0.01])):
            assert gain.at(e) == pytest.approx(case["gain"], rel=1e-10)

    def test_adaptive_looks_at_the_motion_still_to_be_made(self):
        o = look()
        motion = np.linalg.pinv(Point().interaction(o.xy, o.depth)) @ (o.xy - GOAL.xy).ravel()
        # Two ways of the same least squares.
        np.testing.assert_allclose(
            command(IBVS(gain=AdaptiveGain()), o), -AdaptiveGain().at(motion) * motion, rtol=1e-10
        )

    def test_adaptive_rises_towards_the_goal(self):
        assert AdaptiveGain().at(np.zeros(8)) == pytest.approx(4.0, rel=1e-15)
        assert AdaptiveGain().at(np.full(8, 1e3)) == pytest.approx(0.4, rel=1e-15)
        with pytest.raises(ParameterError, match="at_infinity"):
            AdaptiveGain(at_zero=1, at_infinity=2)

    @pytest.mark.parametrize("gain", [0, -1, float("nan")])
    def test_gains_that_do_not_lead_to_the_goal_are_refused(self, gain: float):
        with pytest.raises(ParameterError, match=r"must be > 0|finite"):
            IBVS(gain=gain)

    def test_the_command_is_linear_in_the_gain(self):
        u = [command(IBVS(gain=ConstantGain(value=g)), look()) for g in (0.5, 1.5)]
        np.testing.assert_allclose(u[1], 3 * u[0], rtol=1e-14)


class TestSmoothStart:
    def test_grows_from_rest_to_the_plain_command(self):
        smooth, plain, tau = IBVS(smooth_start_s=0.4), IBVS(), 0.4
        state, u0 = smooth.init(GOAL), command(plain, look())
        for t in (3.0, 3.2, 3.4, 15.0):
            state, given = smooth.step(state, look(t=t), GOAL, SIX)
            np.testing.assert_allclose(given.u, u0 * (1 - np.exp(-(t - 3.0) / tau)), atol=1e-15)
        # 30 tau later nothing is left of it.
        np.testing.assert_allclose(given.u, u0, atol=1e-12)

    def test_begins_anew_after_the_target_was_lost(self):
        law = IBVS(smooth_start_s=0.4)
        state, _ = law.step(law.init(GOAL), look(t=0.0), GOAL, SIX)
        state, _ = law.step(state, look(t=5.0, unseen=(0, 1)), GOAL, SIX)
        _, given = law.step(state, look(t=6.0), GOAL, SIX)
        np.testing.assert_array_equal(given.u, np.zeros(6))


class TestSmoothing:
    def test_is_an_exponential_average(self):
        """A weight of 0.8 of each new command at 25 Hz, as the docstring has it; the first command
        is taken as it is.
        """
        law, plain = IBVS(smoothing_s=-0.04 / np.log(0.2)), IBVS()
        state, mean = law.init(GOAL), np.zeros(6)
        for i, t in enumerate((0.0, 0.04, 0.08, 0.12)):
            seen = replace(look(t=t), xy=look().xy * (1 + i))
            state, given = law.step(state, seen, GOAL, SIX)
            new = command(plain, seen)
            mean = 0.8 * new + 0.2 * mean if i else new
            np.testing.assert_allclose(given.u, mean, rtol=1e-12)

    def test_keeps_the_last_command_where_too_few_markers_are_seen(self):
        law = IBVS(keep_last=True, limits=TwistLimits(speed_mps=0.05))
        state, rest = law.step(law.init(GOAL), look(unseen=(0, 1)), GOAL, SIX)
        assert not rest.twist.any() and rest.rest_reason
        state, given = law.step(state, look(t=1.0), GOAL, SIX)
        _, kept = law.step(state, look(t=2.0, unseen=(0, 1)), GOAL, SIX)
        np.testing.assert_array_equal(kept.twist, given.twist)
        assert kept.rest_reason == rest.rest_reason and not given.rest_reason


@pytest.mark.parametrize(
    "limits", [{"speed_mps": 0.05}, {"rate_radps": 0.02}, {"speed_mps": 0.05, "rate_radps": 0.02}]
)
def test_limits_scale_the_whole_twist(limits: dict[str, float]):
    free, limited = command(IBVS(), look()), command(IBVS(limits=TwistLimits(**limits)), look())
    size = {"speed_mps": np.linalg.norm(limited[:3]), "rate_radps": np.linalg.norm(limited[3:])}
    # The same direction, and just at the tighter limit: rounding.
    np.testing.assert_allclose(
        limited / np.linalg.norm(limited), free / np.linalg.norm(free), atol=1e-14
    )
    assert max(size[name] / limit for name, limit in limits.items()) == pytest.approx(1, rel=1e-12)


class TestFewMarkers:
    def test_three_are_enough_and_only_they_count(self):
        seen = [0, 1, 3]
        o = look(unseen=(2,))
        L, e = Point().interaction(o.xy[seen], o.depth[seen]), (o.xy[seen] - GOAL.xy[seen]).ravel()
        # Square and regular: the pseudo-inverse is the inverse, up to its condition of about 1e2.
        np.testing.assert_allclose(command(IBVS(), o), -0.5 * np.linalg.solve(L, e), rtol=1e-10)

    @pytest.mark.parametrize("unseen", [(0, 1), (1, 2, 3), (0, 1, 2, 3)])
    def test_two_are_too_few_for_six_motions(self, unseen: tuple[int, ...]):
        _, given = IBVS().step(IBVS().init(GOAL), look(unseen=unseen), GOAL, SIX)
        np.testing.assert_array_equal(given.twist, np.zeros(6))
        assert "few markers" in given.rest_reason

    def test_a_marker_without_depth_does_not_count(self):
        o = look()
        half_blind = replace(o, depth=np.where([True, True, False, False], np.nan, o.depth))
        assert IBVS().step(IBVS().init(GOAL), half_blind, GOAL, SIX)[1].rest_reason

    def test_two_are_enough_for_three_motions(self):
        assert (
            not IBVS()
            .step(IBVS().init(GOAL), look(unseen=(0, 2)), GOAL, SIX[:, [0, 1, 5]])[1]
            .rest_reason
        )


class TestMotionBasis:
    """A base that moves in its plane and carries a tilted camera off its centre."""

    BASIS = adjoint(Pose(xyz=(0.1, -0.2, 0.3), rpy_deg=(20, -30, 40)).T)[:, [0, 1, 5]]

    def test_solves_within_the_motions_there_are(self):
        o = look()
        L, e = Point().interaction(o.xy, o.depth), (o.xy - GOAL.xy).ravel()
        _, given = IBVS().step(IBVS().init(GOAL), o, GOAL, self.BASIS)
        np.testing.assert_allclose(given.u, -0.5 * np.linalg.pinv(L @ self.BASIS) @ e, rtol=1e-12)
        np.testing.assert_allclose(given.twist, self.BASIS @ given.u, rtol=1e-15)

    def test_dropping_columns_of_a_six_axis_answer_is_another_and_worse_law(self):
        o = look()
        L, e = Point().interaction(o.xy, o.depth), (o.xy - GOAL.xy).ravel()
        right, cut = command(IBVS(), o, self.BASIS), np.linalg.pinv(self.BASIS) @ command(IBVS(), o)

        def left_over(u: Array) -> float:
            """How far the image's motion is from -gain e."""
            return float(np.linalg.norm(L @ self.BASIS @ u + 0.5 * e))

        # The basis' own answer is the least-squares one; the cut one is far from it, not off by
        # rounding.
        assert left_over(right) < 0.9 * left_over(cut)
        assert np.linalg.norm(right - cut) > 0.3 * np.linalg.norm(right)


def test_interaction_choices():
    o = look()
    e = (o.xy - GOAL.xy).ravel()
    now, then = Point().interaction(o.xy, o.depth), Point().interaction(GOAL.xy, GOAL.depth)
    for word, L in {"current": now, "desired": then, "mean": (now + then) / 2}.items():
        np.testing.assert_allclose(
            command(IBVS(interaction=word), o), -0.5 * np.linalg.pinv(L) @ e, rtol=1e-10
        )
