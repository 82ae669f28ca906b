"""A robot's sensor reading at one instant."""

from __future__ import annotations

from dataclasses import dataclass

from vstestbed.core.geometry import Array


@dataclass(frozen=True, slots=True)
class Reading:
    """Proprioception: joint encoders, and the two quantities of orientation that an observer can use.

    A robot with more sensors has a subclass with more fields (`FlightReading`).

    Attributes:
        q, qd: joint positions and velocities [rad, rad/s], shape (n,) each.
        heading: by a compass, from the world's x axis, counter-clockwise [rad]; None without one.
        tilt: estimated roll and pitch, shape (2,) [rad]; None where the robot estimates none.
    """

    q: Array
    qd: Array
    heading: float | None = None
    tilt: Array | None = None
