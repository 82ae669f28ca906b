"""A car's physical parameters: what they change in models/car.xml, and Ackermann steering for any track and wheelbase."""

from __future__ import annotations

import functools
import math
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Mass, Narrower, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.robots.attitude import GRAVITY
from vstestbed.robots.body import Change, Couple, Scale, Set, Stretch
from vstestbed.robots.wheels import WHEELS

GRIP = 0.8
"""Friction of the tyres on a dry floor (models/car.xml)."""
ROLLING_NM = 1.32
"""Rolling resistance of the buggy's four wheels [Nm]."""
ON_FRONT, ON_REAR = 0.2044, 0.2956
"""Shares of the weight on each front and each rear wheel: of the sprung four fifths .386 are on the front axle."""
MOST_WHEEL_RAD = 1.25
"""How far a front wheel can turn under the deck [rad]."""
CRANK = 0.0, 1.0, 0.42555, 0.23022, 0.04028
"""Polynomial from the steering angle to the left crank in models/car.xml, for track / (2 wheelbase) = .3."""
WHEEL = 0.0, 1.00072, -0.12503, -0.04148, 0.01279
"""Polynomial from the left crank to the left front wheel there."""


@spec
class CarParameters:
    """Physical parameters of a car, which its onboard servos and its odometry know; the defaults are the buggy of models/car.xml.

    The chassis is stretched with wheelbase and track, and raised by twice what the wheels' radius grows. All masses grow alike, springs,
    dampers and rolling resistance with them, so that the ride frequency of 3 Hz stays; the gain of the motor's speed loop grows with
    mass_kg wheel_radius_m^2, so that its time constant stays.

    Args:
        mass_kg: mass of the whole car [kg].
        wheelbase_m: L, distance from the rear to the front axle [m].
        track_m: distance between the middles of a pair of wheels, front and rear [m].
        wheel_radius_m: radius of all four wheels [m].
        motor_torque_nm: largest torque of the motor at the rear axle [Nm].
    """

    mass_kg: Annotated[Mass, Narrower(ge=5, le=2000)] = 60.0
    wheelbase_m: Annotated[PositiveLength, Narrower(ge=0.4, le=4)] = 1.0
    track_m: Annotated[PositiveLength, Narrower(ge=0.3, le=3)] = 0.6
    wheel_radius_m: Annotated[PositiveLength, Narrower(ge=0.1, le=0.4)] = 0.15
    motor_torque_nm: Annotated[float, Ge(0.1), Le(1e4)] = 25.0

    def __post_init__(self) -> None:
        """Refuse wheels that meet, and a car that tips."""
        L, track, r = self.wheelbase_m, self.track_m, self.wheel_radius_m
        if 2 * r + 0.1 > L:
            words = f"must be at least {2 * r + 0.1:.3g} m at wheel_radius_m {r:g}: front and rear wheels would meet"
            raise ParameterError("wheelbase_m", words, L)
        least = max(2 * r, 2 * GRIP * self._height)
        if track < least:
            words = f"must be at least {least:.3g} m at wheel_radius_m {r:g}: a narrower car tips in a bend before its tyres slide"
            raise ParameterError("track_m", words, track)

    @property
    def _height(self) -> float:
        """Of the centre of mass over the floor [m]: four fifths of the mass are sprung."""
        return 0.264 + 1.8 * (self.wheel_radius_m - 0.15)

    @property
    def slant(self) -> float:
        """Track over twice the wheelbase, which decides how far the front wheels' angles differ."""
        return self.track_m / (2 * self.wheelbase_m)

    @property
    def most_steering_rad(self) -> float:
        """The steering angle of the middle of the axle at which the inner wheel stands at MOST_WHEEL_RAD [rad]: cot = cot + slant."""
        return math.atan(1 / (1 / math.tan(MOST_WHEEL_RAD) + self.slant))

    def torque_for(self, acceleration: float, rolling: float | None = None) -> float:
        """Torque at the rear axle for an acceleration [m/s^2], with a rolling resistance [1]; None: that of the file [Nm]."""
        resistance = ROLLING_NM / 0.15 * (self.mass_kg / 60.0) if rolling is None else rolling * self.mass_kg * GRAVITY
        return (self.mass_kg * acceleration + resistance) * self.wheel_radius_m

    def rolling(self, coefficient: float) -> tuple[Change, ...]:
        """Torques on the wheels by a rolling resistance [1]: its share of each wheel's static load, at the radius."""
        whole = coefficient * self.mass_kg * GRAVITY * self.wheel_radius_m
        shares = ON_FRONT, ON_FRONT, ON_REAR, ON_REAR
        return tuple(Set("joint", name, "frictionloss", whole * share) for name, share in zip(WHEELS, shares, strict=True))

    @property
    def ends_m(self) -> tuple[float, float]:
        """The x of the rear and the front bumper [m]."""
        longer = self.wheelbase_m - 1.0
        return -0.188 - 0.17 * longer, 1.208 + 1.19 * longer

    @property
    def changes(self) -> tuple[Change, ...]:
        """What makes the buggy of the file this car; () where it is that one."""
        if self == BUGGY:
            return ()
        L, half, r = self.wheelbase_m, self.track_m / 2, self.wheel_radius_m
        heavier, larger, wide = self.mass_kg / 60.0, r / 0.15, self.track_m / 0.6
        raised = 2 * (r - 0.15)
        found: list[Change] = [Scale("geom", "mass", heavier), Stretch("base", (L, wide, 1.0), (0.0, 0.0, raised))]
        for name, x, y in (("column", 0.98, 0.0), ("crank_left", 0.94, 0.05), ("crank_right", 0.94, -0.05)):
            found.append(Set("body", name, "pos", (x * L, y * wide, 0.30 + raised)))
        for end, part, x in (("front", "fork", L), ("rear", "carrier", 0.0)):
            for side, y in (("left", half), ("right", -half)):
                holder, wheel = f"{end}_{side}_{part}", f"{end}_{side}_wheel"
                found += [
                    Set("body", holder, "pos", (x, y, r)),
                    Stretch(holder, (1.0, 1.0, larger)),
                    Scale("joint", "stiffness", heavier, holder),
                    Scale("joint", "damping", heavier, holder),
                    Scale("geom", "size", (larger, 1.0, larger), wheel),
                    Scale("joint", "frictionloss", heavier * larger, wheel),
                ]
        gain, fastest = 50 * heavier * larger**2, 22 / larger
        found += [
            Set("actuator", "drive", "gainprm", (gain,)),
            Set("actuator", "drive", "biasprm", (0.0, 0.0, -gain)),
            Set("actuator", "drive", "ctrlrange", (-fastest, fastest)),
            Set("actuator", "drive", "forcerange", (-self.motor_torque_nm, self.motor_torque_nm)),
        ]
        crank, wheel = ackermann(self.slant)
        for side, sign in (("left", 1.0), ("right", -1.0)):  # the right side is the left's mirror image, -q(-p(-d))
            mirrored = [tuple(c * sign ** (k + 1) for k, c in enumerate(poly)) for poly in (crank, wheel)]
            found += [Couple(f"crank_{side}", mirrored[0]), Couple(f"front_{side}_steer", mirrored[1])]
        return tuple(found)


