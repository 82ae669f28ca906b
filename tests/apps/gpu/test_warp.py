"""Pictures drawn on a device: the same as those whose rays MuJoCo casts, through any lens, of many
runs at once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest

pytest.importorskip("mujoco_warp")

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.apps.gpu.together import device
from vstestbed.apps.gpu.warp import (
    MOST_TILES,
    PLACES,
    PictureRequest,
    WarpRenderer,
    _kept,
    cut,
    look_of,
    slots_of,
)
from vstestbed.camera import Image, Window
from vstestbed.sim.render.image_sensor import lamps_at
from vstestbed.sim.render.rays import BLANK, RayRenderer
from vstestbed.sim.scene.scene import Scene

SAME = 0.999
"""Share of pixels of the same grey levels: single floats round some elsewhere, by one level."""
SMALL = {"camera.width": 160, "camera.height": 120}


def stage_of(scenario: vs.Scenario) -> Scene:
    s = scenario.resolved
    stage = Scene(s.scene)
    stage.place(0.0, s.target.pose.T, *stage.parts.start)
    return stage


@dataclass
class Draws:
    """What draws the pictures."""

    draw: Callable[[PictureRequest], Sequence[Image]]
    name: str = ""


def renderer(stage: Scene, camera: vs.Camera | None = None) -> WarpRenderer:
    alone = Draws(lambda shot: device().draw([shot])[0], "device")
    return WarpRenderer(stage, camera or stage.parts.camera, alone)


def pixels(images: tuple[Image | None, ...]) -> np.ndarray:
    return np.concatenate([image.reshape(-1, 3) for image in images if image is not None]).astype(
        int
    )


@pytest.mark.parametrize(
    ("name", "changed"),
    one_quick(
        ("arm_ibvs", {**SMALL, "camera.multisampling": 4}),
        ("arm_ibvs", SMALL),
        ("arm_fisheye", {}),
        ("arm_picture", {**SMALL, "camera.anisotropy": 4}),
        ("arm_workshop", SMALL),
        ("arm_mesh", SMALL),
        ("car_line", {}),
        ("omni_catadioptric", {}),
        ("quadrotor_hover", {}),
        ("quadrotor_land", {"camera.multisampling": 4}),
        ("camera_vitvs", {}),
        every=3,
    ),
)
def test_pictures_are_those_of_rays(name: str, changed: dict) -> None:
    stage = stage_of(vs.load(name, changed))
    drawn, cast = (
        pixels(one.images()) for one in (renderer(stage), RayRenderer(stage, stage.parts.camera))
    )
    apart = np.abs(drawn - cast).max(axis=1)
    assert np.mean(apart == 0) > SAME
    assert np.mean(apart > 1) < 1e-4  # where a ray meets an edge within rounding
    assert len(np.unique(cast, axis=0)) > 5  # there is something to be seen
    stage.close()


def test_lamps_shine_as_by_rays_also_dimmed() -> None:
    light = {"xyz": [0.4, -0.4, 1.6], "brightness": 0.7, "ambient": 0.2}
    scenario = vs.load("arm_picture", {**SMALL, "world.light": light, "target.gloss": 0.8})
    stage = stage_of(scenario)
    both = renderer(stage), RayRenderer(stage, scenario.camera)
    for brightness in (1.0, 0.5):  # of a lamp that flickers
        with lamps_at(stage.model, brightness):
            drawn, cast = (pixels(one.images()) for one in both)
        assert np.mean(np.abs(drawn - cast).max(axis=1) <= 1) > SAME
    stage.close()


def test_windows_are_parts_of_the_whole() -> None:
    stage = stage_of(vs.load("arm_ibvs", {"camera.multisampling": 4}))
    one = renderer(stage)
    (whole,) = one.images()
    windows: tuple[Window, ...] = ((240, 100, 290, 140), (0, 470, 640, 480), (635, 0, 640, 5))
    (part,) = one.images((windows,))
    assert whole is not None
    assert part is not None
    outside = np.ones(part.shape[:2], bool)
    for left, top, right, bottom in windows:
        np.testing.assert_array_equal(part[top:bottom, left:right], whole[top:bottom, left:right])
        outside[top:bottom, left:right] = False
    assert (part[outside] == BLANK).all()
    stage.close()


def test_a_picture_does_not_depend_on_the_others() -> None:
    shots: list[PictureRequest] = []

    def keep(shot: PictureRequest) -> list[Image]:
        shots.append(shot)
        return device().draw([shot])[0]

    stages = [
        stage_of(vs.load(name, SMALL)) for name in ("arm_ibvs", "arm_ibvs", "arm_mesh", "arm_ibvs")
    ]
    q = stages[1].parts.start[0]
    stages[1].place(0.0, stages[1].target_pose(), q + 0.05)  # the same scene, seen from elsewhere
    alone = [
        pixels(WarpRenderer(stage, stage.parts.camera, Draws(keep)).images()) for stage in stages
    ]
    shots[3] = replace(shots[3], tiles=shots[3].tiles[:1])
    together = device().draw(shots)
    assert [len(tiles) for tiles in together] == [len(shot.tiles) for shot in shots]
    height, width = 120, 160
    for before, shot, tiles in zip(alone, shots, together, strict=True):
        whole = before.reshape(height, width, 3)
        for (left, top, right, bottom), tile in zip(shot.tiles, tiles, strict=True):
            np.testing.assert_array_equal(tile, whole[top:bottom, left:right])
    assert not np.array_equal(alone[0], alone[1])
    for stage in stages:
        stage.close()


def test_the_same_scene_by_other_samples_of_its_textures_is_another_look() -> None:
    stages = [stage_of(vs.load("arm_picture", {**SMALL, "camera.anisotropy": n})) for n in (1, 8)]
    drawn, cast = (
        [pixels(make(stage).images()) for stage in stages]
        for make in (renderer, lambda stage: RayRenderer(stage, stage.parts.camera))
    )
    assert look_of(stages[0]) != look_of(stages[1])
    for one, other in zip(drawn, cast, strict=True):
        assert np.mean(np.abs(one - other).max(axis=1) <= 1) > SAME
    assert not np.array_equal(*drawn)
    for stage in stages:
        stage.close()


@pytest.mark.parametrize(
    "window", [(0, 0, 640, 480), (3, 7, 4, 8), (0, 100, 1280, 101), (5, 5, 45, 400)]
)
def test_tiles_cover_a_window_once_and_fit(window: Window) -> None:
    left, top, right, bottom = window
    seen = np.zeros((bottom, right), int)
    for a, b, c, d in cut(window):
        assert (c - a + 2) * (d - b + 2) <= PLACES
        seen[b:d, a:c] += 1
    assert (seen[top:bottom, left:right] == 1).all()
    assert seen.sum() == (right - left) * (bottom - top)


def test_slots_hold_every_tile_once() -> None:
    stage = stage_of(vs.load("arm_ibvs", {**SMALL, "camera.multisampling": 4}))
    asked: list[PictureRequest] = []

    def keep(shot: PictureRequest) -> list[Image]:
        asked.append(shot)
        return device().draw([shot])[0]

    windows = tuple((u, v, u + 6, v + 6) for u in range(0, 150, 10) for v in range(0, 110, 10))
    WarpRenderer(stage, stage.parts.camera, Draws(keep)).images((windows,))
    slots = list(slots_of(0, asked[0]))
    assert [tile for slot in slots for _, _, tile in slot.tiles] == list(windows)
    assert all(slot.places <= PLACES and len(slot.tiles) <= MOST_TILES for slot in slots)
    stage.close()


def test_looks_that_were_not_asked_for_longest_go_first() -> None:
    store, made = {}, []

    def of(key: str) -> str:
        return _kept(store, key, lambda: made.append(key) or key.upper(), 2)

    assert [of(key) for key in "abac"] == ["A", "B", "A", "C"]
    assert (made, list(store)) == (["a", "b", "c"], ["a", "c"])
