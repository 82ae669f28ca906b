"""A car: bicycle kinematics both ways, its onboard servos, odometry of the rear wheels, a compass.

Its frame stands on the floor under the middle of the rear axle, x forward. It moves with u = (v, w) of that frame: it cannot go
sideways, and cannot turn on the spot. The setpoint is (speed [m/s], steering angle [rad]); `actuate` moves both there no faster than
a motor and a steering gear do. The body is in models/car.xml; a test holds the file and this together.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.robots.allocation import Allocation, Limit, Mount
from vstestbed.robots.bicycle import STANDSTILL, BicycleLimits, within_limits, yaw_rate
from vstestbed.robots.ground import PLANE, GroundStart, Vehicle
from vstestbed.robots.reading import Reading

WHEELBASE, TRACK, RADIUS = 1.0, 0.6, 0.15
"""[m], those of the model."""
SPEED_INTEGRAL = 8.0
"""Integral gain of the speed servo [1/s]: against the motor loop's offset under rolling resistance, .005 m/s. Slower than that loop,
whose time constant is .03 s, by four."""
INTEGRAL_LIMIT = 1.0
"""Most that the integral adds [rad/s of the wheels]: it does not wind up against a wall."""

_STEERING, _REAR = 0, slice(3, 5)
"""Where `Car.joints` has the steering and the rear wheels."""


@spec
class Compass:
    """An electronic compass: heading = true heading + bias_deg + noise of sigma_deg, white from reading to reading [deg]."""

    bias_deg: Annotated[float, Ge(-180), Le(180)] = 0.0
    sigma_deg: Annotated[float, Ge(0), Le(90)] = 0.5


@spec
class CarLimits:
    """What the onboard servos allow.

    Args:
        speed_mps: largest speed, forward and in reverse [m/s]. At 3 a hard bend is a slide.
        steering_rad: largest steering angle of the middle of the front axle [rad].
        acceleration_mps2: how fast the speed setpoint is followed [m/s^2]; the rear tyres hold about 3.
        steering_rate_radps: how fast the steering setpoint is followed [rad/s].
    """

    speed_mps: Annotated[float, Gt(0), Le(3)] = 1.0
    steering_rad: Annotated[float, Gt(0), Le(1)] = 1.0
    acceleration_mps2: Annotated[float, Gt(0), Le(2.5)] = 1.5
    steering_rate_radps: Annotated[float, Gt(0), Le(4)] = 2.0

    def bicycle(self) -> BicycleLimits:
        """The same for the ideal bicycle: `vstestbed.robots.bicycle.drive`."""
        return BicycleLimits(self.speed_mps, self.steering_rad, self.acceleration_mps2, self.steering_rate_radps)


@dataclass(frozen=True, slots=True)
class CarServos:
    """The onboard memory: where speed [m/s] and steering [rad] setpoints are on their way, and the speed loop's integral [rad/s]."""

    speed: float = 0.0
    steering: float = 0.0
    integral: float = 0.0


