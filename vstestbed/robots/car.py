"""A car: bicycle kinematics both ways, onboard servos, odometry of the rear wheels, a compass.

Its frame lies on the floor under the middle of the rear axle, x forward. It moves with u = (v, w)
of that frame: it can neither go sideways nor turn on the spot. The setpoint is (speed [m/s],
steering angle [rad]); `actuate` approaches both within their rate limits. The body is in
models/car.xml, which `parameters` changes (`CarParameters`), and its imperfections
(`vehicle.Vehicle`).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.planar import moved
from vstestbed.core.quantity import (
    GRAVITY,
    AngleWidth,
    Mass,
    PositiveLength,
    PositiveRate,
    PositiveSpeed,
    TighterBounds,
)
from vstestbed.core.spec import spec
from vstestbed.effects.base import Effect, Sensors
from vstestbed.effects.body import Change, couple, loosen, put, scale, stretch
from vstestbed.effects.floor import UnevenFloor
from vstestbed.effects.wheels import WHEELS, Tyres, WheelSpread
from vstestbed.robots.allocation import Allocation, Mount
from vstestbed.robots.base import BodyFile, Onboard, Reading, SensorModel
from vstestbed.robots.own_model import OwnModel
from vstestbed.robots.realism import Presets
from vstestbed.robots.vehicle import PLANE, GroundStart, Vehicle

# Kinematic bicycle model: a car whose wheels roll without slip, its limits, and its closed loop
# with a law.
#
# With the frame under the middle of the rear axle, x forward, L the wheelbase and gamma the
# steering angle of the middle of the front axle:
#
#     x_dot = v cos(heading),  y_dot = v sin(heading),  heading_dot = w = v tan(gamma) / L
#
# Places are (x, y, heading), shape (..., 3), [m, m, rad]; speeds and angles have the leading axes;
# a single car has none.
#
# Reference: Corke 2017, Robotics, Vision & Control, eq. 4.2, doi:10.1007/978-3-319-54413-7.


# below this speed [m/s] a car counts as standing: gamma = atan(L w / v) is undefined there
STANDSTILL = 1e-6


@dataclass(frozen=True, slots=True)
class BicycleLimits:
    """Limits of a car.

    speed_mps, steering_rad: largest sizes of speed and steering angle.
    acceleration_mps2, steering_rate_radps: largest changes of both; infinity for a car that obeys
    at once.
    """

    speed_mps: float = 1.0
    steering_rad: float = 1.0
    acceleration_mps2: float = np.inf
    steering_rate_radps: float = np.inf


def steering_of(v: Array | float, w: Array | float, wheelbase: float) -> Array:
    """The steering angle for a speed v [m/s] and a yaw rate w [rad/s]: gamma = atan(L w / v), in
    [-pi/2, pi/2].
    """
    # atan2(sign(v) L w, |v|) and not atan2(L w, v): in reverse that would point the wheels
    # backwards. At v = 0 it is a quarter turn.
    return np.arctan2(np.where(v < 0, -w, w) * wheelbase, np.abs(v))


def yaw_rate(v: Array | float, steering: Array | float, wheelbase: float) -> Array:
    """The yaw rate w = v tan(gamma) / L [rad/s] of a speed [m/s] and a steering angle [rad]."""
    return np.asarray(v * np.tan(steering) / wheelbase)


def within_limits(
    v: Array | float, w: Array | float, held: Array | float, wheelbase: float, limits: Limits
) -> tuple[Array, Array]:
    """The speed and steering angle that come nearest to a commanded (v, w) within a car's limits.

    A command that is too fast becomes a slower motion along the same arc. On an arc that is too
    tight the steering angle saturates, with the sign of the arc's curvature, and the speed stays as
    commanded. A car that is to stand, or to turn on the spot, keeps its steering angle `held`.

    v, w: commanded speed [m/s] and yaw rate [rad/s], shape (...). held: the present steering angle,
    shape (...), [rad]. wheelbase: L [m].
    limits: of the speed and of the steering angle. Returns (v, gamma): speed [m/s] and steering
    angle [rad], shape (...) each.
    """
    steering = np.clip(steering_of(v, w, wheelbase), -limits.steering_rad, limits.steering_rad)
    # Else rest would straighten the wheels, or turn them to their stop, under a car that stands.
    steering = np.where(np.abs(v) < STANDSTILL, held, steering)
    # The angle is that of the arc before the speed is cut, so the yaw rate shrinks with the speed
    # and the arc stays. In a bend that is too tight the speed is not cut: a slower car turns no
    # tighter, and keeping the yaw rate would take a faster one.
    return np.clip(v, -limits.speed_mps, limits.speed_mps), steering


def toward(now: Array, setpoint: Array, most: float) -> Array:
    """Rate limiter: `now` moved towards `setpoint` by `most` at the most."""
    return now + np.clip(setpoint - now, -most, most)


def rolled(place: Array, v: Array, steering: Array, wheelbase: float, duration: float) -> Array:
    """The place after `duration` [s] at constant speed and steering angle from `place` (..., 3):
    the exact arc.
    """
    motion = np.stack(np.broadcast_arrays(v, 0.0, yaw_rate(v, steering, wheelbase)), axis=-1)
    return moved(place, motion, duration)


@dataclass(frozen=True, slots=True)
class Drive:
    """Trajectory of the ideal bicycle, time along the first axis.

    t: instants (T,) [s]. place: (x, y, heading) (T, ..., 3); the heading is not wrapped.
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
    limits: Limits,
    duration: float,
    period: float = 0.01,
) -> Drive:
    """Closed loop of a law and a bicycle that knows its place, rolls without slip, and follows
    commands within its limits.

    Args:
        law: maps places (..., 3) to commanded speed and yaw rate (v, w), shape (...) each.
        start: (x, y, heading), shape (..., 3); it stands, wheels straight. wheelbase: L [m].
        limits: of speed and steering angle, and of their rates. duration: how long [s].
        period: of the law; the motion between is an exact arc [s].
    """
    steps = round(duration / period)
    place = np.empty((steps + 1, *np.shape(start)))
    v = np.zeros(place.shape[:-1])
    steering = np.zeros(place.shape[:-1])
    place[0] = start
    now_v = v[0]
    now_steering = steering[0]
    for k in range(steps):
        commanded = within_limits(*law(place[k]), now_steering, wheelbase, limits)
        now_v = toward(now_v, commanded[0], limits.acceleration_mps2 * period)
        now_steering = toward(now_steering, commanded[1], limits.steering_rate_radps * period)
        v[k] = now_v
        steering[k] = now_steering
        place[k + 1] = rolled(place[k], now_v, now_steering, wheelbase, period)
    v[-1] = now_v
    steering[-1] = now_steering
    return Drive(np.linspace(0.0, steps * period, steps + 1), place, v, steering)


