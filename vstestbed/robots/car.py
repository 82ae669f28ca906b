"""A car: bicycle kinematics both ways, onboard servos, odometry of the rear wheels, a compass.

Its frame lies on the floor under the middle of the rear axle, x forward. It moves with u = (v, w) of that frame: it can neither go
sideways nor turn on the spot. The setpoint is (speed [m/s], steering angle [rad]); `actuate` approaches both within their rate limits.
The body is in models/car.xml, which `parameters` changes (`car_body.CarParameters`), and its imperfections (`worn_vehicle`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import AngleWidth, Narrower, PositiveRate, PositiveSpeed
from vstestbed.core.spec import spec
from vstestbed.robots.allocation import Allocation, Limit, Mount
from vstestbed.robots.bicycle import STANDSTILL, BicycleLimits, within_limits, yaw_rate
from vstestbed.robots.body import Change, Loosen, Scale, Set
from vstestbed.robots.car_body import BUGGY, CarParameters
from vstestbed.robots.ground import PLANE, GroundStart
from vstestbed.robots.own_model import OwnModel
from vstestbed.robots.reading import Reading
from vstestbed.robots.realism import Level
from vstestbed.robots.tyres import Tyres
from vstestbed.robots.vehicle_presets import CAR
from vstestbed.robots.wheels import WHEELS
from vstestbed.robots.worn_vehicle import WornVehicle

SPEED_INTEGRAL = 8.0
"""Integral gain of the speed servo [1/s]. It removes the offset of .005 m/s that rolling resistance leaves in the motor loop, and is
four times as slow as that loop, whose time constant is .03 s."""
INTEGRAL_LIMIT = 1.0
"""Bound of the integral [rad/s of the wheels]: anti-windup, for a car that is held up by a wall."""

_STEERING, _REAR = 0, slice(3, 5)
"""Indices of the steering and of the rear wheels in `Car.joints`."""


@spec
class Compass:
    """An electronic compass: heading = true heading + bias + noise, white from reading to reading.

    Args:
        bias_deg: constant error [deg]; e.g. `2`.
        sigma_deg: standard deviation of the noise [deg].
    """

    bias_deg: Annotated[float, Ge(-180), Le(180)] = 0.0
    sigma_deg: Annotated[float, Ge(0), Le(90)] = 0.5


@spec
class CarLimits:
    """Limits of the onboard servos.

    Args:
        speed_mps: largest speed, forward and in reverse [m/s]. At 3 m/s the car slides in a tight bend.
        steering_rad: largest steering angle of the middle of the front axle [rad].
        acceleration_mps2: how fast the speed setpoint is followed [m/s^2]; the rear tyres hold about 3.
        steering_rate_radps: how fast the steering setpoint is followed [rad/s].
    """

    speed_mps: Annotated[PositiveSpeed, Narrower(le=3)] = 1.0
    steering_rad: Annotated[float, Ge(1e-6), Le(1)] = 1.0
    acceleration_mps2: Annotated[float, Ge(1e-6), Le(2.5)] = 1.5
    steering_rate_radps: Annotated[PositiveRate, Narrower(le=4)] = 2.0

    def bicycle(self) -> BicycleLimits:
        """The same for the ideal bicycle: `vstestbed.robots.bicycle.drive`."""
        return BicycleLimits(self.speed_mps, self.steering_rad, self.acceleration_mps2, self.steering_rate_radps)


@dataclass(frozen=True, slots=True)
class CarServos:
    """State of the onboard servos: rate-limited speed [m/s] and steering [rad], the speed loop's integral [rad/s], the drive [rad/s]."""

    speed: float = 0.0
    steering: float = 0.0
    integral: float = 0.0
    drive: float = 0.0


