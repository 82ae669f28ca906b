"""The rotors' angular momentum: gyroscopic torque and the reaction to their acceleration."""

from __future__ import annotations

from typing import Annotated

from annotated_types import Gt, Le

from vstestbed.core.spec import spec
from vstestbed.robots.attitude import Vector
from vstestbed.robots.rotors import X4, Four, QuadrotorParameters

X4_ROTOR = 6.49e-5
"""Inertia of an X-4 rotor about its axis [kg m^2], as in models/quadrotor.xml."""
SPIN = (1.0, -1.0, 1.0, -1.0)
"""Sense of rotation of front, right, back, left about the craft's z."""


@spec
class RotorInertia:
    """Torque of spinning rotors on the body: -J (omega x z) sum s_i w_i - J z sum s_i dw_i/dt, s_i = +1 for a rotor that turns about +z.

    At hover the four momenta cancel; a craft that yaws, whose pairs differ in speed, precesses when it tilts, and each change of a
    rotor's speed turns the body the other way.

    Args:
        inertia_kgm2: J, of one rotor with what turns with it, about its axis [kg m^2]; none scales the X-4's, 6.49e-5, with the craft's
            mass and the square of the radius; e.g. `6.5e-5`.

    Reference: the gyroscopic torque Bouabdallah, Murrieri & Siegwart 2004, doi:10.1109/ROBOT.2004.1302409; the reaction is Euler's second
        law; J: Pounds 2007 (models/quadrotor.xml).
    """

    inertia_kgm2: Annotated[float, Gt(0), Le(10)] | None = None

    def of(self, craft: QuadrotorParameters) -> float:
        """J [kg m^2] of a craft's rotor."""
        scaled = X4_ROTOR * (craft.mass_kg / X4.mass_kg) * (craft.rotor_radius_m / X4.rotor_radius_m) ** 2
        return scaled if self.inertia_kgm2 is None else self.inertia_kgm2


def inertia_torque(J: float, rates: Vector, speeds: Four, accelerations: Four) -> Vector:
    """The torque (3,) [Nm] on the body.

    Args:
        J: of one rotor [kg m^2]. rates: of the body, body axes (3,) [rad/s].
        speeds, accelerations: of the rotors, front right back left, without sign (4,) [rad/s, rad/s^2].
    """
    a, b, c, d = speeds
    h = J * (a - b + c - d)
    a, b, c, d = accelerations
    # omega x z = (w_y, -w_x, 0)
    return -h * rates[1], h * rates[0], -J * (a - b + c - d)
