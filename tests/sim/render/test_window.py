"""SceneDescription of pictures: what is drawn of one is what the whole picture has there."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Perspective
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.render.opengl import (
    LABEL,
    REACH,
    SKYBOX,
    OpenGLRenderer,
    SceneCamera,
    merged,
    part_round,
)
from vstestbed.sim.scene.scene import Scene

WINDOWS = ((300, 100, 420, 180), (250, 150, 270, 170))
PART = (250, 100, 420, 180)
"""The rectangle round both, which takes less time than two draws."""


def stage_of(scenario: Scenario) -> Scene:
    s = scenario
    stage = Scene(s.scene, s.camera.multisampling)
    stage.place(0.0, s.target.T_world_start, *stage.parts.start)
    return stage


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"camera.multisampling": 4},
        {"camera.shadows": True},
        {"camera.principal_px": [300.25, 255.5]},
    ],
    ids=["plain", "smoothed", "shadows", "principal"],
)
def test_a_part_is_what_the_whole_picture_has_there(changes: dict[str, object]):
    stage = stage_of(vs.load("arm_ibvs", changes))
    eye = OpenGLRenderer(stage, stage.parts.camera)
    whole = eye.full_image()
    assert eye.whole
    left, top, right, bottom = PART
    (part,) = eye.images((WINDOWS,))
    assert part is not None and not eye.whole
    apart = np.abs(part[top:bottom, left:right].astype(int) - whole[top:bottom, left:right]).max(
        axis=-1
    )
    # Vertices are rounded to 1/256 px after a float's rounding, which differs: a pixel in some
    # thousands is another one.
    assert np.mean(apart > 1) < 2e-3
    assert np.ptp(part[top:bottom, left:right]) > 100  # there is something to see
    outside = np.ones(part.shape[:2], dtype=bool)
    outside[top:bottom, left:right] = False
    assert not part[outside].any()
    np.testing.assert_array_equal(eye.full_image(), whole)  # and nothing of it stays


@pytest.mark.parametrize(
    ("name", "changes"),
    [("arm_ibvs", {"camera.principal_px": [300.25, 255.5]}), ("quadrotor_hover", {})],
)
def test_geoms_outside_of_the_frustum_are_not_missed(name: str, changes: dict[str, object]):
    stage = stage_of(vs.load(name, changes))
    for view in OpenGLRenderer(stage, stage.parts.camera)._views:
        camera = view._camera
        for windows in (None, ((100, 40, 220, 120), (10, 200, 90, 240))):
            drawn = view.raw(windows).copy()
            kinds = [geom.type for geom in camera._scene.ptr.geoms[: camera._scene.ptr.ngeom]]
            # of each window others are left out, for its draw alone
            assert (LABEL in kinds) == (windows is None)
            camera.local = False
            camera._scene.ptr.flags[SKYBOX] = 1
            np.testing.assert_array_equal(view.raw(windows), drawn)
            camera.local = True


def test_the_next_part_has_nothing_of_the_last():
    stage = stage_of(vs.load("arm_ibvs"))
    eye = OpenGLRenderer(stage, stage.parts.camera)
    eye.images((WINDOWS,))
    (part,) = eye.images((((10, 400, 40, 430),),))
    assert part is not None and part[390:440, :70].any() and not part[68:212, 218:452].any()


@pytest.mark.parametrize(
    ("camera", "noisy"),
    [(Perspective(distortion=(-0.2, 0.05, 0.0, 0.0, 0.0)), False), (Perspective(), True)],
    ids=["bent by its lens", "noise told from the whole"],
)
def test_where_a_part_is_not_enough_the_picture_is_whole(camera: Perspective, noisy: bool):
    stage = stage_of(replace(vs.load("arm_ibvs"), camera=camera))
    eye = OpenGLRenderer(stage, camera, noisy)
    (image,) = eye.images((WINDOWS,))
    assert eye.whole and image is not None and image[10, 10].any()


def test_windows_are_drawn_apart_where_that_takes_less_time():
    far, near = (10, 400, 40, 430), (45, 400, 70, 430)
    assert merged(WINDOWS, 640, 480) == (PART,)
    assert set(merged((far, *WINDOWS, near), 640, 480)) == {PART, (10, 400, 70, 430)}
    assert merged((far, *WINDOWS), 640, 480, math.inf) == ((10, 100, 420, 430),)
    assert merged(((-5, -5, 20, 10), (630, 470, 700, 500), (700, 0, 710, 10)), 640, 480) == (
        (630, 470, 640, 480),
        (0, 0, 20, 10),
    )
    assert merged((), 640, 480) == ()


def test_bands_of_rows_are_looked_at_with_room_within_the_picture():
    assert part_round(WINDOWS, 640, 480) == (218, 68, 452, 212)
    assert part_round(((0, 0, 30, 40), (600, 430, 640, 480)), 640, 480) == (0, 0, 640, 480)
    assert part_round((), 640, 480) is None
    assert round(REACH * 640) == 32


def test_a_floor_casts_no_shadow_on_itself():
    # With its own shadow, software OpenGL dotted the floor of this view from the light's side on.
    stage = stage_of(vs.load("omni_ibvs", {"robot.wheels": "planar"}))
    stage.model.vis.quality.shadowsize = 1024
    view = SceneCamera(stage, "overview", 480, 270, shadows=True, style="outside")
    lit = view.full_image().max(axis=-1)
    stage.model.geom_rgba[:, 3] = np.where(
        stage.model.geom_group == 0, stage.model.geom_rgba[:, 3], 0
    )
    stage.model.mat_rgba[
        [m for m in range(stage.model.nmat) if stage.model.material(m).name != "floor"], 3
    ] = 0
    bare = view.full_image().max(axis=-1)
    # the base, its shadow, those of the landmarks: so there are shadows
    assert np.mean(lit < 120) > 1e-3
    assert not np.any(bare < 140)  # the floor's darker squares are 155 and more
