"""Nuisances of time: each does what it says, measured in pictures, counted in plans and in logs."""

import itertools

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import exp
from vstestbed.sim.base import Plant
from vstestbed.sim.build import PictureSetup, build_plant
from vstestbed.timing.clock import DelayLine
from vstestbed.timing.plan import Planned, Shutter, Timing

STEP, PER_FRAME = 0.002, 20
MANY = 20_000
CAMERA = Perspective(rate_hz=25, latency_s=0.08)
IDEAL = {"camera.rate_hz": 25, "detector": {"kind": "oracle", "field_of_view": "unlimited"}}


def plans(timing: Timing, n: int = MANY) -> list[Planned]:
    shutter = Shutter(timing, CAMERA, STEP, np.random.default_rng(3))
    return [shutter.following() for _ in range(n)]


class TestPlan:
    def test_without_nuisance_a_picture_a_period_late_by_the_latency(self):
        for i, plan in enumerate(plans(Timing(), 50)):
            assert plan == Planned(i, 20 * i, (20 * i,), (1.0,), 20 * i + 40)

    def test_losses_are_counted(self):
        made = plans(Timing(drop_probability=0.3))
        taken = made[-1].frame + 1
        # Binomial: .3 +- .003 (one deviation); four of them.
        assert 1 - len(made) / taken == pytest.approx(0.3, abs=0.011)

    @pytest.mark.parametrize(
        ("jitter", "deviation"), [("uniform", 0.01 / np.sqrt(3)), ("normal", 0.01)]
    )
    def test_jitter_of_the_delivery(self, jitter, deviation):
        late = (
            np.array(
                [p.arrives - p.middle for p in plans(Timing(jitter=jitter, latency_jitter_s=0.01))]
            )
            * STEP
        )
        # Of 20 000 numbers: mean to 1/141, deviation to 1/200 of the deviation; times four. Whole
        # steps add 2^2/12 ms^2.
        assert late.mean() == pytest.approx(0.08, abs=0.03 * deviation)
        assert late.std() == pytest.approx(np.hypot(deviation, STEP / np.sqrt(12)), rel=0.02)
        if jitter == "uniform":
            assert np.abs(late - 0.08).max() <= 0.01 + 1e-12

    def test_jitter_of_the_exposure(self):
        made = plans(Timing(exposure_jitter_s=0.006))
        shift = np.array([p.middle - PER_FRAME * p.frame for p in made[1:]]) * STEP
        assert np.abs(shift).max() <= 0.006 + 1e-12
        assert shift.std() == pytest.approx(
            np.hypot(0.006 / np.sqrt(3), STEP / np.sqrt(12)), rel=0.02
        )
        assert all(p.arrives - p.middle == 40 for p in made)

    def test_exposures_stay_apart_however_they_jitter(self):
        made = plans(Timing(exposure_s=0.02, exposure_jitter_s=0.01, jitter="normal"), 2000)
        assert all(a.opens[-1] <= b.opens[0] for a, b in itertools.pairwise(made))
        # latency counts from the exposure's end
        assert all(p.arrives == p.opens[-1] + 40 for p in made)

    @pytest.mark.parametrize(
        ("exposure", "pictures", "opens"),
        [(0.02, 99, 11), (0.02, 5, 5), (0.02, 4, 3), (0.006, 9, 5)],
    )
    def test_an_exposure_is_symmetric_about_its_middle(self, exposure, pictures, opens):
        plan = plans(Timing(exposure_s=exposure, exposure_pictures=pictures), 3)[2]
        offsets, weights = np.array(plan.opens) - plan.middle, np.array(plan.weights)
        assert len(offsets) == opens and 0 in offsets
        np.testing.assert_array_equal(offsets, -offsets[::-1])
        np.testing.assert_allclose(weights, weights[::-1])
        assert weights.sum() == pytest.approx(1)


def test_nothing_overtakes():
    line: DelayLine[str] = DelayLine()
    line.push(10, "late")
    line.push(7, "early")
    assert line.pop_due(9) == [] and line.pop_due(10) == ["late", "early"]


