"""What a scenario wants: a view, several in turn, one to keep; a place for a vehicle, a gap, a line or a path to keep to, a pad."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Ge, Gt, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.planar import GroundPose
from vstestbed.core.spec import OneOf, spec


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
        threshold_px: RMS error under which a view that is not the last counts as passed, all markers that count in sight [px].
    """

    kind: Literal["views"] = "views"
    views: Annotated[tuple[View, ...], Len(1, 100)]
    threshold_px: Annotated[float, Gt(0)] = 10.0

    def __post_init__(self) -> None:
        """Refuse a single view."""
        if len(self.views) < 2:
            words = "must be a list of 2 or more views; one alone is the goal itself: goal: {view_from: ...} or {T_camera_target: ...}"
            raise ParameterError("views", words)


@spec
class GoalPlace:
    """The goal as a place for a vehicle: `pose` is where it shall stand in the world, by its landmarks."""

    kind: Literal["pose"] = "pose"
    pose: GroundPose


Band = Annotated[float, Gt(0)]
Settle = Annotated[float, Ge(0)]


class _Band:
    """What tasks without an end have: a band in which the true error stays once settled."""

    band_m: float

    @property
    def band(self) -> float:
        """Half its width [m]."""
        return self.band_m


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
class GoalLine(_Band):
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


@spec
class GoalPath(_Band):
    """A task without an end: fly along a path, given by views on it, and keep at its last one.

    The view that is wanted moves from each of the given ones to the next, its camera along a straight line and turning evenly,
    with the smoothest timing from rest to rest (minimum jerk), s(p) = 10 p^3 - 15 p^4 + 6 p^5.

    Args:
        way: the views; the first is wanted for `settle_s`.
        speed_mps: greatest speed of the wanted view along a leg [m/s].
        turn_degps: greatest rate at which it turns [deg/s].
        lead_s: the wanted view's velocity is ordered this much ahead, since a craft's velocity lags its order [s].
        band_m: how far off the path the camera may be from `settle_s` on [m]: off the part where the wanted view is within 2 s of then.
        settle_s: how long it may take to the first view [s].

    Reference: Flash & Hogan 1985, doi:10.1523/JNEUROSCI.05-07-01688.1985 (minimum jerk).
    """

    kind: Literal["path"] = "path"
    way: Annotated[tuple[GoalView, ...], Len(2, 100)]
    speed_mps: Annotated[float, Gt(0)] = 0.5
    turn_degps: Annotated[float, Gt(0)] = 20.0
    lead_s: Annotated[float, Ge(0)] = 0.5
    band_m: Band = 0.15
    settle_s: Settle = 10.0


@spec
class GoalTrack(_Band):
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


@spec
class GoalLanding:
    """Land on the target's pad, its origin: from the view `above` it the wanted view comes down as long as the craft is over it.

    Args:
        above: T_camera_target of the view from which it comes down; it shrinks along its translation.
        descend_mps: how fast it comes down [m/s].
        within_m, within_deg: while the camera is by its own estimate farther off the wanted place, sideways, or turned by more,
            the view waits [m, deg].
        commit_m: nearer than this to the pad it waits no more [m].
        pad_m, touch_mps: how far from the pad's centre, and with what speed against it, a touch-down is a landing [m, m/s].
    """

    kind: Literal["landing"] = "landing"
    above: Pose
    descend_mps: Annotated[float, Gt(0)] = 0.3
    within_m: Annotated[float, Gt(0)] = 0.15
    within_deg: Annotated[float, Gt(0)] = 15.0
    commit_m: Annotated[float, Gt(0)] = 0.4
    pad_m: Annotated[float, Gt(0)] = 0.2
    touch_mps: Annotated[float, Gt(0)] = 0.5


FIELDS = {
    "T_camera_target": "view",
    "view_from": "view_from",
    "views": "views",
    "pose": "pose",
    "gap_m": "gap",
    "offset_m": "line",
    "way": "path",
    "above": "landing",
}
GOALS = OneOf("goal", GoalView, GoalViewFrom, GoalViews, GoalPlace, GoalGap, GoalLine, GoalPath, GoalLanding, GoalTrack, fields=FIELDS)
OnGround = GoalViewFrom | GoalPlace | GoalGap | GoalLine
AnyGoal = Annotated[GoalView | GoalViews | OnGround | GoalPath | GoalLanding | GoalTrack, GOALS]
KEPT = GoalGap, GoalLine, GoalPath, GoalTrack
"""Tasks without an end."""
