"""One OpenGL context for all scenes: each is drawn as if it were alone."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.sim import gl_context as contexts
from vstestbed.sim.gl_context import repeated
from vstestbed.sim.render.opengl import OpenGLRenderer, SceneCamera
from vstestbed.sim.scene.scene import Scene

NAMES = ("arm_ibvs", "arm_tags", "spherical_book")
Made = tuple[Scene, Callable[[], np.ndarray]]


@pytest.fixture
def scene() -> Iterator[Callable[..., Made]]:
    """scene(name, outside): a bundled scenario's start with what draws it, by its own camera or
    from outside (with shadows).
    """
    stages: list[Scene] = []

    def make(name: str, outside: bool = False) -> Made:
        s = vs.load(name)
        stage = Scene(s.scene, samples=4 if outside else 0)
        flange = s.robot.flange_pose(s.robot.configuration())
        stage.place(
            0.0,
            s.target.pose.T,
            s.robot.configuration() if s.robot.body else np.zeros(0),
            flange @ s.camera.mount.T,
        )
        stages.append(stage)
        return stage, SceneCamera(
            stage, "overview", 480, 270, shadows=True, style="outside"
        ).full_image if outside else OpenGLRenderer(stage, s.camera).full_image

    yield make
    for stage in stages:
        stage.close()


def test_scenes_in_turn_look_as_they_do_alone(scene: Callable[..., Made]):
    alone = []
    for name in NAMES:
        for outside in (False, True):
            stage, picture = scene(name, outside)
            alone.append(picture())
            stage.close()
    together = [scene(name, outside)[1] for name in NAMES for outside in (False, True)]
    for order in (range(len(together)), range(len(together) - 1, -1, -1)):
        for i in order:
            np.testing.assert_array_equal(together[i](), alone[i])


def test_a_scene_that_looks_the_same_takes_the_kept_context(scene: Callable[..., Made]):
    first, picture = scene("arm_ibvs")
    picture()
    kept = first.physics.contexts.mujoco
    first.close()
    again, picture = scene("arm_ibvs")
    picture()
    assert again.physics.contexts.mujoco is kept
    other, picture = scene("arm_tags")  # other textures
    picture()
    assert other.physics.contexts.mujoco is not kept
    assert other.physics.contexts.gl is again.physics.contexts.gl


def test_few_are_kept_and_none_is_freed_while_it_is_used(scene: Callable[..., Made]):
    used = [scene("arm_ibvs")]
    before = used[0][1]()
    for width in range(100, 100 + 2 * contexts.MOST_KEPT):
        s = vs.load("arm_ibvs", {"camera.width": 7 * width, "camera.height": 6 * width})
        stage = Scene(s.scene)
        stage.place(0.0, s.target.pose.T, s.robot.configuration())
        OpenGLRenderer(stage, s.camera).full_image()
        stage.close()
    assert len(contexts._kept) <= contexts.MOST_KEPT
    np.testing.assert_array_equal(used[0][1](), before)


def test_a_texture_is_tiled_if_any_material_repeats_it():
    texture = '<texture name="{0}" type="2d" builtin="checker" width="8" height="8"/>'.format
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><asset>{texture("plain")}{texture("shared")}{texture("uniform")}
        <material name="a" texture="plain" texrepeat=".5 1"/><material name="b" texture="shared"/>
        <material name="c" texture="shared" texrepeat="1 9"/>
        <material name="d" texture="uniform" texuniform="true"/></asset></mujoco>"""
    )
    assert repeated(model).tolist() == [False, True, True]
