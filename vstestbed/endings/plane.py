"""The camera is behind its target, whose face it cannot see from there."""

from __future__ import annotations

from operator import mul

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.endings.base import Ending, FrameLimits, IdealRuns, face_can_be_lost
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import Setup


class PlaneCrossed(Ending):
    """Lost, where the camera is behind the plane of a target with one face, by the truth."""

    outcome = Outcome.target_lost

    def __init__(self, setup: Setup):
        self._counts = face_can_be_lost(setup)
        self._before: Array | None = None  # pose of the target in the last frame (4, 4)

    def update(self, frame: Frame) -> Verdict | None:
        if not self._counts:
            return None
        T_camera = frame.truth.T_world_camera
        T_target = frame.truth.T_world_target
        before = self._before
        self._before = T_target
        if not is_behind(T_camera, T_target):
            return None
        if before is None:
            words = "the camera starts behind the plane of the target, whose face it cannot see"
            return Outcome.target_lost, f"{words}; start in front of it, or turn target.pose"
        crossed = is_behind(T_camera, before)  # also of the target where it stood before
        words = (
            "the camera crossed the plane of the target"
            if crossed
            else "the target turned its back to the camera, or moved past it"
        )
        return Outcome.target_lost, words

    @staticmethod
    def over(runs: IdealRuns, limits: FrameLimits) -> NDArray[np.bool_]:
        T = runs.T_camera_target
        if not limits.one_sided:
            return np.zeros(len(T), dtype=bool)
        return np.einsum("mi,mi->m", T[:, :3, 2], T[:, :3, 3]) <= 0


def is_behind(T_world_camera: Array, T_world_target: Array) -> bool:
    """Whether a camera is behind a target's front, from which the target's z points away."""
    away = (T_world_camera[:3, 3] - T_world_target[:3, 3]).tolist()
    return sum(map(mul, away, T_world_target[:3, 2].tolist())) >= 0
