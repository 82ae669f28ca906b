"""Nuisances in the picture: each measured there or counted, and each met by a run that ends
rightly.

| nuisance | does what it says | a run meets it |
|---|---|---|
| image noise | `test_noise_*` here, sim/test_render, sim/test_timing | here |
| blur | sim/test_timing `TestBlur` | sim/test_timing `test_a_blurred_run_converges` |
| brightness and colour drift | here, by numbers and in the picture | here |
| moving shadows | here | here |
| lens, exposure, sensor, stream | camera/test_optics, ...; | sim/render/test_imaging |
| | sim/render/test_lens_effects, ... | |
| dropout of markers | here | here |
| partial hiding | here; vision/test_blobs | here |
| false blobs | here; vision/test_false_blobs | here; studies/test_nuisances |
| distortion that nobody knows of | camera/test_calibration | test_calibrated_loops; |
| | | studies/test_nuisances |
| depth error | camera/test_calibration | test_calibrated_loops; the maps of test_convergence |
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.imaging.sensor import Drift
from vstestbed.sim.build import PictureSetup, build_plant

QUICK = {"law.gain": 2.0, "stop.converged.error_px": 0.5}
# between the light, straight above and behind, and the board; the shadow crosses the board within
# four seconds
SHADOW = {
    "camera.shadows": True,
    "world.plates": [
        {
            "pose": {"xyz": [1.05, -0.45, 1.7]},
            "width": 0.25,
            "height": 0.25,
            "motion": {"kind": "line", "velocity_mps": [0, 0.25, 0]},
        }
    ],
}
DECOYS = [
    {"xyz": [1.4, -0.15, 0.95], "radius": 0.03, "hue_deg": 0},
    {
        "xyz": [1.4, 0.1, 0.66],
        "radius": 0.025,
        "hue_deg": 90,
        "motion": {"kind": "circle", "radius_m": 0.05, "frequency_hz": 0.5},
    },
]


def picture(setting, t: float = 0.0) -> np.ndarray:
    """The servo camera's picture of arm_ibvs at a time, the arm at rest at its start."""
    s = vs.load("arm_ibvs", setting)
    pictures = PictureSetup(
        needs_image=True,
        needs_truth=False,
        image_sigma=s.noise.image_sigma,
        rng=s.rng(1),
        drift=s.noise.drift,
    )
    plant, _ = build_plant(s.scene, pictures)
    plant.advance(round(t / plant.step_s))
    frame = plant.capture(None)[0]
    assert frame is not None and frame.image is not None
    image = frame.image.astype(float)
    plant.close()
    return image


def away(r: vs.Recording) -> np.ndarray:
    """How far each measured marker is from its true image [px], NaN where it was not seen, shape
    (frames, 4).
    """
    return np.column_stack(
        [np.hypot(r[f"u_{i}"] - r[f"u_true_{i}"], r[f"v_{i}"] - r[f"v_true_{i}"]) for i in range(4)]
    )


class TestNoise:
    def test_it_has_the_deviation_that_is_asked_for(self):
        difference = picture({"noise.image_sigma": 6.0}) - picture({})
        grey = difference[100:300, 100:300]
        # 120 000 numbers: .2 % by chance; rounding adds 1/12 to the square.
        assert grey.std() == pytest.approx(6.0, rel=0.01)
        assert abs(grey.mean()) < 0.1

    def test_a_run_meets_it(self):
        r = vs.run(vs.load("arm_ibvs", {"noise.image_sigma": 6.0} | QUICK))
        assert r.outcome is vs.Outcome.converged
        assert np.nanmax(away(r)) < 1.0


class TestDrift:
    def test_gains_drift_as_told(self):
        drift, grey = (
            Drift(brightness=0.2, color=0.1, period_s=8),
            np.full((4, 4, 3), 100, np.uint8),
        )
        for t, wanted in (
            (0, (110, 100, 90)),
            (2, (120, 120, 120)),
            (4, (90, 100, 110)),
            (6, (80, 80, 80)),
        ):
            assert np.allclose(drift.of((grey,), t)[0][0, 0], wanted, atol=1)
        images = (grey,)
        assert Drift().of(images, 1.0) is images

    def test_it_is_in_the_picture(self):
        drift = {"noise.drift": {"brightness": 0.2, "color": 0.1, "period_s": 8}}
        for t in (0.0, 2.0):
            bare, drifted = picture({}, t), picture(drift, t)
            dim = bare.max(axis=2) < 190  # what drift does not clip
            gains = drifted[dim].mean(axis=0) / bare[dim].mean(axis=0)
            # whole grey levels
            assert np.allclose(
                gains, Drift(brightness=0.2, color=0.1, period_s=8).gains(t), atol=0.01
            )

    def test_a_run_meets_it(self):
        drift = {"brightness": 0.3, "color": 0.1, "period_s": 3}
        r = vs.run(vs.load("arm_ibvs", {"noise.drift": drift} | QUICK))
        assert r.outcome is vs.Outcome.converged
        assert r["lost"].sum() == 0


