"""Omnidirectional base on four mecanum wheels: wheel kinematics both ways, odometry, limits.

A wheel's rollers turn freely about their axles: the floor constrains the point under the wheel only
along the axis of the roller that lies there. With the wheel at (x, y), turning at q_dot, and that
roller along (cos(phi), side):

    cos(phi) (vx - wz y - R q_dot) + side (vy + wz x) = 0

where phi is how far the wheel has turned from "a roller straight below", in [-pi/n, pi/n] for n
rollers: a roller at 45 degrees to the axle is tilted by phi, and its projection on the floor
turned. Textbooks have cos(phi) = 1, as for infinitely many rollers; a wheel with n rollers has the
mean over a roller's turn, kappa = sin(pi/n) / (pi/n), which is .980 for nine. Thus

    R q_dot = vx + side (vy + wz x) / kappa - wz y

and with kappa = 1 the equations of the textbooks: vx -+ vy -+ (half base + half track) wz.

Reference: Muir & Neuman 1987, "Kinematic modeling for feedback control of an omnidirectional
wheeled mobile robot", ICRA, pp. 1772-1778; Taheri, Qiao & Ghaeminezhad 2015,
doi:10.5120/19804-1586. Any roller angle: Lynch & Park 2017, Modern Robotics, 13.2. Bodies are in
models/omni.xml and models/omni_planar.xml, which `parameters` changes (`OmniParameters`).
"""

from __future__ import annotations

from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.planar import motion_between
from vstestbed.core.quantity import GRAVITY, Mass, PositiveLength, PositiveRate, TighterBounds
from vstestbed.core.spec import spec
from vstestbed.effects.body import Change, put, scale, stretch
from vstestbed.effects.floor import UnevenFloor
from vstestbed.effects.wheels import WHEELS, WheelSpread
from vstestbed.robots.allocation import Allocation, Mount
from vstestbed.robots.base import BodyFile, Onboard, Reading
from vstestbed.robots.own_model import OwnModel
from vstestbed.robots.realism import Presets
from vstestbed.robots.vehicle import PLANE, GroundStart, Vehicle

# signs of the wheels' places (x, y) in the base frame (4, 2)
CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
SIDES = np.array([-1.0, 1.0, 1.0, -1.0])
"""Axis of the roller on the floor, (1, side), by wheel; with the opposite signs the axes meet at
the centre, and yaw is lost.
"""
ROLLERS = 9  # rollers on each wheel of models/omni.xml


