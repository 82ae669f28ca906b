"""What the quadrotor's instruments make of MuJoCo's perfect sensors: noise, bias, scale error."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from vstestbed.robots.flight_reading import Instruments
from vstestbed.robots.groundspeed import READING_S, VelocitySource
from vstestbed.robots.imu import Imu

READINGS_AHEAD = 64
"""For how many readings noise is drawn at once."""


def drawn_noise(imu: Imu, velocity: VelocitySource, range_sigma_m: float, rng: np.random.Generator) -> Iterator[list[float]]:
    """Noise and bias (10,) of gyro, accelerometer, velocity and range, of one reading after the other."""
    # `sigma_mps` is that of a 20 ms reading; one of 1 ms has the same power spectrum with sqrt(20) times as much.
    flow = velocity.sigma_mps * math.sqrt(READING_S / 0.001)
    sigma = np.repeat([imu.gyro_sigma_radps, imu.accel_sigma_mps2, flow, range_sigma_m], [3, 3, 3, 1])
    bias = np.array([*imu.gyro_bias_radps, *imu.accel_bias_mps2, 0.0, 0.0, 0.0, 0.0])
    while True:  # drawn one by one, at 1 kHz, they would take as long as the rotors' mixer and its speed controllers
        yield from (sigma * rng.standard_normal((READINGS_AHEAD, 10)) + bias).tolist()


def instruments(sensors: Mapping[str, list[float]], noise: list[float], scale_error: float) -> Instruments:
    """The reading of perfect sensors by name (`voltage` [V] where there is one), with noise and bias (10,) and a scale error."""
    gx, gy, gz, fx, fy, fz, vx, vy, vz, e = noise
    (wx, wy, wz), (ax, ay, az), (x, y, z) = sensors["gyro"], sensors["accelerometer"], sensors["velocity"]
    scale, height = 1.0 + scale_error, sensors["range"][0]
    return Instruments(
        (wx + gx, wy + gy, wz + gz),
        (ax + fx, ay + fy, az + fz),
        (x * scale + vx, y * scale + vy, z * scale + vz),
        math.inf if height < 0 else height + e,  # MuJoCo gives -1 where the ray hits nothing
        sensors["voltage"][0] if "voltage" in sensors else math.nan,
    )
