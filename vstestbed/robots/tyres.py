"""Tyres with slip: a transient brush model for the wheels of a vehicle, in numpy; `sim/scene/tyre_forces.py` applies it.

A tyre's contact patch is deflected by u = (along, across) [m] against the wheel. With the patch's sliding velocity V_s, the speed
V of the wheel over the floor and the relaxation length sigma

    du/dt = -V_s - (V / sigma) u

so that a held slip V_s / V builds up over the way sigma, and a tyre at rest is a spring of stiffness C / sigma. The slip u / sigma gives
the force by a brush with parabolic pressure, in its direction and never more than mu F_z:

    F = mu F_z (1 - (1 - x)^3),  x = min(1, C |u / sigma| / (3 mu F_z))

which has the slope C at zero: the cornering stiffness. The coefficient of the tyre is c = C / F_z [1/rad], so that C grows with the load.
Below LOW_SPEED a damper acts beside the spring, without which a car that stands would sway for long; it fades out with
(1 + cos(pi V / LOW_SPEED)) / 2.

Reference: Pacejka 2012, Tire and Vehicle Dynamics, third edition, chapters 3 (brush), 7 (single contact point) and 8 (low speed);
Bernard & Clover 1995, "Tire modeling for low-speed and high-speed calculations", SAE 950311.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Annotated

from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import Narrower, PositiveLength
from vstestbed.core.spec import spec
from vstestbed.robots.attitude import GRAVITY

LOW_SPEED = 0.5
"""Speed below which the damper acts [m/s]; chosen."""
DAMPING = 0.22
"""Share of the critical damping of the load on a tyre at rest; chosen such that a wheel that is let go stops after two swings."""
STIFFEST = 200.0
"""Largest stiffness / relaxation_m [1/m]: beyond, a wheel swings too fast for physics steps of 2 ms."""
Pair = tuple[float, float]
"""Along and across a wheel."""


@spec
class Tyres:
    """Tyres that slip: a brush with relaxation length (`robots/tyres.py`). Without them a tyre has friction alone.

    In the robot's file the wheels are the bodies `<wheel>_wheel` of `wheels.WHEELS` with geoms `<wheel>_contact`, which slide on joints
    `<wheel>_spring`.

    Args:
        stiffness: c, cornering stiffness over load; also that of longitudinal slip [1/rad]; e.g. `10`.
        rear_stiffness: that of the rear wheels [1/rad]; none: as the front's; a car with softer front tyres understeers; e.g. `8`.
        relaxation_m: sigma, the way over which the force follows the slip [m]; e.g. `0.15`.
    """

    stiffness: Annotated[float, Ge(1), Le(60)] = 10.0
    rear_stiffness: Annotated[float, Ge(1), Le(60)] | None = None
    relaxation_m: Annotated[PositiveLength, Narrower(ge=0.02, le=2)] = 0.15

    def __post_init__(self) -> None:
        """Refuse tyres that are too stiff for the physics step."""
        stiffest = max(self.stiffness, self.rear_stiffness or 0.0)
        if stiffest > STIFFEST * self.relaxation_m:
            words = f"must be at least {stiffest / STIFFEST:.3g} m at a stiffness of {stiffest:g}: a stiffer patch needs shorter steps"
            raise ParameterError("relaxation_m", words, self.relaxation_m)

    @property
    def rear(self) -> Tyres:
        """Those of the rear wheels, as a pair of their own."""
        return self if self.rear_stiffness is None else replace(self, stiffness=self.rear_stiffness, rear_stiffness=None)

    def deflected(self, u: Pair, sliding: Pair, speed: float, friction: float, dt: float) -> Pair:
        """The deflection [m] after dt [s]: the exact solution of du/dt for constant velocities, within what a sliding patch has.

        Args:
            u: present one [m]. sliding: V_s [m/s]. speed: V >= 0 [m/s]. friction: mu [1]. dt: [s].
        """
        a = speed * dt / self.relaxation_m
        keep = math.exp(-a)
        gain = dt * (1 - keep) / a if a > 1e-9 else dt
        along, across = keep * u[0] - gain * sliding[0], keep * u[1] - gain * sliding[1]
        # A patch that slides is not deflected further: else it would have to wind back before the force could turn.
        most = 3 * friction * self.relaxation_m / self.stiffness
        share = min(1.0, most / max(math.hypot(along, across), 1e-12))
        return along * share, across * share

    def force(self, u: Pair, sliding: Pair, speed: float, friction: float, load: float) -> Pair:
        """The force of the floor on a wheel, along and across it [N]: the brush's, and the damper's at low speed, mu F_z at most.

        Args:
            u: deflection [m]. sliding, speed, friction: as in `deflected`. load: F_z [N].
        """
        most = friction * load
        slip = math.hypot(*u) / self.relaxation_m
        x = min(1.0, slip * self.stiffness / (3 * friction))
        spring = most * (1 - (1 - x) ** 3) / slip if slip > 1e-9 else self.stiffness * load
        spring /= self.relaxation_m
        damper = self._damper * load * (0.5 + 0.5 * math.cos(math.pi * speed / LOW_SPEED)) if speed < LOW_SPEED else 0.0
        along, across = spring * u[0] - damper * sliding[0], spring * u[1] - damper * sliding[1]
        share = min(1.0, most / max(math.hypot(along, across), 1e-12))
        return along * share, across * share

    @cached_property
    def _damper(self) -> float:
        """Of a tyre at rest, over its load [s/m]."""
        return 2 * DAMPING * math.sqrt(self.stiffness / (self.relaxation_m * GRAVITY))
