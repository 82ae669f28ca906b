"""What a scenario wants: a view, several in turn, a place for a vehicle, a gap to keep, a line to follow, a view to keep."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Len

from vstestbed.geometry import Pose
from vstestbed.ground import GroundPose
from vstestbed.spec import OneOf, spec


@spec
class GoalView:
    """The goal as a view: the pose T_camera_target from which the target shall be seen.

    Args:
        T_camera_target: the pose.
        markers: numbers of the markers that count, from 0; None: all. The others need not be in the picture there: nearby an
            inner set, far away an outer one.
    """

    kind: Literal["view"] = "view"
    T_camera_target: Pose
    markers: Annotated[tuple[Annotated[int, Ge(0)], ...], Len(1, 24)] | None = None


@spec
class GoalViewFrom:
    """The goal as a view: what a vehicle's camera sees of the target from the place `view_from` on the floor."""

    kind: Literal["view_from"] = "view_from"
    view_from: GroundPose


VIEWS = OneOf("view", GoalView, GoalViewFrom, fields={"T_camera_target": "view", "view_from": "view_from"})
View = Annotated[GoalView | GoalViewFrom, VIEWS]


@spec
class GoalViews:
    """Views in turn (via points): each is left for the next when its error falls under `threshold_px`; the last is the goal.

    Args:
        views: the views.
        threshold_px: RMS error of the markers seen under which a view that is not the last counts as passed [px].
    """

    kind: Literal["views"] = "views"
    views: Annotated[tuple[View, ...], Len(2, 100)]
    threshold_px: Annotated[float, Gt(0)] = 10.0


@spec
class GoalPlace:
    """The goal as a place for a vehicle: `pose` is where it shall stand in the world, by its landmarks."""

    kind: Literal["pose"] = "pose"
    pose: GroundPose


Band = Annotated[float, Gt(0)]
Settle = Annotated[float, Ge(0)]


@spec
class GoalGap:
    """A task without an end: keep a distance, on the floor, from the vehicle's origin to the target's.

    Args:
        gap_m: the distance [m].
        band_m: how far off it may be once settled; a tenth of it by default [m].
        settle_s: how long it may take to settle [s].
    """

    kind: Literal["gap"] = "gap"
    gap_m: Annotated[float, Gt(0)]
    band_m: Band | None = None
    settle_s: Settle = 8.0

    @property
    def band(self) -> float:
        """[m]."""
        return self.band_m or 0.1 * self.gap_m


@spec
class GoalLine:
    """A task without an end: keep the vehicle's origin over the line on the floor that the target is.

    Args:
        offset_m: how far to the left of the line to drive [m].
        band_m: how far off it may be once settled [m].
        settle_s: how long it may take to settle [s].
    """

    kind: Literal["line"] = "line"
    offset_m: float = 0.0
    band_m: Band = 0.05
    settle_s: Settle = 5.0

    @property
    def band(self) -> float:
        """[m]."""
        return self.band_m


@spec
class GoalTrack:
    """A task without an end: keep the view of a target that moves.

    Args:
        T_camera_target: the pose from which the target shall be seen at all times.
        band_m: how far the camera may be from there once settled [m].
        settle_s: how long it may take to settle [s].
    """

    kind: Literal["track"] = "track"
    T_camera_target: Pose
    band_m: Band = 0.05
    settle_s: Settle = 5.0

    @property
    def band(self) -> float:
        """[m]."""
        return self.band_m


FIELDS = {"T_camera_target": "view", "view_from": "view_from", "views": "views", "pose": "pose", "gap_m": "gap"}
GOALS = OneOf("goal", GoalView, GoalViewFrom, GoalViews, GoalPlace, GoalGap, GoalLine, GoalTrack, fields=FIELDS)
AnyGoal = Annotated[GoalView | GoalViewFrom | GoalViews | GoalPlace | GoalGap | GoalLine | GoalTrack, GOALS]
KEPT = GoalGap, GoalLine, GoalTrack
"""Tasks without an end."""
