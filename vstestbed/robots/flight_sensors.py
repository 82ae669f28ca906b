"""What the quadrotor's instruments make of MuJoCo's perfect sensors: noise, bias, scale error."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Literal

import numpy as np
from annotated_types import Gt, Le

from vstestbed.core.quantity import GRAVITY, PositiveGain, PositiveTime, Sigma
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec
from vstestbed.effects.base import Sensors, Vector
from vstestbed.robots.attitude import Imu, Level, to_body, to_level
from vstestbed.robots.flight import Instruments

# Ground-speed estimation: a noisy velocity sensor, filtered for use at the control rate.
#
# The sensor (optical flow with a range finder, or Doppler) measures the velocity in body axes. Two
# filters, both in the level frame, which turns with the heading at the rate r:
#
#   flow      fused with the accelerometer. With f = R_level_body a - (0, 0, g), the innovation
#             i = R_level_body v_measured - v and an estimated offset d:
#             v_dot = f - r z x v + 2 w i + d,  d_dot = w^2 i.
#             d absorbs the bias of the accelerometer and the error of the attitude, so v has no
#             steady error.
#   filtered  a first-order low pass: v_dot = i / tau, a trade of noise against lag.
#
# Reference: fixed-gain form of the observer of Hua 2010, doi:10.1016/j.conengprac.2010.01.016.


READING_S = 0.02
"""A flow sensor's exposure and period [s], 50 Hz, to which `sigma_mps` refers. The controller reads
faster, with noise of the same power spectrum.
"""


@spec
class Flow:
    """A velocity fused with the accelerometer.

    Args:
        sigma_mps: noise of a reading of 20 ms on each axis [m/s].
        scale_error: relative error of the scale, of the range by which a flow is multiplied [1].
        bandwidth: w [1/s], the crossover: the velocity sensor counts below it, the accelerometer
            above.
    """

    kind: Literal["flow"] = "flow"
    sigma_mps: Sigma = 0.03
    scale_error: Annotated[float, Gt(-1), Le(10)] = 0.0
    bandwidth: PositiveGain = 2.0


@spec
class Filtered:
    """A velocity through a low pass.

    Args:
        sigma_mps: noise of a reading of 20 ms on each axis [m/s].
        scale_error: relative error of the scale [1].
        tau_s: time constant of the low pass [s].
    """

    kind: Literal["filtered"] = "filtered"
    sigma_mps: Sigma = 0.03
    scale_error: Annotated[float, Gt(-1), Le(10)] = 0.0
    tau_s: PositiveTime = 0.1


VELOCITIES = Registry("velocity", Flow, Filtered)
Source = Flow | Filtered
VelocitySource = Annotated[Source, VELOCITIES]


Groundspeed = tuple[Vector, Vector, Vector]
"""Estimated velocity [m/s] and offset d [m/s^2] in the level frame, and acceleration [m/s^2] in
body axes, (3,) each.
"""
AT_REST: Groundspeed = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)


def step(
    state: Groundspeed,
    R: Level,
    reading: Instruments,
    yaw_rate: float,
    source: Source,
    dt: float,
) -> Groundspeed:
    """One step of the filter.

    R: R_level_body, estimated. yaw_rate: the level frame's rate about z [rad/s]. dt: [s].
    """
    (vx, vy, vz), (dx, dy, dz), _ = state
    mx, my, mz = to_level(R, reading.velocity)
    ix = mx - vx
    iy = my - vy
    iz = mz - vz
    if isinstance(source, Filtered):
        k = 1.0 / source.tau_s
        ax = k * ix
        ay = k * iy
        az = k * iz
        # v relaxes in the turning frame itself; only the acceleration handed on needs the frame's
        # rotation, r z x v.
        v = vx + ax * dt, vy + ay * dt, vz + az * dt
        return v, (dx, dy, dz), to_body(R, (ax - yaw_rate * vy, ay + yaw_rate * vx, az))
    fx, fy, fz = to_level(R, reading.force)
    w = source.bandwidth
    # Gains 2 w and w^2: the error's characteristic polynomial is (s + w)^2, critically damped.
    k = 2.0 * w
    j = w * w * dt
    ax = fx + k * ix + dx
    ay = fy + k * iy + dy
    az = fz - GRAVITY + k * iz + dz
    v = vx + (ax + yaw_rate * vy) * dt, vy + (ay - yaw_rate * vx) * dt, vz + az * dt
    return v, (dx + j * ix, dy + j * iy, dz + j * iz), to_body(R, (ax, ay, az))


def drawn_noise(
    imu: Imu, velocity: VelocitySource, range_sigma_m: float, rng: np.random.Generator
) -> Iterator[list[float]]:
    """Noise and bias (10,) of gyro, accelerometer, velocity and range, of one reading after the
    other.
    """
    # `sigma_mps` is that of a 20 ms reading; one of 1 ms has the same power spectrum with sqrt(20)
    # times as much.
    flow = velocity.sigma_mps * math.sqrt(READING_S / 0.001)
    sigmas = [imu.gyro_sigma_radps, imu.accel_sigma_mps2, flow, range_sigma_m]
    sigma = np.repeat(sigmas, [3, 3, 3, 1])
    bias = np.array([*imu.gyro_bias_radps, *imu.accel_bias_mps2, 0.0, 0.0, 0.0, 0.0])
    # drawn one by one, at 1 kHz, they would take as long as the rotors' mixer and its speed
    # controllers
    while True:
        yield from (sigma * rng.standard_normal((64, 10)) + bias).tolist()


def instruments(sensors: Sensors, noise: list[float], scale_error: float) -> Instruments:
    """The reading of perfect sensors by name (`voltage` [V] where there is one), with noise and
    bias (10,) and a scale error.
    """
    gx, gy, gz, fx, fy, fz, vx, vy, vz, e = noise
    wx, wy, wz = sensors["gyro"]
    ax, ay, az = sensors["accelerometer"]
    x, y, z = sensors["velocity"]
    scale = 1.0 + scale_error
    height = sensors["range"][0]
    return Instruments(
        (wx + gx, wy + gy, wz + gz),
        (ax + fx, ay + fy, az + fz),
        (x * scale + vx, y * scale + vy, z * scale + vz),
        math.inf if height < 0 else height + e,  # MuJoCo gives -1 where the ray hits nothing
        sensors["voltage"][0] if "voltage" in sensors else math.nan,
    )
