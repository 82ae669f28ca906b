"""What vehicles on a floor share: where they start, their pose in the plane, and how a body twist moves it.

A vehicle's configuration is (x, y, heading), shape (..., 3), [m, m, rad]; its frame stands on the floor with x forward and z up.
Its motion is u = (vx, vy, wz) of that frame in its own axes, shape (..., 3), [m/s, m/s, rad/s].
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from vstestbed.errors import ParameterError
from vstestbed.geometry import Array
from vstestbed.spec import spec

PLANE = np.zeros((6, 3))
"""The body twist (v, w) of a planar motion: PLANE @ (vx, vy, wz). Its transpose takes the motion out of a twist."""
PLANE[[0, 1, 5], [0, 1, 2]] = 1.0


@spec
class GroundPose:
    """A vehicle's pose on the floor: x, y [m] and heading_deg from the world's x axis towards y [deg]."""

    x: float = 0.0
    y: float = 0.0
    heading_deg: float = 0.0


@spec
class GroundBox:
    """Half widths of the box from which random starts are drawn: x, y [m], heading_deg [deg]."""

    x: Annotated[float, Ge(0)] = 0.0
    y: Annotated[float, Ge(0)] = 0.0
    heading_deg: Annotated[float, Ge(0), Le(180)] = 0.0


@spec
class GroundStart:
    """Where a vehicle starts: `nominal`, and the box round it from which `random` starts are drawn."""

    nominal: GroundPose = GroundPose()
    random: GroundBox | None = None

    def configuration(self) -> Array:
        """The nominal start (x, y, heading), shape (3,), [m, m, rad]."""
        at = self.nominal
        return np.array([at.x, at.y, math.radians(at.heading_deg)])

    def drawn(self, rng: np.random.Generator) -> GroundStart:
        """A start whose nominal pose is drawn evenly from the box.

        Raises:
            ParameterError: there is no box.
        """
        at, box = self.nominal, self.random
        if box is None:
            raise ParameterError("robot.start.random", "is missing: a seed draws the start from it, e.g. {x: .5, y: .5, heading_deg: 20}")
        x, y, heading = (rng.uniform(-1, 1, 3) * (box.x, box.y, box.heading_deg) + (at.x, at.y, at.heading_deg)).tolist()
        return GroundStart(nominal=GroundPose(x=x, y=y, heading_deg=heading), random=box)


def ground_pose(configuration: Array) -> Array:
    """T_world_base (..., 4, 4) of a vehicle at (x, y, heading) (..., 3)."""
    configuration = np.asarray(configuration, dtype=float)
    c, s = np.cos(configuration[..., 2]), np.sin(configuration[..., 2])
    T = np.zeros((*configuration.shape[:-1], 4, 4))
    T[..., 0, 0] = T[..., 1, 1] = c
    T[..., 0, 1], T[..., 1, 0] = -s, s
    T[..., :2, 3] = configuration[..., :2]
    T[..., 2, 2] = T[..., 3, 3] = 1.0
    return T


def ground_configuration(T_world_base: Array) -> Array:
    """(x, y, heading) (..., 3) of a pose (..., 4, 4); the heading is that of the x axis seen from above, in (-pi, pi]."""
    heading = np.arctan2(T_world_base[..., 1, 0], T_world_base[..., 0, 0])
    return np.stack([T_world_base[..., 0, 3], T_world_base[..., 1, 3], heading], axis=-1)


def moved(configuration: Array, motion: Array, duration: float) -> Array:
    """Where a constant body motion leads: the exact arc.

    With theta = wz t, heading psi, and the SE(2) exponential:
    heading += theta,  (x, y) += R(psi) [[a, -b], [b, a]] (vx, vy) t,  a = sin(theta)/theta,  b = (1 - cos(theta))/theta.

    Args:
        configuration: (x, y, heading), shape (..., 3).
        motion: (vx, vy, wz) in the body's axes, shape (..., 3), [m/s, rad/s].
        duration: t [s].

    Returns:
        (x, y, heading) (..., 3); the heading runs on, it is not wrapped.

    Reference: Lynch & Park 2017, Modern Robotics, section 13.4 (odometry).
    """
    dx, dy, theta = np.moveaxis(np.asarray(motion, dtype=float) * duration, -1, 0)
    a, b = _chord(theta)
    return _ahead(configuration, a * dx - b * dy, b * dx + a * dy, theta)


def motion_between(before: Array, now: Array, duration: float) -> Array:
    """The constant body motion that leads from one configuration to another in a time: the inverse of `moved`.

    Args:
        before, now: (x, y, heading), shape (..., 3); the way's turn is the short one, in [-pi, pi).
        duration: [s], not 0.

    Returns:
        (vx, vy, wz) (..., 3), [m/s, rad/s].
    """
    before, now = np.asarray(before, dtype=float), np.asarray(now, dtype=float)
    c, s = np.cos(before[..., 2]), np.sin(before[..., 2])
    across, up = now[..., 0] - before[..., 0], now[..., 1] - before[..., 1]
    dx, dy = c * across + s * up, c * up - s * across
    theta = np.remainder(now[..., 2] - before[..., 2] + np.pi, 2 * np.pi) - np.pi
    a, b = _chord(theta)
    size = a * a + b * b
    return np.stack([(a * dx + b * dy) / size, (a * dy - b * dx) / size, theta], axis=-1) / duration


def _chord(theta: Array) -> tuple[Array, Array]:
    """sin(theta)/theta and (1 - cos(theta))/theta, exact at 0 too."""
    return np.sinc(theta / np.pi), np.sin(theta / 2) * np.sinc(theta / (2 * np.pi))


def _ahead(configuration: Array, dx: Array, dy: Array, turn: Array) -> Array:
    """The configuration (..., 3) displaced by (dx, dy) in its own axes and turned."""
    configuration = np.asarray(configuration, dtype=float)
    c, s = np.cos(configuration[..., 2]), np.sin(configuration[..., 2])
    return configuration + np.stack([c * dx - s * dy, s * dx + c * dy, turn], axis=-1)