@spec
class OmniParameters:
    """Physical parameters of an omnidirectional base, which its allocation and its odometry know;
    the defaults are models/omni.xml.

    The chassis is stretched with wheelbase and track, a wheel scaled as a whole with its radius at
    a constant mass of .455 kg. The gains of the wheels' speed loops grow with what they move,
    mass_kg R^2 / 4 + 1.6e-3 kg m^2, so that their bandwidth stays.

    Args:
        mass_kg: mass of the whole base [kg].
        wheelbase_m: distance from the rear to the front axles [m].
        track_m: distance between the middles of a pair of wheels [m].
        wheel_radius_m: R, of all four wheels [m].
        motor_torque_nm: largest torque of each wheel's motor [Nm].
        wheel_speed_radps: largest speed of a wheel [rad/s]; a little under the 20.9 of the
            default's motors without load.
    """

    mass_kg: Annotated[Mass, TighterBounds(ge=2.5, le=500)] = 8.0
    wheelbase_m: Annotated[PositiveLength, TighterBounds(ge=0.1, le=3)] = 0.30
    track_m: Annotated[PositiveLength, TighterBounds(ge=0.1, le=3)] = 0.32
    wheel_radius_m: Annotated[PositiveLength, TighterBounds(ge=0.025, le=0.2)] = 0.05
    motor_torque_nm: Annotated[float, Ge(0.01), Le(1e3)] = 2.0
    wheel_speed_radps: Annotated[PositiveRate, TighterBounds(ge=0.1, le=200)] = 20.0

    def __post_init__(self) -> None:
        for field, least in (
            ("wheelbase_m", 2.4 * self.wheel_radius_m),
            ("track_m", 2.0 * self.wheel_radius_m),
        ):
            if getattr(self, field) < least:
                words = f"{least:.3g} m at wheel_radius_m {self.wheel_radius_m:g}"
                raise ParameterError.bound(
                    field, "at least", words, getattr(self, field), why="the wheels would meet"
                )
        # m a = 4 T / R; under 1 m/s^2 it neither follows a law's changes nor stops within half a
        # second.
        most = 4 * self.motor_torque_nm / self.wheel_radius_m / 1.0
        if self.mass_kg > most:
            why = f"motor_torque_nm {self.motor_torque_nm:g} accelerates more by under 1 m/s^2"
            raise ParameterError.bound(
                "mass_kg", "at most", f"{most:.3g} kg", self.mass_kg, why=why
            )

    def wheel_matrix(self, rollers: float = ROLLERS) -> Array:
        """Wheel speeds of a motion without slip, shape (4, 3): q_dot = W @ (vx, vy, wz), in the
        order of WHEELS.

        Row: (1, side / kappa, side x / kappa - y) / R, with kappa = sin(pi/n) / (pi/n).

        rollers: n, how many rollers a wheel has; infinity for the textbooks' equations.
        """
        kappa = float(np.sinc(1 / rollers))  # numpy's sinc(x) is sin(pi x) / (pi x)
        x, y = self.places.T
        rows = np.stack([np.ones(4), SIDES / kappa, SIDES * x / kappa - y], axis=1)
        return rows / self.wheel_radius_m

    @property
    def places(self) -> Array:
        """Places (x, y) of the wheels in the base frame, shape (4, 2) [m]."""
        return CORNERS * (self.wheelbase_m / 2, self.track_m / 2)

    @cached_property
    def W(self) -> Array:
        """`wheel_matrix` of this base (4, 3)."""
        return self.wheel_matrix()

    @cached_property
    def W_inverse(self) -> Array:
        """Motion from wheel speeds (3, 4). Four wheels overdetermine three velocities: least
        squares where slip makes them disagree.
        """
        return np.asarray(np.linalg.pinv(self.W), dtype=np.float64)

    @property
    def spin(self) -> float:
        """Moment of inertia about the axle of a wheel, 4e-4 at a radius of 50 mm, with its motor
        behind its gears [kg m^2].
        """
        return 1.2e-3 + 4.0e-4 * (self.wheel_radius_m / 0.05) ** 2

    @property
    def spin_of_wheels(self) -> Array:
        """The diagonal (3,) of W^T spin W: the wheels' spin as the planar joints have it."""
        return self.spin * (self.W**2).sum(axis=0)

    @property
    def moved(self) -> float:
        """What a wheel's speed loop moves, about the axle [kg m^2]."""
        return self.mass_kg * self.wheel_radius_m**2 / 4 + self.spin

    def changes(self, planar: bool) -> tuple[Change, ...]:
        """What makes the base of omni.xml, or of omni_planar.xml, this one; () where it is that
        one.
        """
        if self == PLATFORM:
            return ()
        larger = self.wheel_radius_m / PLATFORM.wheel_radius_m
        wider = self.wheelbase_m / PLATFORM.wheelbase_m, self.track_m / PLATFORM.track_m, 1.0
        found: list[Change] = [
            (put, "geom", "chassis", "mass", self.mass_kg - len(WHEELS) * 0.455),
            (stretch, "base", wider, (0.0, 0.0, self.wheel_radius_m - PLATFORM.wheel_radius_m)),
        ]
        harder = self.moved / PLATFORM.moved
        fastest = self.wheel_speed_radps
        strongest = self.motor_torque_nm
        for name, (x, y), row, before in zip(
            WHEELS, self.places.tolist(), self.W, PLATFORM.W, strict=True
        ):
            found += [
                (put, "body", name, "pos", (x, y, self.wheel_radius_m)),
                (scale, "geom", "size", larger, name),
                (scale, "geom", "pos", larger, name),
                (scale, "actuator", "gainprm", harder, name),
                (scale, "actuator", "biasprm", harder, name),
                (put, "actuator", name, "ctrlrange", (-fastest, fastest)),
                (put, "actuator", name, "forcerange", (-strongest, strongest)),
            ]
            if planar:  # the gear is the wheel's row; ratios, since the file has five digits of it
                of_x, of_y, of_yaw = (row / before).tolist()
                found.append((scale, "actuator", "gear", (of_x, of_y, 1.0, 1.0, 1.0, of_yaw), name))
            else:
                found += _larger_rollers(name, larger)
        if planar:
            x, y, yaw = self.spin_of_wheels.tolist()
            x_before, y_before, yaw_before = PLATFORM.spin_of_wheels.tolist()
            along = 2.61 * ((x + y) / (x_before + y_before))  # the mean of both slides
            found += [
                (put, "joint", "root_x", "armature", along),
                (put, "joint", "root_y", "armature", along),
                (put, "joint", "root_yaw", "armature", 0.250 * (yaw / yaw_before)),
            ]
        return tuple(found)

    def rolling(self, coefficient: float) -> tuple[Change, ...]:
        """Torques on the wheels by a rolling resistance [1]: its share of a quarter of the weight,
        at the radius.
        """
        torque = coefficient * self.mass_kg * GRAVITY * self.wheel_radius_m / 4
        return tuple((put, "joint", name, "frictionloss", torque) for name in WHEELS)


