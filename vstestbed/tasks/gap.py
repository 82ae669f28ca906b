"""Car following: keep a distance to the vehicle ahead."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.planar import pose_on_ground
from vstestbed.core.quantity import PositiveLength
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.robots import VEHICLES, Robot
from vstestbed.robots.base import Base
from vstestbed.targets import Target
from vstestbed.tasks.continuing import Continuing, Settle, Tolerance
from vstestbed.tasks.setup import Setup
from vstestbed.tasks.speed_monitor import FOLLOWS, STEADY, MinSpeed
from vstestbed.vision.pose.floor_pose import LEVEL

ONE_PLACE_M = 1e-6
"""Points within this of one another in the floor plan are at one place [m]."""


@spec
class GoalGap(Continuing):
    """Continuing task: keep a distance, on the floor, from the vehicle's origin to the target's.

    Behind a vehicle that drives, both vehicles must keep a minimum speed. Behind a target that stands by scenario (`motion: still`)
    the vehicle waits at the distance.

    Args:
        gap_m: the distance [m].
        band_m: tolerance of the distance once settled; a tenth of it by default [m]; e.g. `0.1`.
        settle_s: settling time [s].
    """

    kind: Literal["gap"] = "gap"
    gap_m: PositiveLength
    band_m: Tolerance | None = None
    settle_s: Settle = 8.0
    asks: ClassVar[str] = "gap"
    bases: ClassVar[frozenset[Base]] = frozenset({"planar"})
    needs_pose: ClassVar[bool] = True

    @property
    def tolerance_m(self) -> float:
        """`band_m`, or a tenth of the gap [m]."""
        return self.band_m or 0.1 * self.gap_m

    def check(self, setup: Setup) -> None:
        """The vehicles must not touch at the gap, and the target's origin must be observable."""
        super().check(setup)
        self._check_room(setup.robot, setup.target)
        if setup.law.depth.on_floor:
            self._check_known(setup.camera, setup.target)

    def _check_room(self, robot: Robot, target: Target) -> None:
        """The vehicle's front must stay clear of the rear of the vehicle ahead."""
        if target.carrier is None:
            return
        rear, front = VEHICLES[target.carrier.by]().ends_m[0], robot.ends_m[1]
        least = target.pose.xyz[0] - rear + front
        if self.gap_m <= least:
            words = f"must be over {least:.4g} m: there the front of robot {robot.kind}, {front:g} m before its origin, touches the"
            raise ParameterError("goal.gap_m", f"{words} {target.carrier.by} that carries the target", self.gap_m)

    def _check_known(self, camera: Camera, target: Target) -> None:
        """Points above one another do not determine the target's heading: they must lie over the origin to which the gap is measured."""
        p: Array = target.points @ target.pose.T[:3, :3].T  # from the target's origin, in the axes of what carries it
        if np.ptp(p[:, :2], axis=0).max() > ONE_PLACE_M:
            return
        # One place gives one direction and, by the known height, one distance: enough for a point, not for the carrier's heading.
        if np.abs(p[0, :2]).max() > ONE_PLACE_M:
            words = (
                "has its points at one place of the floor plan, which does not tell its heading, so that its origin, to which the gap is"
            )
            remedy = "measured, stays unknown; use x = y = 0 there and put the place into target.pose, or add a point beside it"
            raise ParameterError("target", f"{words} {remedy}")
        height = p[:, 2] + target.pose.xyz[2] - camera.mount.xyz[2]
        if np.abs(height).max() <= LEVEL * (self.gap_m + abs(camera.mount.xyz[0])):
            words = "has its points at the camera's own height, where their images do not determine their distance"
            raise ParameterError("target", f"{words}; mount the camera higher or lower, or add a point beside it")

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """Nothing: the goal is a distance, not a view, and markers may be out of the picture there."""

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        """The target straight ahead at the gap, its carrier at the vehicle's heading."""
        # The gap counts from the target's origin: its place on the carrier is dropped, its height and orientation stay.
        carrier = target.pose.T.copy()
        carrier[:2, 3] = 0.0
        return (inverse(mount) @ pose_on_ground(np.array([self.gap_m, 0.0, 0.0])) @ carrier,)

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        """With the gap."""
        return tuple(replace(view, gap_m=self.gap_m) for view in super().goal_views(setup))

    def error_m(self, setup: Setup, T_world_base: Array, T_world_target: Array, t: float) -> float:
        """Distance minus gap: positive when too far."""
        return math.dist(T_world_base[:2, 3], T_world_target[:2, 3]) - self.gap_m

    def least_speeds(self, setup: Setup) -> tuple[MinSpeed, ...]:
        """Of leader and follower, where the target is carried."""
        # Without them a run could be completed behind a leader that is stuck, or by a follower that stands while the leader circles it.
        if setup.target.carrier is None:
            return ()
        v = setup.target.carrier.speed_mps
        return MinSpeed("the vehicle ahead", v, STEADY * v), MinSpeed("the vehicle that follows", v, FOLLOWS * v)

    def odometer(self, setup: Setup) -> LeaderAndFollower | None:
        """Of both vehicles."""
        return LeaderAndFollower(setup.target) if setup.target.carrier else None


class LeaderAndFollower:
    """Distances that the leader's and the follower's origins have travelled."""

    def __init__(self, target: Target):
        self._T_target_leader = inverse(target.pose.T)
        self._before: tuple[Array, Array] | None = None
        self._travelled = [0.0, 0.0]

    def update(self, T_world_base: Array, T_world_target: Array) -> tuple[float, ...]:
        """Distances so far [m]: leader, follower."""
        places = T_world_target @ self._T_target_leader, T_world_base
        if self._before is not None:
            steps = [math.dist(a[:2, 3], b[:2, 3]) for a, b in zip(self._before, places, strict=True)]
            self._travelled = [way + step for way, step in zip(self._travelled, steps, strict=True)]
        self._before = places
        return tuple(self._travelled)
