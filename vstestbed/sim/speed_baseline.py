"""Lower bound of a run's cost: the same physics steps and the same raw images, nothing else."""

from __future__ import annotations

import time

import mujoco

from vstestbed.core.geometry import Array, inverse
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.pictures import bare_renderer
from vstestbed.sim.scene.scene import Scene


def measure_baseline(
    parts: SceneDescription, steps_per_frame: int, ctrl: Array, q: Array, T_world_camera: Array, pictures: bool
) -> tuple[float, float]:
    """Wall times of a recorded run's controls with plain `mj_step`, and of its views with plain renders [s].

    Ray casting renders whole images here, so that a run, which renders windows, may cost less.

    Args:
        parts: the scene. steps_per_frame: physics steps between frames.
        ctrl: actuator controls of each frame (frames, nu); q: joint angles of each frame (frames, n).
        T_world_camera: camera poses (frames, 4, 4), which place the free camera.
        pictures: whether the run rendered at all; of several faces of a cube, only those with a marker in them are.
    """
    stage = Scene(parts, samples=parts.camera.multisampling)
    picture = bare_renderer(stage, parts.camera) if pictures else None
    target = parts.target.T_world_start
    stage.place(0.0, target, q[0], T_world_camera[0])
    stage.rest()
    mujoco.mj_forward(stage.model, stage.data)
    physics = render = 0.0
    for frame in range(len(ctrl)):
        if parts.robot.body is None:
            stage.place(0.0, target, q[frame], T_world_camera[frame])
        p_camera = parts.target.seen_from(inverse(target) @ T_world_camera[frame])
        began = time.perf_counter()
        if picture is not None:
            picture(p_camera)
        rendered = time.perf_counter()
        if parts.robot.body is not None:
            stage.data.ctrl[stage.at.ctrl] = ctrl[frame]
            for _ in range(steps_per_frame):
                mujoco.mj_step(stage.model, stage.data)
            physics += time.perf_counter() - rendered
        render += rendered - began
    stage.close()
    return physics, render
