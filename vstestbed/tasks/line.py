"""Line following: keep the vehicle over a line painted on the floor."""

from __future__ import annotations

import math
from typing import Any, ClassVar, Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.planar import place_of
from vstestbed.core.quantity import Length
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal
from vstestbed.laws import Law
from vstestbed.robots import Robot
from vstestbed.robots.base import Base
from vstestbed.targets import GroundLines, Target
from vstestbed.targets.route import Route
from vstestbed.tasks.continuing import Continuing, Settle, Tolerance
from vstestbed.tasks.setup import Setup
from vstestbed.tasks.speed_monitor import STEADY, MinSpeed

ALONG_M = 0.5
"""Search range along the line round the vehicle's last arc length [m]; at 3 m/s and 10 Hz it moves by .3 m a frame."""


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
    asks: ClassVar[str] = "line"
    bases: ClassVar[frozenset[Base]] = frozenset({"planar"})

    def check(self, setup: Setup) -> None:
        """The target must be lines with bends that the vehicle can follow, at a speed within its limits."""
        self._check_law(setup.law)
        self._check_base(setup.robot)
        self._check_drive(setup.robot, _lines(setup.target).route, setup.law)

    def _check_drive(self, robot: Robot, route: Route, law: Law[Any]) -> None:
        """Refuse bends tighter than the turning circle, and a cruising speed beyond the limits."""
        # The parallel at an offset d to the left of a bend of curvature k has the curvature k / (1 - k d).
        k = route.samples.curvature
        tightest = float(np.abs(k / np.maximum(1 - k * self.offset_m, 1e-9)).max())
        if tightest * robot.turning_radius_m > 1:
            words = f"has a bend of {1 / tightest:.3g} m where the vehicle shall drive, which turns no tighter than"
            raise ParameterError("target.route", f"{words} {robot.turning_radius_m:.3g} m; make it wider, or use robot omni")
        if law.cruise_mps is None:
            return
        most = min(robot.top_speed_mps, law.limits.speed_mps or np.inf)
        if law.cruise_mps > most:
            words = f"must be at most {most:g} m/s, which the limits of robot and law allow"
            raise ParameterError("law.cruise_mps", words, law.cruise_mps)

    def check_views(self, setup: Setup, views: tuple[Goal, ...]) -> None:
        """On a straight line all measured points must be in the picture."""
        camera = setup.camera
        if not camera.inside(views[-1].uv).all():
            words = f"are outside the {camera.width} x {camera.height} picture even where all is well"
            raise ParameterError("target.look_m", f"{words}; turn the camera, or use a wider one or other distances")

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        """NaN: the goal is no single pose, but any place along the line."""
        return (np.full((4, 4), np.nan),)

    def goal_views(self, setup: Setup) -> tuple[Goal, ...]:
        """The points measured on a straight line, `offset_m` to its left."""
        mount = setup.believed_camera.mount.T
        ahead = _lines(setup.target).straight_ahead(mount, self.offset_m)
        if not np.isfinite(ahead).all():
            words = "must have the camera look ahead, or down with the top of its picture ahead: lines are met ahead of it"
            raise ParameterError("camera.mount", words, setup.camera.mount.rpy_deg)
        return (Goal.of_points(setup.believed_camera, ahead, np.full((4, 4), np.nan)),)

    def error_m(self, setup: Setup, T_world_base: Array, T_world_target: Array, t: float) -> float:
        """Lateral offset from the line minus `offset_m`, positive to the left."""
        here = place_of(inverse(T_world_target) @ T_world_base)
        return _lines(setup.target).route.beside(here) - self.offset_m

    def least_speeds(self, setup: Setup) -> tuple[MinSpeed, ...]:
        """That of the law's cruising speed."""
        v = setup.law.cruise_mps
        return () if v is None else (MinSpeed("the vehicle, along its line,", v, STEADY * v),)

    def odometer(self, setup: Setup) -> AlongRoute | None:
        """Distance along the route."""
        return AlongRoute(_lines(setup.target).route)


def _lines(target: Target) -> GroundLines:
    """The target as lines on the floor.

    Raises:
        ParameterError: it is another kind of target.
    """
    if not isinstance(target, GroundLines):  # the one task that needs more of its target than markers: a route
        raise ParameterError("goal", "of kind line needs a line on the floor; use target: {kind: lines}")
    return target


class AlongRoute:
    """Distance along a route, in the direction that the vehicle faced at the start: a painted line has no direction."""

    def __init__(self, route: Route):
        self._route = route
        self._s, self._sense, self._travelled = math.nan, 1.0, 0.0

    def update(self, T_world_base: Array, T_world_target: Array) -> tuple[float, ...]:
        """Distance so far [m].

        ds (1 - curvature offset) is the vehicle's own step beside the line, which in a bend is longer or shorter than the line's.
        """
        place, route = place_of(inverse(T_world_target) @ T_world_base), self._route
        if math.isnan(self._s):
            self._s, with_it = route.branch(place)
            self._sense = 1.0 if with_it >= 0 else -1.0
        # Near its last arc length: where the line crosses itself, the nearest point may be on the other branch.
        s, offset = route.nearest(place[:2], around=self._s, reach=ALONG_M)
        self._travelled += self._sense * (s - self._s) * (1 - float(route.at(s)[3]) * offset)
        self._s = s
        return (self._travelled,)