GRIP = 0.8  # friction of the tyres on a dry floor (models/car.xml)
MOST_WHEEL_RAD = 1.25  # how far a front wheel can turn under the deck [rad]
# Polynomial from the steering angle to the left crank in models/car.xml, for track / (2
# wheelbase) = .3.
CRANK = 0.0, 1.0, 0.42555, 0.23022, 0.04028
# polynomial from the left crank to the left front wheel there
WHEEL = 0.0, 1.00072, -0.12503, -0.04148, 0.01279


@spec
class CarParameters:
    """Physical parameters of a car, which its onboard servos and its odometry know; the defaults
    are the buggy of models/car.xml.

    The chassis is stretched with wheelbase and track, and raised by twice what the wheels' radius
    grows. All masses grow alike, springs, dampers and rolling resistance with them, so that the
    ride frequency of 3 Hz stays; the gain of the motor's speed loop grows with mass_kg
    wheel_radius_m^2, so that its time constant stays.

    Args:
        mass_kg: mass of the whole car [kg].
        wheelbase_m: L, distance from the rear to the front axle [m].
        track_m: distance between the middles of a pair of wheels, front and rear [m].
        wheel_radius_m: radius of all four wheels [m].
        motor_torque_nm: largest torque of the motor at the rear axle [Nm].
    """

    mass_kg: Annotated[Mass, TighterBounds(ge=5, le=2000)] = 60.0
    wheelbase_m: Annotated[PositiveLength, TighterBounds(ge=0.4, le=4)] = 1.0
    track_m: Annotated[PositiveLength, TighterBounds(ge=0.3, le=3)] = 0.6
    wheel_radius_m: Annotated[PositiveLength, TighterBounds(ge=0.1, le=0.4)] = 0.15
    motor_torque_nm: Annotated[float, Ge(0.1), Le(1e4)] = 25.0

    def __post_init__(self) -> None:
        L = self.wheelbase_m
        track = self.track_m
        r = self.wheel_radius_m
        if 2 * r + 0.1 > L:
            words = f"{2 * r + 0.1:.3g} m at wheel_radius_m {r:g}"
            raise ParameterError.bound(
                "wheelbase_m", "at least", words, L, why="front and rear wheels would meet"
            )
        # of the centre of mass over the floor: four fifths of the mass are sprung
        height = 0.264 + 1.8 * (r - 0.15)
        least = max(2 * r, 2 * GRIP * height)
        if track < least:
            why = "a narrower car tips in a bend before its tyres slide"
            raise ParameterError.bound(
                "track_m", "at least", f"{least:.3g} m at wheel_radius_m {r:g}", track, why=why
            )

    @property
    def slant(self) -> float:
        """Track over twice the wheelbase, which decides how far the front wheels' angles differ."""
        return self.track_m / (2 * self.wheelbase_m)

    @property
    def most_steering_rad(self) -> float:
        """The steering angle of the middle of the axle at which the inner wheel stands at
        MOST_WHEEL_RAD [rad]: cot = cot + slant.
        """
        return math.atan(1 / (1 / math.tan(MOST_WHEEL_RAD) + self.slant))

    def rolling(self, coefficient: float) -> tuple[Change, ...]:
        """Torques on the wheels by a rolling resistance [1]: its share of each wheel's static load,
        at the radius.
        """
        whole = coefficient * self.mass_kg * GRAVITY * self.wheel_radius_m
        # of the sprung four fifths .386 are on the front axle
        shares = 0.2044, 0.2044, 0.2956, 0.2956
        return tuple(
            (put, "joint", name, "frictionloss", whole * share)
            for name, share in zip(WHEELS, shares, strict=True)
        )

    @property
    def changes(self) -> tuple[Change, ...]:
        """What makes the buggy of the file this car; () where it is that one."""
        if self == BUGGY:
            return ()
        L = self.wheelbase_m
        half = self.track_m / 2
        r = self.wheel_radius_m
        heavier = self.mass_kg / 60.0
        larger = r / 0.15
        wide = self.track_m / 0.6
        raised = 2 * (r - 0.15)
        found: list[Change] = [
            (scale, "geom", "mass", heavier),
            (stretch, "base", (L, wide, 1.0), (0.0, 0.0, raised)),
        ]
        for name, x, y in (
            ("column", 0.98, 0.0),
            ("crank_left", 0.94, 0.05),
            ("crank_right", 0.94, -0.05),
        ):
            found.append((put, "body", name, "pos", (x * L, y * wide, 0.30 + raised)))
        for end, part, x in (("front", "fork", L), ("rear", "carrier", 0.0)):
            for side, y in (("left", half), ("right", -half)):
                holder = f"{end}_{side}_{part}"
                wheel = f"{end}_{side}_wheel"
                found += [
                    (put, "body", holder, "pos", (x, y, r)),
                    (stretch, holder, (1.0, 1.0, larger)),
                    (scale, "joint", "stiffness", heavier, holder),
                    (scale, "joint", "damping", heavier, holder),
                    (scale, "geom", "size", (larger, 1.0, larger), wheel),
                    (scale, "joint", "frictionloss", heavier * larger, wheel),
                ]
        gain = 50 * heavier * larger**2
        fastest = 22 / larger
        found += [
            (put, "actuator", "drive", "gainprm", (gain,)),
            (put, "actuator", "drive", "biasprm", (0.0, 0.0, -gain)),
            (put, "actuator", "drive", "ctrlrange", (-fastest, fastest)),
            (put, "actuator", "drive", "forcerange", (-self.motor_torque_nm, self.motor_torque_nm)),
        ]
        crank, wheel = ackermann(self.slant)
        # the right side is the left's mirror image, -q(-p(-d))
        for side, sign in (("left", 1.0), ("right", -1.0)):
            for joint, polynomial in (
                (f"crank_{side}", crank),
                (f"front_{side}_steer", wheel),
            ):
                mirrored = [c * sign ** (k + 1) for k, c in enumerate(polynomial)]
                found.append((couple, joint, tuple(mirrored)))
        return tuple(found)


