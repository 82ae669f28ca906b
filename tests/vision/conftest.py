"""A stage for the vision tests: markers in front of a camera at the world's origin, rendered by
MuJoCo.
"""

from __future__ import annotations

import os

os.environ.setdefault("MUJOCO_GL", "egl")

from collections.abc import Callable, Iterator

import numpy as np
import pytest
from dm_control import mujoco

from vstestbed.camera import Camera, Perspective, Picture
from vstestbed.core.geometry import Array, Pose, quaternion_wxyz
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.opengl import OpenGLRenderer
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import Plate, World
from vstestbed.targets.base import Target

TakePicture = Callable[..., Picture]

# World = camera frame in computer-vision axes: x right, y down, z forward. Disc faces lie in the
# target's z = 0.
SCENE = """
<mujoco>
  <visual><headlight active="0"/>
    <quality offsamples="{multisampling}" shadowsize="0"/><map znear="0.01" zfar="50"/>
    <global offwidth="{width}" offheight="{height}"/></visual>
  <statistic extent="1" center="0 0 1"/>
  <asset>
    <texture name="sky" type="skybox" builtin="flat" rgb1=".6 .6 .6" width="16" height="96"/>
  </asset>
  <worldbody>
    <light type="directional" dir="0.3 0.5 1" ambient=".3 .3 .3" diffuse=".6 .6 .6"
           specular="0 0 0" castshadow="false"/>
    <camera name="eye" pos="0 0 0" xyaxes="1 0 0 0 -1 0" fovy="{fovy}"/>
    <body name="target" mocap="true">{markers}</body>
    {extra}
  </worldbody>
</mujoco>
"""


def _markers(target: Target, lit: bool) -> str:
    geoms = []
    for p, c in zip(target.points, target.colors, strict=True):
        r, look = target.marker.radius, f'rgba="{c[0]} {c[1]} {c[2]} 1"'
        if not lit:  # light adds 0.4 % to what glows: the exact colour
            look = f'rgba="{c[0] / 250} {c[1] / 250} {c[2] / 250} 1" material="glow"'
        if target.marker.kind == "disc":
            geoms.append(
                f'<geom type="cylinder" size="{r} 1e-4" pos="{p[0]} {p[1]} {p[2] + 1e-4}" {look}/>'
            )
        else:
            geoms.append(f'<geom type="sphere" size="{r}" pos="{p[0]} {p[1]} {p[2]}" {look}/>')
    return "".join(geoms)


@pytest.fixture(scope="session")
def picture() -> TakePicture:
    """picture(target, T_camera_target, camera, extra="", lit=True, t=0.0) -> Picture, one renderer
    a scene.
    """
    stages: dict[str, tuple[mujoco.Physics, mujoco.Camera]] = {}

    def take(
        target: Target,
        T: Array,
        camera: Perspective,
        extra: str = "",
        lit: bool = True,
        t: float = 0.0,
    ) -> Picture:
        fovy = 2 * np.degrees(np.arctan(camera.height / 2 / camera.f))
        size = {
            "width": camera.width,
            "height": camera.height,
            "fovy": fovy,
            "multisampling": camera.multisampling,
        }
        xml = SCENE.format(**size, markers=_markers(target, lit), extra=extra)
        xml = xml.replace("<asset>", '<asset><material name="glow" emission="250" specular="0"/>')
        if xml not in stages:
            physics = mujoco.Physics.from_xml_string(xml)
            stages[xml] = physics, mujoco.Camera(physics, camera.height, camera.width, "eye")
        physics, eye = stages[xml]
        physics.data.mocap_pos[0] = T[:3, 3]
        physics.data.mocap_quat[0] = quaternion_wxyz(T[:3, :3])
        physics.forward()
        return Picture(t=t, images=(eye.render(),))

    return take


CAMERA = Perspective()  # 640 x 480, f = 384 px
TakeScene = Callable[..., Picture]


@pytest.fixture(scope="module")
def scene_picture() -> Iterator[TakeScene]:
    """scene_picture(target, T_camera_target, camera, plates) -> Picture; one renderer a scene."""
    stages: dict[tuple[object, ...], tuple[Scene, OpenGLRenderer]] = {}

    def take(
        target: Target, T: Array, camera: Camera = CAMERA, plates: tuple[Plate, ...] = ()
    ) -> Picture:
        key = (target, camera, plates)
        if key not in stages:
            world = World(floor_z=-20.0, plates=plates)
            stage = Scene(
                SceneDescription(
                    Free(start=FreeStart(nominal=Pose())), camera, target, world, 0.002
                ),
                camera.multisampling,
            )
            stages[key] = stage, OpenGLRenderer(stage, camera)
        stage, eye = stages[key]
        stage.place(0.0, T, np.zeros(0), np.eye(4))
        return Picture(
            0.0, tuple(None if image is None else image.copy() for image in eye.images())
        )

    yield take
    for stage, _ in stages.values():
        stage.close()
