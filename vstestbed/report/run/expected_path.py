"""A vehicle's task on the floor, as its figures need it: goals, route, band, camera, and the way of an ideal bicycle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vstestbed.core.geometry import Array

if TYPE_CHECKING:
    from vstestbed.camera import Camera
    from vstestbed.scenario.scenario import Scenario

RINGS, DIRECTIONS = 120, 541
"""Grid on which what a camera sees of a plane is found out, in polar coordinates round its foot."""


@dataclass(frozen=True)
class GroundTask:
    """Facts of a vehicle's scenario; arrays are empty where there is nothing of the kind.

    Attributes:
        goals: places to come to, in turn, shape (K, 3) [m, m, rad].
        route: what is driven along, by the vehicle or by what it follows, shape (M, 2) [m].
        band_m: how far off a task without an end may be once settled [m]; settle_s: how long that may take [s].
        camera: the camera.
        ideal: way of a reference from the same start, shape (K, 2) [m]; ideal_name: what it is.
    """

    goals: Array
    reference_path: Array
    camera: Camera
    band_m: float | None = None
    settle_s: float = 0.0
    expected_path: Array | None = None
    expected_path_name: str = "ideal bicycle"

    @classmethod
    def of(cls, scenario: Scenario) -> GroundTask | None:
        """The facts of a scenario; None where nothing drives on a floor."""
        from vstestbed.scenario.goal import KEPT

        if not scenario.robot.grounded:
            return None
        goals = [goal.place for goal in scenario.goal_views if goal.place is not None]
        kept = scenario.goal if isinstance(scenario.goal, KEPT) else None
        return cls(
            goals=np.array(goals).reshape(-1, 3),
            reference_path=_reference_path(scenario),
            camera=scenario.camera,
            band_m=kept.band if kept else None,
            settle_s=kept.settle_s if kept else 0.0,
            expected_path=ideal_bicycle_path(scenario),
        )


def _reference_path(scenario: Scenario) -> Array:
    """The route of what carries the target, or of lines on the floor, every 5 cm."""
    from vstestbed.targets.base import Carried
    from vstestbed.targets.ground_lines import GroundLines

    target, motion = scenario.target, scenario.target.motion
    if isinstance(target, GroundLines):
        return target.way[::5]
    return motion.route.samples.xy[::5] if isinstance(motion, Carried) else np.empty((0, 2))


def ideal_bicycle_path(scenario: Scenario) -> Array | None:
    """The way (K, 2) [m] that the pose controller's law takes a bicycle that knows its place and obeys at once, within the car's angle.

    It ends where it is nearest to the goal. None for other laws and vehicles.
    """
    from vstestbed.laws import PoseController
    from vstestbed.laws.polar_pose import direction_to, polar_law
    from vstestbed.robots.bicycle import BicycleLimits, drive
    from vstestbed.robots.car import WHEELBASE, Car

    law, robot, goal = scenario.law, scenario.robot, scenario.goal_view.place
    if not (isinstance(law, PoseController) and isinstance(robot, Car)) or goal is None:
        return None
    start = robot.configuration()
    chosen = {"auto": int(direction_to(start, goal)), "forward": 1, "reverse": -1}[law.direction]
    limits = BicycleLimits(robot.limits.speed_mps, robot.limits.steering_rad)

    def ordered(place: Array) -> tuple[Array, Array]:
        return polar_law(place, goal, np.array(chosen), law.gains, law.speed_mps, law.rest_m)

    way = drive(ordered, start, WHEELBASE, limits, scenario.stop.duration_s, scenario.camera.period).place[:, :2]
    return way[: int(np.argmin(np.linalg.norm(way - goal[:2], axis=1))) + 1]


def largest_deviation(path: Array, reference: Array) -> float:
    """Largest distance [m] of a path's points (T, 2) from a polyline (K, 2)."""
    a, d = reference[:-1], np.diff(reference, axis=0)
    to = path[:, None] - a
    share = np.clip((to * d).sum(axis=-1) / np.maximum((d * d).sum(axis=-1), 1e-12), 0, 1)
    return float(np.linalg.norm(to - share[..., None] * d, axis=-1).min(axis=1).max())


def visible_region(camera: Camera, T_world_camera: Array, height: float, reach: float) -> tuple[Array, Array, Array]:
    """What a camera sees of the horizontal plane at a height, within a distance of its foot.

    Args:
        camera: the camera. T_world_camera: its pose, shape (4, 4).
        height: of the plane, such as that of the landmarks [m].
        reach: how far to look [m].

    Returns:
        x, y [m] of the grid's points and 1 where they are in the picture, else 0; shape (RINGS, DIRECTIONS) each.
    """
    r, a = np.meshgrid(np.linspace(1e-3, reach, RINGS), np.linspace(0, 2 * np.pi, DIRECTIONS), indexing="ij")
    foot = T_world_camera[:3, 3]
    x, y = foot[0] + r * np.cos(a), foot[1] + r * np.sin(a)
    step = np.stack([x - foot[0], y - foot[1], np.full_like(x, height - foot[2])], axis=-1).reshape(-1, 3)
    uv = camera.project(step @ T_world_camera[:3, :3])
    seen = camera.inside(uv) if len(camera.panels) == 1 else np.isfinite(uv[:, 0])
    return x, y, seen.reshape(x.shape).astype(float)
