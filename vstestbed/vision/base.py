"""The contract of a detector: a picture (or, for the oracle, the truth) in, marker pixels in the target's order out."""

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
    """What the simulator knows of the markers: for the oracle, and for no other detector.

    Attributes:
        p_camera: true marker centres in the camera frame, shape (N, 3) [m].
        hidden: which markers something stands in front of, shape (N,).
    """

    p_camera: Array
    hidden: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Detection:
    """Where the markers are in one picture.

    Attributes:
        uv: pixels of the marker centres, shape (N, 2), NaN where a marker is not seen.
        p_camera: true marker centres in the camera frame, shape (N, 3) [m]; only the oracle has them.
        T_camera_target: the target's pose (4, 4), where the detector solved it on its way.
    """

    uv: Array
    p_camera: Array | None = None
    T_camera_target: Array | None = None

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which markers are seen, shape (N,)."""
        return np.isfinite(self.uv[:, 0])


class Detector(Protocol[M]):
    """A detector: parameters frozen in the object, memory (last positions, say) passed through.

    Whoever runs it gives `frame` only where `needs_image` says so, and `view` only where `needs_truth` does.
    """

    @property
    def kind(self) -> str:
        """The detector's word in a scenario."""
        ...

    needs_image: ClassVar[bool]
    """Whether it looks at the picture."""
    needs_truth: ClassVar[bool]
    """Whether it looks behind the scenes: the oracle."""
    markers: ClassVar[tuple[str, ...]]
    """Kinds of markers that it can see; empty: any."""

    def init(self) -> M:
        """The memory before the first picture."""
        ...

    def look(self, memory: M, camera: Camera, target: Target) -> Look | None:
        """Where it is going to look in the next picture; None for everywhere."""
        ...

    def detect(
        self, memory: M, frame: Picture | None, view: TruthView | None, camera: Camera, target: Target, rng: np.random.Generator
    ) -> tuple[M, Detection]:
        """One picture: the next memory and where the markers are."""
        ...
