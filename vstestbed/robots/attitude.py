"""Attitude estimation: the complementary filter of Mahony et al. for gyro and accelerometer, on the
sphere of directions.

The estimate is z, the world's up in body axes, unit: (-sin pitch, cos pitch sin roll, cos pitch cos
roll). An IMU has no reference for heading, which is left out. With the gyro's reading w, its bias b
and the measured up a / |a|:

    e = a / |a| x z,   z_dot = z x (w - b + k_p e),   b_dot = -k_i e.

An accelerometer measures specific force, a = up g + acceleration, which in flight is nearly the
thrust alone. It indicates the tilt only averaged over times in which accelerations cancel; hence a
low gain. Where a velocity is measured, its rate is first subtracted from a (`acceleration`):
without that a step to 2 m/s disturbs the estimate by 5 degrees, and the velocity, levelled with it,
overshoots by a quarter.

Reference: Mahony, Hamel & Pflimlin 2008, doi:10.1109/TAC.2008.923738, the passive filter on one
direction; Martin & Salaun 2010, doi:10.1109/ROBOT.2010.5509980, on what an accelerometer measures;
Hua 2010, doi:10.1016/j.conengprac.2010.01.016, on the use of a velocity.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from vstestbed.core.quantity import GRAVITY, Bias, GainOrZero, PositiveGain, Sigma
from vstestbed.core.spec import spec
from vstestbed.effects.base import Vector

Level = tuple[float, float, float, float, float, float, float, float, float]
"""R_level_body (3, 3) row by row: from body axes to the level frame, which has z up and the body's
heading; its yx is always 0.

Vectors and matrices are plain floats, and equations written out: they run at 1 kHz, where numpy's
overhead for three numbers would be most of the time.
"""


@spec
class Filter:
    """Gains of the attitude filter.

    Args:
        gain: k_p [1/s]: the accelerometer corrects the gyro over times longer than 1 / gain.
        bias_gain: k_i [1/s^2], for the gyro's bias.
        acceleration: `imu` uses the accelerometer as it is, `velocity` subtracts the rate of the
            measured velocity from it.
    """

    gain: PositiveGain = 0.5
    bias_gain: GainOrZero = 0.05
    acceleration: Literal["imu", "velocity"] = "velocity"


class Attitude(NamedTuple):
    """The filter's state: `up` in body axes (3,), unit, and the gyro's `bias` (3,) [rad/s]."""

    up: Vector = (0.0, 0.0, 1.0)
    bias: Vector = (0.0, 0.0, 0.0)

    @property
    def roll(self) -> float:
        """Roll [rad], R_level_body = Ry(pitch) Rx(roll)."""
        return math.atan2(self.up[1], self.up[2])

    @property
    def pitch(self) -> float:
        """Pitch [rad]."""
        # Rounding may leave a unit vector's part a little over 1, which asin refuses; `tilt`
        # likewise.
        return -math.asin(max(-1.0, min(1.0, self.up[0])))

    @property
    def tilt(self) -> float:
        """Angle between the body's z and the world's [rad]."""
        return math.acos(max(-1.0, min(1.0, self.up[2])))


def step(
    state: Attitude, gyro: Vector, force: Vector, acceleration: Vector, filter: Filter, dt: float
) -> Attitude:
    """One step of the filter.

    gyro: angular velocity in body axes (3,) [rad/s]. force: the accelerometer's reading in body
    axes (3,) [m/s^2]: (0, 0, g) at rest.
    acceleration: known acceleration in body axes (3,) [m/s^2], subtracted from the reading; zeros
    where none is known. dt: [s].
    """
    (x, y, z), (bx, by, bz) = state
    fx, fy, fz = force
    kx, ky, kz = acceleration
    gx, gy, gz = gyro
    ax = fx - kx
    ay = fy - ky
    az = fz - kz
    size = math.sqrt(ax * ax + ay * ay + az * az)
    ex = ey = ez = 0.0
    # beyond (free fall, a hard pull) the direction is mostly not gravity's
    if 0.5 * GRAVITY < size < 1.5 * GRAVITY:
        ex = (ay * z - az * y) / size
        ey = (az * x - ax * z) / size
        ez = (ax * y - ay * x) / size
    k = filter.gain
    wx = gx - bx + k * ex
    wy = gy - by + k * ey
    wz = gz - bz + k * ez
    dx = (y * wz - z * wy) * dt
    dy = (z * wx - x * wz) * dt
    dz = (x * wy - y * wx) * dt
    # z turns by the second-order series of exp(-[w] dt): |w|^3 dt^2 t / 6 of error; the first order
    # would have |w|^2 dt t / 2.
    h = 0.5 * dt
    x = x + dx + h * (dy * wz - dz * wy)
    y = y + dy + h * (dz * wx - dx * wz)
    z = z + dz + h * (dx * wy - dy * wx)
    n = 1.0 / math.sqrt(x * x + y * y + z * z)
    i = filter.bias_gain * dt
    return Attitude((x * n, y * n, z * n), (bx - i * ex, by - i * ey, bz - i * ez))


def level(up: Vector) -> Level:
    """R_level_body = Ry(pitch) Rx(roll) for an `up` (3,). With the nose straight up or down, roll
    is taken as 0.
    """
    x, y, z = up
    sp = -x  # sine and cosine of pitch, and of roll
    cp = math.hypot(y, z)
    sr = 0.0
    cr = 1.0
    if cp > 1e-6:
        sr = y / cp
        cr = z / cp
    return cp, sp * sr, sp * cr, 0.0, cr, -sr, -sp, cp * sr, cp * cr


def to_level(R: Level, v: Vector) -> Vector:
    """A vector (3,) of body axes in the level frame: R v."""
    xx, xy, xz, _, yy, yz, zx, zy, zz = R
    x, y, z = v
    return xx * x + xy * y + xz * z, yy * y + yz * z, zx * x + zy * y + zz * z


def to_body(R: Level, v: Vector) -> Vector:
    """A vector (3,) of the level frame in body axes: R^T v."""
    xx, xy, xz, _, yy, yz, zx, zy, zz = R
    x, y, z = v
    return xx * x + zx * z, xy * x + yy * y + zy * z, xz * x + yz * y + zz * z


def heading_rate(R: Level, rates: Vector) -> float:
    """Rate of the heading [rad/s], (w_y sin roll + w_z cos roll) / cos pitch, of body rates w (3,)
    [rad/s].

    Bounded near a pitch of 90 degrees.
    """
    xx, _, _, _, yy, yz, _, _, _ = R
    return (yy * rates[2] - yz * rates[1]) / (xx if xx > 0.1 else 0.1)


@spec
class Imu:
    """Noise of each reading (at the control rate) and constant bias, in body axes.

    The defaults are an MPU-6000's by its data sheet (InvenSense 2013: .005 deg/s and 400 ug per
    root hertz, here over 500 Hz), with the bias that calibration leaves.

    Args:
        gyro_sigma_radps: standard deviation of the gyro's noise on each axis [rad/s].
        gyro_bias_radps: the gyro's bias (x, y, z) [rad/s].
        accel_sigma_mps2: standard deviation of the accelerometer's noise on each axis [m/s^2].
        accel_bias_mps2: the accelerometer's bias (x, y, z) [m/s^2].
    """

    gyro_sigma_radps: Sigma = 0.002
    gyro_bias_radps: Bias = (0.003, -0.002, 0.001)
    accel_sigma_mps2: Sigma = 0.09
    accel_bias_mps2: Bias = (0.05, -0.03, 0.08)
