"""Vibration of the quadrotor's inertial measurement unit by its rotors."""

from __future__ import annotations

import math
from typing import Annotated

from annotated_types import Ge, Le

from vstestbed.core.quantity import Sigma
from vstestbed.core.spec import spec
from vstestbed.effects.base import Four, Vector


@spec
class Vibration:
    """Tones of the rotors and broadband noise at the IMU, as the accelerometer and the gyro meet them.

    A rotor at angle phi and speed w adds (w / w_hover)^2 times: its imbalance, which turns with it, (a cos phi, a sin phi, 0), the blades'
    thrust that pulses as each passes an arm, (0, 0, p cos n phi), and the rates that these make, (g cos phi, g sin phi, 0). Sampling at
    1 kHz shows tones over 500 Hz at their alias, as an IMU without a filter does. It is not seen in the pictures: the mount is taken to
    isolate the camera. An autopilot calls standard deviations under 30 m/s^2 acceptable, and under 15 normal (ArduPilot, "Measuring
    vibration"); the default has 3 along x and y, 4 along z; the share of each part is chosen.

    Args:
        imbalance_mps2: a, amplitude of one rotor's imbalance at hover [m/s^2].
        blade_pass_mps2: p, amplitude of one rotor's pulses of thrust at hover [m/s^2].
        gyro_radps: g, amplitude of one rotor's rates at hover [rad/s].
        blades: n, of a rotor.
        accel_sigma_mps2: standard deviation of broadband noise on each axis of the accelerometer, beside its own [m/s^2].
        gyro_sigma_radps: standard deviation of the same of the gyro [rad/s].

    Reference: ArduPilot documentation, Measuring Vibration, ardupilot.org/copter/docs/common-measuring-vibration.html.
    """

    imbalance_mps2: Sigma = 2.0
    blade_pass_mps2: Sigma = 2.5
    gyro_radps: Sigma = 0.02
    blades: Annotated[int, Ge(1), Le(12)] = 2
    accel_sigma_mps2: Sigma = 0.5
    gyro_sigma_radps: Sigma = 0.005

    def at(self, angles: Four, W: Four, hover: float, noise: list[float]) -> tuple[Vector, Vector]:
        """What is added to the accelerometer (3,) [m/s^2] and to the gyro (3,) [rad/s].

        angles, W: of the rotors, (4,) [rad] and squared speeds [(rad/s)^2]. hover: W at hover. noise: six normal numbers.
        """
        x = y = z = 0.0
        for phi, share in zip(angles, W, strict=True):
            x += share * math.cos(phi)
            y += share * math.sin(phi)
            z += share * math.cos(self.blades * phi)
        a, p, g = self.imbalance_mps2 / hover, self.blade_pass_mps2 / hover, self.gyro_radps / hover
        i, j, k, u, v, w = noise
        s, r = self.accel_sigma_mps2, self.gyro_sigma_radps
        return (a * x + s * i, a * y + s * j, p * z + s * k), (g * x + r * u, g * y + r * v, r * w)
