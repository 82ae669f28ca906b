"""Four rotors in a plus: the craft's parameters, mixer with priorities at the rotors' limits, speed
controllers.

With squared speeds W = w^2 of front, right, back and left, arm d, thrust b W and drag torque k W:

    thrust = b (W_f + W_r + W_b + W_l)      torque x = d b (W_l - W_r)
    torque z = k (W_r + W_l - W_f - W_b)    torque y = d b (W_b - W_f)

Solved with a mean t, halves p (pitch) and r (roll) of the pairs' differences and a share y of yaw:
W_f, W_b = t -+ p - y,  W_r, W_l = t -+ r + y.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Annotated

from annotated_types import Ge, Gt, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import clip
from vstestbed.core.quantity import (
    GRAVITY,
    Mass,
    PositiveLength,
    PositiveRate,
    PositiveTime,
    TighterBounds,
)
from vstestbed.core.spec import spec
from vstestbed.effects.base import Four, Vector
from vstestbed.effects.body import Change, put

LEAST_THRUST_TO_WEIGHT = 1.3
"""The flight loops' largest tilt, 30 degrees, takes a thrust of 1.15 times the weight; under this
limit no margin is left.
"""
# least angular acceleration about x and y that the rotors must make at hover [rad/s^2]: the X-4's
# is 27
LEAST_TURN = 10.0
HUB_M = 0.075  # radius of the hub, where the arms begin [m]
# Moments of inertia about x, y and z [kg m^2]
Inertia = Annotated[tuple[Annotated[float, Gt(0), Le(1e3)], ...], Len(3, 3)]


@spec
class QuadrotorParameters:
    """Physical parameters of a quadrotor, which its flight loops know; the defaults are those of
    the X-4 Flyer.

    Args:
        mass_kg: mass of the whole craft [kg].
        inertia_kgm2: moments of inertia about x, y and z [kg m^2]; None scales the X-4's, (.082,
            .082, .149), with mass_kg and the square of arm_m; e.g. `[0.08, 0.08, 0.15]`.
        arm_m: distance from the centre to each rotor [m].
        rotor_radius_m: radius of the discs as drawn and as touched [m]; the thrust is
            `thrust_coefficient` alone.
        thrust_coefficient: b, a rotor's thrust over its squared speed [N s^2].
        drag_coefficient: k, a rotor's drag torque over its squared speed [Nm s^2].
        rotor_speed_radps: largest speed of a rotor [rad/s].
        rotor_lag_s: time constant of w^2 behind its command, without a speed controller [s].
        drag_area_m2: air drag is -1/2 rho A |v| v with this A = C_d times area [m^2].

    Reference: Pounds 2007, PhD thesis, Australian National University; models/quadrotor.xml has the
    details.
    """

    mass_kg: Annotated[Mass, TighterBounds(ge=0.05, le=200)] = 4.0
    inertia_kgm2: Inertia | None = None
    arm_m: Annotated[PositiveLength, TighterBounds(ge=0.1, le=3)] = 0.315
    rotor_radius_m: Annotated[PositiveLength, TighterBounds(ge=0.02, le=2)] = 0.165
    thrust_coefficient: Annotated[float, Ge(1e-9), Le(1.0)] = 1.3234e-5
    drag_coefficient: Annotated[float, Ge(1e-12), Le(1.0)] = 1.0697e-7
    rotor_speed_radps: Annotated[PositiveRate, TighterBounds(ge=10)] = 1000.0
    rotor_lag_s: Annotated[PositiveTime, TighterBounds(ge=0.005, le=1)] = 0.117
    drag_area_m2: Annotated[float, Ge(0), Le(100)] = 0.10

    def __post_init__(self) -> None:
        most = self.arm_m / math.sqrt(2)
        if self.rotor_radius_m >= most:
            raise ParameterError.bound(
                "rotor_radius_m",
                "under",
                f"{most:.3g} m at arm_m {self.arm_m:g}",
                self.rotor_radius_m,
                why="neighbouring rotors would meet",
            )
        a, b, c = sorted(self.inertia)
        if a + b < c:
            words = (
                "must have no moment over the sum of the two others, as any body has;"
                f" {c:g} is over {a + b:.4g}"
            )
            raise ParameterError("inertia_kgm2", words, list(self.inertia))
        ratio = 4 * self.thrust_coefficient * self.limit / (self.mass_kg * GRAVITY)
        if ratio < LEAST_THRUST_TO_WEIGHT:
            need = LEAST_THRUST_TO_WEIGHT / ratio
            words = (
                f"leaves a thrust of {ratio:.3g} times the weight;"
                f" to hover with a margin takes {LEAST_THRUST_TO_WEIGHT:g}."
                f" Works: mass_kg up to {self.mass_kg / need:.3g},"
                f" or thrust_coefficient from {self.thrust_coefficient * need:.3g},"
                f" or rotor_speed_radps from {self.rotor_speed_radps * math.sqrt(need):.4g}"
            )
            raise ParameterError("mass_kg", words)
        tilting = max(self.inertia[:2])
        margin = min(self.hover, self.limit - self.hover)
        turn = 2 * self.arm_m * self.thrust_coefficient * margin / tilting
        if turn < LEAST_TURN:
            words = (
                f"lets the rotors turn the craft by {turn:.2g} rad/s^2,"
                f" which takes {LEAST_TURN:g} to keep it level;"
                f" works: moments up to {tilting * turn / LEAST_TURN:.3g}"
            )
            raise ParameterError("inertia_kgm2", words)

    @cached_property
    def inertia(self) -> Vector:
        """Moments of inertia (3,) about x, y and z [kg m^2]."""
        if self.inertia_kgm2 is not None:
            x, y, z = self.inertia_kgm2
            return x, y, z
        share = (self.mass_kg / 4.0) * (self.arm_m / 0.315) ** 2
        return 0.082 * share, 0.082 * share, 0.149 * share

    @cached_property
    def limit(self) -> float:
        """Largest w^2 [(rad/s)^2]."""
        return self.rotor_speed_radps**2

    @cached_property
    def hover(self) -> float:
        """w^2 at hover [(rad/s)^2]; the X-4's is that of 861 rad/s."""
        return self.mass_kg * GRAVITY / (4 * self.thrust_coefficient)

    @cached_property
    def yaw_torque(self) -> float:
        """Largest yaw torque [Nm], of the X-4 .066. Yaw is weak, since only the rotors' drag
        torques turn a craft about z.

        It may use .6 of the rotors' margin at hover: the rest is for attitude and thrust.
        """
        return 0.6 * 4 * self.drag_coefficient * (self.limit - self.hover)

    @cached_property
    def yaw_slope(self) -> float:
        """Slope of the yaw-rate command [rad/s^2]: .4 of the X-4, whose rotors can realise .45, and
        as much less of other craft.
        """
        return 0.4 * ((self.yaw_torque / self.inertia[2]) / (X4.yaw_torque / X4.inertia[2]))

    @cached_property
    def units(self) -> Vector:
        """Roll or pitch torque of a unit of r or p, thrust of a unit of t, yaw torque of a unit of
        y [Nm s^2, N s^2, Nm s^2].
        """
        return (
            2 * self.arm_m * self.thrust_coefficient,
            4 * self.thrust_coefficient,
            4 * self.drag_coefficient,
        )

    def changes(self, body_share: float = 1.0) -> tuple[Change, ...]:
        """What makes the craft of the file, the X-4, this one; body_share: of its air drag, where a
        model of the rotors has the rest.
        """
        b = self.thrust_coefficient
        k = self.drag_coefficient
        wide = self.arm_m / X4.arm_m
        d = self.arm_m
        drag = 1.5915 * (body_share * self.drag_area_m2 / X4.drag_area_m2)
        found: list[Change] = [
            (put, "body", "base", "mass", self.mass_kg),
            (put, "body", "base", "inertia", self.inertia),
            (put, "geom", "air", "fluid_coefs", (drag,)),
        ]
        for name, x, y, turn in (
            ("front", 1, 0, -1),
            ("right", 0, -1, 1),
            ("back", -1, 0, -1),
            ("left", 0, 1, 1),
        ):
            along = (d + HUB_M) / 2
            half = (d - HUB_M) / 2
            place = x * d, y * d
            leg = *_at(x, y, 0.14 * wide, -0.008), *_at(x, y, 0.22 * wide, -0.16)
            found += [
                (put, "actuator", f"rotor_{name}", "gear", (0, 0, b, 0, 0, turn * k)),
                (put, "actuator", f"rotor_{name}", "dynprm", (self.rotor_lag_s,)),
                (put, "actuator", f"rotor_{name}", "ctrlrange", (0, self.limit)),
                (put, "geom", f"motor_{name}", "pos", place),
                (put, "geom", f"disc_{name}", "pos", place),
                (put, "geom", f"blade_{name}", "pos", place),
                (put, "site", f"rotor_{name}", "pos", place),
                (put, "geom", f"arm_{name}", "pos", (x * along, y * along)),
                (put, "geom", f"arm_{name}", "size", (half, 0.011) if x else (0.011, half)),
                (put, "geom", f"disc_{name}", "size", (self.rotor_radius_m,)),
                (put, "geom", f"blade_{name}", "size", (self.rotor_radius_m - 0.005,)),
                (put, "geom", f"foot_{name}", "pos", (x * 0.22 * wide, y * 0.22 * wide)),
                (put, "geom", f"leg_{name}", "fromto", leg),
            ]
        return tuple(found)


