"""A law without equations for many runs in a batch: its `step` is asked run by run."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array
from vstestbed.features.observation import Goal, Observation, Relative
from vstestbed.laws import Law
from vstestbed.laws.views import Views
from vstestbed.loop.guarded_law import GuardedLaw
from vstestbed.robots.own_model import OwnModel
from vstestbed.vision.pose.homography import relative_view

SIX = np.eye(6)
"""The motions of the ideal camera."""
LEAST_POSE = 3
"""Markers that leave finitely many poses."""


class OneByOne:
    """Keeps the memory of each run; the batch holds its number.

    Args:
        law: any. camera: the lens, for pixel coordinates.
    """

    state_size = 1

    def __init__(self, law: Law[Any], camera: Camera):
        self._law, self._camera, self._memories = law, camera, []
        self._moved: list[Array] = []
        self._guarded: list[GuardedLaw] = []

    def step(self, memory: Array, views: Views, seen: NDArray[np.bool_], goal: Goal) -> tuple[Array, Array]:
        """One frame of m runs: the next memory (m, 1), and the camera twists (m, 6), NaN where the law orders rest.

        Args:
            memory: numbers of the runs' memories (m, 1); NaN before the first frame.
            views: of all markers (m, N, 3). seen: which of them the law is shown (m, N).
            goal: the goal view.
        """
        memory, twist = memory.copy(), np.full((len(memory), 6), np.nan)
        uv = np.where(seen[..., None], self._camera.project(views.p), np.nan)
        for i in range(len(memory)):
            if np.isnan(memory[i, 0]):
                memory[i, 0] = len(self._memories)
                self._memories.append(self._law.init(goal))
                self._moved.append(np.zeros(6))
                self._guarded.append(GuardedLaw(self._law))
            k = int(memory[i, 0])
            observation = self._observation(views, i, seen[i], uv[i], goal, self._moved[k])
            self._memories[k], command = self._guarded[k].step(self._memories[k], observation, goal, SIX)
            if not command.rest_reason:
                twist[i] = command.twist
                self._moved[k] = command.twist * self._camera.period
        return memory, twist

    def failed(self, memory: Array) -> NDArray[np.bool_]:
        """In which runs, by the numbers of their memories (m, 1), the law has failed (m,)."""
        return np.array([not np.isnan(k) and bool(self._guarded[int(k)].failure) for k in memory[:, 0]], dtype=bool)

    def _observation(self, views: Views, i: int, seen: NDArray[np.bool_], uv: Array, goal: Goal, moved: Array) -> Observation:
        """What the law is shown of run i."""
        inputs = self._law.inputs
        xy, depth, ray, reach = (np.where(seen if a.ndim == 1 else seen[:, None], a, np.nan) for a in _of(views, i))
        T = views.T_camera_target[i] if np.count_nonzero(seen) >= LEAST_POSE else None
        relative: Relative | None = relative_view(goal.xy, xy, goal.normal) if "relative" in inputs else None
        if self._law.depth.needs_pose and T is None:
            depth = np.full_like(depth, np.nan)
        radius = views.radius_px[i] if "radius_px" in inputs else None
        robot = OwnModel.of_ideal_camera(self._camera.period, moved) if "robot" in inputs else None
        return Observation(views.t, uv, xy, depth, T, ray, reach, relative, radius_px=radius, robot=robot)


def _of(views: Views, i: int) -> tuple[Array, Array, Array, Array]:
    """Normalised coordinates, depths, rays and ranges of run i."""
    return views.xy[i], views.depth[i], views.ray[i], views.range[i]
