"""The interface of a detector: a picture in (for the oracle, the truth), marker pixels in the
target's order out.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Picture, Regions, Window
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.features.depth import depth_at
from vstestbed.features.observation import Goal
from vstestbed.targets.base import Target

M = TypeVar("M")


class TruthView(NamedTuple):
    """True marker centres in the camera frame (N, 3) [m], and which are occluded (N,): for the
    oracle alone.
    """

    p_camera: Array
    hidden: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Detection:
    """Marker positions found in one picture.

    Attributes:
        uv: images of the marker centres, shape (N, 2) [px], NaN where a marker is not seen.
        p_camera: true marker centres in the camera frame, shape (N, 3) [m]; only the oracle has
            them.
        T_camera_target: pose of the target, shape (4, 4), if the detector solves it anyway.
        goal: the goal's view of the points in these rows, where they are not the target's markers.
        ids: then, the number of the point in each row (N,), the same as long as the row shows the
            same point; -1 in an empty row.
        why: why none is seen, in words for a run that ends thereby.
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


class Detector(Generic[M]):
    """A detector: its parameters are frozen in the object; its state, such as the last positions,
    is passed through.

    By default it finds the target's markers and needs no picture of the goal. The caller gives
    `picture` only if `needs_image` is set, and `view` only if `needs_truth` is.
    """

    kind: Any  # the word in a scenario: a field of each
    needs_image: ClassVar[bool]  # it reads the picture
    needs_truth: ClassVar[bool] = False  # it reads the ground truth: the oracle
    markers: ClassVar[tuple[str, ...]] = ()  # kinds of markers that it can detect; empty: any
    needs_sheet: ClassVar[bool] = False  # it finds the picture of a target `picture`
    # it finds the goal picture's points, not the target's markers
    needs_goal: ClassVar[bool] = False
    # `detect` draws from its generator, so that another seed gives other points
    draws: ClassVar[bool] = False
    # These without a type: a kind may have a field or a property in their place.
    rows: Any = None  # how many points it reports, where they are not the target's markers
    changing: Any = False  # its rows may come to show other points (`Detection.ids`)
    # they do so in most pictures, so that nothing can be learnt of a point over time
    fleeting: Any = False

    def init(self) -> Any:
        """The state before the first picture."""
        return None

    def begin(self, goal: Goal, camera: Camera, target: Target) -> Any:
        """The state before the first picture of a run to a goal, with the picture taken there where
        `needs_goal` is set.
        """
        return self.init()

    def regions_of_interest(self, state: M, camera: Camera, target: Target) -> Regions | None:
        """Regions of interest in the next picture; None for the whole picture."""
        return None

    @abstractmethod
    def detect(
        self,
        state: M,
        picture: Picture | None,
        view: TruthView | None,
        camera: Camera,
        target: Target,
        rng: np.random.Generator,
    ) -> tuple[M, Detection]:
        """One picture: the next state and the marker positions.

        Raises ParameterError: the picture, or the truth, is missing; or the target is of another
        kind.
        """
        ...

    def _given(self, picture: Picture | None) -> Picture:
        if picture is None or picture.empty:
            raise ParameterError.missing(
                "picture",
                f"detector {self.kind} needs one; use detector oracle where there is none",
            )
        return picture


DetectorBase = Detector  # the name from which plugins derive


# Points of the goal's picture as a goal: their depths by the depth camera or by the target's plane.
def goal_of_points(goal: Goal, uv: Array) -> Goal:
    """The goal with the points at uv (K, 2) [px] of its picture in place of the target's markers.

    Their depths are the depth camera's at the nearest pixel where it measured, else those of the
    target's plane z = 0 at the goal pose.
    """
    ray = goal.camera.ray(uv)
    normal = goal.T_camera_target[:3, 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        # where rays meet the plane; negative behind the camera
        z = (normal @ goal.T_camera_target[:3, 3]) / (ray @ normal) * ray[:, 2]
    if goal.image is not None and goal.image.depth is not None:
        measured = depth_at(goal.image.depth, uv)
        z = np.where(np.isfinite(measured), measured, z)
    z = np.where(z > 0, z, np.nan)
    p = ray * (z / ray[:, 2])[:, None]
    known = np.isfinite(p[:, 0])
    points = replace(goal, uv=uv, depth=p[:, 2], ray=ray, range=np.linalg.norm(p, axis=1))
    if np.count_nonzero(known) < 3:  # they span no plane
        return replace(points, counted=known if len(uv) else None)
    made = Goal.of_picture(goal.camera, uv[known], p[known], goal.T_camera_target)
    counted = None if known.all() else known
    return replace(points, middle=made.middle, normal=made.normal, counted=counted)


def points_of(goal: Goal) -> Array:
    """The goal's points (K, 3) in the target's frame [m], by their depths in its view."""
    return transform(inverse(goal.T_camera_target), goal.ray * goal.range[:, None])


# Search windows around tracked objects in the next picture.
Move = tuple[float, float]  # displacement (du, dv) of an object from one picture to the next [px]


def window_round(box: Window, move: Move, lens: Camera, margin: float) -> Window | None:
    """The window around an object's box, moved on at constant velocity, with `margin` [px] and half
    of the last move around it.

    It is clipped to the image; None outside of it.
    """
    left, top, right, bottom = box
    du, dv = move
    grow_u = margin + abs(du) / 2
    grow_v = margin + abs(dv) / 2
    left = max(0, int(left + du - grow_u))
    top = max(0, int(top + dv - grow_v))
    right = min(lens.width, math.ceil(right + du + grow_u))
    bottom = min(lens.height, math.ceil(bottom + dv + grow_v))
    return (left, top, right, bottom) if left < right and top < bottom else None


def windows_round(
    boxes: Sequence[Window | None],
    moves: Sequence[Move],
    camera: Camera,
    margin: float,
    panels: Sequence[int] | None = None,
) -> list[Window] | None:
    """A window around each object's predicted box, in its panel; None where an object is lost or a
    whole search is faster.

    Args:
        boxes: bounding boxes in the last picture [px]; None for a lost object. moves: displacements
            since the picture before [px].
        margin: around the predicted box [px].
        panels: index of the camera's panel in which each object is; None: of a camera with one
            panel, in others it is None.
    """
    if panels is None:
        if len(camera.panels) > 1:
            return None
        panels = [0] * len(boxes)
    out: list[Window] = []
    for box, move, panel in zip(boxes, moves, panels, strict=True):
        window = window_round(box, move, camera.panels[panel].lens, margin) if box else None
        if window is None:
            return None
        out.append(window)
    covered = sum((right - left) * (bottom - top) for left, top, right, bottom in out)
    size = sum(p.lens.width * p.lens.height for p in camera.panels)
    # Where windows cover more of the image together, a search of the whole is faster.
    return out if out and covered <= 0.3 * size else None
