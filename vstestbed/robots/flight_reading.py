"""What a quadrotor's instruments read and its flight loops estimate, and the setpoints of its failsafe."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.attitude import Vector
from vstestbed.robots.reading import Reading

HOLD = np.zeros(4)
"""The setpoint that levels the craft and holds it where it is."""


def descend(speed_mps: float) -> Array:
    """The setpoint (4,) of a level vertical descent at a speed [m/s]."""
    return np.array([0.0, 0.0, -speed_mps, 0.0])


class Instruments(NamedTuple):
    """What the instruments read at one instant; plain floats, since the flight loops read them at 1 kHz.

    Attributes:
        gyro: body rates (3,) [rad/s]. force: specific force of the accelerometer, body axes (3,) [m/s^2].
        velocity: of the optical-flow instrument, body axes (3,) [m/s]. range_m: of the range finder that looks down, inf over nothing [m].
        voltage_v: of the battery, NaN where none is modelled [V].
    """

    gyro: Vector
    force: Vector
    velocity: Vector
    range_m: float
    voltage_v: float = math.nan


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
    """A quadrotor's reading at one instant: its range finder, and what its flight loops estimate from all instruments.

    Attributes:
        range_m: of the range finder that looks down, inf over nothing [m]. estimate: of the flight loops.
        voltage_v: of the battery, NaN where none is modelled [V].
    """

    range_m: float
    estimate: FlightEstimate
    voltage_v: float = math.nan

    @property
    def body_twist(self) -> Array:
        """(v, w) of the base in body axes (6,), estimated."""
        return np.concatenate([self.estimate.velocity, self.estimate.rates])
