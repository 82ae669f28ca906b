"""Runs with targets that move, cameras in the room, sets of markers that take turns; nuisances, each measured, each met by a run."""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Frame
from vstestbed.errors import ScenarioError
from vstestbed.sim.noise import Drift
from vstestbed.sim.scene import Parts
from vstestbed.sim.stage import Stage

OUT = {"detector": "oracle", "noise.pixel_sigma_px": 0.05}


class TestTracking:
    def test_a_view_kept_in_its_band_completes_and_its_error_is_told(self):
        r = vs.run(vs.load("arm_track_circle", OUT | {"stop.duration_s": 8}))
        assert r.outcome is vs.Outcome.completed
        s, settled = r.summary(), r["t"] >= 5
        metres = r["position_error_m"][settled]
        assert np.allclose(metres, np.abs(r["off_m"][settled]), rtol=0, atol=1e-12)
        assert s["tracking_rms_m"] == pytest.approx(np.sqrt(np.mean(metres**2)))
        assert s["tracking_max_m"] == pytest.approx(metres.max())
        assert 0 < s["tracking_rms_px"] < s["tracking_max_px"]

    def test_without_feedforward_it_leaves_the_band(self):
        r = vs.run(vs.load("arm_track_circle", OUT | {"stop.duration_s": 8, "law.feedforward": "none"}))
        assert r.outcome is vs.Outcome.timed_out
        assert "out of its band" in r.reason
        # Speed over |j w + gain exp(-j w T)|, T latency, half a period and the servos' lag: .083 m.
        assert r.summary()["tracking_rms_m"] == pytest.approx(0.083, rel=0.06)

    def test_a_target_at_rest_has_no_tracking_error(self):
        assert vs.run(vs.load("arm_ibvs", OUT | {"stop.duration_s": 0.2})).summary()["tracking_rms_m"] is None

    @pytest.mark.study
    @pytest.mark.parametrize(("name", "times"), [("arm_track_circle", 5), ("arm_track_random", 3)])
    def test_twenty_seeds_paired(self, name, times):
        def error(feedforward, seed):
            return vs.run(vs.load(name, OUT | {"law.feedforward": feedforward}).randomised(seed)).summary()["tracking_rms_m"]

        ways = ({"kind": "none"}, {"kind": "kalman_cv"}, {"kind": "kalman_ca", "predict_s": 0.1})
        e = np.array([[error(way, seed) for way in ways] for seed in range(20)])
        print(name, "RMS [mm]", np.round(1e3 * np.median(e, axis=0), 2), "least ratio", np.round((e[:, :1] / e).min(axis=0), 2))
        assert (e[:, 0] > times * e[:, 1]).all()
        assert np.median(e[:, 1]) > np.median(e[:, 2])


class TestEyeToHand:
    def test_the_hand_goes_where_the_camera_wants_it(self):
        r = vs.run(vs.load("arm_eye_to_hand", {"detector": "oracle", "law.gain": 1.0, "stop.converged.error_px": 0.5}))
        assert r.outcome is vs.Outcome.converged
        assert np.ptp(r["cam_x"]) == 0
        assert r.summary()["path_ratio"] > 1
        order, made = (np.column_stack([r[f"{who}_{c}"] for c in ("vx", "vy", "vz", "wx", "wy", "wz")]) for who in ("cmd", "act"))
        later = slice(10, 40)  # the servos follow within .1 s
        assert np.abs(made[later] - order[later]).max() < 0.15 * np.abs(order[later]).max()

    def test_pixels_are_where_they_should_be(self):
        r = vs.run(vs.load("arm_eye_to_hand", {"stop.duration_s": 0.2}))
        assert max(np.abs(r[f"u_{i}"] - r[f"u_true_{i}"]).max() for i in range(4)) < 0.5

    def test_only_a_hand_can_hold(self):
        with pytest.raises(ScenarioError, match="held is for an arm's hand"):
            vs.load("arm_eye_to_hand", {"robot": {"kind": "free", "start": {"nominal": {"xyz": [0.5, 0, 0.7]}}}})

    @pytest.mark.study
    def test_twenty_seeds(self):
        outcomes = [vs.run(vs.load("arm_eye_to_hand").randomised(seed)).outcome for seed in range(20)]
        assert outcomes == [vs.Outcome.converged] * 20


class TestDocking:
    def test_the_inner_markers_take_over(self):
        r = vs.run(vs.load("arm_docking", {"stop.converged.error_px": 1.0, "law.gain": 1.0}))
        assert r.outcome is vs.Outcome.converged
        assert r["view"][0] == 0
        assert r["view"][-1] == 1
        assert not np.isfinite(r["u_0"][-1])  # the outer ones have left the picture
        assert np.isfinite([r[f"u_{i}"][-1] for i in (4, 5, 6, 7)]).all()

    def test_one_square_overflows(self):
        r = vs.run(vs.load("arm_docking_overflow", {"law.gain": 1.0}))
        assert r.outcome is vs.Outcome.target_lost
        assert vs.run(vs.load("arm_docking_overflow", {"law.gain": 1.0, "camera.fovy_deg": 90, "detector": "oracle"})).outcome.success

    def test_what_cannot_be_seen_there_is_refused(self):
        with pytest.raises(ScenarioError, match="outside the 640 x 480 picture"):
            vs.load("arm_docking", {"goal.views": [{"T_camera_target": {"xyz": [0, 0, 0.8]}}, {"T_camera_target": {"xyz": [0, 0, 0.42]}}]})
        with pytest.raises(ScenarioError, match="numbers of markers, 0 to 7"):
            vs.load("arm_docking", {"goal": {"T_camera_target": {"xyz": [0, 0, 0.6]}, "markers": [0, 1, 8]}})


