"""One exposure time for brightness, noise and motion blur: the smear's length, reciprocity, the
photon transfer curve, the clock.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Array
from vstestbed.imaging.exposure import AutoExposure, ExposureControl
from vstestbed.imaging.sensor import SensorNoise
from vstestbed.imaging.shutter import Opening
from vstestbed.sim.base import Plant
from vstestbed.sim.build import PictureSetup, build_plant
from vstestbed.timing.plan import Shutter, Timing

STEP, PER_FRAME, SPEED = 0.002, 20, -2.0
SMALL = {
    "kind": "perspective",
    "width": 240,
    "height": 160,
    "fovy_deg": 60,
    "rate_hz": 25,
    "renderer": "rays",
}
FOCAL_PX = 80 / np.tan(np.radians(30))
ONE_MARKER = {"robot.start": {"nominal": {"xyz": [-0.25, -0.25, 2.4]}}}


def scenario(
    exposure: dict[str, Any], settings: dict[str, Any] | None = None, **camera: Any
) -> vs.Scenario:
    """A small camera 0.6 m in front of one marker, which is in the middle of its picture."""
    made = {"camera": SMALL | {"exposure": {"blurs": True} | exposure} | camera}
    return vs.load(
        "ibvs_book",
        made | ONE_MARKER | {"detector": "blobs", "law.depth": "constant"} | (settings or {}),
    )


def plant_of(s: vs.Scenario) -> Plant:
    return build_plant(s.scene, PictureSetup(needs_image=True, needs_truth=False))[0]


def flown(exposure_s: float) -> Array:
    """The second picture (H, W, 3) of a camera that goes sideways, exposed for a time [s], as
    bright as the rendered one.
    """
    s = scenario({"time_s": exposure_s, "nominal_s": exposure_s}, renderer="gl", multisampling=16)
    with closing(plant_of(s)) as plant:
        plant.apply(np.array([SPEED, 0, 0, 0, 0, 0]))
        shutter = Shutter(s.timing, s.camera, STEP, np.random.default_rng(0))
        shutter.following()
        plan, step = shutter.following(plant.exposure_s()), 0
        for at, weight in zip(plan.opens, plan.weights, strict=True):
            plant.advance(at - step)
            plant.expose(weight)
            step = at
        picture = plant.developed(plan.middle * STEP)
        assert picture is not None and picture.image is not None
        return picture.image.astype(float)


def smear(image: Array) -> tuple[float, float]:
    """Mean and variance along u of the marker's light: how far a pixel is from the board's grey, as
    long as it was covered.
    """
    part = image[70:90, 126:161]
    light, u = np.abs(part - part[0, -1]).sum(axis=(0, 2)), np.arange(126, 161)
    middle = float((light * u).sum() / light.sum())
    return middle, float((light * (u - middle) ** 2).sum() / light.sum())


def test_the_smear_is_as_long_as_the_exposure_time():
    # Neither time is a whole number of pairs of physics steps.
    (at, sharp), *blurred = (smear(flown(exposure_s)) for exposure_s in (1e-4, 0.013, 0.019))
    for exposure_s, (middle, variance) in zip((0.013, 0.019), blurred, strict=True):
        pixels = np.sqrt(12 * (variance - sharp))
        assert pixels == pytest.approx(FOCAL_PX * -SPEED * exposure_s / 0.6, rel=0.02)
        assert middle == pytest.approx(at, abs=0.1)  # the time stamp is the exposure's middle


@pytest.mark.parametrize("exposure_s", [5e-4, 0.002, 0.003, 0.004, 0.0101, 0.02, 0.037])
def test_weights_have_the_moments_of_the_exposure(exposure_s: float):
    camera = Perspective(rate_hz=25, exposure=ExposureControl(time_s=exposure_s, blurs=True))
    shutter = Shutter(Timing(), camera, STEP, np.random.default_rng(0))
    w, t = np.array(shutter.opening.weights), shutter.opening.nodes
    assert w.sum() == pytest.approx(1) and w @ t == pytest.approx(0, abs=1e-12) and (w > 0).all()
    assert w @ t**2 == pytest.approx(exposure_s**2 / 12, rel=1e-9)
    assert len(w) <= 9 and t[-1] >= exposure_s / 2 - 1e-9
    plan = [shutter.following() for _ in range(2)][1]
    # complete when the exposure ends
    assert 0 <= (plan.arrives - plan.middle) * STEP - exposure_s / 2 < STEP


def test_two_steps_are_simpsons_rule():
    np.testing.assert_allclose(
        Opening(2 * STEP, 1, 9, STEP, exact=True).weights, [1 / 6, 2 / 3, 1 / 6]
    )


def still(
    exposure: dict[str, Any], pictures: int, **camera: Any
) -> Iterator[tuple[float, float, Array]]:
    """Exposure time [s], gain and image of the pictures of a small camera at rest."""
    s = scenario(exposure, width=72, height=56, **camera)
    with closing(plant_of(s)) as plant:
        shutter = Shutter(s.timing, s.camera, STEP, np.random.default_rng(0))
        for _ in range(pictures):
            plan = shutter.following(plant.exposure_s())
            for weight in plan.weights:
                plant.expose(weight)
            picture = plant.developed(plan.middle * STEP)
            assert picture is not None and picture.image is not None and picture.exposed is not None
            yield picture.exposed.time_s, picture.exposed.gain, picture.image.astype(float)


def test_time_and_gain_make_up_for_a_step_of_the_light():
    auto = {
        "target_grey": 60,
        "lag_s": 0.05,
        "delay_pictures": 0,
        "longest_s": 0.02,
        "largest_gain": 16,
    }
    taken = still({"light": [[0.4, 0.5], [0.8, 0.05]], "auto": auto}, 30)
    made = np.array([(time_s, gain, image.mean()) for time_s, gain, image in taken])
    bright, dim, dark = (made[k, :2] for k in (9, 19, 29))
    assert dim[0] / bright[0] == pytest.approx(2, rel=0.02) and bright[1] == dim[1] == 1
    # first the time, then the gain
    assert dark == pytest.approx([0.02, bright[0] / 0.05 / 0.02], rel=0.02)
    np.testing.assert_allclose(made[[9, 19, 29], 2], 60, rtol=0.03)
    assert made[10, 2] == pytest.approx(30, rel=0.03)  # what the first picture showed of it


def test_noise_grows_with_gain_and_not_with_time():
    chip = SensorNoise(dsnu_e=0, prnu=0, bits=12)
    auto = {"target_grey": 60, "delay_pictures": 0, "longest_s": 0.01, "largest_gain": 100}
    found = []
    for light in (1.0, 0.02):
        taken = list(
            still(
                {"light": [[0.0, light]], "auto": auto},
                2,
                sensor={"dsnu_e": 0, "prnu": 0, "bits": 12},
            )
        )
        gain, board = taken[0][1], [image for _, _, image in taken]
        variance, mean = float(((board[0] - board[1]) ** 2).mean() / 2), float(board[0].mean())
        # In the picture's 8 bits, with the rounding of 12 bits down to them.
        K = chip.K / 16 * gain
        expected = (K * chip.dark_noise_e) ** 2 + 1 / 12 + K * (mean + 0.5)
        assert variance == pytest.approx(expected, rel=0.05)
        found.append((gain, variance))
    assert found[0][0] == 1 and found[1][0] > 8 and found[1][1] > 5 * found[0][1]


def test_a_row_of_a_rolling_shutter_is_exposed_for_the_time():
    exposure = ExposureControl(blurs=True, auto=AutoExposure(longest_s=0.01))
    camera = Perspective(rate_hz=25, readout_s=0.02, exposure=exposure)
    shutter = Shutter(Timing(), camera, STEP, np.random.default_rng(0))
    shutter.following()
    for exposure_s, end in ((0.002, 26), (0.01, 28)):
        plan = shutter.following(exposure_s)
        assert plan.arrives % PER_FRAME == (end + 4) % PER_FRAME or plan.arrives - plan.middle in (
            6,
            8,
        )
        rows = np.stack([draw[1] for weight in plan.weights for draw in weight])  # pyright: ignore[reportAttributeAccessIssue] - all are contributions here
        spread = (
            rows * (shutter.opening.nodes[:, None] - camera.row_delay(np.arange(480.0))) ** 2
        ).sum(axis=0)
        assert spread.max() >= exposure_s**2 / 12
        assert np.median(spread) == pytest.approx(exposure_s**2 / 12, abs=STEP**2 / 4)


def test_an_oracles_log_does_not_depend_on_pictures():
    settings = {"detector": "oracle", "law.depth": "oracle", "stop.duration_s": 0.4}
    s = scenario({"auto": {"target_grey": 200}, "time_s": 0.008}, settings)
    logs = []
    for pictures in (False, True):
        with vs.Session(s, pictures=pictures) as session:
            session.reset()
            while session.episode is not None and session.episode.outcome is None:
                session.step()
            logs.append(session.recording().table)
    np.testing.assert_array_equal(*logs)


@pytest.mark.parametrize(
    ("exposure", "logged"),
    [
        ({"time_s": 0.008, "gain": 4}, (0.008, 4)),
        ({"nominal_s": 0.006}, (0.006, 1)),
        ({"time_s": 0.02, "gain": 3, "auto": {"longest_s": 0.01, "largest_gain": 16}}, (0.01, 6)),
    ],
)
def test_an_oracles_log_has_time_and_gain_with_which_the_camera_begins(
    exposure: dict[str, Any], logged: tuple[float, float]
):
    recording = vs.run(
        scenario(exposure, {"detector": "oracle", "law.depth": "oracle", "stop.duration_s": 0.1})
    )
    columns = [recording.columns.index(name) for name in ("exposure_s", "gain")]
    np.testing.assert_allclose(
        recording.table[:, columns], np.tile(logged, (len(recording.table), 1)), rtol=1e-12
    )


def test_what_does_not_fit_into_a_period_is_refused():
    for exposure, settings, words in (
        ({"auto": {"longest_s": 0.041}}, {}, r"camera\.exposure\.auto\.longest_s.*at most 0\.04 s"),
        ({"time_s": 0.041}, {}, r"camera\.exposure\.time_s.*at most 0\.04 s"),
        (
            {"auto": {"longest_s": 0.02}},
            {"camera.readout_s": 0.03},
            r"longest_s.*at most 0\.01 s.*less camera\.readout_s = 0\.03 s",
        ),
        (
            {},
            {"timing.exposure_s": 0.01},
            r"timing\.exposure_s.*must be 0: with camera\.exposure\.blurs",
        ),
        ({"auto": {}}, {"timing.exposure_jitter_s": 0.011}, r"exposure_jitter_s.*at most 0\.01 s"),
    ):
        with pytest.raises((ParameterError, ScenarioError), match=words):
            scenario(exposure, settings)
