"""The rotors' angular momentum: gyroscopic torque and the reaction to their acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Protocol

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from vstestbed.core.spec import spec
from vstestbed.effects.base import Four

ROTOR_M = 0.045  # height of the rotors over the centre of mass [m], by models/quadrotor.xml
X4_ROTOR = 6.49e-5  # inertia of a rotor of the X-4 Flyer about its axis [kg m^2], as in models/quadrotor.xml
SPIN = (1.0, -1.0, 1.0, -1.0)  # sense of rotation of front, right, back, left about the craft's z


class _Craft(Protocol):
    """What is asked of a craft's parameters, see `QuadrotorParameters`; hover and limit: squared speeds of the rotors [rad^2/s^2]."""

    @property
    def mass_kg(self) -> float: ...
    @property
    def arm_m(self) -> float: ...
    @property
    def rotor_radius_m(self) -> float: ...
    @property
    def rotor_lag_s(self) -> float: ...
    @property
    def thrust_coefficient(self) -> float: ...
    @property
    def drag_coefficient(self) -> float: ...
    @property
    def hover(self) -> Any: ...
    @property
    def limit(self) -> Any: ...


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

    def of(self, craft: _Craft) -> float:
        """J [kg m^2] of a craft's rotor; the X-4 has 4 kg, and rotors of .165 m."""
        scaled = X4_ROTOR * (craft.mass_kg / 4.0) * (craft.rotor_radius_m / 0.165) ** 2
        return scaled if self.inertia_kgm2 is None else self.inertia_kgm2


Factors = Annotated[tuple[Annotated[float, Ge(0.2), Le(2)], ...], Len(4, 4)]


@spec
class MotorSpread:
    """Rotors off from one another: thrust b f_i w^2, and a largest w^2 of l_i times the limit; the flight loops take them as alike.

    At hover the weaker rotor of a pair turns faster, f_front w_front^2 = f_back w_back^2, and both pairs have the same sum of w^2, as
    their drag torques cancel; the flight loops find this trim by their integrals in the first seconds. A motor that saturates early
    leaves less torque about one axis. Factors are drawn from the run's seed unless they are listed. The default sigmas are chosen.

    Args:
        thrust_sigma: standard deviation of a rotor's thrust coefficient, as a share of it [1].
        limit_sigma: standard deviation of what is missing of a motor's limit of w^2, as a share of it; no limit is higher [1].
        thrust: the four factors f of front, right, back and left [1]; none draws them; e.g. `[1.03, 1, 0.98, 1]`.
        limit: the four factors l [1]; none draws them; e.g. `[1, 0.95, 1, 1]`.
    """

    thrust_sigma: Annotated[float, Ge(0), Le(0.2)] = 0.01
    limit_sigma: Annotated[float, Ge(0), Le(0.2)] = 0.01
    thrust: Factors | None = None
    limit: Factors | None = None

    @property
    def draws(self) -> bool:
        """Whether factors are drawn."""
        return (self.thrust is None and self.thrust_sigma > 0) or (self.limit is None and self.limit_sigma > 0)

    def drawn(self, rng: np.random.Generator) -> tuple[Four, Four]:
        """The factors f and l (4,) of a run."""
        off = np.clip(rng.standard_normal((2, 4)), -3.0, 3.0)  # by three standard deviations at most
        f = 1.0 + self.thrust_sigma * off[0] if self.thrust is None else np.array(self.thrust)
        limit = 1.0 - self.limit_sigma * np.abs(off[1]) if self.limit is None else np.array(self.limit)
        return _four(f.tolist()), _four(limit.tolist())


def hover_squares(thrust: Four, craft: _Craft) -> Four:
    """W (4,) of front, right, back and left at which rotors of these factors f (4,) hold the craft without torque about any axis.

    f_front W_front = f_back W_back, f_right W_right = f_left W_left, W_front + W_back = W_right + W_left = 2 S: with the harmonic means h
    of each pair's factors, S = 2 W_hover / (h_1 + h_2).
    """
    front, right, back, left = thrust
    one, other = 2 * front * back / (front + back), 2 * right * left / (right + left)
    double = 4 * craft.hover / (one + other)
    return (
        double * back / (front + back),
        double * left / (right + left),
        double * front / (front + back),
        double * right / (right + left),
    )


def _four(values: Sequence[float]) -> Four:
    a, b, c, d = values
    return a, b, c, d