def test_with_leave_to_overtake_the_earlier_one_leaves_first():
    line: DelayLine[str] = DelayLine(overtakes=True)
    for due, item in ((10, "late"), (7, "early"), (10, "later"), (8, "between")):
        line.push(due, item)
    assert line.next_due() == 7 and line.pop_due(7) == ["early"]
    # what is due at once leaves in the order in which it came
    assert line.pop_due(20) == ["between", "late", "later"]


def test_times_that_do_not_fit_are_refused():
    for timing, words in (
        ({"exposure_s": 0.001}, "at least two physics steps, 0.004 s"),
        ({"exposure_s": 0.05}, "at most the camera's period, 0.04 s"),
        ({"exposure_s": 0.02, "exposure_jitter_s": 0.011}, "at most 0.01 s"),
        ({"drop_probability": 1.0}, "drop_probability"),
        (
            {"command_hz": 300},
            r"timing\.command_hz.*whole number of physics steps of 0.002 s apart: 166.6666667, 250",
        ),
        ({"command_hz": 1000}, r"timing\.command_hz.*: 250, 500, or give physics"),
        ({"command_hz": 1.25}, r"timing\.command_hz.*at least 2 Hz"),
        (
            {"command_hz": 25, "interpolation": "ramp"},
            r"timing\.command_hz.*at least 50 Hz here \(two setpoints",
        ),
        ({"camera_clock": {"offset_s": 100}}, "a minute"),
        ({"camera_clock": {"drift_ppm": 1e6}}, "drift_ppm"),
    ):
        with pytest.raises((ParameterError, ScenarioError), match=words):
            vs.load("ibvs_book", IDEAL | {"timing": timing})


class TestBlur:
    """A marker that goes over the picture at a known speed, caught by an open shutter."""

    SPEED, EXPOSURE = -2.0, 0.02

    def plant(self, image_sigma: float) -> tuple[vs.Scenario, Plant]:
        """A small camera .6 m in front of one marker, which is in the middle of its picture."""
        settings = {
            "camera": {
                "kind": "perspective",
                "width": 200,
                "height": 160,
                "fovy_deg": 60,
                "rate_hz": 25,
                "renderer": "rays",
            },
            "robot.start": {"nominal": {"xyz": [-0.25, -0.25, 2.4]}},
        }
        s, rng = vs.load("ibvs_book", settings), np.random.default_rng(0)
        pictures = PictureSetup(
            needs_image=True, needs_truth=False, image_sigma=image_sigma, rng=rng
        )
        return s, build_plant(s.scene, pictures)[0]

    def picture(self, plant: Plant, exposure_s: float) -> np.ndarray:
        plant.apply(np.array([self.SPEED, 0, 0, 0, 0, 0]))
        shutter = Shutter(
            Timing(exposure_s=exposure_s, exposure_pictures=99),
            CAMERA,
            STEP,
            np.random.default_rng(0),
        )
        shutter.following()
        plan, step = shutter.following(), 0
        plant.advance(plan.opens[0])
        step = plan.opens[0]
        for at, weight in zip(plan.opens, plan.weights, strict=True):
            plant.advance(at - step)
            plant.expose(weight)
            step = at
        frame = plant.developed(plan.middle * STEP)
        assert frame is not None and frame.image is not None and frame.t == plan.middle * STEP
        return frame.image

    def width(self, image: np.ndarray) -> tuple[float, float]:
        """Mean and variance along u of the marker's light: how far a pixel is from the board's
        grey, as long as it was covered.
        """
        part = image[70:90, 106:150].astype(float)
        light = np.abs(part - part[0, -1]).sum(axis=(0, 2))
        u = np.arange(106, 150)
        middle = float((light * u).sum() / light.sum())
        return middle, float((light * (u - middle) ** 2).sum() / light.sum())

    def test_length_in_the_picture(self):
        s, made = self.plant(image_sigma=0.0)
        image = self.picture(made, self.EXPOSURE)
        made.close()
        f, depth = s.camera.f, 0.6
        radius_px, length_px = f * 0.03 / depth, f * -self.SPEED * self.EXPOSURE / depth
        middle, variance = self.width(image)
        # A disc has the variance r^2/4 along a line, a path of length l adds l^2/12: 12 and 7.1
        # px^2. Pixels add 1/12.
        assert np.sqrt(12 * (variance - radius_px**2 / 4)) == pytest.approx(length_px, rel=0.05)
        # The stamp is the middle of the exposure: by then the camera has gone 2 m/s * .04 s from
        # the marker's axis.
        assert middle == pytest.approx(s.camera.centre[0] - f * self.SPEED * 0.04 / depth, abs=0.3)

    def test_noise_comes_once(self):
        _, made = self.plant(image_sigma=8.0)
        image = self.picture(made, self.EXPOSURE).astype(float)
        made.close()
        board = image[100:140, 20:60]  # one plain surface
        # Noise of 8 grey levels in 4800 numbers: known to 1 %; rounding adds 1/12 to its square.
        # Means of sixteen would have 2.
        assert np.std(board - board.mean(axis=(0, 1))) == pytest.approx(8.0, rel=0.04)


