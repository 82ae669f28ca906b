"""Runs with targets that move, cameras in the room, sets of markers that take turns."""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ScenarioError

OUT = {"detector": "oracle", "noise.pixel_sigma_px": 0.05}


class TestTracking:
    def test_a_view_kept_in_its_band_completes_and_its_error_is_told(self):
        r = vs.run(vs.load("arm_track_circle", OUT | {"stop.duration_s": 8}))
        assert r.outcome is vs.Outcome.completed
        s, settled = r.summary(), r["t"] >= 5
        metres = r["position_error_m"][settled]
        assert np.allclose(metres, np.abs(r["task_error_m"][settled]), rtol=0, atol=1e-12)
        assert s["tracking_rms_m"] == pytest.approx(np.sqrt(np.mean(metres**2)))
        assert s["tracking_max_m"] == pytest.approx(metres.max())
        assert 0 < s["tracking_rms_px"] < s["tracking_max_px"]

    def test_without_feedforward_it_leaves_the_band(self):
        r = vs.run(
            vs.load("arm_track_circle", OUT | {"stop.duration_s": 8, "law.feedforward": "none"})
        )
        assert r.outcome is vs.Outcome.timed_out
        assert "out of its band" in r.reason
        # Speed over |j w + gain exp(-j w T)|, T latency, half a period and the servos' lag: .083 m.
        assert r.summary()["tracking_rms_m"] == pytest.approx(0.083, rel=0.06)

    def test_a_target_at_rest_has_no_tracking_error(self):
        assert (
            vs.run(vs.load("arm_ibvs", OUT | {"stop.duration_s": 0.2})).summary()["tracking_rms_m"]
            is None
        )

    @pytest.mark.study
    @pytest.mark.parametrize(("name", "times"), [("arm_track_circle", 5), ("arm_track_random", 3)])
    def test_twenty_seeds_paired(self, name, times):
        def error(feedforward, seed):
            return vs.run(
                vs.load(name, OUT | {"law.feedforward": feedforward}).randomised(seed)
            ).summary()["tracking_rms_m"]

        plain = [
            {"kind": kind} for kind in ("none", "kalman_cv", "kalman_ca", "alpha_beta", "integral")
        ]
        ways = plain + [{"kind": "kalman_ca", "predict_s": p} for p in (0.06, 0.1, 0.14)]
        e = np.array([[error(way, seed) for way in ways] for seed in range(20)])
        for way, median, least in zip(
            ways, 1e3 * np.median(e, axis=0), (e[:, :1] / e).min(axis=0), strict=True
        ):
            print(name, way, f"RMS {median:.1f} mm, least ratio {least:.2f}")
        assert (e[:, 0] > times * e[:, 1]).all()
        assert np.median(e[:, 1]) > np.median(e[:, 5])


class TestEyeToHand:
    def test_the_hand_goes_where_the_camera_wants_it(self):
        r = vs.run(
            vs.load(
                "arm_eye_to_hand",
                {"detector": "oracle", "law.gain": 1.0, "stop.converged.error_px": 0.5},
            )
        )
        assert r.outcome is vs.Outcome.converged
        assert np.ptp(r["cam_x"]) == 0
        assert r.summary()["path_ratio"] > 1
        assert r.summary()["tracking_rms_m"] is None  # what the hand brings is no pursuit
        order, made = (
            np.column_stack([r[f"{who}_{c}"] for c in ("vx", "vy", "vz", "wx", "wy", "wz")])
            for who in ("cmd", "act")
        )
        later = slice(10, 40)  # the servos follow within .1 s
        assert np.abs(made[later] - order[later]).max() < 0.15 * np.abs(order[later]).max()

    def test_pixels_are_where_they_should_be(self):
        r = vs.run(vs.load("arm_eye_to_hand", {"stop.duration_s": 0.2}))
        assert max(np.abs(r[f"u_{i}"] - r[f"u_true_{i}"]).max() for i in range(4)) < 0.5

    def test_only_a_hand_can_hold(self):
        with pytest.raises(ScenarioError, match="may not be held with robot"):
            vs.load(
                "arm_eye_to_hand",
                {"robot": {"kind": "free", "start": {"nominal": {"xyz": [0.5, 0, 0.7]}}}},
            )

    @pytest.mark.study
    def test_twenty_seeds(self):
        outcomes = [
            vs.run(vs.load("arm_eye_to_hand").randomised(seed)).outcome for seed in range(20)
        ]
        assert outcomes == [vs.Outcome.converged] * 20


class TestDocking:
    @pytest.mark.study
    def test_the_inner_markers_take_over(self):
        r = vs.run(vs.load("arm_docking", {"stop.converged.error_px": 1.0, "law.gain": 1.0}))
        assert r.outcome is vs.Outcome.converged
        assert r["view"][0] == 0
        assert r["view"][-1] == 1
        assert 0.95 < r.summary()["path_ratio"] < 1.05  # straight on, by both
        assert not np.isfinite(r["u_0"][-1])  # the outer ones have left the picture
        assert np.isfinite([r[f"u_{i}"][-1] for i in (4, 5, 6, 7)]).all()

    @pytest.mark.study
    def test_one_square_overflows(self):
        r = vs.run(vs.load("arm_docking_overflow", {"law.gain": 1.0}))
        assert r.outcome is vs.Outcome.target_lost
        assert vs.run(
            vs.load(
                "arm_docking_overflow",
                {"law.gain": 1.0, "camera.fovy_deg": 90, "detector": "oracle"},
            )
        ).outcome.success

    def test_what_cannot_be_seen_there_is_refused(self):
        with pytest.raises(ScenarioError, match="outside the 640 x 480 picture"):
            vs.load(
                "arm_docking",
                {
                    "goal.views": [
                        {"T_camera_target": {"xyz": [0, 0, 0.8]}},
                        {"T_camera_target": {"xyz": [0, 0, 0.42]}},
                    ]
                },
            )
        with pytest.raises(ScenarioError, match="numbers of markers, 0 to 7"):
            vs.load(
                "arm_docking",
                {"goal": {"T_camera_target": {"xyz": [0, 0, 0.6]}, "markers": [0, 1, 8]}},
            )
