"""Pictures of whole scenes for the detectors' tests: a target before a free camera, drawn by the scene itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from vstestbed.camera import Camera, Perspective, Picture
from vstestbed.core.geometry import Array, Pose
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.sim.render.opengl import OpenGLRenderer
from vstestbed.sim.scene.compose import Parts
from vstestbed.sim.scene.stage import Stage
from vstestbed.sim.scene.world import Plate, World
from vstestbed.targets.base import Target

CAMERA = Perspective()  # 640 x 480, f = 384 px
TakeScene = Callable[..., Picture]


@pytest.fixture(scope="module")
def scene_picture() -> Iterator[TakeScene]:
    """scene_picture(target, T_camera_target, camera, plates) -> Picture; one renderer a scene."""
    stages: dict[tuple[object, ...], tuple[Stage, OpenGLRenderer]] = {}

    def take(target: Target, T: Array, camera: Camera = CAMERA, plates: tuple[Plate, ...] = ()) -> Picture:
        key = (target, camera, plates)
        if key not in stages:
            world = World(floor_z=-20.0, plates=plates)
            stage = Stage(Parts(Free(start=FreeStart(nominal=Pose())), camera, target, world, 0.002), camera.multisampling)
            stages[key] = stage, OpenGLRenderer(stage, camera)
        stage, eye = stages[key]
        stage.place(0.0, T, np.zeros(0), np.eye(4))
        return Picture(0.0, tuple(None if image is None else image.copy() for image in eye.images()))

    yield take
    for stage, _ in stages.values():
        stage.close()