class TestInRuns:
    def test_losses_leave_gaps_in_the_log(self):
        r = vs.run(
            vs.load("ibvs_book", IDEAL | {"timing.drop_probability": 0.5, "stop.duration_s": 12})
        )
        frame = r["frame"]
        np.testing.assert_allclose(r["t"], frame * 0.04, rtol=1e-12)
        share = len(frame) / (frame[-1] + 1)
        # 200 to 300 pictures, deviation .03: four of them
        assert share == pytest.approx(0.5, abs=0.13)
        assert r.outcome is vs.Outcome.converged  # with half of the pictures all the same

    def test_first_motion_after_the_command_latency(self):
        timing = {
            "timing.command_latency_s": 0.046,
            "camera.latency_s": 0.02,
            "stop.duration_s": 0.2,
        }
        r = vs.run(vs.load("ibvs_book", IDEAL | timing))
        np.testing.assert_allclose(r["t_cmd"], r["t"] + 0.066, atol=1e-12)
        place = np.array([r[f"cam_{x}"] for x in "xyz"]).T
        first = np.array([r[f"cmd_{n}"][0] for n in ("vx", "vy", "vz", "wx", "wy", "wz")])
        np.testing.assert_array_equal(place[1], place[0])  # at 40 ms nothing has moved
        # at 80 ms it has for 14 ms
        T = r.scenario.robot.start.nominal.T @ exp(first * (0.08 - 0.066))
        np.testing.assert_allclose(place[2], T[:3, 3], atol=1e-12)

    def test_an_arms_servos_hear_of_it_as_late(self):
        setting = {
            "detector": "oracle",
            "timing.command_latency_s": 0.1,
            "stop.duration_s": 0.2,
            "robot.actuation": "ideal",
        }
        r = vs.run(vs.load("arm_ibvs", setting))
        told = np.array([r[f"ctrl_joint_{i}"] for i in range(1, 7)])
        # 0, 40, 80 ms; from 120 ms on
        assert not told[:, :3].any() and told[:, 3:].any(axis=0).all()

    def test_a_blurred_run_converges(self):
        setting = {"timing.exposure_s": 0.02, "timing.exposure_pictures": 5, "law.gain": 1.5}
        lens = {
            "kind": "perspective",
            "width": 500,
            "height": 500,
            "focal_length_m": 0.008,
            "pixel_size_m": 2e-5,
            "rate_hz": 10,
        }
        r = vs.run(
            vs.load("ibvs_book", {"camera": lens} | setting | {"stop.converged.error_px": 0.2})
        )
        assert r.outcome is vs.Outcome.converged
        seen = np.array([[r[f"{c}_{i}"] for c in "uv"] for i in range(4)])
        true = np.array([[r[f"{c}_true_{i}"] for c in "uv"] for i in range(4)])
        # A symmetric smear leaves the middle: pixels agree with the truth at the stamp, while
        # markers smear by up to 9 px.
        assert np.nanmedian(np.abs(seen - true)) < 0.15

    def test_the_same_seed_jitters_the_same(self):
        setting = IDEAL | {
            "timing": {
                "exposure_jitter_s": 0.01,
                "latency_jitter_s": 0.03,
                "drop_probability": 0.1,
            },
            "stop.duration_s": 1,
        }
        runs = [vs.run(vs.load("ibvs_book", setting | {"seed": seed})) for seed in (1, 1, 2)]
        np.testing.assert_array_equal(runs[0].table, runs[1].table)
        assert not np.array_equal(runs[0]["t"], runs[2]["t"])
        assert np.all(np.diff(runs[0]["t_cmd"]) >= 0)
