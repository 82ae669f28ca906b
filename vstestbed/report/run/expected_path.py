"""Task of a ground vehicle as its figures need it: goals, reference path, tolerance, camera, and the path of an ideal bicycle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from vstestbed.core.geometry import Array

if TYPE_CHECKING:
    from vstestbed.camera import Camera
    from vstestbed.scenario.scenario import Scenario

RINGS, DIRECTIONS = 120, 541
"""Polar grid around the camera's foot point on which the visible region of a plane is sampled."""


@dataclass(frozen=True)
class GroundTask:
    """Task of a ground vehicle; arrays are empty where the scenario has nothing of the kind.

    Attributes:
        goals: goal poses (x, y, heading) in their order, shape (K, 3) [m, m, rad].
        reference_path: path to be driven, by the vehicle itself or by the target that it follows, shape (M, 2) [m].
        camera: the servo camera.
        band_m: error tolerance of a continuing task after `settle_s` [s], [m]; None for a task with an end.
        expected_path: path of an ideal vehicle from the same start, shape (K, 2) [m]; expected_path_name: its name in the legend.
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
        """The task of a scenario; None for a robot that is no ground vehicle."""
        if scenario.robot.base != "planar":
            return None
        goals = [goal.place for goal in scenario.goal_views if goal.place is not None]
        return cls(
            goals=np.array(goals).reshape(-1, 3),
            reference_path=scenario.target.floor_path[::5],
            camera=scenario.camera,
            band_m=scenario.goal.tolerance_m,
            settle_s=scenario.goal.settle_s,
            expected_path=ideal_bicycle_path(scenario),
        )


def ideal_bicycle_path(scenario: Scenario) -> Array | None:
    """Path (K, 2) [m] of the pose controller with an ideal bicycle: true pose, no actuator dynamics, the car's steering limit.

    It ends at its point nearest to the goal. None for other laws and vehicles.
    """
    from vstestbed.laws import PoseController
    from vstestbed.laws.polar_pose import direction_to, polar_law
    from vstestbed.robots.bicycle import BicycleLimits, drive
    from vstestbed.robots.car import Car

    law, robot, goal = scenario.law, scenario.robot, scenario.goal_view.place
    # the ideal bicycle is the ideal car: no other robot has its wheelbase and steering
    if not (isinstance(law, PoseController) and isinstance(robot, Car)) or goal is None:
        return None
    start = robot.configuration()
    chosen = {"auto": int(direction_to(start, goal)), "forward": 1, "reverse": -1}[law.direction]
    limits = BicycleLimits(robot.limits.speed_mps, robot.limits.steering_rad)

    def command(place: Array) -> tuple[Array, Array]:
        return polar_law(place, goal, np.array(chosen), law.gains, law.speed_mps, law.rest_m)

    way = drive(command, start, robot.parameters.wheelbase_m, limits, scenario.stop.duration_s, scenario.camera.period).place[:, :2]
    return way[: int(np.argmin(np.linalg.norm(way - goal[:2], axis=1))) + 1]


def largest_deviation(path: Array, reference: Array) -> float:
    """Largest distance [m] of the points (T, 2) of a path from a polyline (K, 2)."""
    a, d = reference[:-1], np.diff(reference, axis=0)
    to = path[:, None] - a
    # foot point on each segment, as a share of its length; 1e-12 m^2: repeated points
    share = np.clip((to * d).sum(axis=-1) / np.maximum((d * d).sum(axis=-1), 1e-12), 0, 1)
    return float(np.linalg.norm(to - share[..., None] * d, axis=-1).min(axis=1).max())


def visible_region(camera: Camera, T_world_camera: Array, height: float, reach: float) -> tuple[Array, Array, Array]:
    """The part of a horizontal plane that is in the image, within a distance of the camera's foot point.

    Args:
        camera: the camera model. T_world_camera: its pose, shape (4, 4).
        height: z of the plane in the world, such as that of the landmarks [m].
        reach: radius of the sampled disc [m].

    Returns:
        x, y [m] of the grid's points and 1 where a point is in the image, else 0; shape (RINGS, DIRECTIONS) each.
    """
    r, a = np.linspace(1e-3, reach, RINGS)[:, None], np.linspace(0, 2 * np.pi, DIRECTIONS)
    foot = T_world_camera[:3, 3]
    across, along = r * np.cos(a), r * np.sin(a)
    step = np.stack([across, along, np.full_like(across, height - foot[2])], axis=-1).reshape(-1, 3)
    # not `@`: over so many rows BLAS starts threads, which wait for each other longer than the product takes
    uv = camera.project(np.einsum("ni,ij->nj", step, T_world_camera[:3, :3]))
    # a camera with several panels has no image border, only directions that it cannot project
    seen = camera.inside(uv) if len(camera.panels) == 1 else np.isfinite(uv[:, 0])
    return foot[0] + across, foot[1] + along, seen.reshape(across.shape).astype(float)
