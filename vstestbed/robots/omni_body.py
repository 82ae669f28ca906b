"""An omnidirectional base's physical parameters: the kinematics of its wheels, and what they change in models/omni*.xml."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Mass, Narrower, PositiveLength, PositiveRate
from vstestbed.core.spec import spec
from vstestbed.robots.attitude import GRAVITY
from vstestbed.robots.body import Change, Scale, Set, Stretch
from vstestbed.robots.wheels import WHEELS

CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]])
"""Signs of the wheels' places (x, y) in the base frame, shape (4, 2)."""
SIDES = np.array([-1.0, 1.0, 1.0, -1.0])
"""Axis of the roller on the floor, (1, side), by wheel; with the opposite signs the axes meet at the centre, and yaw is lost."""
ROLLERS = 9
"""Rollers on each wheel of models/omni.xml."""
WHEEL_KG, SPIN, ROTOR = 0.455, 4.0e-4, 1.2e-3
"""Mass of a wheel [kg]; its moment of inertia about the axle at a radius of 50 mm, and the motor's behind its gears [kg m^2]."""


@spec
class OmniParameters:
    """Physical parameters of an omnidirectional base, which its allocation and its odometry know; the defaults are models/omni.xml.

    The chassis is stretched with wheelbase and track, a wheel scaled as a whole with its radius at a constant mass of .455 kg. The gains
    of the wheels' speed loops grow with what they move, mass_kg R^2 / 4 + 1.6e-3 kg m^2, so that their bandwidth stays.

    Args:
        mass_kg: mass of the whole base [kg].
        wheelbase_m: distance from the rear to the front axles [m].
        track_m: distance between the middles of a pair of wheels [m].
        wheel_radius_m: R, of all four wheels [m].
        motor_torque_nm: largest torque of each wheel's motor [Nm].
        wheel_speed_radps: largest speed of a wheel [rad/s]; a little under the 20.9 of the default's motors without load.
    """

    mass_kg: Annotated[Mass, Narrower(ge=2.5, le=500)] = 8.0
    wheelbase_m: Annotated[PositiveLength, Narrower(ge=0.1, le=3)] = 0.30
    track_m: Annotated[PositiveLength, Narrower(ge=0.1, le=3)] = 0.32
    wheel_radius_m: Annotated[PositiveLength, Narrower(ge=0.025, le=0.2)] = 0.05
    motor_torque_nm: Annotated[float, Ge(0.01), Le(1e3)] = 2.0
    wheel_speed_radps: Annotated[PositiveRate, Narrower(ge=0.1, le=200)] = 20.0

    def __post_init__(self) -> None:
        """Refuse wheels that meet, and motors that cannot drive the base."""
        for field, least in (("wheelbase_m", 2.4 * self.wheel_radius_m), ("track_m", 2.0 * self.wheel_radius_m)):
            if getattr(self, field) < least:
                words = f"must be at least {least:.3g} m at wheel_radius_m {self.wheel_radius_m:g}: the wheels would meet"
                raise ParameterError(field, words, getattr(self, field))
        # m a = 4 T / R; under 1 m/s^2 it neither follows a law's changes nor stops within half a second.
        most = 4 * self.motor_torque_nm / self.wheel_radius_m / 1.0
        if self.mass_kg > most:
            words = f"must be at most {most:.3g} kg: motor_torque_nm {self.motor_torque_nm:g} accelerates more by under 1 m/s^2"
            raise ParameterError("mass_kg", words, self.mass_kg)

    def wheel_matrix(self, rollers: float = ROLLERS) -> Array:
        """Wheel speeds of a motion without slip, shape (4, 3): q_dot = W @ (vx, vy, wz), in the order of WHEELS.

        Row: (1, side / kappa, side x / kappa - y) / R, with kappa = sin(pi/n) / (pi/n).

        Args:
            rollers: n, how many rollers a wheel has; infinity for the textbooks' equations.
        """
        kappa = float(np.sinc(1 / rollers))  # numpy's sinc(x) is sin(pi x) / (pi x)
        x, y = self.places.T
        return np.stack([np.ones(4), SIDES / kappa, SIDES * x / kappa - y], axis=1) / self.wheel_radius_m

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
        """Motion from wheel speeds (3, 4). Four wheels overdetermine three velocities: least squares where slip makes them disagree."""
        return np.asarray(np.linalg.pinv(self.W), dtype=np.float64)

    @property
    def ends_m(self) -> tuple[float, float]:
        """The x of the rear and the front edge of its wheels [m]."""
        half = self.wheelbase_m / 2 + 0.058 * (self.wheel_radius_m / 0.05)
        return -half, half

    @property
    def top_speed_mps(self) -> float:
        """Straight ahead [m/s]."""
        return self.wheel_speed_radps * self.wheel_radius_m

    @property
    def spin(self) -> float:
        """Moment of inertia of a wheel with its motor about the axle [kg m^2]."""
        return ROTOR + SPIN * (self.wheel_radius_m / 0.05) ** 2

    @property
    def moved(self) -> float:
        """What a wheel's speed loop moves, about the axle [kg m^2]."""
        return self.mass_kg * self.wheel_radius_m**2 / 4 + self.spin

    def changes(self, planar: bool) -> tuple[Change, ...]:
        """What makes the base of omni.xml, or of omni_planar.xml, this one; () where it is that one."""
        if self == PLATFORM:
            return ()
        larger = self.wheel_radius_m / PLATFORM.wheel_radius_m
        stretch = self.wheelbase_m / PLATFORM.wheelbase_m, self.track_m / PLATFORM.track_m, 1.0
        found: list[Change] = [
            Set("geom", "chassis", "mass", self.mass_kg - len(WHEELS) * WHEEL_KG),
            Stretch("base", stretch, (0.0, 0.0, self.wheel_radius_m - PLATFORM.wheel_radius_m)),
        ]
        harder = self.moved / PLATFORM.moved
        for name, (x, y), row, before in zip(WHEELS, self.places.tolist(), self.W, PLATFORM.W, strict=True):
            found += [
                Set("body", name, "pos", (x, y, self.wheel_radius_m)),
                Scale("geom", "size", larger, name),
                Scale("geom", "pos", larger, name),
                Scale("actuator", "gainprm", harder, name),
                Scale("actuator", "biasprm", harder, name),
                Set("actuator", name, "ctrlrange", (-self.wheel_speed_radps, self.wheel_speed_radps)),
                Set("actuator", name, "forcerange", (-self.motor_torque_nm, self.motor_torque_nm)),
            ]
            if planar:  # the gear is the wheel's row; ratios, since the file has five digits of it
                of_x, of_y, of_yaw = (row / before).tolist()
                found.append(Scale("actuator", "gear", (of_x, of_y, 1.0, 1.0, 1.0, of_yaw), name))
            else:
                found += _larger_rollers(name, larger)
        return (*found, *(self._planar_inertia() if planar else ()))

    def rolling(self, coefficient: float) -> tuple[Change, ...]:
        """Torques on the wheels by a rolling resistance [1]: its share of a quarter of the weight, at the radius."""
        torque = coefficient * self.mass_kg * GRAVITY * self.wheel_radius_m / 4
        return tuple(Set("joint", name, "frictionloss", torque) for name in WHEELS)

    def _planar_inertia(self) -> tuple[Change, ...]:
        """Of the wheels' spin, W^T J W, as the planar joints have it; the mean of x and y for both slides."""
        J, before = (p.spin * (p.W**2).sum(axis=0) for p in (self, PLATFORM))
        along, turning = float((J[0] + J[1]) / (before[0] + before[1])), float(J[2] / before[2])
        both = (Set("joint", name, "armature", 2.61 * along) for name in ("root_x", "root_y"))
        return (*both, Set("joint", "root_yaw", "armature", 0.250 * turning))


def larger_wheel(name: str, factor: float) -> tuple[Change, ...]:
    """One wheel scaled as a whole with its rollers."""
    return Scale("geom", "size", factor, name), Scale("geom", "pos", factor, name), *_larger_rollers(name, factor)


def _larger_rollers(name: str, factor: float) -> tuple[Change, ...]:
    """The rollers of a wheel scaled, and moved outwards alike."""
    rollers = [f"{name}_roller{i}" for i in range(ROLLERS)]
    return tuple(change for roller in rollers for change in (Scale("body", "pos", factor, roller), Scale("geom", "size", factor, roller)))


PLATFORM = OmniParameters()
"""The base of models/omni.xml and models/omni_planar.xml."""