BUGGY = CarParameters()  # the car of models/car.xml


@functools.lru_cache(maxsize=64)
def ackermann(slant: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Polynomials p, q of order 4, (5,) each, with q(p(d)) = atan2(sin d, cos d - slant sin d): the
    left wheel for a steering angle d.

    Least squares by Levenberg and Marquardt's method over the steering angles that the car can
    have, from the solution for a slant of .3.
    """
    if slant == BUGGY.slant:
        return CRANK, WHEEL
    # here: only a car of another shape pays for the import
    from scipy.optimize import least_squares

    most = min(1.05, math.atan(1 / (1 / math.tan(MOST_WHEEL_RAD) + slant)) + 0.05)
    d = most * np.cos(np.linspace(0, np.pi, 121))  # denser at the ends, where polynomials miss most
    wanted = np.arctan2(np.sin(d), np.cos(d) - slant * np.sin(d))

    def miss(x: Array) -> Array:
        crank = d + d[:, None] ** np.arange(2, 5) @ x[:3]
        return crank[:, None] ** np.arange(1, 5) @ x[3:] - wanted

    first = np.array([*CRANK[2:], *WHEEL[1:]]) * (slant / BUGGY.slant) ** np.array(
        [1, 2, 3, 0, 1, 2, 3]
    )
    a, b, c, *q = least_squares(miss, first, method="lm", ftol=1e-15, xtol=1e-15).x.tolist()
    return (0.0, 1.0, a, b, c), (0.0, *q)


# indices of the steering and of the rear wheels in `Car.joints`
_STEERING = 0
_REAR = slice(3, 5)


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
        speed_mps: largest speed, forward and in reverse [m/s]. At 3 m/s the car slides in a tight
            bend.
        steering_rad: largest steering angle of the middle of the front axle [rad].
        acceleration_mps2: how fast the speed setpoint is followed [m/s^2]; the rear tyres hold
            about 3.
        steering_rate_radps: how fast the steering setpoint is followed [rad/s].
    """

    speed_mps: Annotated[PositiveSpeed, TighterBounds(le=3)] = 1.0
    steering_rad: Annotated[float, Ge(1e-6), Le(1)] = 1.0
    acceleration_mps2: Annotated[float, Ge(1e-6), Le(2.5)] = 1.5
    steering_rate_radps: Annotated[PositiveRate, TighterBounds(le=4)] = 2.0


Limits = BicycleLimits | CarLimits
Servos = tuple[float, float, float, float]
"""State of the onboard servos: rate-limited speed [m/s] and steering [rad], the speed loop's
integral [rad/s], the drive [rad/s].
"""


CAR: Presets = {
    "lab": {
        "tyres": Tyres(stiffness=12.0, relaxation_m=0.1),
        "steering_play_deg": 0.5,
        "drive_lag_s": 0.05,
        "wheel_spread": WheelSpread(sigma=0.001),
        "uneven_floor": UnevenFloor(rms_m=0.0005, correlation_m=0.3),
    },
    "field": {
        "tyres": Tyres(stiffness=6.0, relaxation_m=0.25),
        "rolling_resistance": 0.03,
        "steering_play_deg": 2.0,
        "drive_lag_s": 0.2,
        "wheel_spread": WheelSpread(sigma=0.005),
        "uneven_floor": UnevenFloor(rms_m=0.005, correlation_m=0.5),
    },
}
"""Imperfections of a level; their values are chosen, models/README.md says from what."""


@spec
class Car(Vehicle, Onboard):
    """A buggy, of 60 kg by default, with Ackermann steering and rear drive.

    Args:
        parameters: mass, wheels and motor, which the car knows.
        start: where the middle of its rear axle starts on the floor, and its heading.
        compass: errors of its compass.
        wheel_radius_error: relative error of the calibrated wheel radius, which its speed servo and
            its odometry use [1]: .02 for 2 % too large.
        limits: of its speed, its steering angle and their rates.
        tyres: that slip; none: friction alone; e.g. `{stiffness: 10, relaxation_m: 0.15}`.
        steering_play_deg: how far the steering's servo turns from one end of its play to the other
            before the wheels follow [deg]; none: no play; e.g. `1`.
    """

    kind: Literal["car"] = "car"
    parameters: CarParameters = BUGGY
    start: GroundStart = GroundStart()
    compass: Compass = Compass()
    wheel_radius_error: Annotated[float, Gt(-0.5), Lt(1)] = 0.0
    limits: CarLimits = CarLimits()
    tyres: Tyres | None = None
    steering_play_deg: Annotated[AngleWidth, TighterBounds(le=20)] | None = None
    presets = CAR
    imperfect_wheels = True
    joints = (
        *("steering", "front_left_steer", "front_right_steer"),
        *("rear_left", "rear_right", "front_left", "front_right"),
    )
    control_period_s = 0.01
    proprioception_names: ClassVar[tuple[str, ...]] = (  # pyright: ignore[reportIncompatibleMethodOverride] - a constant
        *Vehicle.proprioception_names,
        "compass",
        "steering",
    )

    def __post_init__(self) -> None:
        body = self.parameters
        limits = self.limits
        if limits.steering_rad > body.most_steering_rad:
            most = math.floor(1e3 * body.most_steering_rad) / 1e3
            words = (
                f"must be at most {most:g} rad at track_m {body.track_m:g} and wheelbase_m"
                f" {body.wheelbase_m:g}:"
                " the inner front wheel would turn beyond 71 degrees, into the chassis"
            )
            raise ParameterError("limits.steering_rad", words, limits.steering_rad)
        resistance = 1.32 / 0.15 * (body.mass_kg / 60.0)  # of the file's buggy: 1.32 Nm
        if self.rolling_resistance is not None:
            resistance = self.rolling_resistance * body.mass_kg * GRAVITY
        need = (body.mass_kg * limits.acceleration_mps2 + resistance) * body.wheel_radius_m
        lacks = need - body.motor_torque_nm
        if lacks > 0:
            words = (
                f"{need:.3g} Nm for limits.acceleration_mps2 {limits.acceleration_mps2:g} with"
                f" mass_kg {body.mass_kg:g}"
            )
            most = limits.acceleration_mps2 - lacks / (body.mass_kg * body.wheel_radius_m)
            if most > 0.01:
                words += f"; or lower that acceleration to {most:.2g} m/s^2"
            raise ParameterError.bound(
                "parameters.motor_torque_nm", "at least", words, body.motor_torque_nm
            )

    @property
    def body(self) -> BodyFile:
        """No wheel is steered across the car's way; the wheels turn without end."""
        limits = np.array([[-math.pi / 2, math.pi / 2]] * 3 + [[-np.inf, np.inf]] * 4)
        found = list(self.parameters.changes)
        if self.rolling_resistance is not None:
            found += self.parameters.rolling(self.rolling_resistance)
        if self.wheel_spread is not None:
            found += [
                (scale, "geom", "size", (factor, 1.0, factor), f"{name}_wheel")
                for name, factor in zip(WHEELS, self.wheel_spread.factors, strict=True)
            ]
        if self.tyres is not None:  # the floor carries a wheel, and the tyre alone holds it
            found += [(put, "geom", f"{name}_contact", "condim", 1) for name in WHEELS]
        if self.steering_play_deg:
            found.append((loosen, "steering", math.radians(self.steering_play_deg)))
        return BodyFile(
            "car.xml", ("drive", "steering"), ("heading",), changes=tuple(found), limits=limits
        )

    @property
    def acting(self) -> tuple[Effect, ...]:
        """Its tyres before the others."""
        if self.tyres is None:
            return super().acting
        return self.tyres, *super().acting

    @property
    def ends_m(self) -> tuple[float, float]:
        """The x of its rear and its front bumper [m]."""
        longer = self.parameters.wheelbase_m - 1.0
        return -0.188 - 0.17 * longer, 1.208 + 1.19 * longer

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

    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """Camera twists of (v, w) of the base, shape (6, 2), for any mount."""
        return mount.to_camera @ PLANE[:, [0, 2]]

    def own_model(self, reading: Reading, mount: Mount) -> OwnModel:
        """(v, w): its speed and the yaw rate on its tightest circle; its servos' acceleration, and
        v / L times the rate of its steering.
        """
        limits = self.limits
        v = limits.speed_mps
        radius = self.turning_radius_m
        speeds = np.array([v, v / radius])
        turn = v * limits.steering_rate_radps / self.parameters.wheelbase_m
        accelerations = np.array([limits.acceleration_mps2, turn])
        J = self.motion_basis(mount, reading.q)
        return OwnModel.of_motions(("v", "w"), J, speeds, accelerations, turning_radius_m=radius)

    @property
    def draws_heading(self) -> bool:
        """The noise of its compass."""
        return self.compass.sigma_deg > 0

    def instruments(self, rng: np.random.Generator) -> SensorModel:
        """Exact encoders, and the compass: the direction of the base's true x axis with bias and
        noise, in [-pi, pi).
        """
        compass = self.compass

        def read(q: Array, qd: Array, sensors: Sensors) -> Reading:
            x, y = sensors["heading"][:2]
            error = math.radians(compass.bias_deg + compass.sigma_deg * rng.standard_normal())
            heading = (math.atan2(y, x) + error + math.pi) % (2 * math.pi) - math.pi
            return Reading(q, qd, heading=heading)

        return read

    def proprioception(self, reading: Reading, odometry: Array | None) -> Array:
        """Dead reckoning (x, y, heading) from its start, the compass's heading, the steering angle:
        (5,) [m, m, rad, rad, rad].
        """
        more = [reading.heading or 0.0, reading.q[_STEERING]]
        return np.append(super().proprioception(reading, odometry), more)

    def odometry(self, before: Reading, now: Reading, duration: float) -> Array:
        """Mean motion (vx, 0, wz), shape (3,), of the base between two readings of its encoders.

        v = r (left + right) / 2,  w = r (right - left) / track,

        of the rear wheels' speeds and the calibrated radius r.

        Where a wheel spins, it is wrong.
        """
        if duration <= 0:
            return np.zeros(3)
        # Not v tan(steering) / L: the rear wheels roll without side slip while tyres hold, so this
        # is exact however the steering moves between the readings, and the front wheels slip
        # sideways a little.
        left, right = (now.q[_REAR] - before.q[_REAR]) * (self.believed_radius / duration)
        return np.array([(left + right) / 2, 0.0, (right - left) / self.parameters.track_m])

    def measured_twist(
        self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount
    ) -> Array:
        """Mean camera twist (6,) between two readings, from the encoders alone; zero where no time
        has passed.
        """
        return mount.to_camera @ (PLANE @ self.odometry(before, now, duration))

    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """Speed [m/s] and steering angle [rad] for a camera twist (6,), as `within_limits` has it.

        Only (v, w) of the base's twist can be realised; the rest is dropped, also from
        `Allocation.twist`. `scale` is the realised share of the speed ("speed") or of the yaw rate,
        where the arc is too tight ("joint_limit": the steering is at its stop), or 0 for a turn on
        the spot ("singular"); of several the smallest. A car that is to stand keeps its measured
        steering angle.
        """
        v, w = (PLANE[:, [0, 2]].T @ (mount.to_flange @ twist)).tolist()
        held = float(reading.q[_STEERING])
        wheelbase = self.parameters.wheelbase_m
        speed, steering = map(float, within_limits(v, w, held, wheelbase, self.limits))
        turn = float(yaw_rate(speed, steering, wheelbase)) if abs(speed) >= STANDSTILL else 0.0
        of_turn = turn / w if abs(w) > STANDSTILL else 1.0
        scale = 1.0
        limit = ""
        if abs(v) < STANDSTILL:
            if abs(w) >= STANDSTILL:
                scale = 0.0
                limit = "singular"
        elif of_turn < speed / v - 1e-9:
            # The speed's cut shrinks the yaw rate alike: only a yaw rate that shrinks more has met
            # the steering's stop. 1e-9 is for rounding.
            scale = of_turn
            limit = "joint_limit"
        elif speed / v < 1:
            scale = speed / v
            limit = "speed"
        made = mount.to_camera @ (PLANE @ np.array([speed, 0.0, turn]))
        return Allocation(
            setpoint=np.array([speed, steering]), twist=made, scale=scale, limit=limit
        )

    def stopping(self, setpoint: Array, elapsed_s: float) -> Array:
        """No speed, on the same arc: its speed servo slows it down within
        `limits.acceleration_mps2`.
        """
        return np.array([0.0, setpoint[1]])

    def begin(self) -> Servos:
        return 0.0, 0.0, 0.0, 0.0

    def actuate(
        self, state: Servos, setpoint: Array, reading: Reading, dt: float
    ) -> tuple[Servos, Array]:
        """One period dt [s] of the speed and steering servos: the next state, and ctrl (2,): wheels
        [rad/s], steering [rad].

        Both setpoints are approached within their rate limits. The speed loop has integral action
        on the rear wheels' mean speed.
        """
        limits = self.limits
        speed, steering, integral, drive = state
        v, angle = setpoint.tolist()
        speed = speed + _within(_within(v, limits.speed_mps) - speed, limits.acceleration_mps2 * dt)
        turn = _within(angle, limits.steering_rad) - steering
        steering = steering + _within(turn, limits.steering_rate_radps * dt)
        wheels = speed / self.believed_radius
        error = wheels - sum(reading.qd[_REAR].tolist()) / 2
        # Its gain of 8 / s removes the offset of .005 m/s that rolling resistance leaves in the
        # motor loop, and is four times as slow as that loop, whose time constant is .03 s. The
        # bound of 1 rad/s is for a car that is held up by a wall (anti-windup). None at rest: the
        # motor loop alone holds a standing car, and an integral would creep it after a residual
        # error.
        integral = _within(integral + 8.0 * error * dt, 1.0) if speed else 0.0
        drive = self.lagged(drive, wheels + integral, dt)
        return (speed, steering, integral, drive), np.array([drive, steering])


def _within(x: float, most: float) -> float:
    return max(-most, min(most, x))
