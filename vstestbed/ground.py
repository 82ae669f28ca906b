"""Places on the floor: (x, y, heading) in the world [m, rad], as poses and as what a vehicle's way changes."""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np

from vstestbed.geometry import Array
from vstestbed.spec import spec


@spec
class GroundPose:
    """A place on the floor as people write it: x, y [m] and a heading from the x axis, counter-clockwise [deg]."""

    x: float = 0.0
    y: float = 0.0
    heading_deg: float = 0.0

    @property
    def heading(self) -> float:
        """[rad]."""
        return math.radians(self.heading_deg)

    @cached_property
    def place(self) -> Array:
        """(x, y, heading), shape (3,) [m, rad]."""
        return np.array([self.x, self.y, self.heading])

    @property
    def T(self) -> Array:
        """T_world_base (4, 4)."""
        return pose_on_ground(self.place)


def pose_on_ground(place: Array) -> Array:
    """T_world_base (4, 4) of a place (x, y, heading): on the floor, upright."""
    x, y, heading = place
    c, s = math.cos(heading), math.sin(heading)
    return np.array([[c, -s, 0.0, x], [s, c, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def place_of(T: Array) -> Array:
    """(x, y, heading) of poses T (..., 4, 4), shape (..., 3): the heading is that of the x axis, seen from above."""
    return np.stack([T[..., 0, 3], T[..., 1, 3], np.arctan2(T[..., 1, 0], T[..., 0, 0])], axis=-1)


def wrapped(angle: Array | float) -> Array:
    """Angles brought into [-pi, pi) [rad]."""
    return (np.asarray(angle, dtype=float) + np.pi) % (2 * np.pi) - np.pi


def relative(here: Array, there: Array) -> Array:
    """The place `there` (..., 3) as seen from `here` (..., 3): (ahead, to the left, turn), shape (..., 3)."""
    d = there - here
    c, s = np.cos(here[..., 2]), np.sin(here[..., 2])
    return np.stack([c * d[..., 0] + s * d[..., 1], -s * d[..., 0] + c * d[..., 1], wrapped(d[..., 2])], axis=-1)


def composed(place: Array, step: Array) -> Array:
    """Where a step (ahead, to the left, turn) (3,) leads from a place (3,); the heading is not wrapped."""
    c, s = math.cos(place[2]), math.sin(place[2])
    return np.array([place[0] + c * step[0] - s * step[1], place[1] + s * step[0] + c * step[1], place[2] + step[2]])


def arc(velocity: Array, duration: float) -> Array:
    """The step (ahead, to the left, turn) that a constant (vx, vy, wz) in the vehicle's frame makes: an exact arc.

    With a = wz duration:  dx = (vx sin a - vy (1 - cos a))/wz,  dy = (vx (1 - cos a) + vy sin a)/wz.
    """
    vx, vy, wz = velocity
    a = wz * duration
    along, aside = (math.sin(a) / a, (1 - math.cos(a)) / a) if abs(a) > 1e-6 else (1 - a * a / 6, a / 2)
    return np.array([(vx * along - vy * aside) * duration, (vx * aside + vy * along) * duration, a])