def _at(x: int, y: int, out: float, z: float) -> Vector:
    return x * out, y * out, z


X4 = QuadrotorParameters()  # the X-4 Flyer, of models/quadrotor.xml


def mix(thrust: float, torque: Vector, craft: QuadrotorParameters) -> tuple[Four, bool]:
    """W (4,) of front, right, back and left within limits, for a thrust [N] and a torque (3,) [Nm];
    and whether any of these was cut.

    At the limits roll and pitch come first, then thrust, then yaw: the mean is moved until the
    pairs' differences fit, and yaw gets the margin that is left. Differences beyond the whole range
    are cut to it.
    """
    # Attitude before thrust: a craft that is level can climb later; one that is not level
    # accelerates sideways. Clipping each rotor by itself would lose roll and pitch torque whenever
    # the thrust is high.
    limit = craft.limit
    half = 0.5 * limit
    x, y, z = torque
    per_pair, per_four, per_yaw = craft.units
    r = x / per_pair
    p = y / per_pair
    t = thrust / per_four
    y = z / per_yaw
    cut = False
    # here and below: such a case is rare, and calls take time
    if not (-half <= r <= half and -half <= p <= half):
        r = clip(r, -half, half)
        p = clip(p, -half, half)
        cut = True
    ar = abs(r)
    ap = abs(p)
    widest = ar if ar > ap else ap
    if not widest <= t <= limit - widest:
        t = clip(t, widest, limit - widest)
        cut = True
    above = limit - t
    below = t
    if not (ap - above <= y <= above - ar and ar - below <= y <= below - ap):
        y = clip(y, max(ap - above, ar - below), min(above - ar, below - ap))
        cut = True
    return (t - p - y, t - r + y, t + p - y, t + r + y), cut


