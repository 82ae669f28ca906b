"""The quadrotor's battery: voltage under load, and what it makes of the orders to the rotors."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated

from annotated_types import Ge, Gt, Le

from vstestbed.core.spec import spec
from vstestbed.effects.rotors import _Craft


@spec
class Battery:
    """A pack of lithium polymer cells in series, with V = E(s) - R I, I = P / V and ds/dt = -I / Q.

    E(s) = n (3.685 + .2156 s - .1178 s^2 + .3201 s^3 - 1.031 exp(-35 s)) is the voltage without load at a state of charge s, and
    P = sum k w_i^3 / eta + avionics. A rotor's order is a share of the battery's voltage, so its w^2, and the limit of its w^2, follow
    (V / V_ref)^2, up to the limit that its speed controller has anyway. V_ref is that of this pack at hover at `reference_charge`, where
    the craft's thrust was calibrated. The lag stays as it is.

    The flight loops do not know the voltage: their climb loop's integral takes up the difference, to MAX_TRIM; beyond it the craft sinks.
    It starts in trim. The craft measures the voltage, for its log alone (column `battery_v`). Left out: the cells' own transients, and
    temperature. R, Q, n, eta and avionics are chosen; the X-4's are not known.

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
    charge: Annotated[float, Ge(0), Le(1)] = 1.0
    resistance_ohm: Annotated[float, Ge(0), Le(10)] = 0.02
    reference_charge: Annotated[float, Ge(0.05), Le(1)] = 0.5
    efficiency: Annotated[float, Ge(0.05), Le(1)] = 0.75
    avionics_w: Annotated[float, Ge(0), Le(1e4)] = 10.0

    def open_voltage(self, charge: float) -> float:
        """E [V] at a state of charge 0 to 1."""
        s = charge
        return self.cells * (3.685 + s * (0.2156 + s * (-0.1178 + s * 0.3201)) - 1.031 * math.exp(-35.0 * s))

    def voltage(self, charge: float, power: float) -> float:
        """V [V] while a power [W] is drawn: the upper root of V^2 - E V + P R = 0; E/2, the most that it gives, where there is none."""
        E = self.open_voltage(charge)
        return 0.5 * (E + math.sqrt(max(0.0, E * E - 4.0 * power * self.resistance_ohm)))

    def drained(self, charge: float, current: float, dt: float) -> float:
        """The state of charge after dt [s] of a current [A], 0 at least."""
        return max(0.0, charge - current * dt / (3600.0 * self.capacity_ah))

    def power(self, speeds: tuple[float, ...], craft: _Craft) -> float:
        """P [W] of rotors at these speeds [rad/s]."""
        return craft.drag_coefficient * sum(w * w * w for w in speeds) / self.efficiency + self.avionics_w

    def share(self, voltage: float, craft: _Craft) -> float:
        """(V / V_ref)^2, by which a rotor's ordered w^2 is multiplied [1]."""
        ratio = voltage / reference_voltage(self, craft)
        return ratio * ratio

    def share_at_start(self, craft: _Craft) -> float:
        """The same as the craft hovers at the start."""
        return self.share(self.voltage(self.charge, self.power((math.sqrt(craft.hover),) * 4, craft)), craft)


@lru_cache(maxsize=64)
def reference_voltage(battery: Battery, craft: _Craft) -> float:
    """V_ref [V]: at `reference_charge`, while the craft hovers."""
    return battery.voltage(battery.reference_charge, battery.power((math.sqrt(craft.hover),) * 4, craft))
