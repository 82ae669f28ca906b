"""The oracle: a detector that reads the ground truth. A baseline for comparison with vision, never
a default.
"""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.camera import Camera, Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import all_finite
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.targets.base import Target
from vstestbed.vision.base import Detection, DetectorBase, TruthView


@spec
class Oracle(DetectorBase):
    """True projections and true depths; pixel noise is the scenario's `noise.pixel_sigma_px`, added
    by the `Observer`.

    Directions that the lens cannot project are never seen: with a perspective lens, all behind the
    camera. With a limited field of view a marker is also lost when it is occluded, outside the
    image or cut by its border (`Camera.whole`).

    Latency, jitter, lost and late pictures, a rolling shutter (`camera.readout_s`) and dropout act
    on it as on every detector; of an exposure it sees the middle. What changes grey levels alone
    does not act on it, and a run says so.

    Args:
        field_of_view: `limited` by the image's borders and by occlusion, or `unlimited`: all that
            the lens can project.
    """

    kind: Literal["oracle"] = "oracle"
    field_of_view: Literal["limited", "unlimited"] = "limited"
    needs_image: ClassVar[bool] = False
    needs_truth: ClassVar[bool] = True

    def detect(
        self,
        state: None,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[None, Detection]:
        """True pixels (N, 2) and centres (N, 3) of the visible markers, NaN for the others."""
        if view is None:
            words = (
                "the oracle needs the true view of the target;"
                " use detector blobs where there is none"
            )
            raise ParameterError.missing("view", words)
        p = view.p_camera
        uv = camera.project(p)
        if self.field_of_view == "unlimited" and all_finite(uv):
            return None, Detection(uv=uv, p_camera=p)
        seen = np.isfinite(uv[:, 0])
        if self.field_of_view == "limited":
            seen &= ~view.hidden & camera.whole(p, target.marker.radius)
        mask = np.where(seen, 1.0, np.nan)
        return None, Detection(uv=uv * mask[:, None], p_camera=p * mask[:, None])


@spec
class NoDetector(DetectorBase):
    """Nothing is detected: a law that works on grey levels (`photometric`) needs neither markers
    nor an oracle.
    """

    kind: Literal["none"] = "none"
    needs_image: ClassVar[bool] = False
    rows = 0

    def begin(self, goal: Goal, camera: Camera, target: Target) -> Goal:
        """The goal without its markers."""
        return goal.rows(np.zeros(0, np.intp))

    def detect(
        self,
        state: Goal | None,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[Goal | None, Detection]:
        """No point."""
        return state, Detection(uv=np.empty((0, 2)), goal=state)
