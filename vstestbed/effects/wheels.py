"""The four wheels of a vehicle: how far their radii are from one another, and tyres that slip.

Tyres are a transient brush model in plain numbers, which `TyreForces` applies.

A tyre's contact patch is deflected by u = (along, across) [m] against the wheel. With the patch's
sliding velocity V_s, the speed V of the wheel over the floor and the relaxation length sigma

    du/dt = -V_s - (V / sigma) u

so that a held slip V_s / V builds up over the way sigma, and a tyre at rest is a spring of
stiffness C / sigma. The slip u / sigma gives the force by a brush with parabolic pressure, in its
direction and never more than mu F_z:

    F = mu F_z (1 - (1 - x)^3),  x = min(1, C |u / sigma| / (3 mu F_z))

which has the slope C at zero: the cornering stiffness. The coefficient of the tyre is c = C / F_z
[1/rad], so that C grows with the load. Below LOW_SPEED a damper acts beside the spring, without
which a car that stands would sway for long; it fades out with (1 + cos(pi V / LOW_SPEED)) / 2.

Reference: Pacejka 2012, Tire and Vehicle Dynamics, third edition, chapters 3 (brush), 7 (single
contact point) and 8 (low speed); Bernard & Clover 1995, "Tire modeling for low-speed and high-speed
calculations", SAE 950311.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Len, Lt

from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import GRAVITY, PositiveLength, TighterBounds
from vstestbed.core.spec import spec
from vstestbed.effects.base import Actor, Effect, RobotBody

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
RadiusError = Annotated[float, Gt(-0.2), Lt(0.2)]
Errors = Annotated[tuple[RadiusError, ...], Len(4, 4)]


@spec
class WheelSpread:
    """How far the true radius of each wheel is from the nominal one, which the vehicle knows:
    listed, or drawn with the scenario's seed.

    Args:
        sigma: standard deviation of the relative errors that are drawn, one for each wheel [1];
            e.g. `0.003`.
        errors: relative errors of the radii, front left, front right, rear left, rear right [1];
            none: they are drawn; e.g. `[0, 0, 0.004, -0.004]`.
    """

    sigma: Annotated[float, Ge(0), Le(0.05)] = 0.0
    errors: Errors | None = None

    def __post_init__(self) -> None:
        if self.sigma and self.errors is not None:
            words = "with sigma > 0, which draws them, also that of robot.realism"
            raise ParameterError.fixed(
                "errors",
                "none",
                list(self.errors),
                where=words,
                works="sigma 0 beside the listed errors",
            )

    def drawn(self, rng: np.random.Generator) -> WheelSpread:
        """With four errors listed that are drawn from `rng`; itself where sigma is 0."""
        if not self.sigma:
            return self
        errors = np.clip(self.sigma * rng.standard_normal(4), -0.19, 0.19)
        return WheelSpread(errors=tuple(np.round(errors, 9).tolist()))

    @property
    def factors(self) -> tuple[float, ...]:
        """True over nominal radius of each wheel, (4,); 1 before they are drawn."""
        return tuple(1 + error for error in self.errors or (0.0,) * len(WHEELS))


LOW_SPEED = 0.5  # speed below which the damper acts [m/s]; chosen
# largest stiffness / relaxation_m [1/m]: beyond, a wheel swings too fast for physics steps of 2 ms
STIFFEST = 200.0
Pair = tuple[float, float]  # along and across a wheel


@spec
class Tyres(Effect):
    """Tyres that slip: a brush with relaxation length. Without them a tyre has friction alone.

    In the robot's file the wheels are the bodies `<wheel>_wheel` of `wheels.WHEELS` with geoms
    `<wheel>_contact`, which slide on joints `<wheel>_spring`.

    Args:
        stiffness: c, cornering stiffness over load; also that of longitudinal slip [1/rad]; e.g.
            `10`.
        rear_stiffness: that of the rear wheels [1/rad]; none: as the front's; a car with softer
            front tyres understeers; e.g. `8`.
        relaxation_m: sigma, the way over which the force follows the slip [m]; e.g. `0.15`.
    """

    stiffness: Annotated[float, Ge(1), Le(60)] = 10.0
    rear_stiffness: Annotated[float, Ge(1), Le(60)] | None = None
    relaxation_m: Annotated[PositiveLength, TighterBounds(ge=0.02, le=2)] = 0.15

    def __post_init__(self) -> None:
        stiffest = max(self.stiffness, self.rear_stiffness or 0.0)
        if stiffest > STIFFEST * self.relaxation_m:
            words = f"{stiffest / STIFFEST:.3g} m at a stiffness of {stiffest:g}"
            raise ParameterError.bound(
                "relaxation_m",
                "at least",
                words,
                self.relaxation_m,
                why="a stiffer patch needs shorter steps",
            )

    @property
    def rear(self) -> Tyres:
        """Those of the rear wheels, as a pair of their own."""
        if self.rear_stiffness is None:
            return self
        return replace(self, stiffness=self.rear_stiffness, rear_stiffness=None)

    def deflected(self, u: Pair, sliding: Pair, speed: float, friction: float, dt: float) -> Pair:
        """The deflection [m] after dt [s]: the exact solution of du/dt for constant velocities,
        within what a sliding patch has.

        u: present one [m]. sliding: V_s [m/s]. speed: V >= 0 [m/s]. friction: mu [1]. dt: [s].
        """
        a = speed * dt / self.relaxation_m
        keep = math.exp(-a)
        gain = dt * (1 - keep) / a if a > 1e-9 else dt
        along = keep * u[0] - gain * sliding[0]
        across = keep * u[1] - gain * sliding[1]
        # A patch that slides is not deflected further: else it would have to wind back before the
        # force could turn.
        most = 3 * friction * self.relaxation_m / self.stiffness
        share = min(1.0, most / max(math.hypot(along, across), 1e-12))
        return along * share, across * share

    def force(self, u: Pair, sliding: Pair, speed: float, friction: float, load: float) -> Pair:
        """The force of the floor on a wheel, along and across it [N]: the brush's, and the damper's
        at low speed, mu F_z at most.

        u: deflection [m]. sliding, speed, friction: as in `deflected`. load: F_z [N].
        """
        most = friction * load
        slip = math.hypot(*u) / self.relaxation_m
        x = min(1.0, slip * self.stiffness / (3 * friction))
        spring = most * (1 - (1 - x) ** 3) / slip if slip > 1e-9 else self.stiffness * load
        spring /= self.relaxation_m
        damper = 0.0
        if speed < LOW_SPEED:
            damper = self._damper * load * (0.5 + 0.5 * math.cos(math.pi * speed / LOW_SPEED))
        along = spring * u[0] - damper * sliding[0]
        across = spring * u[1] - damper * sliding[1]
        share = min(1.0, most / max(math.hypot(along, across), 1e-12))
        return along * share, across * share

    def actor(self, body: RobotBody, rng: np.random.Generator) -> Actor:
        return TyreForces(body, self)

    @cached_property
    def _damper(self) -> float:
        """Of a tyre at rest, over its load [s/m]: .22 of the critical one (chosen), so that a wheel
        let go stops after two swings.
        """
        return 2 * 0.22 * math.sqrt(self.stiffness / (self.relaxation_m * GRAVITY))


class TyreForces(Actor):
    """Applies the forces where the wheels touch the floor. Their contacts carry the load alone,
    without friction.

    The load of a wheel is the force of constraints on the slide of its spring, in the last step:
    that of its contact.

    body: the vehicle. tyres: of all its wheels.
    """

    def __init__(self, body: RobotBody, tyres: Tyres):
        model = body.model
        self._data = body.data
        self._model = body.model
        self._tyres = (tyres, tyres, tyres.rear, tyres.rear)
        self._bodies = [int(model.body(f"robot/{name}_wheel").id) for name in WHEELS]
        self._slides = np.array([model.joint(f"robot/{name}_spring").dofadr[0] for name in WHEELS])
        contacts = [model.geom(f"robot/{name}_contact").id for name in WHEELS]
        self._radius = model.geom_size[contacts, 0].tolist()
        self._friction = model.geom_friction[contacts, 0].tolist()
        self._deflection: list[Pair] = [(0.0, 0.0)] * len(WHEELS)
        self._twist = np.zeros(6)
        self._wrench = np.zeros((len(WHEELS), 6))

    def act(self, t: float, dt: float) -> None:
        """The forces of the next physics step, of dt [s]."""
        import mujoco

        # Plain numbers, wheel by wheel: arrays of four take five times as long.
        data = self._data
        twist = self._twist
        loads = data.qfrc_constraint[self._slides].tolist()
        axles = data.xmat[self._bodies][:, [1, 4]].tolist()
        for i, body in enumerate(self._bodies):
            mujoco.mj_objectVelocity(self._model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
            self._wrench[i] = self._wheel(i, loads[i], axles[i], twist.tolist(), dt)
        data.xfrc_applied[self._bodies] = self._wrench

    def _wheel(
        self, i: int, load: float, axle: list[float], twist: list[float], dt: float
    ) -> tuple[float, ...]:
        """Force and torque at the centre of wheel i [N, Nm], from the horizontal part of its axle
        and its twist (w, v).
        """
        if load <= 0:  # in the air: it lands with a patch that is not deflected
            self._deflection[i] = 0.0, 0.0
            return (0.0,) * 6
        size = math.hypot(*axle)
        r = self._radius[i]
        tyre = self._tyres[i]
        # along: axle x up; across is (-y, x)
        x = axle[1] / size
        y = -axle[0] / size
        wx, wy, _, vx, vy, _ = twist
        # Of the point of the wheel under its centre: v + w x (0, 0, -r).
        px = vx - r * wy
        py = vy + r * wx
        sliding = (px * x + py * y, py * x - px * y)
        speed = abs(vx * x + vy * y)
        friction = self._friction[i]
        u = tyre.deflected(self._deflection[i], sliding, speed, friction, dt)
        self._deflection[i] = u
        along, across = tyre.force(u, sliding, speed, friction, load)
        fx = along * x - across * y
        fy = along * y + across * x
        return fx, fy, 0.0, r * fy, -r * fx, 0.0
