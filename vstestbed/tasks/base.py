"""The contract of a task: checks, goal views, reference generation, monitor and metrics.

A goal block of a scenario is a `Task`: parameters and behaviour in one frozen object. No code outside this folder tests its kind.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Law
from vstestbed.robots import Robot
from vstestbed.robots.base import Base
from vstestbed.robots.supervisor import Supervisor
from vstestbed.targets import Target
from vstestbed.tasks.frame import ImageError
from vstestbed.tasks.goal_picture import GoalPicture
from vstestbed.tasks.judged import JudgedError, by_convergence
from vstestbed.tasks.monitor import TaskMonitor
from vstestbed.tasks.reached import GoalMonitor
from vstestbed.tasks.setup import Setup
from vstestbed.tasks.stop import Stop
from vstestbed.tasks.visible import check_level, check_visible
from vstestbed.vision.pose.calibration_error import pose_by_depth, shown_goal

Log = Mapping[str, Array]
"""The columns of a log by name, shape (frames,) each."""


class Reference(NamedTuple):
    """State of the reference: the goal views in turn, and the number of the current one."""

    views: tuple[Goal, ...]
    view: int = 0


class Task(Protocol):
    """The task of a scenario, its `goal` block. `TaskBase` has defaults for all but `kind` and `goal_poses`."""

    asks: ClassVar[str]
    """The word by which a law declares that it supports such tasks (`Law.tasks`)."""
    bases: ClassVar[frozenset[Base]]
    """The bases of robots that can execute it."""
    continuing: ClassVar[bool]
    """Whether it has no goal to reach, but an error to keep within a tolerance for the whole duration."""
    lands: ClassVar[bool]
    """Whether it ends on the ground."""
    by_clock: ClassVar[bool]
    """Whether the reference moves with time, so that `goal_poses` are points on a trajectory."""
    needs_pose: ClassVar[bool]
    """Whether the law needs the target's pose itself, so that its depth source must be one that estimates it."""

    @property
    def kind(self) -> str:
        """The word in a scenario."""
        ...

    @property
    def tolerance_m(self) -> float | None:
        """Of a continuing task, the largest permitted error once settled [m]; None for others."""
        ...

    @property
    def settle_s(self) -> float:
        """Settling time, after which the tolerance counts [s]."""
        ...

    def check(self, setup: Setup) -> None:
        """Refuse unsuitable robots, laws and targets. ParameterError names the field and what would work."""
        ...

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """Refuse goal views that cannot be seen. ParameterError names the field and what would work."""
        ...

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        """T_camera_target (4, 4) at each goal view in turn, for a camera at this mount T_base_camera (4, 4)."""
        ...

    def goal_pose_at(self, setup: Setup, poses: tuple[Array, ...], t: float, view: int) -> Array | None:
        """T_camera_target (4, 4) at the goal of a time [s] and a view, of `poses`, the `goal_poses`; None where no single pose is it."""
        ...

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        """The goals for the law: one view, or several in turn."""
        ...

    @property
    def pictures(self) -> tuple[GoalPicture, ...]:
        """What is said of the picture at each goal view; () where nothing can be."""
        ...

    def begin(self, setup: Setup, views: tuple[Goal, ...]) -> Any:
        """The initial state of the reference."""
        ...

    def reference(self, memory: Any, seen: Observation) -> tuple[Any, Goal]:
        """The next state, and the goal for the law at this frame."""
        ...

    def passed(self, memory: Any, error: ImageError) -> tuple[Any, Goal | None]:
        """After a frame: the next state, and the new goal for which the law must be initialised again, if there is one."""
        ...

    def monitor(self, setup: Setup, supervisor: Supervisor) -> TaskMonitor:
        """The monitor, which measures the task's error and decides when it is completed or failed."""
        ...

    def metrics(self, log: Log) -> dict[str, float | None]:
        """Summary figures of this task alone."""
        ...

    def judged(self, log: Log, stop: Stop) -> JudgedError:
        """The error by which the task was judged, from the log of a run."""
        ...

    def distance_to_go_m(self, log: Log, goal_poses: tuple[Array, ...]) -> float:
        """Straight distance from the start of a run to its goal [m]."""
        ...


