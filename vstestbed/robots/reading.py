"""What a robot measures of itself at one instant."""

from __future__ import annotations

from dataclasses import dataclass

from vstestbed.core.geometry import Array


@dataclass(frozen=True, slots=True)
class Reading:
    """Proprioception: joint encoders, and the two quantities that an observer can use of any robot.

    A robot with more instruments has a reading of its own with more fields (`FlightReading`).

    Attributes:
        q, qd: its joints [rad, rad/s], shape (n,) each.
        heading: of a robot with a compass, from the world's x axis, counter-clockwise [rad].
        tilt: of a robot that estimates its attitude, roll and pitch, shape (2,) [rad].
    """

    q: Array
    qd: Array
    heading: float | None = None
    tilt: Array | None = None