BUGGY = CarParameters()
"""The car of models/car.xml."""


@functools.lru_cache(maxsize=64)
def ackermann(slant: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Polynomials p, q of order 4, (5,) each, with q(p(d)) = atan2(sin d, cos d - slant sin d): the left wheel for a steering angle d.

    Least squares by Levenberg and Marquardt's method over the steering angles that the car can have, from the solution for a slant of .3.
    """
    if slant == BUGGY.slant:
        return CRANK, WHEEL
    most = min(1.05, math.atan(1 / (1 / math.tan(MOST_WHEEL_RAD) + slant)) + 0.05)
    d = most * np.cos(np.linspace(0, np.pi, 121))  # denser at the ends, where polynomials miss most
    wanted = np.arctan2(np.sin(d), np.cos(d) - slant * np.sin(d))
    x = np.array([*CRANK[2:], *WHEEL[1:]]) * (slant / BUGGY.slant) ** np.array([1, 2, 3, 0, 1, 2, 3])
    damping, (error, J) = 1e-3, _miss(x, d, wanted)
    for _ in range(300):
        tried = x - np.linalg.solve(J.T @ J + damping * np.diag((J**2).sum(axis=0)), J.T @ error)
        now = _miss(tried, d, wanted)
        if now[0] @ now[0] < error @ error:
            x, (error, J), damping = tried, now, max(damping / 4, 1e-12)
        else:
            damping *= 4
    a, b, c, *q = x.tolist()
    return (0.0, 1.0, a, b, c), (0.0, *q)


def _miss(x: Array, d: Array, wanted: Array) -> tuple[Array, Array]:
    """Errors (N,) of the two polynomials (7,) and their Jacobian (N, 7)."""
    powers = np.arange(2, 5)
    crank = d + d[:, None] ** powers @ x[:3]
    of_crank = crank[:, None] ** np.arange(1, 5)
    slope = (np.arange(1, 5) * crank[:, None] ** np.arange(4)) @ x[3:]
    return of_crank @ x[3:] - wanted, np.hstack([slope[:, None] * d[:, None] ** powers, of_crank])
