"""No detector: for laws that work on whole pictures."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.camera import Camera, Picture
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.targets.base import Target
from vstestbed.vision.base import Detection, DetectorBase, TruthView


@spec
class NoDetector(DetectorBase):
    """Nothing is detected: a law that works on grey levels (`photometric`) needs neither markers nor an oracle."""

    kind: Literal["none"] = "none"
    needs_image: ClassVar[bool] = False
    rows = 0

    def begin(self, goal: Goal, camera: Camera, target: Target) -> Goal:
        """The goal without its markers."""
        return goal.rows(np.zeros(0, np.intp))

    def detect(
        self, memory: Goal | None, picture: Picture | None, view: TruthView | None, camera: Camera, target: Target, rng: np.random.Generator
    ) -> tuple[Goal | None, Detection]:
        """No point."""
        return memory, Detection(uv=np.empty((0, 2)), goal=memory)
