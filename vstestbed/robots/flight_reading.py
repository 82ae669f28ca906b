"""What a quadrotor measures and estimates on board, and the setpoints that are no law's."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.reading import Reading

HOLD = np.zeros(4)
"""The setpoint that levels the craft and holds it where it is."""
ROTORS_OFF = np.array([0.0, 0.0, -math.inf, 0.0])
"""The setpoint of a craft that has landed: it sinks no deeper, rotors run out and stay off."""


def descend(speed_mps: float) -> Array:
    """The setpoint (4,) that levels the craft and lets it sink at a speed [m/s]."""
    return np.array([0.0, 0.0, -speed_mps, 0.0])


@dataclass(frozen=True, slots=True)
class FlightEstimate:
    """What the flight loops know at one instant.

    Attributes:
        velocity: in body axes (3,) [m/s]. rates: body rates without the gyro's bias (3,) [rad/s].
        ref_tilt: roll and pitch that the velocity loop asks for (2,) [rad]. ref_rates: rates that the attitude loop asks for (3,) [rad/s].
        rotor_limit_s: for how long a rotor has been at its limit [s].
        overturned: tilted beyond 60 degrees, or on the way back from there. stands: on something that bears it.
    """

    velocity: Array
    rates: Array
    ref_tilt: Array
    ref_rates: Array
    rotor_limit_s: float
    overturned: bool
    stands: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightReading(Reading):
    """What a quadrotor's instruments tell at one instant, and what its flight loops make of it.

    Attributes:
        gyro: body rates (3,) [rad/s]. force: specific force of the accelerometer, body axes (3,) [m/s^2].
        velocity: of the optical-flow instrument, body axes (3,) [m/s]. range_m: of the range finder that looks down, inf over nothing [m].
        estimate: of the flight loops; None in a raw reading, before `Quadrotor.reported`.
    """

    gyro: Array
    force: Array
    velocity: Array
    range_m: float
    estimate: FlightEstimate | None = None

    @property
    def body_twist(self) -> Array:
        """(v, w) of the base in body axes (6,): by the flight loops' estimate, of a raw reading by the instruments."""
        if self.estimate is None:
            return np.concatenate([self.velocity, self.gyro])
        return np.concatenate([self.estimate.velocity, self.estimate.rates])
