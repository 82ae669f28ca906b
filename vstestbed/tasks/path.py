"""Path following: a reference that moves along views by the clock, and stays at the last one."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, exp, inverse, pose_from, rotation_angle
from vstestbed.core.quantity import PositivePixels, PositiveRateDeg, PositiveSpeed, Time
from vstestbed.core.spec import spec
from vstestbed.features import ThetaU
from vstestbed.features.observation import Goal, Observation
from vstestbed.robots import Robot
from vstestbed.targets import Target
from vstestbed.tasks.base import GoalPicture, Log, Task, view_from
from vstestbed.tasks.continuing import Continuing, Settle, Tolerance
from vstestbed.tasks.frame import ImageError
from vstestbed.tasks.judged import JudgedError, by_convergence
from vstestbed.tasks.monitor import Setup
from vstestbed.tasks.stop import Converged, Stop
from vstestbed.tasks.view import VIEWS, GoalView, GoalViewFrom

_TURN = ThetaU()
# ratio of peak to mean speed of a minimum-jerk motion: s'(p) = 30 p^2 (1 - p)^2 at p = 1/2
JERK_PEAK = 15 / 8
DIFFERENCE_S = 1e-3  # step of the central difference for the reference's velocity [s]
LEAST_LEG_S = 0.5  # shortest duration of a leg [s]; two equal views would have a leg of none
LATE_S = 2.0
"""The error is taken from the part of the path that the reference passes within this time [s]: a
lag along the path is no error.
"""


class _Views(Task):
    """A task of several views, which stand in one of its fields. listed: the name of that field."""

    listed: ClassVar[str]

    @property
    def _each(self) -> tuple[GoalView | GoalViewFrom, ...]:
        return getattr(self, self.listed)

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        poses = list[Array]()
        for view in self._each:
            poses += view.goal_poses(target, mount)
        return tuple(poses)

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        goals = []
        for i, view in enumerate(self._each):
            goals += [replace(goal, view=i) for goal in view.goal_views(setup)]
        return tuple(goals)

    @property
    def view_fields(self) -> tuple[str, ...]:  # pyright: ignore[reportIncompatibleVariableOverride] - a property in place of a constant
        """Field of each view."""
        return tuple(
            view.view_fields[0].replace("goal.", f"goal.{self.listed}.{i}.")
            for i, view in enumerate(self._each)
        )

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        for i, view in enumerate(self._each):
            view.check_counted(setup, f"goal.{self.listed}.{i}.markers")
        super().check_views(setup, views)


@spec
class GoalPath(_Views, Continuing):  # pyright: ignore[reportIncompatibleVariableOverride] - see `view_fields`
    """Continuing task: fly along a path through given views, and stay at the last one.

    Between two views the reference camera moves along a straight line, rotating about a fixed axis,
    with minimum-jerk timing from rest to rest, s(p) = 10 p^3 - 15 p^4 + 6 p^5.

    Args:
        way: the views; the first is held for `settle_s`.
        speed_mps: peak speed of the reference along a leg [m/s].
        turn_degps: its peak angular rate [deg/s].
        lead_s: the reference's velocity is fed forward this much ahead, since a craft's velocity
            lags its setpoint [s].
        band_m: tolerance of the camera's distance from the path, from `settle_s` on, within 2 s of
            the reference [m].
        settle_s: time to reach the first view [s].

    Reference: Flash & Hogan 1985, doi:10.1523/JNEUROSCI.05-07-01688.1985 (minimum jerk).
    """

    kind: Literal["path"] = "path"
    way: Annotated[tuple[GoalView, ...], Len(2, 100)]
    speed_mps: PositiveSpeed = 0.5
    turn_degps: PositiveRateDeg = 20.0
    lead_s: Time = 0.5
    band_m: Tolerance = 0.15
    settle_s: Settle = 10.0
    asks = "path"
    bases = frozenset({"floating"})
    by_clock = True
    listed = "way"

    @cached_property
    def _ways(self) -> tuple[Array, ...]:
        """T_target_camera (4, 4) of each view."""
        return tuple(inverse(view.T_camera_target.T) for view in self.way)

    @cached_property
    def _until(self) -> Array:
        """When each view is reached, for the last time (n,) [s]."""
        times = []
        for a, b in pairwise(self._ways):
            length = np.linalg.norm(b[:3, 3] - a[:3, 3])
            angle = rotation_angle(a[:3, :3].T @ b[:3, :3])
            move_s = JERK_PEAK * length / self.speed_mps
            turn_s = JERK_PEAK * angle / np.radians(self.turn_degps)
            times.append(max(move_s, turn_s, LEAST_LEG_S))
        return np.asarray(self.settle_s + np.concatenate([[0.0], np.cumsum(times)]), dtype=float)

    @property
    def end_s(self) -> float:
        """When the last view is reached [s]."""
        return float(self._until[-1])

    def goal_pose_at(self, setup: Setup, poses: tuple[Array, ...], t: float, view: int) -> Array:
        return self.at(t)[0]

    def begin(self, setup: Setup, views: tuple[Goal, ...]) -> Setup:
        return setup

    def reference(self, state: Setup, seen: Observation) -> tuple[Setup, Goal]:
        T, view = self.at(seen.t)
        return state, replace(view_from(state, lambda _: T, view), twist=self.twist_at(seen.t))

    def error_m(self, setup: Setup, T_world_base: Array, T_world_target: Array, t: float) -> float:
        return self.off(inverse(T_world_target) @ T_world_base @ setup.camera.mount.T, t)

    def at(self, t: float) -> tuple[Array, int]:
        """T_camera_target (4, 4) at a time [s], and the number of the view at the end of the
        present leg.
        """
        leg = int(np.searchsorted(self._until, t, side="right")) - 1
        if leg < 0:
            return inverse(self._ways[0]), 0
        if leg >= len(self._ways) - 1:
            return inverse(self._ways[-1]), len(self._ways) - 1
        a = self._ways[leg]
        b = self._ways[leg + 1]
        share = _smooth((t - self._until[leg]) / (self._until[leg + 1] - self._until[leg]))
        return inverse(between(a, b, share)), leg + 1

    def twist_at(self, t: float) -> Array:
        """Velocity of the reference camera at t + lead_s,
        in its frame at time t (6,) [m/s, rad/s].
        """
        then = t + self.lead_s
        before = inverse(self.at(then - DIFFERENCE_S)[0])
        after = inverse(self.at(then + DIFFERENCE_S)[0])
        # Ahead in time, since the craft lags, but in the axes of the camera now, in which the law
        # commands.
        back = inverse(self.at(t)[0])[:3, :3].T
        v = (after[:3, 3] - before[:3, 3]) / (2 * DIFFERENCE_S)
        w = before[:3, :3] @ _TURN.measure(before[:3, :3].T @ after[:3, :3]) / (2 * DIFFERENCE_S)
        return np.concatenate([back @ v, back @ w])

    def off(self, T_target_camera: Array, t: float) -> float:
        """Distance [m] of a camera (4, 4) from the part of the path that the reference passes
        within LATE_S of a time [s].
        """
        until = self._until
        first, last = np.clip([t - LATE_S, t + LATE_S], until[0], until[-1])
        x = T_target_camera[:3, 3]
        nearest = np.inf
        for leg in range(len(until) - 1):
            began = until[leg]
            ended = until[leg + 1]
            if began > last or ended < first:
                continue
            # The part of this leg within the window, by travelled shares; a leg of pure rotation
            # has no length to divide by.
            a = self._ways[leg][:3, 3]
            along = self._ways[leg + 1][:3, 3] - a
            low = _smooth(np.clip((first - began) / (ended - began), 0, 1))
            high = _smooth(np.clip((last - began) / (ended - began), 0, 1))
            share = np.clip((x - a) @ along / max(along @ along, 1e-12), low, high)
            nearest = min(nearest, float(np.linalg.norm(x - a - share * along)))
        return nearest


def _smooth(p: float) -> float:
    """Minimum-jerk profile: the travelled share of a leg at the share p of its duration."""
    return p**3 * (10 - 15 * p + 6 * p * p)


def between(a: Array, b: Array, share: float) -> Array:
    """The pose (4, 4) at a share of the way from pose a to pose b: on a straight line, with a
    rotation about a fixed axis. Of a camera on its way from view to view: its poses
    T_target_camera. T_camera_target would bend the line while the camera turns.
    """
    T = np.eye(4)
    T[:3, 3] = (1 - share) * a[:3, 3] + share * b[:3, 3]
    turn = share * _TURN.measure(a[:3, :3].T @ b[:3, :3])
    T[:3, :3] = a[:3, :3] @ exp(np.concatenate([np.zeros(3), turn]))[:3, :3]
    return T


# Via points: several views in turn.
class Passage(NamedTuple):
    """State of the reference: the goal views in turn, the number of the current one, and since when
    the goal moves to it.

    moves: whether it is on its way there. left_s: when it left the view before [s]; NaN until the
    first frame after that.
    """

    setup: Setup
    views: tuple[Goal, ...]
    view: int = 0
    moves: bool = False
    left_s: float = math.nan


@spec
class GoalViews(_Views):
    """Via points: views in turn, each passed when its error falls under `threshold_px`; the last is
    the goal.

    Without `speed_mps` the goal jumps from view to view, and the command with it: the law begins
    anew. With it the goal moves, a camera's pose on a straight line at constant speed, and the law
    goes on: its command stays continuous. The law's own lag, speed / gain behind the goal, blends
    one leg into the next: its velocity is v2 + (v1 - v2) exp(-gain t) after the goal has turned
    from v1 to v2 = speed, so that at a corner of angle a the speed never falls under speed *
    cos(a/2), and a right angle is cut by half the lag. For that a view must count as passed at this
    lag at the latest: a smaller `threshold_px` lets the camera slow down first.

    Args:
        views: the views.
        threshold_px: RMS error under which a view that is not the last counts as passed, with all
            its markers in sight [px].
        speed_mps: speed of the goal on its way to the next view [m/s]; None: it jumps.
        turn_degps: largest angular rate of the goal on its way [deg/s]; where a leg turns by more,
            it is slower.

    Reference: Taylor 1979, doi:10.1147/rd.234.0424 (straight lines through via points, blended at
    the corners).
    """

    kind: Literal["views"] = "views"
    views: Annotated[tuple[Annotated[GoalView | GoalViewFrom, VIEWS], ...], Len(1, 100)]
    threshold_px: PositivePixels = 10.0
    speed_mps: PositiveSpeed | None = None
    turn_degps: PositiveRateDeg = 45.0
    listed = "views"

    def __post_init__(self) -> None:
        """Refuse a single view."""
        if len(self.views) < 2:
            words = (
                "must be a list of 2 or more views;"
                " one alone is the goal itself: goal: {view_from: ...} or {T_camera_target: ...}"
            )
            raise ParameterError("views", words)

    def _check_base(self, robot: Robot) -> None:
        if any(robot.base not in view.bases for view in self.views):
            what = f"{self.kind} with robot {robot.kind}"
            raise ParameterError.excluded(
                "goal", what, why="it is for a vehicle", works="T_camera_target"
            )

    def check(self, setup: Setup) -> None:
        super().check(setup)
        for view in self.views:
            view.check(setup)

    @property
    def pictures(self) -> tuple[GoalPicture, ...]:
        return tuple(view.picture for view in self.views)

    def begin(self, setup: Setup, views: tuple[Goal, ...]) -> Passage:
        return Passage(setup, views)

    def reference(self, state: Passage, seen: Observation) -> tuple[Passage, Goal]:
        """The current view; with `speed_mps`, where the goal is on its way there."""
        goal = state.views[state.view]
        if not state.moves:
            return state, goal
        if math.isnan(state.left_s):
            state = state._replace(left_s=seen.t)
        share = (seen.t - state.left_s) / self._leg_s(state)
        if share >= 1:
            return state._replace(moves=False), goal

        def pose_with(mount: Array) -> Array:
            return inverse(between(*self._leg(state, mount), share))

        on_the_way = view_from(state.setup, pose_with, state.view)
        return state, replace(on_the_way, counted=goal.counted, moves=True)

    def _leg(self, state: Passage, mount: Array) -> tuple[Array, Array]:
        """T_target_camera (4, 4) of the view before the current one, and of the current one."""
        poses = self.goal_poses(state.setup.target, mount)
        return inverse(poses[state.view - 1]), inverse(poses[state.view])

    def _leg_s(self, state: Passage) -> float:
        """Duration of the goal's way to the current view [s]."""
        assert self.speed_mps is not None  # else nothing moves
        a, b = self._leg(state, state.setup.believed_camera.mount.T)
        turn_s = rotation_angle(a[:3, :3].T @ b[:3, :3]) / math.radians(self.turn_degps)
        # Two equal views have a leg of no length.
        return max(float(np.linalg.norm(b[:3, 3] - a[:3, 3])) / self.speed_mps, float(turn_s), 1e-9)

    def passed(self, state: Passage, error: ImageError) -> tuple[Passage, Goal | None]:
        """The next view, when all markers that count are seen with a small error, and the goal
        stands.
        """
        near = error.all_seen and error.rms_px < self.threshold_px and not state.moves
        if not (near and state.view + 1 < len(self.views)):
            return state, None
        moves = self.speed_mps is not None
        state = state._replace(view=state.view + 1, moves=moves, left_s=math.nan)
        # Returned as a new goal, the view makes the loop initialise the law again: its state
        # belongs to the view that is passed.
        return state, None if state.moves else state.views[state.view]

    def judged(self, log: Log, stop: Stop) -> JudgedError:
        """The error at the last view; of a run that did not come so far, that at the view where it
        ended.
        """
        if len(log["view"]) and log["view"][-1] + 1 < len(self.views):
            return by_convergence(log, Converged(error_px=self.threshold_px))
        return super().judged(log, stop)

    def distance_to_go_m(self, log: Log, goal_poses: tuple[Array, ...]) -> float:
        # Not the log's position error, which is that of the current view: the first one, at the
        # start.
        position = np.array([log[f"tgt_{a}"][0] for a in "xyz"])
        turn = np.array([log[f"tgt_q{a}"][0] for a in "wxyz"])
        T_goal = pose_from(position, turn) @ inverse(goal_poses[-1])
        camera = np.array([log[f"cam_{a}"][0] for a in "xyz"])
        return float(np.linalg.norm(T_goal[:3, 3] - camera))
