"""Flicker: the closed-form means against numerical integrals, and bands, beat and cancellation in
pictures against the means.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

import vstestbed as vs
from vstestbed.core.geometry import Array
from vstestbed.imaging.flicker import STEADY, Flicker
from vstestbed.imaging.shutter import of_rows
from vstestbed.sim.build import PictureSetup, build_plant
from vstestbed.timing.plan import Shutter

LAMP = {"brightness": 0.4, "ambient": 0.4}
FLICKER = {"frequency_hz": 100.0, "depth": 0.4, "phase_deg": 30.0}


def pictures(
    renderer: str,
    flicker: dict[str, float] | None,
    number: int = 3,
    lit: bool = True,
    settings: dict[str, Any] | None = None,
) -> list[Array]:
    """A column of pictures of a lit grey board that fills them, (number, H); or of an unlit marker
    that does.
    """
    near = {"xyz": [0, 0, 2.4]} if lit else {"xyz": [0.25, 0.25, 2.97]}
    light = LAMP if flicker is None else LAMP | {"flicker": flicker}
    camera = {
        "kind": "perspective",
        "width": 120,
        "height": 120,
        "fovy_deg": 30,
        "rate_hz": 25,
        "renderer": renderer,
    }
    goal = {"goal.T_camera_target.xyz": [0, 0, 1.5]}
    s = vs.load(
        "ibvs_book",
        {"camera": camera, "robot.start": {"nominal": near}, "world.light": light}
        | goal
        | (settings or {}),
    )
    plant = build_plant(s.scene, PictureSetup(needs_image=True, needs_truth=False))[0]
    assert s.world.light is not None
    rng = np.random.default_rng(0)
    shutter = Shutter(s.timing, s.camera, plant.step_s, rng, flicker=s.world.light.flicker)
    columns = []
    for _ in range(number):
        plan = shutter.following()
        for weight in plan.weights:
            plant.expose(weight)
        picture = plant.developed(plan.middle * plant.step_s)
        assert picture is not None and picture.image is not None
        columns.append(picture.image[:, 60].max(axis=1).astype(float))
    plant.close()
    return columns


class TestMeans:
    LIGHT = Flicker(frequency_hz=97.0, depth=0.7, phase_deg=25.0)

    def brightness(self, t: float) -> float:
        return 1 + 0.7 * np.cos(2 * np.pi * 97 * t + np.radians(25))

    @pytest.mark.parametrize("exposure_s", [0.001, 0.004, 0.013])
    def test_mean_of_an_exposure(self, exposure_s: float):
        for t in (0.0, 0.0033, 12.3456):
            exact = quad(self.brightness, t - exposure_s / 2, t + exposure_s / 2)[0] / exposure_s
            assert self.LIGHT.mean(t, exposure_s) == pytest.approx(exact, abs=1e-9)
        assert self.LIGHT.mean(0.2, 0.0) == pytest.approx(self.brightness(0.2))

    def test_whole_periods_cancel(self):
        np.testing.assert_allclose(self.LIGHT.mean(np.linspace(0, 1, 50), 3 / 97), 1)

    @pytest.mark.parametrize("exposure_s", [0.0, 0.002, 0.01])
    def test_light_of_the_images_adds_up_to_the_mean(self, exposure_s: float):
        nodes, rows = 7.0 + np.linspace(-0.02, 0.02, 9), 7.0 + np.linspace(-0.012, 0.012, 33)
        weights, light = of_rows(nodes, rows, exposure_s, self.LIGHT)
        np.testing.assert_allclose(weights.sum(axis=0), 1)
        if exposure_s:
            np.testing.assert_allclose(
                light.sum(axis=0), self.LIGHT.mean(rows, exposure_s), atol=1e-9
            )
            value = quad(
                lambda t: np.interp(t, nodes, np.eye(9)[4]) * self.brightness(t), 6.999, 7.001
            )[0]
            at = of_rows(nodes, np.array([7.0]), 0.002, self.LIGHT)[1][4, 0]
            assert at == pytest.approx(value / 0.002, abs=1e-6)


@pytest.mark.parametrize("renderer", ["gl", "rays"])
class TestPictures:
    @pytest.mark.parametrize("exposure_s", [0.0, 0.002, 0.006])
    def test_bands_of_a_rolling_shutter(self, renderer: str, exposure_s: float):
        roll = {"camera.readout_s": 0.02, "timing.exposure_s": exposure_s}
        steady, light = pictures(renderer, None, 1)[0], Flicker(**FLICKER)
        rows = (np.arange(120) - 59.5) / 120 * 0.02
        columns = pictures(renderer, FLICKER, 2, settings=roll)
        for number, column in enumerate(columns):
            # rounded twice
            np.testing.assert_allclose(
                column, steady * light.mean(0.04 * number + rows, exposure_s), atol=1.0
            )
        # A period of 10 ms is 60 of the 120 rows, and the amplitude is the depth times a sinc.
        share = columns[0] / steady - 1
        wave = share @ np.exp(-2j * np.pi * np.arange(120) / 60) / 60
        assert abs(wave) == pytest.approx(0.4 * np.sinc(100 * exposure_s), abs=0.004)
        assert np.abs(share @ np.exp(-2j * np.pi * np.arange(120) / 40) / 60) < 0.004

    def test_beat_of_a_global_shutter(self, renderer: str):
        # 100 Hz is 10 Hz more than three times the camera's 30 Hz: a period of the beat is three
        # pictures.
        steady = pictures(renderer, None, 1)[0]
        levels = [
            column.mean() / steady.mean()
            for column in pictures(renderer, FLICKER, 6, settings={"camera.rate_hz": 30})
        ]
        beat = 1 + 0.4 * np.cos(2 * np.pi * 10 * np.arange(6) / 30 + np.radians(30))
        np.testing.assert_allclose(levels, beat, atol=0.008)

    @pytest.mark.parametrize("readout_s", [0.0, 0.02])
    def test_an_exposure_of_a_period_shows_nothing(self, renderer: str, readout_s: float):
        settings = {"camera.readout_s": readout_s, "timing.exposure_s": 0.01}
        for column in pictures(renderer, FLICKER, 2, settings=settings):
            np.testing.assert_allclose(column, pictures(renderer, None, 1)[0], atol=1)

    @pytest.mark.parametrize("readout_s", [0.0, 0.02])
    def test_what_is_not_lit_does_not_flicker(self, renderer: str, readout_s: float):
        column = pictures(
            renderer,
            FLICKER | {"depth": 1.0},
            2,
            lit=False,
            settings={"camera.readout_s": readout_s},
        )[1]
        assert np.ptp(column) <= 1 and column.mean() > 254


def test_none_is_steady_and_costs_nothing():
    light = vs.load("ibvs_book", {"world.light": LAMP}).world.light
    assert light is not None and light.flicker == STEADY
    s = vs.load("ibvs_book")
    assert Shutter(
        s.timing, s.camera, 0.002, np.random.default_rng(0), flicker=STEADY
    ).following().weights == (1.0,)


def test_a_run_sees_it_and_an_oracle_does_not():
    lamp = {
        "world.light": LAMP | {"flicker": FLICKER | {"depth": 0.9}},
        "stop.duration_s": 0.5,
        "robot.start.nominal": {"xyz": [0, 0, 1.5]},
    }
    means = []
    with vs.Session(vs.load("ibvs_book", lamp | {"camera.rate_hz": 30}), pictures=True) as session:
        image = session.reset().image
        for _ in range(3):
            assert image is not None
            means.append(image[490:510, 490:510].mean())
            image = session.step().image
    assert max(means) > 2 * min(means)
    blind = {"detector": "oracle", "law.depth": "oracle", "stop.duration_s": 0.5}
    a, b = (
        vs.run(vs.load("ibvs_book", blind | own))
        for own in ({}, {"world.light": lamp["world.light"]})
    )
    np.testing.assert_array_equal(a.table, b.table)
