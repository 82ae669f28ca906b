"""The floor of a run's cost: the same physics steps and the same raw pictures, nothing else."""

from __future__ import annotations

import time
from dataclasses import dataclass

import mujoco
import numpy as np

from vstestbed.geometry import Array, inverse, transform
from vstestbed.sim.cube import drawn_for
from vstestbed.sim.pinhole import Pinhole
from vstestbed.sim.render import View
from vstestbed.sim.scene import Parts
from vstestbed.sim.stage import Stage


@dataclass(frozen=True)
class Floor:
    """Wall time of a run's bare physics and bare pictures [s]."""

    physics_s: float
    render_s: float

    @property
    def total_s(self) -> float:
        """Both together [s]."""
        return self.physics_s + self.render_s


def measure_floor(parts: Parts, steps_per_frame: int, ctrl: Array, q: Array, T_world_camera: Array, pictures: bool) -> Floor:
    """Replay a recorded run's controls with bare `mj_step`, and its views with bare renders of the kept camera.

    Args:
        parts: the scene. steps_per_frame: physics steps between frames.
        ctrl: actuator controls of each frame (frames, nu); q: joint angles of each frame (frames, n).
        T_world_camera: camera poses (frames, 4, 4), which place the free camera.
        pictures: whether the run rendered at all; of several faces of a cube, only those with a marker in them are.
    """
    stage = Stage(parts, samples=parts.camera.multisampling)
    drawn = drawn_for(parts.camera) if pictures else ()
    views = [View(stage, p.name, p.width, p.height, parts.camera.shadows, "own") for p in drawn]
    target = parts.target.pose.T
    stage.place(0.0, target, q[0], T_world_camera[0])
    mujoco.mj_forward(stage.model, stage.data)
    physics = render = 0.0
    for frame in range(len(ctrl)):
        if parts.robot.model is None:
            stage.place(0.0, target, q[frame], T_world_camera[frame])
        p_camera = transform(inverse(T_world_camera[frame]) @ target, parts.target.points)
        looked_at = [view for view, p in zip(views, drawn, strict=True) if _holds(p, p_camera, alone=len(drawn) == 1)]
        began = time.perf_counter()
        for view in looked_at:
            view.raw()
        rendered = time.perf_counter()
        if parts.robot.model is not None:
            stage.data.ctrl[: ctrl.shape[1]] = ctrl[frame]
            for _ in range(steps_per_frame):
                mujoco.mj_step(stage.model, stage.data)
            physics += time.perf_counter() - rendered
        render += rendered - began
    stage.close()
    return Floor(physics, render)


def _holds(face: Pinhole, p_camera: Array, alone: bool) -> bool:
    """Whether one of the markers (N, 3) lies in the middle part of a face, |x|, |y| <= z in its axes; the only picture always counts."""
    p = p_camera @ face.R_camera_face
    return alone or bool((np.abs(p[:, :2]).max(axis=1) <= p[:, 2]).any())
