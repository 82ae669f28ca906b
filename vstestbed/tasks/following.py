"""Following: the vehicle ahead at a distance, a line on the floor."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.planar import place_of, pose_on_ground
from vstestbed.core.quantity import Length, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.robots import VEHICLES
from vstestbed.robots.vehicle import Vehicle
from vstestbed.targets import GroundLines, Target
from vstestbed.targets.route import Route
from vstestbed.tasks.continuing import (
    FOLLOWS,
    STEADY,
    Continuing,
    LeastSpeeds,
    Odometer,
    Settle,
    Tolerance,
)
from vstestbed.tasks.monitor import Setup
from vstestbed.vision.floor_pose import LEVEL

ONE_PLACE_M = 1e-6  # points within this of one another in the floor plan are at one place [m]


@spec
class GoalGap(Continuing):
    """Continuing task: keep a distance, on the floor, from the vehicle's origin to the target's.

    Behind a vehicle that drives, both vehicles must keep a minimum speed. Behind a target that
    stands by scenario (`motion: still`) the vehicle waits at the distance.

    Args:
        gap_m: the distance [m].
        band_m: tolerance of the distance once settled; a tenth of it by default [m]; e.g. `0.1`.
        settle_s: settling time [s].
    """

    kind: Literal["gap"] = "gap"
    gap_m: PositiveLength
    band_m: Tolerance | None = None
    settle_s: Settle = 8.0
    asks = "gap"
    bases = frozenset({"planar"})
    needs_pose = True

    @property
    def tolerance_m(self) -> float:
        """`band_m`, or a tenth of the gap [m]."""
        return self.band_m or 0.1 * self.gap_m

    def check(self, setup: Setup) -> None:
        """The vehicles must not touch at the gap, and the target's origin must be observable."""
        super().check(setup)
        robot = setup.robot
        camera = setup.camera
        target = setup.target
        if target.carrier is not None and isinstance(robot, Vehicle):
            rear = VEHICLES[target.carrier.by]().ends_m[0]
            front = robot.ends_m[1]
            least = target.pose.xyz[0] - rear + front
            if self.gap_m <= least:
                front_m = f"the front of robot {robot.kind}, {front:g} m before its origin,"
                why = f"there {front_m} touches the {target.carrier.by} that carries the target"
                raise ParameterError.bound(
                    "goal.gap_m", "over", f"{least:.4g} m", self.gap_m, why=why
                )
        # Points above one another do not determine the target's heading: they must lie over the
        # origin to which the gap is measured. p is from the target's origin, in the axes of what
        # carries it.
        p: Array = target.points @ target.pose.T[:3, :3].T
        if not setup.law.depth.on_floor or np.ptp(p[:, :2], axis=0).max() > ONE_PLACE_M:
            return
        # One place gives one direction and, by the known height, one distance: enough for a point,
        # not for the carrier's heading.
        if np.abs(p[0, :2]).max() > ONE_PLACE_M:
            words = (
                "has its points at one place of the floor plan, which does not tell its heading, so"
                " that its origin, to which the gap is measured, stays unknown;"
                " use x = y = 0 there and put the place into target.pose, or add a point beside it"
            )
            raise ParameterError("target", words)
        height = p[:, 2] + target.pose.xyz[2] - camera.mount.xyz[2]
        if np.abs(height).max() <= LEVEL * (self.gap_m + abs(camera.mount.xyz[0])):
            words = (
                "has its points at the camera's own height,"
                " where their images do not determine their distance;"
                " mount the camera higher or lower, or add a point beside it"
            )
            raise ParameterError("target", words)

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """Nothing: the goal is a distance, not a view,
        and markers may be out of the picture there.
        """

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        # The gap counts from the target's origin: its place on the carrier is dropped, its height
        # and orientation stay.
        carrier = target.pose.T.copy()
        carrier[:2, 3] = 0.0
        return (inverse(mount) @ pose_on_ground(np.array([self.gap_m, 0.0, 0.0])) @ carrier,)

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        return tuple(replace(view, gap_m=self.gap_m) for view in super().goal_views(setup))

    def error_m(self, setup: Setup, T_world_base: Array, T_world_target: Array, t: float) -> float:
        """Distance minus gap: positive when too far."""
        return math.dist(T_world_base[:2, 3], T_world_target[:2, 3]) - self.gap_m

    def least_speeds(self, setup: Setup) -> LeastSpeeds:
        # Without them a run could be completed behind a leader that is stuck, or by a follower that
        # stands while the leader circles it.
        if setup.target.carrier is None:
            return (), None
        v = setup.target.carrier.speed_mps
        speeds = ("the vehicle ahead", v, STEADY * v), ("the vehicle that follows", v, FOLLOWS * v)
        return speeds, leader_and_follower(setup.target)