def _larger_rollers(name: str, factor: float) -> tuple[Change, ...]:
    found: list[Change] = []
    for i in range(ROLLERS):
        roller = f"{name}_roller{i}"
        found.append((scale, "body", "pos", factor, roller))
        found.append((scale, "geom", "size", factor, roller))
    return tuple(found)


PLATFORM = OmniParameters()  # the base of models/omni.xml and models/omni_planar.xml


OMNI: Presets = {
    "lab": {
        "rolling_resistance": 0.01,
        "drive_lag_s": 0.03,
        "wheel_spread": WheelSpread(sigma=0.001),
        "uneven_floor": UnevenFloor(rms_m=0.0002, correlation_m=0.3),
    },
    "field": {
        "rolling_resistance": 0.03,
        "drive_lag_s": 0.1,
        "wheel_spread": WheelSpread(sigma=0.004),
        "uneven_floor": UnevenFloor(rms_m=0.001, correlation_m=0.3),
    },
}
"""Imperfections of a level; their values are chosen, models/README.md says from what."""


@spec
class Omni(Vehicle, Onboard):
    """A platform on four mecanum wheels, driven by wheel speeds. Of its imperfections `planar`
    wheels can have lag alone.

    Args:
        wheels: `rollers` (default): nine free rollers on each wheel touch the floor, and slip where
            it is slippery; `planar`: ideal wheels without contact, a tenth of the cost.
        parameters: mass, wheels and motors, which the base knows.
        start: where it starts on the floor.
        wheel_radius_error: relative error of the calibrated wheel radius [1]: .02 for 2 % too
            large.
    """

    kind: Literal["omni"] = "omni"
    wheels: Literal["rollers", "planar"] = "rollers"
    parameters: OmniParameters = PLATFORM
    start: GroundStart = GroundStart()
    wheel_radius_error: Annotated[float, Gt(-0.5), Lt(1)] = 0.0
    presets = OMNI
    imperfect_wheels = True
    control_period_s = 0.004

    def __post_init__(self) -> None:
        of_rollers = (self.wheel_spread, self.rolling_resistance, self.uneven_floor)
        if self.wheels == "planar" and of_rollers != (None, None, None):
            raise ParameterError.fixed(
                "wheels",
                "rollers",
                self.wheels,
                where="with realism, wheel_spread, rolling_resistance or uneven_floor",
                why="planar wheels do not touch the floor",
            )

    @property
    def onboard(self) -> Onboard | None:
        """The drive's lag; without it the wheels' speeds are the actuators' controls."""
        return self if self.drive_lag_s else None

    @property
    def stop_s(self) -> float:
        """From its top speed, of 1 m/s by default, at 2 m/s^2: rollers hold on a dry floor [s]."""
        return self.top_speed_mps / 2.0

    @property
    def body(self) -> BodyFile:
        """With rollers, which slip, or with planar wheels, which never do."""
        rolls = self.wheels == "rollers"
        found = list(self.parameters.changes(planar=not rolls))
        if self.rolling_resistance is not None:
            found += self.parameters.rolling(self.rolling_resistance)
        if self.wheel_spread is not None:
            for name, factor in zip(WHEELS, self.wheel_spread.factors, strict=True):
                found += [
                    (scale, "geom", "size", factor, name),
                    (scale, "geom", "pos", factor, name),
                    *_larger_rollers(name, factor),
                ]
        file = "omni.xml" if rolls else "omni_planar.xml"
        return BodyFile(file, WHEELS, changes=tuple(found), slips=rolls)

    @property
    def ends_m(self) -> tuple[float, float]:
        """The x of the rear and the front edge of its wheels [m]."""
        half = self.parameters.wheelbase_m / 2 + 0.058 * (self.parameters.wheel_radius_m / 0.05)
        return -half, half

    @property
    def top_speed_mps(self) -> float:
        """Straight ahead [m/s]."""
        return self.parameters.wheel_speed_radps * self.parameters.wheel_radius_m

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that its encoders read: the wheels, or the base's own joints in the model
        without wheel joints.
        """
        # Only differences of the latter are used (`odometry`): the absolute place would be truth.
        return WHEELS if self.wheels == "rollers" else ("root_x", "root_y", "root_yaw")

    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """Camera twists of (vx, vy, wz) of the base, shape (6, 3), for any mount."""
        return mount.to_camera @ PLANE

    def own_model(self, reading: Reading, mount: Mount) -> OwnModel:
        """(vx, vy, wz), as its wheels' speed allows them one at a time, with the speed that each
        wheel may have.
        """
        p = self.parameters
        speeds = p.wheel_speed_radps / np.abs(p.W).max(axis=0)
        wheels = p.W / (1 + self.wheel_radius_error)
        most = np.full(len(wheels), p.wheel_speed_radps)
        J = self.motion_basis(mount, reading.q)
        return OwnModel.of_motions(
            ("vx", "vy", "wz"), J, speeds, speeds / self.stop_s, sums=wheels, most=most
        )

    def stopping(self, setpoint: Array, elapsed_s: float) -> Array:
        """All wheels fall to rest within `stop_s`."""
        return setpoint * max(0.0, 1.0 - elapsed_s / self.stop_s)

    def odometry(self, before: Reading, now: Reading, duration: float) -> Array:
        """Mean motion (vx, vy, wz) of the base between two readings of its encoders, with the
        calibrated radius.

        Rollers: inverse wheel kinematics, blind to slip. Planar: the arc of constant velocity
        between the two poses, which is what wheels without slip would measure, to third order in
        the duration.
        """
        belief = 1 + self.wheel_radius_error
        if duration <= 0:
            return np.zeros(3)
        if self.wheels == "planar":
            return belief * motion_between(before.q, now.q, duration)
        return belief * (self.parameters.W_inverse @ (now.q - before.q)) / duration

    def measured_twist(
        self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount
    ) -> Array:
        """Mean camera twist (6,) between two readings, from the encoders alone; zero where no time
        has passed.
        """
        return mount.to_camera @ PLANE @ self.odometry(before, now, duration)

    def begin(self) -> Array:
        """A drive at rest (4,) [rad/s]."""
        return np.zeros(4)

    def actuate(
        self, state: Array, setpoint: Array, reading: Reading, dt: float
    ) -> tuple[Array, Array]:
        """The wheel speeds (4,) [rad/s] that the drive follows: behind those of the setpoint, by
        its lag.
        """
        drive = self.lagged(state, setpoint, dt)
        return drive, drive

    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """Wheel speeds (4,) [rad/s] for a camera twist (6,), scaled as a whole into their limits.

        Only (vx, vy, wz) of the base's twist can be realised; the rest is dropped, also from
        `Allocation.twist`.
        """
        motion = PLANE.T @ (mount.to_flange @ twist)
        # Wheels that the robot takes for larger than they are get less speed, and the base moves by
        # less than `twist` says.
        p = self.parameters
        speeds = p.W @ motion / (1 + self.wheel_radius_error)
        scale = min(1.0, p.wheel_speed_radps / max(float(np.abs(speeds).max()), 1e-12))
        return Allocation(
            setpoint=speeds * scale,
            twist=mount.to_camera @ PLANE @ motion * scale,
            scale=scale,
            limit="speed" if scale < 1.0 else "",
        )