def picture(setting, t=0.0):
    """The servo camera's picture of arm_ibvs at its start, at a time, and its true markers' places in it [px]."""
    from vstestbed.sim.render import Eye

    s = vs.load("arm_ibvs", setting)
    stage = Stage(Parts(s.robot, s.camera, s.target, s.world, 0.002))
    q, T = Parts(s.robot, s.camera, s.target, s.world, 0.002).start
    stage.place(t, s.target.T_world_start, q, T)
    image = Eye(stage, s.camera).picture()
    uv = s.camera.project((s.target.points @ s.target.pose.T[:3, :3].T + s.target.pose.T[:3, 3] - T[:3, 3]) @ T[:3, :3])
    stage.close()
    return image, uv


class TestNuisances:
    def test_gains_drift_as_told(self):
        drift, grey = Drift(brightness=0.2, color=0.1, period_s=8), np.full((4, 4, 3), 100, np.uint8)
        for t, wanted in ((0, (110, 100, 90)), (2, (120, 120, 120)), (4, (90, 100, 110)), (6, (80, 80, 80))):
            assert np.allclose(drift.of(Frame(t=t, images=(grey,))).image[0, 0], wanted, atol=1)
        frame = Frame(t=1.0, images=(grey,))
        assert Drift().of(frame) is frame

    def test_brightness_and_colour_drift_are_met(self):
        drift = {"brightness": 0.3, "color": 0.1, "period_s": 3}
        r = vs.run(vs.load("arm_ibvs", {"noise.drift": drift, "law.gain": 2.0, "stop.converged.error_px": 0.5}))
        assert r.outcome is vs.Outcome.converged
        assert r["lost"].sum() == 0

    def test_markers_drop_out_as_often_as_told(self):
        r = vs.run(vs.load("arm_ibvs", OUT | {"noise.dropout": 0.2, "stop.duration_s": 12, "stop.converged.hold_s": 30}))
        missing = np.mean([~np.isfinite(r[f"u_{i}"]) for i in range(4)])
        assert missing == pytest.approx(0.2, abs=0.035)  # 1204 draws: .0115 by chance, three times that
        assert np.nanmedian(r["error_px"][-50:]) < 2  # it works on; three markers tell less

    def test_a_moving_shadow_is_in_the_picture_and_markers_are_found_in_it(self):
        plate = {
            "pose": {"xyz": [1.05, -0.45, 1.7]},
            "width": 0.25,
            "height": 0.25,
            "motion": {"kind": "line", "velocity_mps": [0, 0.1, 0]},
        }
        setting = {"world.plates": [plate], "camera.shadows": True}
        bare, _ = picture({"camera.shadows": True})
        first, later = (picture(setting, t)[0].astype(int) for t in (0.0, 2.0))
        dark = [np.argwhere(bare.astype(int).sum(axis=2) - image.sum(axis=2) > 60) for image in (first, later)]
        assert min(len(d) for d in dark) > 300
        assert np.linalg.norm(dark[1].mean(axis=0) - dark[0].mean(axis=0)) > 20  # .2 m at 1 m is some 77 px, less where it leaves the board

    def test_decoys_are_in_the_picture_and_steal_nothing(self):
        decoys = [
            {"xyz": [1.4, -0.15, 0.95], "radius": 0.03, "hue_deg": 0},
            {"xyz": [1.4, 0.1, 0.66], "radius": 0.025, "hue_deg": 90, "motion": {"kind": "circle", "radius_m": 0.05, "frequency_hz": 0.5}},
        ]
        image, _ = picture({"world.decoys": decoys})
        bare, _ = picture({})
        red = [np.count_nonzero((i[..., 0].astype(int) - i[..., 1:].max(axis=2)) > 60) for i in (image, bare)]
        assert red[0] > red[1] + 300  # a ball of 3 cm at .8 m has 14 px radius
        r = vs.run(vs.load("arm_ibvs", {"world.decoys": decoys, "law.gain": 2.0, "stop.converged.error_px": 0.5}))
        assert r.outcome is vs.Outcome.converged
        off = [np.hypot(r[f"u_{i}"] - r[f"u_true_{i}"], r[f"v_{i}"] - r[f"v_true_{i}"]) for i in range(4)]
        assert np.nanmax(off) < 3  # never a decoy: those are tens of px away

    def test_a_plate_that_hides_markers_in_part_and_goes_on(self):
        plate = {
            "pose": {"xyz": [1.2, 0.15, 0.8], "rpy_deg": [0, 90, 0]},
            "width": 0.06,
            "height": 0.06,
            "motion": {"kind": "line", "velocity_mps": [0, -0.15, 0]},
        }
        r = vs.run(vs.load("arm_ibvs", {"world.plates": [plate], "law.gain": 2.0, "stop.converged.error_px": 0.5}))
        assert r.outcome is vs.Outcome.converged
