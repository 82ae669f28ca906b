"""SE(2): places (x, y, heading) on the floor in the world frame [m, rad], their composition, and
motions between them.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
from pydantic import model_validator

from vstestbed.core.geometry import Array, joined, pose_block
from vstestbed.core.quantity import Angle, Length
from vstestbed.core.spatial import class_of, floor_place, is_matrix
from vstestbed.core.spec import spec

__all__ = [
    "GroundPose",
    "arc",
    "block_of",
    "composed",
    "motion_between",
    "moved",
    "place_of",
    "pose_on_ground",
    "relative",
    "wrapped",
]


@spec
class GroundPose:
    """A place on the floor in YAML.

    In Python every field of this class also takes spatialmath's SE2, and an SE3 that stands upright
    at height 0.

    Args:
        x, y: coordinates in the world [m].
        heading_deg: direction of travel from the world's x axis, counter-clockwise [deg].
    """

    x: Length = 0.0
    y: Length = 0.0
    heading_deg: Angle = 0.0

    @model_validator(mode="before")
    @classmethod
    def _from_matrix(cls, given: Any) -> Any:
        return place_block(given) if is_matrix(given) else given

    @property
    def heading(self) -> float:
        """The heading [rad]."""
        return math.radians(self.heading_deg)

    @cached_property
    def place(self) -> Array:
        """The array (x, y, heading), shape (3,) [m, rad]."""
        return np.array([self.x, self.y, self.heading])

    @property
    def T(self) -> Array:
        """T_world_base (4, 4)."""
        return pose_on_ground(self.place)


def block_of(value: Any) -> Any:
    """A pose (SE3 or (4, 4)) or a place (SE2 or (3, 3)) as the plain block of a scenario; any other
    value as it is.
    """
    kind = class_of(value)
    shape = value.shape if isinstance(value, np.ndarray) else ()
    if kind == "SE2" or shape == (3, 3):
        return place_block(value)
    if kind or shape == (4, 4):
        return pose_block(value)
    return value


def place_block(value: Any) -> dict[str, Any]:
    """The fields of the GroundPose of an SE2, a matrix, or an SE3 on the floor (`floor_place`)."""
    return dict(zip(("x", "y", "heading_deg"), floor_place(value), strict=True))


def pose_on_ground(place: Array) -> Array:
    """T_world_base (..., 4, 4) of places (x, y, heading) (..., 3): at height 0, without roll and
    pitch.
    """
    place = np.asarray(place, dtype=float)
    c = np.cos(place[..., 2])
    s = np.sin(place[..., 2])
    T = np.zeros((*place.shape[:-1], 4, 4))
    T[..., 0, 0] = T[..., 1, 1] = c
    T[..., 0, 1] = -s
    T[..., 1, 0] = s
    T[..., :2, 3] = place[..., :2]
    T[..., 2, 2] = T[..., 3, 3] = 1.0
    return T


def place_of(T: Array) -> Array:
    """Places (x, y, heading) (..., 3) of poses T (..., 4, 4): the heading is that of the x axis,
    projected on the floor.
    """
    return joined(T[..., 0, 3], T[..., 1, 3], np.arctan2(T[..., 1, 0], T[..., 0, 0]))


def wrapped(angle: Array | float) -> Array:
    """Angles wrapped to [-pi, pi) [rad]."""
    return (np.asarray(angle, dtype=float) + np.pi) % (2 * np.pi) - np.pi


def relative(here: Array, there: Array) -> Array:
    """The place `there` (..., 3) relative to `here` (..., 3): (ahead, left, turn), shape (..., 3)
    [m, m, rad].
    """
    d = there - here  # in world axes; the rotation by -heading turns it into the axes of `here`
    c = np.cos(here[..., 2])
    s = np.sin(here[..., 2])
    return joined(c * d[..., 0] + s * d[..., 1], -s * d[..., 0] + c * d[..., 1], wrapped(d[..., 2]))


def composed(place: Array, step: Array) -> Array:
    """Places (..., 3) after steps (ahead, left, turn) (..., 3); the heading is not wrapped."""
    place = np.asarray(place, dtype=float)
    step = np.asarray(step, dtype=float)
    c = np.cos(place[..., 2])
    s = np.sin(place[..., 2])
    ahead = step[..., 0]
    left = step[..., 1]
    return place + joined(c * ahead - s * left, s * ahead + c * left, step[..., 2])


def arc(motion: Array, duration: float) -> Array:
    """The step (ahead, left, turn) (..., 3) of a constant motion (vx, vy, wz) in the vehicle frame:
    an exact arc.

    With theta = wz t: (ahead, left) = [[a, -b], [b, a]] (vx, vy) t, a = sin(theta)/theta, b = (1 -
    cos(theta))/theta.
    Reference: Lynch & Park 2017, Modern Robotics, section 13.4 (odometry).
    """
    step = np.asarray(motion, dtype=float) * duration
    dx = step[..., 0]
    dy = step[..., 1]
    theta = step[..., 2]
    a, b = _chord(theta)
    return joined(a * dx - b * dy, b * dx + a * dy, theta)


def moved(place: Array, motion: Array, duration: float) -> Array:
    """Places (..., 3) after a constant motion (vx, vy, wz) (..., 3) for a duration [s]."""
    return composed(place, arc(motion, duration))


def motion_between(before: Array, now: Array, duration: float) -> Array:
    """The constant motion (vx, vy, wz) (..., 3) between two places in a duration [s]: the inverse
    of `arc`, with a turn in [-pi, pi).
    """
    step = relative(np.asarray(before, dtype=float), np.asarray(now, dtype=float))
    dx, dy, theta = np.moveaxis(step, -1, 0)
    a, b = _chord(theta)
    # The inverse of the matrix [[a, -b], [b, a]] of `arc`; its determinant is 0 only for a full
    # turn.
    size = a * a + b * b
    return joined((a * dx + b * dy) / size, (a * dy - b * dx) / size, theta) / duration


def _chord(theta: Array) -> tuple[Array, Array]:
    """sin(theta)/theta and (1 - cos(theta))/theta,
    exact also at 0 (np.sinc has the limit there).
    """
    return np.sinc(theta / np.pi), np.sin(theta / 2) * np.sinc(theta / (2 * np.pi))
