"""Views as goals: a pose from which the target is seen, a place on the floor, the view of a moving
target.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Len, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, inverse, rigid_error
from vstestbed.core.planar import GroundPose
from vstestbed.core.registry import Registry
from vstestbed.core.spec import Shorthand, spec
from vstestbed.features.observation import Goal
from vstestbed.robots import Mount
from vstestbed.targets import Name, Target
from vstestbed.tasks.base import GoalPicture, Task
from vstestbed.tasks.continuing import Continuing, Settle, Tolerance
from vstestbed.tasks.monitor import Setup


@spec
class GoalView(Task):
    """The goal as a view: the pose T_camera_target from which the target is to be seen.

    Args:
        T_camera_target: the pose.
        markers: numbers of the markers that count, from 0, or their names; None: all. The others
            may be out of the picture: near the target an inner set can count, far away an outer
            one.
        picture: the picture taken there, for a law or a detector that compares with it: a file's
            name, or a block.
    """

    kind: Literal["view"] = "view"
    T_camera_target: Pose
    markers: Annotated[tuple[Annotated[int, Ge(0), Lt(24)] | Name, ...], Len(1, 24)] | None = None
    picture: Annotated[GoalPicture, Shorthand("file")] = GoalPicture()
    view_fields = ("goal.T_camera_target",)

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        return (self.T_camera_target.T,)

    @property
    def pictures(self) -> tuple[GoalPicture, ...]:
        return (self.picture,)

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        views = super().goal_views(setup)
        if self.markers is None:
            return views
        numbers = [setup.target.number(marker) for marker in self.markers]
        counted = np.isin(np.arange(len(setup.target.points)), numbers)
        return tuple(replace(view, counted=counted) for view in views)

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        self.check_counted(setup, "goal.markers")
        super().check_views(setup, views)

    def check_counted(self, setup: Setup, field: str) -> None:
        """Refuse numbers of markers that do not exist, and fewer markers than the law needs."""
        if self.markers is None:
            return
        if setup.target.outlined:
            raise ParameterError.fixed(
                field, "left out", list(self.markers), why="the points of an outline count together"
            )
        robot = setup.robot
        n = len(setup.target.points)
        basis = robot.motion_basis(Mount.of(setup.camera.mount.T), robot.start_joints())
        needed = setup.law.markers_needed(basis)
        numbers = [setup.target.number(marker) for marker in self.markers]
        if not 0 <= min(numbers) <= max(numbers) < n:
            names = setup.target.names
            words = (
                "must be numbers of markers,"
                f" 0 to {n - 1}{', or names: ' * bool(names)}{', '.join(names)}"
            )
            raise ParameterError(field, words, list(self.markers))
        if len(set(numbers)) < needed:
            raise ParameterError.count(
                field, f"{needed} or more", f"markers for law {setup.law.kind}", list(self.markers)
            )


@spec
class GoalViewFrom(Task):
    """The goal as a view: what a vehicle's camera sees of the target from a place on the floor.

    Args:
        view_from: the place of the vehicle.
        picture: the picture taken there, for a law or a detector that compares with it: a file's
            name, or a block.
    """

    kind: Literal["view_from"] = "view_from"
    view_from: GroundPose
    picture: Annotated[GoalPicture, Shorthand("file")] = GoalPicture()
    view_fields = ("goal.view_from",)
    bases = frozenset({"planar"})
    needs_still = True

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        return (inverse(self.view_from.T @ mount) @ target.pose.T,)

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        return tuple(
            replace(view, place=self.view_from.place) for view in super().goal_views(setup)
        )

    @property
    def pictures(self) -> tuple[GoalPicture, ...]:
        return (self.picture,)

    def check_counted(self, setup: Setup, field: str) -> None:
        """Nothing: all markers count."""


VIEWS = Registry(
    "view", GoalView, GoalViewFrom, fields={"T_camera_target": "view", "view_from": "view_from"}
)


# Docking at a place: a vehicle drives to a pose on the floor, by landmarks.
@spec
class GoalPlace(Task):
    """The goal as a place of a vehicle in the world, reached by landmarks.

    Args:
        pose: the place.
    """

    kind: Literal["pose"] = "pose"
    pose: GroundPose
    asks = "pose"
    bases = frozenset({"planar"})
    needs_pose = True
    needs_still = True

    def check(self, setup: Setup) -> None:
        """The goal must be judged by the estimate, with a threshold beyond the distance at which
        the law rests.
        """
        super().check(setup)
        near = setup.stop.converged.position_m
        law = setup.law
        if not setup.stop.converged.by_estimate:
            words = (
                "must have position_m or rotation_deg for a goal of kind pose,"
                " where some of the target may be out of the picture"
            )
            raise ParameterError("stop.converged", words)
        if near is not None and law.rest_m >= near:
            limit = f"stop.converged.position_m = {near:g} m"
            why = "nearer than rest_m the vehicle stands for good"
            raise ParameterError.bound("law.rest_m", "under", limit, law.rest_m, why=why)

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """Nothing: the goal is a place, and markers may be out of the picture there."""

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        return (inverse(self.pose.T @ mount) @ target.pose.T,)

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        return tuple(replace(view, place=self.pose.place) for view in super().goal_views(setup))


# Tracking: keep a view of a moving target.
@spec
class GoalTrack(Continuing):
    """Continuing task: keep a view of a moving target.

    Args:
        T_camera_target: the pose from which the target is to be seen at all times.
        band_m: tolerance of the camera's distance from that pose once settled [m].
        settle_s: settling time [s].
    """

    kind: Literal["track"] = "track"
    T_camera_target: Pose
    band_m: Tolerance = 0.05
    settle_s: Settle = 5.0
    view_fields = ("goal.T_camera_target",)

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        return (self.T_camera_target.T,)

    def error_m(self, setup: Setup, T_world_base: Array, T_world_target: Array, t: float) -> float:
        T_camera = T_world_base @ setup.camera.mount.T
        return rigid_error(T_camera, T_world_target @ inverse(self.T_camera_target.T))[0]
