"""Via points: several views in turn."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse, pose_from
from vstestbed.core.quantity import PositivePixels
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.robots import Robot
from vstestbed.targets import Target
from vstestbed.tasks.base import Log, Reference, TaskBase
from vstestbed.tasks.frame import ImageError
from vstestbed.tasks.judged import JudgedError, by_convergence
from vstestbed.tasks.setup import Setup
from vstestbed.tasks.stop import Converged, Stop
from vstestbed.tasks.view import VIEWS, GoalView, GoalViewFrom


@spec
class GoalViews(TaskBase):
    """Via points: views in turn, each passed when its error falls under `threshold_px`; the last is the goal.

    Args:
        views: the views.
        threshold_px: RMS error under which a view that is not the last counts as passed, with all its markers in sight [px].
    """

    kind: Literal["views"] = "views"
    views: Annotated[tuple[Annotated[GoalView | GoalViewFrom, VIEWS], ...], Len(1, 100)]
    threshold_px: PositivePixels = 10.0

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
    def view_fields(self) -> tuple[str, ...]:
        """Field of each view."""
        return tuple(view.view_fields[0].replace("goal.", f"goal.views.{i}.") for i, view in enumerate(self.views))

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """Each view, with its own markers."""
        for i, view in enumerate(self.views):
            view.check_counted(setup, f"goal.views.{i}.markers")
        super().check_views(setup, views)

    def passed(self, memory: Reference, error: ImageError) -> tuple[Reference, Goal | None]:
        """The next view, when all markers that count are seen with a small error."""
        if not (error.all_seen and error.rms_px < self.threshold_px and memory.view + 1 < len(self.views)):
            return memory, None
        # Returned as a new goal, the view makes the loop initialise the law again: its memory belongs to the view that is passed.
        memory = memory._replace(view=memory.view + 1)
        return memory, memory.views[memory.view]

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
