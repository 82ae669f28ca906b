"""The inertial measurement unit of the quadrotor."""

from __future__ import annotations

from vstestbed.core.quantity import Bias, Sigma
from vstestbed.core.spec import spec


@spec
class Imu:
    """Noise of each reading (at the control rate) and constant bias, in body axes.

    The defaults are an MPU-6000's by its data sheet (InvenSense 2013: .005 deg/s and 400 ug per root hertz, here over 500 Hz), with
    the bias that calibration leaves.

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
