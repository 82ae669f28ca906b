"""Pictures of a world by a free camera, by both renderers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from vstestbed.camera import Camera, Image, Perspective
from vstestbed.core.geometry import Pose
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.opengl import OpenGLRenderer
from vstestbed.sim.render.rays import RayRenderer
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import World
from vstestbed.targets import Target
from vstestbed.targets.base import Square

LENS = Perspective(width=320, height=240, fovy_deg=60)
FAR = Square(side=0.3, pose=Pose(xyz=(0, 0, 30)))
"""A target out of sight."""
DOWN = Pose(xyz=(0, 0, 2), rpy_deg=(180, 0, 0))
"""A camera 2 m over the floor that looks down: x to the right, y of the world up in the picture."""


@contextmanager
def seen(
    world: World,
    target: Target = FAR,
    lens: Camera = LENS,
    by: tuple[type, ...] = (OpenGLRenderer, RayRenderer),
) -> Iterator[Callable[..., list[Image]]]:
    """The pictures as a function of the camera's pose and the time."""
    stage = Scene(
        SceneDescription(Free(start=FreeStart(nominal=Pose())), lens, target, world, step=0.002)
    )
    eyes = [renderer(stage, lens) for renderer in by]

    def at(view: Pose = DOWN, t: float = 0.0) -> list[Image]:
        stage.place(t, target.pose.T, np.zeros(0), view.T)
        return [eye.full_image().copy() for eye in eyes]

    yield at
    stage.close()


def pixel_of(
    point: tuple[float, float, float], view: Pose = DOWN, lens: Perspective = LENS
) -> np.ndarray:
    """The pixel (2,) of a point of the world."""
    p = np.linalg.inv(view.T) @ [*point, 1.0]
    return lens.f * p[:2] / p[2] + [(lens.width - 1) / 2, (lens.height - 1) / 2]
