"""Via points: several views in turn."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse, pose_from, rotation_angle
from vstestbed.core.quantity import PositivePixels, PositiveRateDeg, PositiveSpeed
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal, Observation
from vstestbed.robots import Robot
from vstestbed.targets import Target
from vstestbed.tasks.base import Log, TaskBase, view_from
from vstestbed.tasks.frame import ImageError
from vstestbed.tasks.goal_picture import GoalPicture
from vstestbed.tasks.judged import JudgedError, by_convergence
from vstestbed.tasks.path import between
from vstestbed.tasks.setup import Setup
from vstestbed.tasks.stop import Converged, Stop
from vstestbed.tasks.view import VIEWS, GoalView, GoalViewFrom


class Passage(NamedTuple):
    """State of the reference: the goal views in turn, the number of the current one, and since when the goal moves to it.

    moves: whether it is on its way there. left_s: when it left the view before [s]; NaN until the first frame after that.
    """

    setup: Setup
    views: tuple[Goal, ...]
    view: int = 0
    moves: bool = False
    left_s: float = math.nan


@spec
class GoalViews(TaskBase):
    """Via points: views in turn, each passed when its error falls under `threshold_px`; the last is the goal.

    Without `speed_mps` the goal jumps from view to view, and the command with it: the law begins anew. With it the goal moves,
    a camera's pose on a straight line at constant speed, and the law goes on: its command stays continuous. The law's own lag,
    speed / gain behind the goal, blends one leg into the next: its velocity is v2 + (v1 - v2) exp(-gain t) after the goal has turned
    from v1 to v2 = speed, so that at a corner of angle a the speed never falls under speed * cos(a/2), and a right angle is cut by half
    the lag. For that a view must count as passed at this lag at the latest: a smaller `threshold_px` lets the camera slow down first.

    Args:
        views: the views.
        threshold_px: RMS error under which a view that is not the last counts as passed, with all its markers in sight [px].
        speed_mps: speed of the goal on its way to the next view [m/s]; None: it jumps.
        turn_degps: largest angular rate of the goal on its way [deg/s]; where a leg turns by more, it is slower.

    Reference: Taylor 1979, doi:10.1147/rd.234.0424 (straight lines through via points, blended at the corners).
    """

    kind: Literal["views"] = "views"
    views: Annotated[tuple[Annotated[GoalView | GoalViewFrom, VIEWS], ...], Len(1, 100)]
    threshold_px: PositivePixels = 10.0
    speed_mps: PositiveSpeed | None = None
    turn_degps: PositiveRateDeg = 45.0

    def __post_init__(self) -> None:
        """Refuse a single view."""
        if len(self.views) < 2:
            words = "must be a list of 2 or more views; one alone is the goal itself: goal: {view_from: ...} or {T_camera_target: ...}"
            raise ParameterError("views", words)

    def _check_base(self, robot: Robot) -> None:
        if any(robot.base not in view.bases for view in self.views):
            raise ParameterError("goal", f"of kind {self.kind} is for a vehicle; robot {robot.kind} takes T_camera_target")

    def check(self, setup: Setup) -> None:
        """Also the checks of each view."""
        super().check(setup)
        for view in self.views:
            view.check(setup)

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        """Those of each view."""
        return tuple(pose for view in self.views for pose in view.goal_poses(target, mount))

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        """Each view, with its number."""
        return tuple(replace(goal, view=i) for i, view in enumerate(self.views) for goal in view.goal_views(setup))

    @property
    def pictures(self) -> tuple[GoalPicture, ...]:
        """Of each view."""
        return tuple(picture for view in self.views for picture in view.pictures)

    @property
    def view_fields(self) -> tuple[str, ...]:
        """Field of each view."""
        return tuple(view.view_fields[0].replace("goal.", f"goal.views.{i}.") for i, view in enumerate(self.views))

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """Each view, with its own markers."""
        for i, view in enumerate(self.views):
            view.check_counted(setup, f"goal.views.{i}.markers")
        super().check_views(setup, views)

    def begin(self, setup: Setup, views: tuple[Goal, ...]) -> Passage:
        """At the first view."""
        return Passage(setup, views)

    def reference(self, memory: Passage, seen: Observation) -> tuple[Passage, Goal]:
        """The current view; with `speed_mps`, where the goal is on its way there."""
        goal = memory.views[memory.view]
        if not memory.moves:
            return memory, goal
        if math.isnan(memory.left_s):
            memory = memory._replace(left_s=seen.t)
        share = (seen.t - memory.left_s) / self._leg_s(memory)
        if share >= 1:
            return memory._replace(moves=False), goal
        on_the_way = view_from(memory.setup, lambda mount: inverse(between(*self._leg(memory, mount), share)), memory.view)
        return memory, replace(on_the_way, counted=goal.counted, moves=True)

    def _leg(self, memory: Passage, mount: Array) -> tuple[Array, Array]:
        """T_target_camera (4, 4) of the view before the current one, and of the current one."""
        a, b = self.goal_poses(memory.setup.target, mount)[memory.view - 1 : memory.view + 1]
        return inverse(a), inverse(b)

    def _leg_s(self, memory: Passage) -> float:
        """Duration of the goal's way to the current view [s]."""
        assert self.speed_mps is not None  # else nothing moves
        a, b = self._leg(memory, memory.setup.believed_camera.mount.T)
        turn_s = rotation_angle(a[:3, :3].T @ b[:3, :3]) / math.radians(self.turn_degps)
        # Two equal views have a leg of no length.
        return max(float(np.linalg.norm(b[:3, 3] - a[:3, 3])) / self.speed_mps, float(turn_s), 1e-9)

    def passed(self, memory: Passage, error: ImageError) -> tuple[Passage, Goal | None]:
        """The next view, when all markers that count are seen with a small error, and the goal stands."""
        near = error.all_seen and error.rms_px < self.threshold_px and not memory.moves
        if not (near and memory.view + 1 < len(self.views)):
            return memory, None
        memory = memory._replace(view=memory.view + 1, moves=self.speed_mps is not None, left_s=math.nan)
        # Returned as a new goal, the view makes the loop initialise the law again: its memory belongs to the view that is passed.
        return memory, None if memory.moves else memory.views[memory.view]

    def judged(self, log: Log, stop: Stop) -> JudgedError:
        """The error at the last view; of a run that did not come so far, that at the view where it ended."""
        if len(log["view"]) and log["view"][-1] + 1 < len(self.views):
            return by_convergence(log, Converged(error_px=self.threshold_px))
        return super().judged(log, stop)

    def distance_to_go_m(self, log: Log, goal_poses: tuple[Array, ...]) -> float:
        """To the last view."""
        # Not the log's position error, which is that of the current view: the first one, at the start.
        target = np.array([log[f"tgt_{a}"][0] for a in "xyz"]), np.array([log[f"tgt_q{a}"][0] for a in "wxyz"])
        T_goal = pose_from(*target) @ inverse(goal_poses[-1])
        return float(np.linalg.norm(T_goal[:3, 3] - np.array([log[f"cam_{a}"][0] for a in "xyz"])))
