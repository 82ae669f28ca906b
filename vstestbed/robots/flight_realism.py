"""The imperfections of a quadrotor, each a block of its own, and the presets that fill them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from vstestbed.core.errors import ParameterError
from vstestbed.core.spec import spec
from vstestbed.robots.aerodynamics import Downwash, GroundEffect, RotorDrag
from vstestbed.robots.attitude import GRAVITY
from vstestbed.robots.battery import Battery
from vstestbed.robots.flight import MAX_TRIM
from vstestbed.robots.motor_spread import MotorSpread, hover_squares
from vstestbed.robots.realism import Level, Realistic
from vstestbed.robots.rotor_inertia import RotorInertia
from vstestbed.robots.rotors import QuadrotorParameters
from vstestbed.robots.vibration import Vibration

ROTORS = ("front", "right", "back", "left")
LAB: dict[str, object] = {
    "ground_effect": GroundEffect(),
    "rotor_drag": RotorDrag(),
    "downwash": Downwash(),
    "rotor_inertia": RotorInertia(),
    "battery": Battery(),
    "vibration": Vibration(),
    "motors": MotorSpread(),
}
"""A craft with balanced rotors and a full battery; values as in the blocks' own defaults."""
FIELD: dict[str, object] = LAB | {
    "downwash": Downwash(turbulence=0.05),
    "battery": Battery(charge=0.25, resistance_ohm=0.04),
    "vibration": Vibration(imbalance_mps2=4.0, blade_pass_mps2=4.0, gyro_radps=0.04, accel_sigma_mps2=1.5, gyro_sigma_radps=0.015),
    "motors": MotorSpread(thrust_sigma=0.04, limit_sigma=0.04),
}
"""A worn craft late in its flight: chipped rotors, a nearly empty battery that is old; values chosen."""


@spec
class FlightRealism(Realistic):
    """The imperfections of a craft that flies; each block is off where it is not given, and costs nothing then.

    Args:
        ground_effect: more thrust near the ground; e.g. `{strength: 1}`.
        rotor_drag: drag of the rotors against a cross wind, linear in the velocity; e.g. `{coefficient: 0.62}`.
        downwash: thrust that fluctuates where the wake comes back from the ground, or from a deck; e.g. `{turbulence: 0.05}`.
        rotor_inertia: gyroscopic and reaction torque of the rotors; e.g. `{inertia_kgm2: 6.5e-5}`.
        battery: voltage that falls under load and with the charge, and the rotors' speed with it; e.g. `{charge: 0.4}`.
        vibration: of the inertial measurement unit, by the rotors; e.g. `{imbalance_mps2: 8}`.
        motors: rotors that differ in thrust and in their limit; e.g. `{thrust_sigma: 0.03}`.
    """

    ground_effect: GroundEffect | None = None
    rotor_drag: RotorDrag | None = None
    downwash: Downwash | None = None
    rotor_inertia: RotorInertia | None = None
    battery: Battery | None = None
    vibration: Vibration | None = None
    motors: MotorSpread | None = None

    presets: ClassVar[Mapping[Level, Mapping[str, object]]] = {"lab": LAB, "field": FIELD}

    @property
    def draws(self) -> bool:
        """Motors that are not listed, a wake that fluctuates, vibration."""
        return (self.motors is not None and self.motors.draws) or self.downwash is not None or self.vibration is not None

    @property
    def imperfect(self) -> bool:
        """Whether any block is given."""
        return any(getattr(self, name) is not None for name in LAB)

    def check_hover(self, craft: QuadrotorParameters) -> None:
        """Refuse a battery, or listed motors, with which a craft cannot hover at its start; motors that are drawn are not known yet."""
        share = self.battery.share_at_start(craft) if self.battery else 1.0
        least = max(GRAVITY / (GRAVITY + MAX_TRIM), craft.hover / craft.limit)
        if self.battery and share < least:
            words = f"leaves {share:.2g} of the ordered thrust at the start; the flight loops make up for {least:.2g} at least. Works:"
            raise ParameterError("battery.charge", f"{words} more charge, or a lower reference_charge", self.battery.charge)
        if self.motors and self.motors.thrust:
            front, right, back, left = self.motors.thrust
            squares = hover_squares((front, right, back, left), craft)
            for name, W, factor in zip(ROTORS, squares, self.motors.limit or (1.0,) * 4, strict=True):
                most = share * factor * craft.limit
                if most < W:
                    words = f"makes the {name} rotor turn at {W**0.5:.4g} rad/s to hover, beyond its {most**0.5:.4g}"
                    raise ParameterError("motors.thrust", f"{words}; works: factors nearer to 1", list(self.motors.thrust))
