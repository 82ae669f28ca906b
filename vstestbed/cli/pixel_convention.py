"""Check of the pixel convention: balls of known position are rendered, detected and compared with
the camera model.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import Literal

import numpy as np

from vstestbed.camera import Camera, Perspective, Picture
from vstestbed.core.geometry import Array, Pose, transform
from vstestbed.robots.free import Free, FreeStart
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.pictures import servo_renderer
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import World
from vstestbed.targets.base import Points
from vstestbed.targets.markers import Sphere
from vstestbed.vision import Blobs

__all__ = ["BALLS", "pixel_convention"]

BALLS = tuple(
    (x, y, z) for z, y in ((0.0, -0.35), (0.3, 0.0), (-0.2, 0.35)) for x in (-0.5, -0.17, 0.17, 0.5)
)
"""Twelve balls over the whole image at several depths, in the target frame [m]."""


def pixel_convention(
    renderer: Literal["auto", "gl", "rays"] = "auto", camera: Camera | None = None
) -> tuple[Array, str]:
    """Render twelve balls and detect them: measured minus predicted pixels of their centres (N, 2)
    [px], and the renderer's name.

    Raises EnvironmentLackError: renderer is gl, and OpenGL does not work here.
    """
    camera = replace(camera or Perspective(multisampling=4), renderer=renderer)
    # Unlit: shading would shift a ball's centroid towards the light.
    target = Points(at=BALLS, pose=Pose(xyz=(0, 0, 1.2)), marker=Sphere(radius=0.035, lit=False))
    robot = Free(start=FreeStart(nominal=Pose()))
    parts = SceneDescription(robot, camera, target, World(floor_z=-20.0), step=0.002)
    with closing(Scene(parts, samples=camera.multisampling)) as stage:
        drawing = servo_renderer(stage, camera)
        stage.place(0.0, target.pose.T, np.zeros(0), np.eye(4))
        image = drawing.full_image()
        detector = Blobs()
        _, found = detector.detect(
            detector.init(), Picture(0.0, (image,)), None, camera, target, np.random.default_rng(0)
        )
    return found.uv - camera.project(transform(target.pose.T, target.points)), drawing.name