@spec
class Car(WornVehicle):
    """A buggy, of 60 kg by default, with Ackermann steering and rear drive.

    Args:
        parameters: mass, wheels and motor, which the car knows.
        start: where the middle of its rear axle starts on the floor, and its heading.
        compass: errors of its compass.
        wheel_radius_error: relative error of the calibrated wheel radius, which its speed servo and its odometry use [1]: .02 for 2 %
            too large.
        limits: of its speed, its steering angle and their rates.
        tyres: that slip; none: friction alone; e.g. `{stiffness: 10, relaxation_m: 0.15}`.
        steering_play_deg: how far the steering's servo turns from one end of its play to the other before the wheels follow [deg];
            none: no play; e.g. `1`.
    """

    kind: Literal["car"] = "car"
    parameters: CarParameters = BUGGY
    start: GroundStart = GroundStart()
    compass: Compass = Compass()
    wheel_radius_error: Annotated[float, Gt(-0.5), Lt(1)] = 0.0
    limits: CarLimits = CarLimits()
    tyres: Tyres | None = None
    steering_play_deg: Annotated[AngleWidth, Narrower(le=20)] | None = None
    presets: ClassVar[Mapping[Level, Mapping[str, object]]] = CAR
    actuators: ClassVar[tuple[str, ...]] = ("drive", "steering")
    sensors: ClassVar[tuple[str, ...]] = ("heading",)
    control_period_s: ClassVar[float | None] = 0.01
    motion_names: ClassVar[tuple[str, ...]] = ("v", "w")

    def __post_init__(self) -> None:
        """Refuse limits that its wheels and its motor cannot keep."""
        body, limits = self.parameters, self.limits
        if limits.steering_rad > body.most_steering_rad:
            words = f"must be at most {math.floor(1e3 * body.most_steering_rad) / 1e3:g} rad at track_m {body.track_m:g} and wheelbase_m"
            words = f"{words} {body.wheelbase_m:g}: the inner front wheel would turn beyond 71 degrees, into the chassis"
            raise ParameterError("limits.steering_rad", words, limits.steering_rad)
        if (need := body.torque_for(limits.acceleration_mps2, self.rolling_resistance)) > body.motor_torque_nm:
            most = limits.acceleration_mps2 - (need - body.motor_torque_nm) / (body.mass_kg * body.wheel_radius_m)
            words = (
                f"must be at least {need:.3g} Nm for limits.acceleration_mps2 {limits.acceleration_mps2:g} with mass_kg {body.mass_kg:g}"
            )
            other = f"; or lower that acceleration to {most:.2g} m/s^2" if most > 0.01 else ""
            raise ParameterError("parameters.motor_torque_nm", f"{words}{other}", body.motor_torque_nm)

    @property
    def model(self) -> str:
        """Its file."""
        return "car.xml"

    @property
    def body_changes(self) -> tuple[Change, ...]:
        """Those of its parameters and of its imperfections."""
        found = list(self.parameters.changes)
        if self.rolling_resistance is not None:
            found += self.parameters.rolling(self.rolling_resistance)
        if self.wheel_spread is not None:
            found += [
                Scale("geom", "size", (factor, 1.0, factor), f"{name}_wheel")
                for name, factor in zip(WHEELS, self.wheel_spread.factors, strict=True)
            ]
        if self.tyres is not None:  # the floor carries a wheel, and the tyre alone holds it
            found += [Set("geom", f"{name}_contact", "condim", 1) for name in WHEELS]
        if self.steering_play_deg:
            found.append(Loosen("steering", math.radians(self.steering_play_deg)))
        return tuple(found)

    @property
    def ends_m(self) -> tuple[float, float]:
        """The x of its rear and its front bumper [m]."""
        return self.parameters.ends_m

    @property
    def joints(self) -> tuple[str, ...]:
        """Steering and wheels."""
        return (
            *("steering", "front_left_steer", "front_right_steer"),
            *("rear_left", "rear_right", "front_left", "front_right"),
        )

    @property
    def joint_limits(self) -> Array:
        """No wheel is steered across the car's way; the wheels turn without end."""
        return np.array([[-math.pi / 2, math.pi / 2]] * 3 + [[-np.inf, np.inf]] * 4)

    @property
    def turning_radius_m(self) -> float:
        """Of its tightest circle, of the middle of the rear axle: L / tan(steering) [m]."""
        return self.parameters.wheelbase_m / math.tan(self.limits.steering_rad)

    @property
    def top_speed_mps(self) -> float:
        """[m/s]."""
        return self.limits.speed_mps

    @property
    def believed_radius(self) -> float:
        """The calibrated wheel radius, with its error [m]."""
        return self.parameters.wheel_radius_m * (1 + self.wheel_radius_error)

    def started_at(self, configuration: Array) -> Car:
        """The same car from another place (x, y, heading)."""
        return dataclasses.replace(self, start=self.start.at(configuration))

    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """Camera twists of (v, w) of the base, shape (6, 2), for any mount."""
        return mount.to_camera @ PLANE[:, [0, 2]]

    @property
    def motion_limits(self) -> tuple[Array, Array]:
        """Its speed, and the yaw rate on its tightest circle; its servos' acceleration, and v / L times the rate of its steering."""
        v, limits = self.limits.speed_mps, self.limits
        turn = v * limits.steering_rate_radps / self.parameters.wheelbase_m
        return np.array([v, v / self.turning_radius_m]), np.array([limits.acceleration_mps2, turn])

    def own_model(self, reading: Reading, mount: Mount) -> OwnModel:
        """(v, w), with the tightest circle."""
        return dataclasses.replace(super().own_model(reading, mount), turning_radius_m=self.turning_radius_m)

    @property
    def draws_heading(self) -> bool:
        """The noise of its compass."""
        return self.compass.sigma_deg > 0

    def measured(self, q: Array, qd: Array, sensors: Mapping[str, list[float]], noise: np.random.Generator) -> Reading:
        """Exact encoders, and the compass: the direction of the base's true x axis with bias and noise, in [-pi, pi)."""
        x, y = sensors["heading"][:2]
        error = math.radians(self.compass.bias_deg + self.compass.sigma_deg * noise.standard_normal())
        return Reading(q, qd, heading=(math.atan2(y, x) + error + math.pi) % (2 * math.pi) - math.pi)

    @property
    def proprioception_names(self) -> tuple[str, ...]:
        """Dead reckoning, compass, steering."""
        return *super().proprioception_names, "compass", "steering"

    def proprioception(self, reading: Reading, odometry: Array | None) -> Array:
        """Dead reckoning (x, y, heading) from its start, the compass's heading, the steering angle: (5,) [m, m, rad, rad, rad]."""
        return np.array([*super().proprioception(reading, odometry), reading.heading or 0.0, reading.q[_STEERING]])

    def odometry(self, before: Reading, now: Reading, duration: float) -> Array:
        """Mean motion (vx, 0, wz), shape (3,), of the base between two readings of its encoders.

        v = r (left + right) / 2,  w = r (right - left) / track, of the rear wheels' speeds and the calibrated radius r.

        Where a wheel spins, it is wrong.
        """
        if duration <= 0:
            return np.zeros(3)
        # Not v tan(steering) / L: the rear wheels roll without side slip while tyres hold, so this is exact however the steering
        # moves between the readings, and the front wheels slip sideways a little.
        left, right = (now.q[_REAR] - before.q[_REAR]) * (self.believed_radius / duration)
        return np.array([(left + right) / 2, 0.0, (right - left) / self.parameters.track_m])

    def measured_twist(self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount) -> Array:
        """Mean camera twist (6,) between two readings, from the encoders alone; zero where no time has passed."""
        return mount.to_camera @ (PLANE @ self.odometry(before, now, duration))

    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """Speed [m/s] and steering angle [rad] for a camera twist (6,), as `bicycle.within_limits` has it.

        Only (v, w) of the base's twist can be realised; the rest is dropped, also from `Allocation.twist`. `scale` is the realised
        share of the speed ("speed") or of the yaw rate, where the arc is too tight ("joint_limit": the steering is at its stop), or 0
        for a turn on the spot ("singular"); of several the smallest. A car that is to stand keeps its measured steering angle.
        """
        v, w = (PLANE[:, [0, 2]].T @ (mount.to_flange @ twist)).tolist()
        held, wheelbase = float(reading.q[_STEERING]), self.parameters.wheelbase_m
        speed, steering = (float(x) for x in within_limits(v, w, held, wheelbase, self.limits.bicycle()))
        turn = float(yaw_rate(speed, steering, wheelbase)) if abs(speed) >= STANDSTILL else 0.0
        scale, limit = 1.0, ""
        if abs(v) < STANDSTILL:
            scale, limit = (1.0, "") if abs(w) < STANDSTILL else (0.0, "singular")
        else:
            scale, limit = _smallest(speed / v, turn / w if abs(w) > STANDSTILL else 1.0)
        made = mount.to_camera @ (PLANE @ np.array([speed, 0.0, turn]))
        return Allocation(setpoint=np.array([speed, steering]), twist=made, scale=scale, limit=limit)

    def stopping(self, setpoint: Array, elapsed_s: float) -> Array:
        """No speed, on the same arc: its speed servo slows it down within `limits.acceleration_mps2`."""
        return np.array([0.0, setpoint[1]])

    def begin(self) -> CarServos:
        """At rest, wheels straight."""
        return CarServos()

    def actuate(self, memory: CarServos, setpoint: Array, reading: Reading, dt: float) -> tuple[CarServos, Array]:
        """One period dt [s] of the speed and steering servos: the next state, and ctrl (2,): wheels [rad/s], steering [rad].

        Both setpoints are approached within their rate limits. The speed loop has integral action on the rear wheels' mean speed.
        """
        limits = self.limits
        v, angle = setpoint.tolist()
        speed = memory.speed + _within(_within(v, limits.speed_mps) - memory.speed, limits.acceleration_mps2 * dt)
        turn = _within(angle, limits.steering_rad) - memory.steering
        steering = memory.steering + _within(turn, limits.steering_rate_radps * dt)
        wheels = speed / self.believed_radius
        error = wheels - sum(reading.qd[_REAR].tolist()) / 2
        # None at rest: the motor loop alone holds a standing car, and an integral would creep it after a residual error.
        integral = _within(memory.integral + SPEED_INTEGRAL * error * dt, INTEGRAL_LIMIT) if speed else 0.0
        drive = self.lagged(memory.drive, wheels + integral, dt)
        return CarServos(speed, steering, integral, drive), np.array([drive, steering])


def _within(x: float, most: float) -> float:
    """Clip x to [-most, most]."""
    return max(-most, min(most, x))


def _smallest(of_speed: float, of_turn: float) -> tuple[float, Limit]:
    """The scale of an allocation and the name of its limit, from the realised shares of speed and yaw rate."""
    # The speed's cut shrinks the yaw rate alike: only a yaw rate that shrinks more has met the steering's stop. 1e-9 is for rounding.
    if of_turn < of_speed - 1e-9:
        return of_turn, "joint_limit"
    return (of_speed, "speed") if of_speed < 1 else (1.0, "")