@spec
class Car(Vehicle):
    """A buggy of 60 kg with Ackermann steering and rear drive.

    Args:
        start: where the middle of its rear axle starts on the floor, and its heading.
        compass: errors of its compass.
        wheel_radius_error: relative error of the wheel radius that it believes in, in its speed servo and its odometry: .02 for 2 %
            too large.
        limits: of its speed, its steering angle and their rates.
    """

    kind: Literal["car"] = "car"
    start: GroundStart = GroundStart()
    compass: Compass = Compass()
    wheel_radius_error: Annotated[float, Gt(-0.5), Lt(1)] = 0.0
    limits: CarLimits = CarLimits()
    actuators: ClassVar[tuple[str, ...]] = ("drive", "steering")
    sensors: ClassVar[tuple[str, ...]] = ("heading",)
    ends_m: ClassVar[tuple[float, float]] = (-0.188, 1.208)
    """Where its bumpers end, behind and ahead of its origin [m]."""
    control_period_s: ClassVar[float | None] = 0.01

    @property
    def model(self) -> str:
        """Its file."""
        return "car.xml"

    @property
    def joints(self) -> tuple[str, ...]:
        """Steering and wheels."""
        return (
            *("steering", "front_left_steer", "front_right_steer"),
            *("rear_left", "rear_right", "front_left", "front_right"),
        )

    @property
    def turning_radius_m(self) -> float:
        """Of its tightest circle, of the middle of the rear axle: L / tan(steering) [m]."""
        return WHEELBASE / math.tan(self.limits.steering_rad)

    @property
    def top_speed_mps(self) -> float:
        """[m/s]."""
        return self.limits.speed_mps

    @property
    def believed_radius(self) -> float:
        """The wheel radius that it believes in [m]."""
        return RADIUS * (1 + self.wheel_radius_error)

    def randomised(self, rng: np.random.Generator) -> Car:
        """The same car with a start drawn from the box. ParameterError when it has none."""
        return dataclasses.replace(self, start=self.start.drawn(rng))

    def started_at(self, configuration: Array) -> Car:
        """The same car from another place (x, y, heading)."""
        return dataclasses.replace(self, start=self.start.at(configuration))

    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """Camera twists of (v, w) of the base, shape (6, 2), for any mount."""
        return mount.to_camera @ PLANE[:, [0, 2]]

    def measured(self, q: Array, qd: Array, sensors: Mapping[str, Array], rng: np.random.Generator) -> Reading:
        """Exact encoders, and the compass: the direction of the base's true x axis with bias and noise, in [-pi, pi)."""
        x, y = sensors["heading"][:2]
        error = math.radians(self.compass.bias_deg + self.compass.sigma_deg * rng.standard_normal())
        return Reading(q, qd, heading=(math.atan2(y, x) + error + math.pi) % (2 * math.pi) - math.pi)

    def odometry(self, before: Reading, now: Reading, duration: float) -> Array:
        """Mean motion (vx, 0, wz), shape (3,), of the base between two readings of its encoders.

        v = r (left + right) / 2,  w = r (right - left) / track, of the rear wheels' speeds and the radius that it believes in.

        Of the rear wheels, not v tan(steering) / L: where tyres hold they roll without side slip, and the result is exact however the
        steering moves meanwhile; the front ones slip sideways a little. Where a wheel spins both are wrong.
        """
        if duration <= 0:
            return np.zeros(3)
        left, right = (now.q[_REAR] - before.q[_REAR]) * (self.believed_radius / duration)
        return np.array([(left + right) / 2, 0.0, (right - left) / TRACK])

    def measured_twist(self, before: Reading, now: Reading, duration: float, ordered: Array, mount: Mount) -> Array:
        """Mean camera twist (6,) between two readings, from the encoders alone; zero where no time has passed."""
        return mount.to_camera @ (PLANE @ self.odometry(before, now, duration))

    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """Speed [m/s] and steering angle [rad] for a camera twist (6,), as `bicycle.within_limits` has it.

        Of the base's twist only (v, w) can be made; the rest is left out, and `twist` is without it. `scale` is the part of the speed
        that is left ("speed") or of the turn, where the arc is too tight ("joint_limit": the steering is at its end), or 0
        for a turn on the spot ("singular"); of several the smallest. A car that shall stand keeps its steering as measured.
        """
        v, w = (PLANE[:, [0, 2]].T @ (mount.to_flange @ twist)).tolist()
        held = float(reading.q[_STEERING])
        speed, steering = (float(x) for x in within_limits(v, w, held, WHEELBASE, self.limits.bicycle()))
        turn = float(yaw_rate(speed, steering, WHEELBASE)) if abs(speed) >= STANDSTILL else 0.0
        scale, limit = 1.0, ""
        if abs(v) < STANDSTILL:
            scale, limit = (1.0, "") if abs(w) < STANDSTILL else (0.0, "singular")
        else:
            scale, limit = _smallest(speed / v, turn / w if abs(w) > STANDSTILL else 1.0)
        made = mount.to_camera @ (PLANE @ np.array([speed, 0.0, turn]))
        return Allocation(setpoint=np.array([speed, steering]), twist=made, scale=scale, limit=limit)

    def begin(self) -> CarServos:
        """It stands, wheels straight."""
        return CarServos()

    def actuate(self, memory: CarServos, setpoint: Array, reading: Reading, dt: float) -> tuple[CarServos, Array]:
        """One period dt [s] of the speed and steering servos: the next memory, and ctrl (2,): wheels [rad/s], steering [rad].

        Both setpoints are approached at the limits' rates. The speed has an integral of its error, measured at the rear wheels' mean
        speed; a car that shall stand has none: its motor holds it.
        """
        limits = self.limits
        v, angle = setpoint.tolist()
        speed = memory.speed + _within(_within(v, limits.speed_mps) - memory.speed, limits.acceleration_mps2 * dt)
        turn = _within(angle, limits.steering_rad) - memory.steering
        steering = memory.steering + _within(turn, limits.steering_rate_radps * dt)
        wheels = speed / self.believed_radius
        error = wheels - sum(reading.qd[_REAR].tolist()) / 2
        integral = _within(memory.integral + SPEED_INTEGRAL * error * dt, INTEGRAL_LIMIT) if speed else 0.0
        return CarServos(speed, steering, integral), np.array([wheels + integral, steering])


def _within(x: float, most: float) -> float:
    """x, or the end of [-most, most] that is nearest."""
    return max(-most, min(most, x))


def _smallest(of_speed: float, of_turn: float) -> tuple[float, Limit]:
    """The scale of an allocation and its limit's name, from what is left of the speed and of the turn."""
    if of_turn < of_speed - 1e-9:
        return of_turn, "joint_limit"
    return (of_speed, "speed") if of_speed < 1 else (1.0, "")
