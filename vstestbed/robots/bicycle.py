"""Kinematic bicycle model: a car whose wheels roll without slip, its limits, and its closed loop with a law.

With the frame under the middle of the rear axle, x forward, L the wheelbase and gamma the steering angle of the middle of the
front axle:

    x_dot = v cos(heading),  y_dot = v sin(heading),  heading_dot = w = v tan(gamma) / L

Places are (x, y, heading), shape (..., 3), [m, m, rad]; speeds and angles have the leading axes; a single car has none.

Reference: Corke 2017, Robotics, Vision & Control, eq. 4.2, doi:10.1007/978-3-319-54413-7.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.planar import moved

STANDSTILL = 1e-6
"""Below this speed [m/s] a car counts as standing: gamma = atan(L w / v) is undefined there."""


@dataclass(frozen=True, slots=True)
class BicycleLimits:
    """Limits of a car.

    Attributes:
        speed_mps, steering_rad: largest sizes of speed and steering angle.
        acceleration_mps2, steering_rate_radps: largest changes of both; infinity for a car that obeys at once.
    """

    speed_mps: float = 1.0
    steering_rad: float = 1.0
    acceleration_mps2: float = np.inf
    steering_rate_radps: float = np.inf


def steering_of(v: Array | float, w: Array | float, wheelbase: float) -> Array:
    """The steering angle for a speed v [m/s] and a yaw rate w [rad/s]: gamma = atan(L w / v), in [-pi/2, pi/2]."""
    v, w = np.asarray(v, dtype=float), np.asarray(w, dtype=float)
    # atan2(sign(v) L w, |v|) and not atan2(L w, v): in reverse that would point the wheels backwards. At v = 0 it is a quarter turn.
    return np.arctan2(np.where(v < 0, -w, w) * wheelbase, np.abs(v))


def yaw_rate(v: Array | float, steering: Array | float, wheelbase: float) -> Array:
    """The yaw rate w = v tan(gamma) / L [rad/s] of a speed [m/s] and a steering angle [rad]."""
    return np.asarray(v * np.tan(steering) / wheelbase)


def within_limits(v: Array | float, w: Array | float, held: Array | float, wheelbase: float, limits: BicycleLimits) -> tuple[Array, Array]:
    """The speed and steering angle that come nearest to a commanded (v, w) within a car's limits.

    A command that is too fast becomes a slower motion along the same arc. On an arc that is too tight the steering angle saturates,
    with the sign of the arc's curvature, and the speed stays as commanded. A car that is to stand, or to turn on the spot, keeps its
    steering angle `held`.

    Args:
        v, w: commanded speed [m/s] and yaw rate [rad/s], shape (...).
        held: the present steering angle, shape (...), [rad].
        wheelbase: L [m].
        limits: of the speed and of the steering angle.

    Returns:
        (v, gamma): speed [m/s] and steering angle [rad], shape (...) each.
    """
    steering = np.clip(steering_of(v, w, wheelbase), -limits.steering_rad, limits.steering_rad)
    # Else rest would straighten the wheels, or turn them to their stop, under a car that stands.
    steering = np.where(np.abs(v) < STANDSTILL, held, steering)
    # The angle is that of the arc before the speed is cut, so the yaw rate shrinks with the speed and the arc stays. In a bend that is
    # too tight the speed is not cut: a slower car turns no tighter, and keeping the yaw rate would take a faster one.
    return np.clip(v, -limits.speed_mps, limits.speed_mps), steering


def toward(now: Array, setpoint: Array, most: float) -> Array:
    """Rate limiter: `now` moved towards `setpoint` by `most` at the most."""
    return now + np.clip(setpoint - now, -most, most)


def rolled(place: Array, v: Array, steering: Array, wheelbase: float, duration: float) -> Array:
    """The place after `duration` [s] at constant speed and steering angle from `place` (..., 3): the exact arc."""
    v = np.asarray(v, dtype=float)
    motion = np.stack(np.broadcast_arrays(v, 0.0, yaw_rate(v, steering, wheelbase)), axis=-1)
    return moved(place, motion, duration)


@dataclass(frozen=True, slots=True)
class Drive:
    """Trajectory of the ideal bicycle, time along the first axis.

    Attributes:
        t: instants (T,) [s].
        place: (x, y, heading) (T, ..., 3); the heading is not wrapped.
        v, steering: held from each instant to the next, (T, ...) [m/s], [rad]; the last ones repeat.
    """

    t: Array
    place: Array
    v: Array
    steering: Array


def drive(
    law: Callable[[Array], tuple[Array, Array]],
    start: Array,
    wheelbase: float,
    limits: BicycleLimits,
    duration: float,
    period: float = 0.01,
) -> Drive:
    """Closed loop of a law and a bicycle that knows its place, rolls without slip, and follows commands within its limits.

    Args:
        law: maps places (..., 3) to commanded speed and yaw rate (v, w), shape (...) each.
        start: (x, y, heading), shape (..., 3); it stands, wheels straight.
        wheelbase: L [m].
        limits: of speed and steering angle, and of their rates.
        duration: how long [s].
        period: of the law; the motion between is an exact arc [s].
    """
    steps = round(duration / period)
    place = np.empty((steps + 1, *np.shape(start)))
    v, steering = np.zeros(place.shape[:-1]), np.zeros(place.shape[:-1])
    place[0] = start
    now_v, now_steering = v[0], steering[0]
    for k in range(steps):
        commanded = within_limits(*law(place[k]), now_steering, wheelbase, limits)
        now_v = toward(now_v, commanded[0], limits.acceleration_mps2 * period)
        now_steering = toward(now_steering, commanded[1], limits.steering_rate_radps * period)
        v[k], steering[k] = now_v, now_steering
        place[k + 1] = rolled(place[k], now_v, now_steering, wheelbase, period)
    v[-1], steering[-1] = now_v, now_steering
    return Drive(np.linspace(0.0, steps * period, steps + 1), place, v, steering)
