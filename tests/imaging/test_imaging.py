"""Lens, exposure, sensor and stream in a run: whole pictures, either renderer, goal pictures,
pictures taken again, random numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Image, Picture, Regions
from vstestbed.imaging.chain import Imaging
from vstestbed.loop.plants import take_goal_images
from vstestbed.scenario.distributions import IMAGING_STREAM
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Plant, SceneState
from vstestbed.sim.build import PictureSetup, build_plant
from vstestbed.sim.replay import Replay, Rerendering

SMALL = {"camera.width": 160, "camera.height": 120}
LOOK: Regions = (((20, 20, 60, 60),),)
DEFOCUS = {"focus_m": 0.3, "f_number": 1.4, "focal_length_m": 0.05}
ALL = {
    "camera.optics": {"vignetting": 0.3, "red_px": 1.0, "defocus": DEFOCUS},
    "camera.exposure": {"auto": {"target_grey": 90.0}},
    "camera.sensor": {"white_e": 500.0},
    "camera.stream": {"kind": "h264", "crf": 20},
}


def scenario(changes: dict[str, Any], name: str = "arm_ibvs") -> Scenario:
    return vs.load(name, SMALL | changes)


@contextmanager
def plant(s: Scenario, seed: int = 3, sigma: float = 0.0) -> Iterator[Plant]:
    random = {"rng": np.random.default_rng(8), "imaging_rng": np.random.default_rng(seed)}
    pictures = PictureSetup(needs_image=True, needs_truth=False, image_sigma=sigma, **random)
    made, _ = build_plant(s.scene, pictures)
    with closing(made):
        yield made


def seen(picture: Picture | None) -> Image:
    assert picture is not None and picture.whole and picture.image is not None
    return picture.image.copy()


def first(
    changes: dict[str, Any], regions: Regions | None = None, seed: int = 3, sigma: float = 0.0
) -> Image:
    with plant(scenario(changes), seed, sigma) as one:
        return seen(one.capture(regions)[0])


def test_regions_of_interest_change_nothing():
    np.testing.assert_array_equal(first(ALL, LOOK), first(ALL))


def test_both_renderers_are_blurred_alike():
    changes = {"camera.optics": ALL["camera.optics"]}
    gl, rays = (
        first({**changes, "camera.renderer": name}).astype(float) for name in ("gl", "rays")
    )
    sharp = first({}).astype(float)
    detail = [np.abs(np.diff(image, axis=1)).max() for image in (gl, rays, sharp)]
    assert detail[0] < 0.6 * detail[2]
    assert np.median(np.abs(gl - rays)) <= 1 and np.mean(np.abs(gl - rays)) < 1


def test_seeds_draw_the_sensor_and_nothing_else():
    sensor = {"camera.sensor": {}}
    a, b, other = first(sensor), first(sensor), first(sensor, seed=4)
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(a, other)
    # The scenario's own noise is the same with and without the sensor's: their mean difference has
    # no part of it.
    with_both, alone, plain = (
        first(sensor, sigma=3.0).astype(float),
        first({}, sigma=3.0).astype(float),
        first({}).astype(float),
    )
    own, both = (alone - plain).ravel(), (with_both - plain).ravel()
    assert np.corrcoef(own, both)[0, 1] > 0.7


def test_a_run_and_its_pictures_taken_again_are_the_same():
    s = scenario(ALL | {"seed": 5})
    with vs.Session(s, pictures=True) as session:
        taken = []
        frame = session.reset()
        for _ in range(5):
            assert frame.image is not None
            truth = frame.truth
            taken.append(
                (frame.t, truth.T_world_target, truth.q, truth.T_world_camera, frame.image.copy())
            )
            frame = session.step()
    with closing(Rerendering(s.scene, imaging_rng=s.rng(IMAGING_STREAM))) as rerendered:
        for t, T_world_target, q, T_world_camera, image in taken:
            again = rerendered.picture(t, T_world_target, q, T_world_camera)
            np.testing.assert_array_equal(again, image)


def test_the_goals_picture_is_seen_through_the_same_camera_at_rest():
    larger = {"camera.width": 320, "camera.height": 240}
    s, bare = scenario(ALL | larger, "arm_photometric"), scenario(larger, "arm_photometric")
    with plant(s) as one, plant(bare) as other:
        before = seen(one.capture()[0])
        shown, sharp = take_goal_images(s, one)[0].image, take_goal_images(bare, other)[0].image
        with plant(s) as third:
            seen(third.capture()[0])
            # the goal's picture has drawn nothing
            np.testing.assert_array_equal(seen(third.capture()[0]), seen(one.capture()[0]))
    assert shown.mean() == pytest.approx(90, abs=3)  # exposed as the camera would have settled
    assert (
        np.abs(np.diff(shown.astype(float), axis=1)).max()
        < 0.7 * np.abs(np.diff(sharp.astype(float), axis=1)).max()
    )
    assert before.mean() == pytest.approx(90, abs=3)


def test_a_step_of_the_light_is_seen_and_settles_in_a_run():
    s = scenario(
        {
            "camera.exposure": {
                "light": [[0.4, 2.0]],
                "auto": {"target_grey": 80, "lag_s": 0.2, "delay_pictures": 0},
            }
        }
    )
    means = []
    with vs.Session(s, pictures=True) as session:
        frame = session.reset()
        for _ in range(40):
            assert frame.image is not None
            means.append(frame.image.mean())
            frame = session.step(np.zeros(6))
    error = np.log2(np.array(means) / 80)
    t = np.arange(40) * s.camera.period - 0.4
    assert np.abs(error[t < -1e-6]).max() < 0.02
    after = t > -1e-6
    np.testing.assert_allclose(error[after], np.exp(-t[after] / 0.2), atol=0.06)


def test_nothing_is_made_for_a_camera_without_any():
    assert scenario({}).camera.imaging(None) is None
    assert isinstance(scenario(ALL).camera.imaging(None), Imaging)


def test_a_film_drawn_again_shows_the_camera_at_rest():
    s = scenario(ALL)
    with (
        closing(Replay(s.scene, share=0.5)) as replay,
        closing(Replay(replace(s.scene, camera=scenario({}).camera))) as bare,
    ):
        state = SceneState(0.0, s.target.T_world_start, s.robot.configuration(), np.eye(4))
        shown, sharp = (one.picture("eye", (80, 60), state) for one in (replay, bare))
    assert shown.shape == (120, 160, 3) and shown.mean() == pytest.approx(90, abs=3)
    assert (
        np.abs(np.diff(shown.astype(float), axis=1)).max()
        < 0.7 * np.abs(np.diff(sharp.astype(float), axis=1)).max()
    )


def test_a_run_converges_through_all_of_it():
    mild = {
        "camera.optics": {
            "vignetting": 0.3,
            "red_px": 0.2,
            "blue_px": -0.2,
            "defocus": {"focus_m": 0.8, "f_number": 2, "focal_length_m": 0.008},
        },
        "camera.exposure": {"auto": {"target_grey": 150}, "light": [[0.5, 1.3]]},
        "camera.sensor": {},
        "camera.stream": {"kind": "h264", "colours": "full"},
    }
    size = {"camera.width": 320, "camera.height": 240, "target.marker.radius": 0.04}
    quick = {"law.gain": 2.0, "stop.converged.error_px": 0.5, "stop.converged.hold_s": 0.2}
    run = vs.run(vs.load("arm_ibvs", size | quick | mild))
    assert run.summary()["outcome"] == "converged"
