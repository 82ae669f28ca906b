"""The camera leaves for the far distance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.endings.base import Ending, FrameLimits, IdealRuns
from vstestbed.tasks.frame import Frame

FAR_M = 200.0  # distance from the target beyond which the camera has diverged [m]


class Divergence(Ending):
    """Diverged, by the true distance of the camera from its target."""

    outcome = Outcome.diverged

    def update(self, frame: Frame) -> Verdict | None:
        away = frame.truth.T_world_camera[:3, 3] - frame.truth.T_world_target[:3, 3]
        if math.hypot(*away.tolist()) > FAR_M:
            return Outcome.diverged, f"the camera is more than {FAR_M:g} m away from the target"
        return None

    @staticmethod
    def over(runs: IdealRuns, limits: FrameLimits) -> NDArray[np.bool_]:
        return np.linalg.norm(runs.T_camera_target[:, :3, 3], axis=1) > FAR_M
