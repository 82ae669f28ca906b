"""Aerodynamic effects of a quadrotor's rotors: the ground below them, the drag of blades in a cross wind, the wake that comes back.

Each is off unless its block is given. T = b w^2 is a rotor's thrust, R its radius, z its height over what is straight below it.
"""

from __future__ import annotations

import math
from typing import Annotated

from annotated_types import Ge, Le

from vstestbed.core.quantity import Narrower, PositiveTime
from vstestbed.core.spec import spec

AIR = 1.184  # density of the air [kg/m^3] at 25 degrees, as in models/quadrotor.xml
Share = Annotated[float, Ge(0), Le(1)]


@spec
class GroundEffect:
    """More thrust near the ground: T / T_inf = 1 / (1 - k (R/4z)^2 / (1 + (v/v_i)^2)), v_i^2 = T / (2 rho pi R^2).

    v is the rotor's speed along its disc. z is taken straight below four points of each disc, at R / sqrt(2), which halves its area,
    and the gain is their mean: over the edge of a deck a disc loses it by parts, and the rotors that are still over the deck tilt the
    craft. Below z = R/2, where the equation ceases to hold, z counts as R/2. What lies below is a plane to the equation: left out are
    the mirror images of the other rotors and the fountain between them, for which measured quadrotors have a `strength` over 1.

    Args:
        strength: k, how strong it is; 1 is the equation [1].

    Reference: Cheeseman & Bennett 1955, The effect of the ground on a helicopter rotor in forward flight, ARC R&M 3021; over an edge and
        of several rotors Sanchez-Cuevas, Heredia & Ollero 2017, doi:10.1155/2017/1823056.
    """

    strength: Annotated[float, Ge(0), Le(3)] = 1.0

    def gain(self, nearness: float, radius: float, thrust: float, speed: float) -> float:
        """T / T_inf. nearness: (R/z)^2 [1]; radius: R [m]; thrust: T [N]; speed: along the disc [m/s]."""
        induced = thrust / (2 * AIR * math.pi * radius * radius)
        return 1.0 / (1.0 - self.strength * nearness / 16.0 * induced / (induced + speed * speed)) if induced > 0 else 1.0


@spec
class RotorDrag:
    """Drag of the rotors against a cross wind, by flapping of the blades and by induced drag: F = -sum_i k w_i P v_i, k = C b / R.

    v_i is the hub's velocity against the air and P drops its part along the rotor's axis. With the advance ratio mu = v / (w R) it is
    F = C mu T. The X-4's blades flap by a1 = .31 mu (models/quadrotor.xml derives it), and induced drag of stiff blades is taken to be as
    much again: C = .62. Without this block both are part of `parameters.drag_area_m2`, which grows with v^2.

    Args:
        coefficient: C, drag over thrust and advance ratio [1].
        body_share: share of `parameters.drag_area_m2` that remains, since the rest stands for what is modelled here; the X-4's hub,
            arms and legs have .55 of it [1].

    Reference: Mahony, Kumar & Corke 2012, doi:10.1109/MRA.2012.2206474.
    """

    coefficient: Annotated[float, Ge(0), Le(10)] = 0.62
    body_share: Share = 0.55


@spec
class Downwash:
    """The wake that the ground, or a deck, throws back into the rotors: each thrust fluctuates, T (1 + s (R/z)^2 x).

    x is a first-order Gauss-Markov process of unit variance, of each rotor its own. The decay is that of the ground effect; there is no
    published law of its size, so both values are chosen. Left out: steady forces along the deck, and the push on the deck itself.

    Args:
        turbulence: s, standard deviation of a rotor's thrust one radius over the ground, as a share of it [1].
        turbulence_s: correlation time of the fluctuation [s].
    """

    turbulence: Share = 0.02
    turbulence_s: Annotated[PositiveTime, Narrower(ge=1e-3, le=100)] = 0.15


def nearness(z: float, radius: float) -> float:
    """(R/z)^2 of a height z [m], 0 over nothing; under R/2 Cheeseman & Bennett's equation, infinite at R/4, does not hold: R/2 counts."""
    ratio = radius / z if z > 0.5 * radius else 2.0
    return ratio * ratio
