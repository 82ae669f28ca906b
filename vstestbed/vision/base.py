"""The interface of a detector: a picture in (for the oracle, the truth), marker pixels in the target's order out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Look, Picture
from vstestbed.core.geometry import Array
from vstestbed.features.observation import Goal
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
        goal: the goal's view of the very points in these rows, where they are not the target's markers.
        ids: then, the number of the point in each row (N,), the same as long as the row shows the same point; -1 in an empty row.
        why: why none is seen, in words for a run that ends thereby; "" where there is nothing to say.
    """

    uv: Array
    p_camera: Array | None = None
    T_camera_target: Array | None = None
    goal: Goal | None = None
    ids: NDArray[np.intp] | None = None
    why: str = ""

    @property
    def seen(self) -> NDArray[np.bool_]:
        """Which markers are seen, shape (N,)."""
        return np.isfinite(self.uv[:, 0])


class Detector(Protocol[M]):
    """A detector: its parameters are frozen in the object; its state, such as the last positions, is passed through.

    The caller gives `picture` only if `needs_image` is set, and `view` only if `needs_truth` is. `DetectorBase` has the defaults.
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
    needs_sheet: ClassVar[bool]
    """It finds the picture of a target `picture`."""
    needs_goal: ClassVar[bool]
    """It finds the goal picture's points, not the target's markers."""
    draws: ClassVar[bool]
    """`detect` draws from its generator, so that another seed gives other points."""

    @property
    def rows(self) -> int | None:
        """How many points it reports, where they are not the target's markers; None: one for each marker."""
        ...

    @property
    def changing(self) -> bool:
        """Whether its rows may come to show other points (`Detection.ids`)."""
        ...

    @property
    def fleeting(self) -> bool:
        """Whether they do so in most pictures, so that nothing can be learnt of a point over time."""
        ...

    def init(self) -> M:
        """The state before the first picture."""
        ...

    def begin(self, goal: Goal, camera: Camera, target: Target) -> M:
        """The state before the first picture of a run to a goal, with the picture taken there where `needs_goal` is set."""
        ...

    def look(self, memory: M, camera: Camera, target: Target) -> Look | None:
        """Regions of interest in the next picture; None for the whole picture."""
        ...

    def detect(
        self, memory: M, picture: Picture | None, view: TruthView | None, camera: Camera, target: Target, rng: np.random.Generator
    ) -> tuple[M, Detection]:
        """One picture: the next state and the marker positions."""
        ...


class DetectorBase:
    """Defaults: a detector of the target's markers, which needs no picture of the goal. Its subclasses define the rest of `Detector`."""

    needs_truth: ClassVar[bool] = False
    markers: ClassVar[tuple[str, ...]] = ()
    needs_sheet: ClassVar[bool] = False
    needs_goal: ClassVar[bool] = False
    draws: ClassVar[bool] = False
    rows: Any = None  # without a type, as in `LawBase`: a subclass may have a field or a property in its place
    changing: Any = False
    fleeting: Any = False

    def init(self) -> Any:
        """No state."""
        return None

    def begin(self, goal: Goal, camera: Camera, target: Target) -> Any:
        """As `init`."""
        return self.init()

    def look(self, memory: Any, camera: Camera, target: Target) -> Look | None:
        """The whole picture."""
        return None
