"""A quadrotor's rotors: their angular momentum, how they differ, the battery that feeds them, the
vibration that they make.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, Protocol

import numpy as np
from annotated_types import Ge, Gt, Le, Len

from vstestbed.core.quantity import Share, Sigma
from vstestbed.core.spec import spec
from vstestbed.effects.base import Four, Vector

ROTOR_M = 0.045  # height of the rotors over the centre of mass [m], by models/quadrotor.xml
# inertia of a rotor of the X-4 Flyer about its axis [kg m^2], as in models/quadrotor.xml
X4_ROTOR = 6.49e-5


class _Craft(Protocol):
    """What is asked of a craft's parameters, see `QuadrotorParameters`; hover and limit: squared
    speeds of the rotors [rad^2/s^2].
    """

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
    """Torque of spinning rotors on the body: -J (omega x z) sum s_i w_i - J z sum s_i dw_i/dt,
    s_i = +1 for a rotor that turns about +z.

    At hover the four momenta cancel; a craft that yaws, whose pairs differ in speed, precesses when
    it tilts, and each change of a rotor's speed turns the body the other way.

    Args:
        inertia_kgm2: J, of one rotor with what turns with it, about its axis [kg m^2]; none scales
            the X-4's, 6.49e-5, with the craft's mass and the square of the radius; e.g. `6.5e-5`.

    Reference: the gyroscopic torque Bouabdallah, Murrieri & Siegwart 2004,
        doi:10.1109/ROBOT.2004.1302409; the reaction is Euler's second law; J: Pounds 2007
        (models/quadrotor.xml).
    """

    inertia_kgm2: Annotated[float, Gt(0), Le(10)] | None = None

    def of(self, craft: _Craft) -> float:
        """J [kg m^2] of a craft's rotor; the X-4 has 4 kg, and rotors of .165 m."""
        scaled = X4_ROTOR * (craft.mass_kg / 4.0) * (craft.rotor_radius_m / 0.165) ** 2
        return scaled if self.inertia_kgm2 is None else self.inertia_kgm2


Factors = Annotated[tuple[Annotated[float, Ge(0.2), Le(2)], ...], Len(4, 4)]


@spec
class MotorSpread:
    """Rotors off from one another: thrust b f_i w^2, and a largest w^2 of l_i times the limit; the
    flight loops take them as alike.

    At hover the weaker rotor of a pair turns faster, f_front w_front^2 = f_back w_back^2, and both
    pairs have the same sum of w^2, as their drag torques cancel; the flight loops find this trim by
    their integrals in the first seconds. A motor that saturates early leaves less torque about one
    axis. Factors are drawn from the run's seed unless they are listed. The default sigmas are
    chosen.

    Args:
        thrust_sigma: standard deviation of a rotor's thrust coefficient, as a share of it [1].
        limit_sigma: standard deviation of what is missing of a motor's limit of w^2, as a share of
            it; no limit is higher [1].
        thrust: the four factors f of front, right, back and left [1]; none draws them; e.g.
            `[1.03, 1, 0.98, 1]`.
        limit: the four factors l [1]; none draws them; e.g. `[1, 0.95, 1, 1]`.
    """

    thrust_sigma: Annotated[float, Ge(0), Le(0.2)] = 0.01
    limit_sigma: Annotated[float, Ge(0), Le(0.2)] = 0.01
    thrust: Factors | None = None
    limit: Factors | None = None

    @property
    def draws(self) -> bool:
        """Whether factors are drawn."""
        return (self.thrust is None and self.thrust_sigma > 0) or (
            self.limit is None and self.limit_sigma > 0
        )

    def drawn(self, rng: np.random.Generator) -> tuple[Four, Four]:
        """The factors f and l (4,) of a run."""
        # by three standard deviations at most
        off = np.clip(rng.standard_normal((2, 4)), -3.0, 3.0)
        thrust = self.thrust or (1.0 + self.thrust_sigma * off[0]).tolist()
        limit = self.limit or (1.0 - self.limit_sigma * np.abs(off[1])).tolist()
        return _four(thrust), _four(limit)


def hover_squares(thrust: Four, craft: _Craft) -> Four:
    """W (4,) of front, right, back and left at which rotors of these factors f (4,) hold the craft
    without torque about any axis.

    f_front W_front = f_back W_back, f_right W_right = f_left W_left, W_front + W_back = W_right +
    W_left = 2 S: with the harmonic means h of each pair's factors, S = 2 W_hover / (h_1 + h_2).
    """
    front, right, back, left = thrust
    one = 2 * front * back / (front + back)
    other = 2 * right * left / (right + left)
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