class TaskBase:
    """Defaults: one view, for robots on any base, reached when the error is small."""

    asks: ClassVar[str] = "view"
    bases: ClassVar[frozenset[Base]] = frozenset({"fixed", "planar", "floating"})
    continuing: ClassVar[bool] = False
    lands: ClassVar[bool] = False
    by_clock: ClassVar[bool] = False
    needs_pose: ClassVar[bool] = False
    needs_still: ClassVar[bool] = False
    """Whether the target must stand still."""

    kind: Any  # the word in a scenario: a field of each task
    settle_s: Any = 0.0

    @property
    def tolerance_m(self) -> float | None:
        """None: the task has a goal to reach."""
        return None

    if TYPE_CHECKING:  # each task has its own; not at run time, where the contract misses it

        def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:  # noqa: D102 - the protocol says it
            ...

    def check(self, setup: Setup) -> None:
        """The law supports the task, the robot's base can execute it, and the target has markers."""
        self._check_law(setup.law)
        self._check_base(setup.robot)
        if setup.target.painted_route is not None:
            words = "needs markers, and lines on the floor have none; use goal: {kind: line} and law: {kind: line_following}"
            raise ParameterError("goal", f"of kind {self.kind} {words}")
        if self.needs_still and setup.target.moves:
            words = "needs a target that stands still; for one that moves use goal: {gap_m: ...} or {T_camera_target: ...}"
            raise ParameterError("goal", f"of kind {self.kind} {words}")

    def _check_law(self, law: Law[Any]) -> None:
        if self.asks not in law.tasks:
            words = f"may not be of kind {self.kind} with law {law.kind}, which takes {' or '.join(law.tasks)}"
            raise ParameterError("goal", words)
        if self.needs_pose and not law.depth.needs_pose:
            words = f"may not be {law.depth.kind} with law {law.kind}, which needs the pose itself; use floor or pnp"
            raise ParameterError("law.depth", words)

    def _check_base(self, robot: Robot) -> None:
        if robot.base in self.bases:
            return
        if self.bases == {"floating"}:
            raise ParameterError("goal", f"of kind {self.kind} is for a craft that flies (robot quadrotor)")
        raise ParameterError("goal", f"of kind {self.kind} is for a vehicle; robot {robot.kind} takes T_camera_target")

    @property
    def pictures(self) -> tuple[GoalPicture, ...]:
        """None: the simulated camera takes them."""
        return ()

    @property
    def view_fields(self) -> tuple[str, ...]:
        """The scenario's field of each goal view, for error messages; `goal` where there is none."""
        return ()

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """Every goal view must show its markers, and a flying robot must be level there."""
        poses = self.goal_poses(setup.target, setup.camera.mount.T)
        fields = self.view_fields or ("goal",) * len(poses)
        for field, pose, view in zip(fields, poses, views, strict=True):
            check_visible(setup, field, pose, view.counted)
            check_level(setup.robot, setup.camera, setup.target, pose, field)

    def goal_pose_at(self, setup: Setup, poses: tuple[Array, ...], t: float, view: int) -> Array | None:
        """The pose of the view."""
        return poses[view] if np.isfinite(poses[view]).all() else None

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        """The views from the goal poses."""
        n = len(self.goal_poses(setup.target, setup.camera.mount.T))
        # i=i binds the number now: a plain closure would give every view the last pose.
        return tuple(view_from(setup, lambda mount, i=i: self.goal_poses(setup.target, mount)[i], i) for i in range(n))

    def begin(self, setup: Setup, views: tuple[Goal, ...]) -> Any:
        """At the first view."""
        return Reference(views)

    def reference(self, memory: Any, seen: Observation) -> tuple[Any, Goal]:
        """The current view."""
        return memory, memory.views[memory.view]

    def passed(self, memory: Any, error: ImageError) -> tuple[Any, Goal | None]:
        """The same view."""
        return memory, None

    def monitor(self, setup: Setup, supervisor: Supervisor) -> TaskMonitor:
        """Reached when `stop.converged` holds."""
        return GoalMonitor(setup, len(self.goal_poses(setup.target, setup.camera.mount.T)), supervisor)

    def metrics(self, log: Log) -> dict[str, float | None]:
        """None."""
        return {}

    def judged(self, log: Log, stop: Stop) -> JudgedError:
        """The error that `stop.converged` tests."""
        return by_convergence(log, stop.converged)

    def distance_to_go_m(self, log: Log, goal_poses: tuple[Array, ...]) -> float:
        """The first frame's position error."""
        return float(log["position_error_m"][0])


def view_from(setup: Setup, pose_with: Callable[[Array], Array], number: int = 0) -> Goal:
    """The goal for the law: the view from a goal pose.

    Args:
        setup: the experiment's parts.
        pose_with: maps a mount T_base_camera (4, 4) to T_camera_target (4, 4) at the goal. Where the goal is a place of the base, a
            wrong calibration of the mount displaces the believed goal view.
        number: of the view, among several in turn.
    """
    target, points, scale = setup.target, setup.target.points, setup.depth_scale
    if setup.goal_shown:
        made = shown_goal(setup.camera, setup.believed_camera, target, pose_with(setup.camera.mount.T))
    else:
        T = pose_with(setup.believed_camera.mount.T)
        made = Goal.of_points(setup.believed_camera, target.points_at(T), T)
    if scale is not None:
        # A shown goal is known by its picture alone, so that its pose is estimated with the wrong depths, too.
        pose = pose_by_depth(made.T_camera_target, points, scale) if setup.goal_shown else made.T_camera_target
        made = replace(made.deepened(scale), T_camera_target=pose)
    return replace(made, view=number) if number else made