def leader_and_follower(target: Target) -> Odometer:
    """Distances that the leader's and the follower's origins have travelled."""
    T_target_leader = inverse(target.pose.T)
    before = list[Array]()
    travelled = [0.0, 0.0]

    def travel(T_world_base: Array, T_world_target: Array) -> tuple[float, ...]:
        places = [T[:2, 3] for T in (T_world_target @ T_target_leader, T_world_base)]
        for i, place in enumerate(before):
            travelled[i] += math.dist(place, places[i])
        before[:] = places
        return tuple(travelled)

    return travel


# Line following: keep the vehicle over a line painted on the floor.

# search range along the line round the vehicle's last arc length [m]; at 3 m/s and 10 Hz it moves
# by .3 m a frame
ALONG_M = 0.5


@spec
class GoalLine(Continuing):
    """Continuing task: keep the vehicle's origin over the target, a line on the floor.

    Args:
        offset_m: lateral offset at which to drive, to the left of the line [m].
        band_m: tolerance of the lateral error once settled [m].
        settle_s: settling time [s].
    """

    kind: Literal["line"] = "line"
    offset_m: Length = 0.0
    band_m: Tolerance = 0.05
    settle_s: Settle = 5.0
    asks = "line"
    bases = frozenset({"planar"})

    def check(self, setup: Setup) -> None:
        """The target must be lines with bends that the vehicle can follow, at a speed within its
        limits.
        """
        self._check_law(setup.law)
        self._check_base(setup.robot)
        robot = setup.robot
        route = _lines(setup.target).route
        law = setup.law
        if not isinstance(robot, Vehicle):
            return
        # The parallel at an offset d to the left of a bend of curvature k has the curvature k /
        # (1 - k d).
        k = route.samples[3]
        tightest = float(np.abs(k / np.maximum(1 - k * self.offset_m, 1e-9)).max())
        if tightest * robot.turning_radius_m > 1:
            words = (
                f"has a bend of {1 / tightest:.3g} m where the vehicle shall drive,"
                f" which turns no tighter than {robot.turning_radius_m:.3g} m;"
                " make it wider, or use robot omni"
            )
            raise ParameterError("target.route", words)
        if law.cruise_mps is None:
            return
        most = min(robot.top_speed_mps, law.limits.speed_mps or np.inf)
        if law.cruise_mps > most:
            words = f"{most:g} m/s, which the limits of robot and law allow"
            raise ParameterError.bound("law.cruise_mps", "at most", words, law.cruise_mps)

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """On a straight line all measured points must be in the picture."""
        camera = setup.camera
        if not camera.inside(views[-1].uv).all():
            words = (
                f"are outside the {camera.width} x {camera.height} picture even where all is well;"
                " turn the camera, or use a wider one or other distances"
            )
            raise ParameterError("target.look_m", words)

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        """NaN: the goal is no single pose, but any place along the line."""
        return (np.full((4, 4), np.nan),)

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        mount = setup.believed_camera.mount.T
        ahead = _lines(setup.target).straight_ahead(mount, self.offset_m)
        if not np.isfinite(ahead).all():
            words = (
                "must have the camera look ahead, or down with the top of its picture ahead:"
                " lines are met ahead of it"
            )
            raise ParameterError("camera.mount", words, setup.camera.mount.rpy_deg)
        return (Goal.of_points(setup.believed_camera, ahead, np.full((4, 4), np.nan)),)

    def error_m(self, setup: Setup, T_world_base: Array, T_world_target: Array, t: float) -> float:
        """Lateral offset from the line minus `offset_m`, positive to the left."""
        here = place_of(inverse(T_world_target) @ T_world_base)
        return _lines(setup.target).route.beside(here) - self.offset_m

    def least_speeds(self, setup: Setup) -> LeastSpeeds:
        v = setup.law.cruise_mps
        odometer = along_route(_lines(setup.target).route)
        return () if v is None else (("the vehicle, along its line,", v, STEADY * v),), odometer


def _lines(target: Target) -> GroundLines:
    """The target as lines on the floor. Raises ParameterError: it is another kind of target."""
    # the one task that needs more of its target than markers: a route
    if not isinstance(target, GroundLines):
        raise ParameterError.needs(
            "goal", "a line on the floor for kind line", works="target: {kind: lines}"
        )
    return target


def along_route(route: Route) -> Odometer:
    """Distance along a route, in the direction that the vehicle faced at the start: a painted line
    has no direction. ds (1 - curvature offset) is the vehicle's own step beside the line, which in
    a bend is longer or shorter than the line's.
    """
    last = math.nan
    sense = 1.0
    travelled = 0.0

    def travel(T_world_base: Array, T_world_target: Array) -> tuple[float, ...]:
        nonlocal last, sense, travelled
        place = place_of(inverse(T_world_target) @ T_world_base)
        if math.isnan(last):
            last, with_it = route.branch(place)
            sense = 1.0 if with_it >= 0 else -1.0
        # Near its last arc length: where the line crosses itself, the nearest point may be on the
        # other branch.
        s, offset = route.nearest(place[:2], around=last, reach=ALONG_M)
        travelled += sense * (s - last) * (1 - float(route.at(s)[3]) * offset)
        last = s
        return (travelled,)

    return travel