@spec
class Battery:
    """A pack of lithium polymer cells in series, with V = E(s) - R I, I = P / V and ds/dt = -I / Q.

    E(s) = n (3.685 + .2156 s - .1178 s^2 + .3201 s^3 - 1.031 exp(-35 s)) is the voltage without
    load at a state of charge s, and P = sum k w_i^3 / eta + avionics. A rotor's order is a share of
    the battery's voltage, so its w^2, and the limit of its w^2, follow (V / V_ref)^2, up to the
    limit that its speed controller has anyway. V_ref is that of this pack at hover at
    `reference_charge`, where the craft's thrust was calibrated. The lag stays as it is.

    The flight loops do not know the voltage: their climb loop's integral takes up the difference,
    to MAX_TRIM; beyond it the craft sinks. It starts in trim. The craft measures the voltage, for
    its log alone (column `battery_v`). Left out: the cells' own transients, and temperature. R, Q,
    n, eta and avionics are chosen; the X-4's are not known.

    Args:
        cells: n, in series.
        capacity_ah: Q, charge of the full pack [A h].
        charge: state of charge at the start, 0 is empty [1].
        resistance_ohm: R, of the whole pack with its leads [V/A].
        reference_charge: state of charge at which the craft's thrust was calibrated [1].
        efficiency: eta, of motors and speed controllers together [1].
        avionics_w: what else it feeds [W].

    Reference: E(s): Chen & Rincon-Mora 2006, doi:10.1109/TEC.2006.874229.
    """

    cells: Annotated[int, Ge(1), Le(100)] = 4
    capacity_ah: Annotated[float, Gt(0), Le(1e4)] = 5.0
    charge: Share = 1.0
    resistance_ohm: Annotated[float, Ge(0), Le(10)] = 0.02
    reference_charge: Annotated[float, Ge(0.05), Le(1)] = 0.5
    efficiency: Annotated[float, Ge(0.05), Le(1)] = 0.75
    avionics_w: Annotated[float, Ge(0), Le(1e4)] = 10.0

    def open_voltage(self, charge: float) -> float:
        """E [V] at a state of charge 0 to 1."""
        s = charge
        return self.cells * (
            3.685 + s * (0.2156 + s * (-0.1178 + s * 0.3201)) - 1.031 * math.exp(-35.0 * s)
        )

    def voltage(self, charge: float, power: float) -> float:
        """V [V] while a power [W] is drawn: the upper root of V^2 - E V + P R = 0; E/2, the most
        that it gives, where there is none.
        """
        E = self.open_voltage(charge)
        return 0.5 * (E + math.sqrt(max(0.0, E * E - 4.0 * power * self.resistance_ohm)))

    def drained(self, charge: float, current: float, dt: float) -> float:
        """The state of charge after dt [s] of a current [A], 0 at least."""
        return max(0.0, charge - current * dt / (3600.0 * self.capacity_ah))

    def power(self, speeds: tuple[float, ...], craft: _Craft) -> float:
        """P [W] of rotors at these speeds [rad/s]."""
        rotors = craft.drag_coefficient * sum(w * w * w for w in speeds)
        return rotors / self.efficiency + self.avionics_w

    def hovering(self, craft: _Craft, charge: float) -> float:
        """V [V] at a state of charge, while a craft hovers."""
        return self.voltage(charge, self.power((math.sqrt(craft.hover),) * 4, craft))

    def share(self, voltage: float, craft: _Craft) -> float:
        """(V / V_ref)^2, by which a rotor's ordered w^2 is multiplied [1]."""
        ratio = voltage / reference_voltage(self, craft)
        return ratio * ratio

    def share_at_start(self, craft: _Craft) -> float:
        """The same as the craft hovers at the start."""
        return self.share(self.hovering(craft, self.charge), craft)


@lru_cache(maxsize=64)
def reference_voltage(battery: Battery, craft: _Craft) -> float:
    """V_ref [V]: at `reference_charge`, while the craft hovers."""
    return battery.hovering(craft, battery.reference_charge)


@spec
class Vibration:
    """Tones of the rotors and broadband noise at the IMU, as the accelerometer and the gyro meet
    them.

    A rotor at angle phi and speed w adds (w / w_hover)^2 times: its imbalance, which turns with it,
    (a cos phi, a sin phi, 0), the blades' thrust that pulses as each passes an arm, (0, 0, p cos n
    phi), and the rates that these make, (g cos phi, g sin phi, 0). Sampling at 1 kHz shows tones
    over 500 Hz at their alias, as an IMU without a filter does. It is not seen in the pictures: the
    mount is taken to isolate the camera. An autopilot calls standard deviations under 30 m/s^2
    acceptable, and under 15 normal (ArduPilot, "Measuring vibration"); the default has 3 along x
    and y, 4 along z; the share of each part is chosen.

    Args:
        imbalance_mps2: a, amplitude of one rotor's imbalance at hover [m/s^2].
        blade_pass_mps2: p, amplitude of one rotor's pulses of thrust at hover [m/s^2].
        gyro_radps: g, amplitude of one rotor's rates at hover [rad/s].
        blades: n, of a rotor.
        accel_sigma_mps2: standard deviation of broadband noise on each axis of the accelerometer,
            beside its own [m/s^2].
        gyro_sigma_radps: standard deviation of the same of the gyro [rad/s].

    Reference: ArduPilot documentation, Measuring Vibration,
    ardupilot.org/copter/docs/common-measuring-vibration.html.
    """

    imbalance_mps2: Sigma = 2.0
    blade_pass_mps2: Sigma = 2.5
    gyro_radps: Sigma = 0.02
    blades: Annotated[int, Ge(1), Le(12)] = 2
    accel_sigma_mps2: Sigma = 0.5
    gyro_sigma_radps: Sigma = 0.005

    def at(self, angles: Four, W: Four, hover: float, noise: list[float]) -> tuple[Vector, Vector]:
        """What is added to the accelerometer (3,) [m/s^2] and to the gyro (3,) [rad/s].

        angles, W: of the rotors, (4,) [rad] and squared speeds [(rad/s)^2]. hover: W at hover.
            noise: six normal numbers.
        """
        x = y = z = 0.0
        for phi, share in zip(angles, W, strict=True):
            x += share * math.cos(phi)
            y += share * math.sin(phi)
            z += share * math.cos(self.blades * phi)
        a = self.imbalance_mps2 / hover
        p = self.blade_pass_mps2 / hover
        g = self.gyro_radps / hover
        i, j, k, u, v, w = noise
        s = self.accel_sigma_mps2
        r = self.gyro_sigma_radps
        return (a * x + s * i, a * y + s * j, p * z + s * k), (g * x + r * u, g * y + r * v, r * w)
