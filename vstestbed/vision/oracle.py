"""The oracle: a detector that knows the truth. The baseline against which vision is compared, never a default."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Frame
from vstestbed.errors import ParameterError
from vstestbed.geometry import Array
from vstestbed.spec import spec
from vstestbed.target import Target
from vstestbed.vision.base import Detection, TruthView


@spec
class Oracle:
    """True projections and true depths; pixel noise is the scenario's `noise.pixel_sigma_px`, added by the `Observer`.

    A marker behind the camera is never seen. With a limited field of view, neither is one that is hidden, outside the
    picture or cut by its border: whose centre is nearer to the border than the marker's apparent half width (height), the
    root of the squared shifts in u (in v) that one marker radius along the camera's x and along its y make.

    Args:
        field_of_view: `limited` by the picture and by what stands in the way, or `unlimited`: all that is in front.
    """

    kind: Literal["oracle"] = "oracle"
    field_of_view: Literal["limited", "unlimited"] = "limited"
    needs_image: ClassVar[bool] = False
    needs_truth: ClassVar[bool] = True
    markers: ClassVar[tuple[str, ...]] = ()

    def init(self) -> None:
        """The oracle remembers nothing."""

    def detect(
        self, memory: None, frame: Frame | None, view: TruthView | None, camera: Camera, target: Target, rng: np.random.Generator
    ) -> tuple[None, Detection]:
        """True pixels (N, 2) and depths (N,) of what can be seen, NaN for the rest.

        Raises:
            ParameterError: no truth was given.
        """
        if view is None:
            raise ParameterError("view", "is missing: the oracle needs the true view of the target; use detector blobs where there is none")
        p = view.p_camera
        uv = camera.project(p)
        seen = np.isfinite(uv[:, 0])
        if self.field_of_view == "limited":
            seen &= ~view.hidden & _whole(uv, p, camera, target.marker.radius)
        mask = np.where(seen, 1.0, np.nan)
        return None, Detection(uv=uv * mask[:, None], depth=p[:, 2] * mask)


def _whole(uv: Array, p: Array, camera: Camera, radius: float) -> NDArray[np.bool_]:
    """Whether the markers at p (N, 3) lie in the picture with a margin of their apparent radius, shape (N,)."""
    across = camera.project(p + np.array([radius, 0, 0])) - uv
    down = camera.project(p + np.array([0, radius, 0])) - uv
    size = np.array([camera.width, camera.height])
    with np.errstate(invalid="ignore"):
        return np.all(np.minimum(uv + 0.5, size - 0.5 - uv) >= np.hypot(across, down), axis=-1)
