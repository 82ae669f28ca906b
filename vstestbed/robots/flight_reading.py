"""A quadrotor's sensor reading and onboard estimate, and the setpoints of its failsafe."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.reading import Reading

HOLD = np.zeros(4)
"""The setpoint that levels the craft and holds it where it is."""
ROTORS_OFF = np.array([0.0, 0.0, -math.inf, 0.0])
"""The setpoint that switches the rotors off for good: no finite climb rate can be mistaken for it."""


def descend(speed_mps: float) -> Array:
    """The setpoint (4,) of a level vertical descent at a speed [m/s]."""
    return np.array([0.0, 0.0, -speed_mps, 0.0])


@dataclass(frozen=True, slots=True)
class FlightEstimate:
    """State of the flight loops at one instant: estimates, and the references that each loop gives to the next.

    Attributes:
        velocity: in body axes (3,) [m/s]. rates: body rates without the gyro's bias (3,) [rad/s].
        ref_tilt: reference roll and pitch, from the velocity loop (2,) [rad]. ref_rates: reference body rates, from the attitude loop
            (3,) [rad/s].
        rotor_limit_s: for how long a rotor has been at its limit [s].
        overturned: tilted beyond 60 degrees, or still levelling after that. stands: its feet carry its weight.
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
    """Sensor readings of a quadrotor at one instant, and the estimate that its flight loops derive from them.

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
        """(v, w) of the base in body axes (6,): from the estimate, or from the raw sensors of a reading without one."""
        # The estimate first: it has the gyro's bias removed, and less noise than one flow reading of a millisecond.
        if self.estimate is None:
            return np.concatenate([self.velocity, self.gyro])
        return np.concatenate([self.estimate.velocity, self.estimate.rates])
