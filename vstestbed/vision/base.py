"""The interface of a detector: a picture in (for the oracle, the truth), marker pixels in the target's order out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Look, Picture
from vstestbed.core.geometry import Array
from vstestbed.targets.base import Target

M = TypeVar("M")


@dataclass(frozen=True, slots=True)
class TruthView:
    """Ground truth of the markers, for the oracle alone.

    Attributes:
        p_camera: true marker centres in the camera frame, shape (N, 3) [m].
        hidden: which markers are occluded, shape (N,).
    """

    p_camera: Array
    hidden: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Detection:
    """Marker positions found in one picture.

    Attributes:
        uv: images of the marker centres, shape (N, 2) [px], NaN where a marker is not seen.
        p_camera: true marker centres in the camera frame, shape (N, 3) [m]; only the oracle has them.
        T_camera_target: pose of the target, shape (4, 4), if the detector solves it anyway.
    """

    uv: Array
    p_camera: Array | None = None
    T_camera_target: Array | None = None

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which markers are seen, shape (N,)."""
        return np.isfinite(self.uv[:, 0])


class Detector(Protocol[M]):
    """A detector: its parameters are frozen in the object; its state, such as the last positions, is passed through.

    The caller gives `picture` only if `needs_image` is set, and `view` only if `needs_truth` is.
    """

    @property
    def kind(self) -> str:
        """The detector's name in a scenario."""
        ...

    needs_image: ClassVar[bool]
    """It reads the picture."""
    needs_truth: ClassVar[bool]
    """It reads the ground truth: the oracle."""
    markers: ClassVar[tuple[str, ...]]
    """Kinds of markers that it can detect; empty: any."""

    def init(self) -> M:
        """The state before the first picture."""
        ...

    def look(self, memory: M, camera: Camera, target: Target) -> Look | None:
        """Regions of interest in the next picture; None for the whole picture."""
        ...

    def detect(
        self, memory: M, picture: Picture | None, view: TruthView | None, camera: Camera, target: Target, rng: np.random.Generator
    ) -> tuple[M, Detection]:
        """One picture: the next state and the marker positions."""
        ...