class TestDropout:
    def test_markers_drop_out_as_often_as_told(self):
        setting = {"detector": "oracle", "noise.pixel_sigma_px": 0.05, "noise.dropout": 0.2}
        r = vs.run(
            vs.load("arm_ibvs", setting | {"stop.duration_s": 12, "stop.converged.hold_s": 30})
        )
        missing = np.mean(~np.isfinite(away(r)))
        # 1204 draws: .0115 by chance, three times that
        assert missing == pytest.approx(0.2, abs=0.035)
        assert np.nanmedian(r["error_px"][-50:]) < 2  # it works on; three markers tell less

    def test_a_run_meets_it(self):
        # Converged is who holds all four for .2 s, six pictures: .95^24 = .29 of all stretches.
        r = vs.run(
            vs.load("arm_ibvs", {"noise.dropout": 0.05, "stop.converged.hold_s": 0.2} | QUICK)
        )
        assert r.outcome is vs.Outcome.converged
        assert np.isnan(away(r)).any()


class TestShadows:
    @pytest.mark.opengl
    def test_a_moving_shadow_is_in_the_picture(self):
        bare = picture({"camera.shadows": True})
        dark = [np.argwhere((bare - picture(SHADOW, t)).sum(axis=2) > 60) for t in (0.0, 0.8)]
        assert min(len(d) for d in dark) > 300
        # .2 m at 1 m is some 77 px, less where it leaves the board
        assert np.linalg.norm(dark[1].mean(axis=0) - dark[0].mean(axis=0)) > 20

    @pytest.mark.study
    def test_a_run_meets_it(self):
        """It passes over two markers on the way; a lit disc loses a fourth of its light, and keeps
        its hue.
        """
        s = vs.load("arm_ibvs")
        T = s.robot.flange_pose(s.robot.configuration()) @ s.camera.mount.T
        column, row = (
            np.round(s.camera.project(s.target.seen_from(np.linalg.inv(s.target.pose.T) @ T)))
            .astype(int)
            .T
        )
        light = np.array(
            [picture(SHADOW, t)[row, column].max(axis=1) for t in (0.0, 0.4, 0.8, 1.2, 1.6)]
        )
        assert np.count_nonzero(light.min(axis=0) < 0.8 * light.max(axis=0)) == 2
        soft = {"camera.multisampling": 4}  # grey at the discs' edges: there brightness counts
        bare, r = (
            vs.run(vs.load("arm_ibvs", setting | soft | QUICK))
            for setting in ({"camera.shadows": True}, SHADOW)
        )
        assert r.outcome is vs.Outcome.converged
        assert r["t"][-1] > 1.6
        assert r["lost"].sum() == 0
        n = min(len(r["t"]), len(bare["t"]))
        moved = max(np.abs(r[f"u_{i}"][:n] - bare[f"u_{i}"][:n]).max() for i in range(4))
        # its border across a disc draws the centroid towards the light; it was there
        assert 0.05 < moved < 0.5
        assert np.nanmax(away(r)) < 0.5


class TestFalseBlobs:
    def test_decoys_are_in_the_picture(self):
        red = [
            np.count_nonzero(i[..., 0] - i[..., 1:].max(axis=2) > 60)
            for i in (picture({"world.decoys": DECOYS}), picture({}))
        ]
        assert red[0] > red[1] + 300  # a ball of 3 cm at .8 m has 14 px radius

    def test_they_steal_nothing(self):
        r = vs.run(vs.load("arm_ibvs", {"world.decoys": DECOYS} | QUICK))
        assert r.outcome is vs.Outcome.converged
        assert np.nanmax(away(r)) < 3  # never a decoy: those are tens of px away


class TestHiding:
    def test_a_plate_that_hides_markers_in_part_and_goes_on(self):
        # 5 cm before the board, over the whole of the marker at y = z - .7 = .25 after a second
        plate = {
            "pose": {"xyz": [1.45, 0.4, 0.93], "rpy_deg": [0, 90, 0]},
            "width": 0.06,
            "height": 0.06,
            "motion": {"kind": "line", "velocity_mps": [0, -0.15, 0]},
        }
        r = vs.run(vs.load("arm_ibvs", {"world.plates": [plate]} | QUICK))
        assert r.outcome is vs.Outcome.converged
        off = away(r)
        # hidden for a while, and back
        assert 5 < np.isnan(off).any(axis=1).sum() < 40 and np.isfinite(off[-10:]).all()
        # what is left of a marker is taken whole only while little is missing
        assert np.nanmax(off) < 3
