"""The conditions under which a law of `switched` is left, and the quantities that they compare."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import cached_property

import numpy as np

from vstestbed.core.geometry import Array, inverse, rotation_angle
from vstestbed.core.quantity import PositiveAngle, PositiveLength, PositivePixels
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal, Observation

INPUTS = {
    "position": ("T_camera_target",),
    "rotation": ("T_camera_target",),
    "retreat": ("T_camera_target",),
    "border": ("radius_px",),
    "joint_margin": ("robot",),
}
"""The fields of an Observation that a quantity needs besides the pixels."""


@spec
class Until:
    """A law is left when one of these holds; none: it is never left.

    Args:
        error_over_px, error_under_px: RMS of the image error over the coordinates seen [px]; e.g. `20`.
        position_over_m, position_under_m: distance of the camera from its goal, by the estimated pose [m]; e.g. `0.5`.
        rotation_over_deg, rotation_under_deg: angle of the camera from its goal, by the estimated pose [deg]; e.g. `40`.
        retreat_over_m: distance from the target's origin beyond that at the start and that at the goal, by the estimated pose [m].
        border_under_px: distance of the nearest marker's edge from the image border, 0 where a marker is not seen [px].
        joint_margin_under_deg: distance of the nearest joint from its limit, a joint that slides counting a radian a metre; infinite for
            a robot whose joints have no limits [deg]; e.g. `10`.
    """

    error_over_px: PositivePixels | None = None
    error_under_px: PositivePixels | None = None
    position_over_m: PositiveLength | None = None
    position_under_m: PositiveLength | None = None
    rotation_over_deg: PositiveAngle | None = None
    rotation_under_deg: PositiveAngle | None = None
    retreat_over_m: PositiveLength | None = None
    border_under_px: PositivePixels | None = None
    joint_margin_under_deg: PositiveAngle | None = None

    @cached_property
    def limits(self) -> tuple[tuple[str, int, float], ...]:
        """Of each condition the quantity, 1 for `over` or -1 for `under`, and the limit."""
        given = ((f.name, getattr(self, f.name)) for f in fields(self))
        return tuple((*_split(name), limit) for name, limit in given if limit is not None)

    @property
    def quantities(self) -> tuple[str, ...]:
        """The names of what is compared."""
        return tuple(name for name, _, _ in self.limits)

    def holds(self, values: Mapping[str, float]) -> bool:
        """Whether a quantity is beyond its limit; one that is unknown (NaN) is not."""
        return any(side * values[name] > side * limit for name, side, limit in self.limits)

    def receded(self, values: Mapping[str, float], hysteresis: float) -> bool:
        """Whether all quantities are back by this share of their limits; one that is unknown (NaN) is not."""
        return all(side * values[name] <= side * limit * (1 - side * hysteresis) for name, side, limit in self.limits)


def _split(field: str) -> tuple[str, int]:
    """Quantity and side of a field: `border_under_px` is ("border", -1)."""
    quantity, _, _ = field.partition("_over_" if "_over_" in field else "_under_")
    return quantity, 1 if "_over_" in field else -1


def target_distance(observation: Observation) -> float:
    """Distance of the camera from the target's origin by the estimated pose [m]; NaN where it is unknown."""
    T = observation.T_camera_target
    return math.nan if T is None else float(np.linalg.norm(T[:3, 3]))


def quantity(name: str, observation: Observation, goal: Goal, start_m: float) -> float:
    """One of the quantities, in the unit of its fields; NaN where it is unknown.

    start_m: distance of the camera from the target at the start.
    """
    if name == "retreat":
        return target_distance(observation) - max(start_m, float(np.linalg.norm(goal.T_camera_target[:3, 3])))
    return _MEASURES[name](observation, goal)


def _error_px(observation: Observation, goal: Goal) -> float:
    error = (observation.uv - goal.uv)[observation.seen]
    return math.sqrt(float(np.mean(error**2))) if error.size else math.nan


def _T_goal_camera(observation: Observation, goal: Goal) -> Array:
    T = observation.T_camera_target
    return np.full((4, 4), np.nan) if T is None else goal.T_camera_target @ inverse(T)


def _position_m(observation: Observation, goal: Goal) -> float:
    return float(np.linalg.norm(_T_goal_camera(observation, goal)[:3, 3]))


def _rotation_deg(observation: Observation, goal: Goal) -> float:
    return math.degrees(float(rotation_angle(_T_goal_camera(observation, goal)[:3, :3])))


def _border_px(observation: Observation, goal: Goal) -> float:
    seen = observation.seen
    if not (seen if goal.counted is None else seen[goal.counted]).all():
        return 0.0
    distance = goal.camera.borders(observation.uv[seen])[0].min(axis=1)
    radius = 0.0 if observation.radius_px is None else np.nan_to_num(observation.radius_px[seen])
    return float(np.min(distance - radius, initial=np.inf))


def _joint_margin_deg(observation: Observation, goal: Goal) -> float:
    robot = observation.robot
    if robot is None:
        return math.nan
    return math.degrees(float(np.minimum(robot.q - robot.low, robot.high - robot.q).min(initial=np.inf)))


_MEASURES: dict[str, Callable[[Observation, Goal], float]] = {
    "error": _error_px,
    "position": _position_m,
    "rotation": _rotation_deg,
    "border": _border_px,
    "joint_margin": _joint_margin_deg,
}