def speed_control(
    turning: Four, reference: Four, response_s: float, dt: float, craft: QuadrotorParameters
) -> tuple[Four, Four]:
    """Speed controllers: commands that make the rotors reach `reference` with the time constant
    `response_s` instead of their lag.

    u = W + (lag / response_s) (W_wanted - W), within 0 and the limit: lead compensation, bounded by
    full voltage. A real controller measures its rotor's speed by commutation; this one predicts W
    by the lag's own equation.

    turning, reference: W of the rotors now and as commanded, (4,). response_s: [s], up to
    `craft.rotor_lag_s`.
    dt: [s] until the next command. craft: whose rotors these are. Returns W after dt, and the
    commands u (4,).
    """
    lag = craft.rotor_lag_s
    limit = craft.limit
    # (1, 1) Pade of 1 - exp(-dt / lag): 1e-7 at 1 ms
    lead = lag / response_s
    ahead = dt / (lag + 0.5 * dt)
    a, b, c, d = turning
    A, B, C, D = reference
    ua = a + lead * (A - a)
    ub = b + lead * (B - b)
    uc = c + lead * (C - c)
    ud = d + lead * (D - d)
    # as in `mix`
    if not (
        0.0 <= ua <= limit and 0.0 <= ub <= limit and 0.0 <= uc <= limit and 0.0 <= ud <= limit
    ):
        ua = clip(ua, 0.0, limit)
        ub = clip(ub, 0.0, limit)
        uc = clip(uc, 0.0, limit)
        ud = clip(ud, 0.0, limit)
    after = (
        a + ahead * (ua - a),
        b + ahead * (ub - b),
        c + ahead * (uc - c),
        d + ahead * (ud - d),
    )
    return after, (ua, ub, uc, ud)
