"""The ideal plant: a camera that moves exactly as told. It needs MuJoCo only where somebody wants a picture of it."""

from __future__ import annotations

import numpy as np

from vstestbed.camera import Frame, Look
from vstestbed.geometry import Array, exp, inverse
from vstestbed.motion import Path
from vstestbed.observation import Encoders
from vstestbed.sim.base import Eyes, Truth
from vstestbed.sim.noise import NO_DRIFT, Drift
from vstestbed.sim.scene import Parts
from vstestbed.sim.stage import Stage

NONE = np.zeros(0)


class IdealPlant:
    """T_world_camera <- T_world_camera exp([v] dt), the setpoint v held between commands.

    Args:
        parts: what is in the world. steps_per_frame: physics steps between pictures.
        eye: makes the pictures; None where no detector needs them. stage: tells what is hidden; None where nothing is.
        path: where the target is at a time; None for one that stands still. drift: of the camera's gains.
    """

    def __init__(
        self,
        parts: Parts,
        steps_per_frame: int,
        stage: Stage | None = None,
        eye: Eyes | None = None,
        path: Path | None = None,
        drift: Drift = NO_DRIFT,
    ):
        self._path, self._drift = path, drift
        self.step_s, self.steps_per_frame = parts.step, steps_per_frame
        self._T = parts.start[1]
        self._T_world_target = parts.target.pose.T
        self._T_target_world = inverse(self._T_world_target)
        self._target = parts.target
        self._stage, self._eye = stage, eye
        self._twist = np.zeros(6)
        self._steps = 0
        self._hidden = np.zeros(len(self._target.points), dtype=bool)

    @property
    def render_s(self) -> float:
        """Wall time spent on pictures so far [s]."""
        return self._eye.spent_s if self._eye else 0.0

    def capture(self, look: Look | None = None) -> tuple[Frame | None, Truth]:
        """The picture, where one is wanted, and the truth."""
        t = self._steps * self.step_s
        T = self._T.copy()
        if self._path is not None:
            self._T_world_target = self._path(t)
            self._T_target_world = inverse(self._T_world_target)
        p_camera = self._target.seen_from(self._T_target_world @ T)
        hidden, frame = self._hidden, None
        if self._stage is not None:
            self._stage.place(t, self._T_world_target, NONE, T)
            hidden = self._stage.hidden(T, p_camera)
        if self._eye is not None:
            frame = self._drift.of(Frame(t, self._eye.glimpse(look), self._eye.whole))
        truth = Truth(T, self._T_world_target, self._twist, NONE, NONE, NONE, p_camera, hidden, contact=False)
        return frame, truth

    def encoders(self) -> Encoders:
        """No joints."""
        return Encoders(NONE, NONE)

    def apply(self, setpoint: Array) -> None:
        """Move with this camera twist (6,) from now on."""
        self._twist = setpoint

    def advance(self, steps: int) -> bool:
        """Let time pass, in one exact exponential."""
        self._T = self._T @ exp(self._twist * (steps * self.step_s))
        self._steps += steps
        return True

    def close(self) -> None:
        """Free the pictures."""
        if self._stage is not None:
            self._stage.close()
