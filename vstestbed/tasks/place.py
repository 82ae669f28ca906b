"""Docking at a place: a vehicle drives to a pose on the floor, by landmarks."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Literal

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.planar import GroundPose
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.robots.base import Base
from vstestbed.targets import Target
from vstestbed.tasks.base import TaskBase
from vstestbed.tasks.setup import Setup


@spec
class GoalPlace(TaskBase):
    """The goal as a place of a vehicle in the world, reached by landmarks.

    Args:
        pose: the place.
    """

    kind: Literal["pose"] = "pose"
    pose: GroundPose
    asks: ClassVar[str] = "pose"
    bases: ClassVar[frozenset[Base]] = frozenset({"planar"})
    needs_pose: ClassVar[bool] = True
    needs_still: ClassVar[bool] = True

    def check(self, setup: Setup) -> None:
        """The goal must be judged by the estimate, with a threshold beyond the distance at which the law rests."""
        super().check(setup)
        near, law = setup.stop.converged.position_m, setup.law
        if not setup.stop.converged.by_estimate:
            words = "must have position_m or rotation_deg for a goal of kind pose, where some of the target may be out of the picture"
            raise ParameterError("stop.converged", words)
        if near is not None and law.rest_m >= near:
            words = f"must be under stop.converged.position_m = {near:g} m: nearer than rest_m the vehicle stands for good"
            raise ParameterError("law.rest_m", words, law.rest_m)

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """Nothing: the goal is a place, and markers may be out of the picture there."""

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        """The target seen from the place, through the mount."""
        return (inverse(self.pose.T @ mount) @ target.pose.T,)

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        """The view with the place, which the law uses."""
        return tuple(replace(view, place=self.pose.place) for view in super().goal_views(setup))
