"""The imperfections of one quadrotor in one run: its blocks as forces, torques, orders and
vibration.

It knows the truth, which the simulator gives it, and the flight loops know nothing of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.quantity import PositiveTime, Share, TighterBounds
from vstestbed.core.spec import spec
from vstestbed.effects.base import Actor, Effect, Four, RobotBody, Vector
from vstestbed.effects.rotors import (
    ROTOR_M,
    Battery,
    MotorSpread,
    RotorInertia,
    Vibration,
    _Craft,
    _four,
)

# Aerodynamics of the rotors: the ground below them, the drag of blades in a cross wind, the wake
# that comes back. T = b w^2 is a rotor's thrust, R its radius, z its height over what is straight
# below it.
AIR = 1.184  # density of the air [kg/m^3] at 25 degrees, as in models/quadrotor.xml


@spec
class GroundEffect:
    """More thrust near the ground: T / T_inf = 1 / (1 - k (R/4z)^2 / (1 + (v/v_i)^2)), v_i^2 = T /
    (2 rho pi R^2).

    v is the rotor's speed along its disc. z is taken straight below four points of each disc, at R
    / sqrt(2), which halves its area, and the gain is their mean: over the edge of a deck a disc
    loses it by parts, and the rotors that are still over the deck tilt the craft. Below z = R/2,
    where the equation ceases to hold, z counts as R/2. What lies below is a plane to the equation:
    left out are the mirror images of the other rotors and the fountain between them, for which
    measured quadrotors have a `strength` over 1.

    Args:
        strength: k, how strong it is; 1 is the equation [1].

    Reference: Cheeseman & Bennett 1955, The effect of the ground on a helicopter rotor in forward
        flight, ARC R&M 3021; over an edge and of several rotors Sanchez-Cuevas, Heredia & Ollero
        2017, doi:10.1155/2017/1823056.
    """

    strength: Annotated[float, Ge(0), Le(3)] = 1.0

    def gain(self, nearness: float, radius: float, thrust: float, speed: float) -> float:
        """T / T_inf. nearness: (R/z)^2 [1]; radius: R [m]; thrust: T [N]; speed: along the disc
        [m/s].
        """
        induced = thrust / (2 * AIR * math.pi * radius * radius)
        if induced <= 0:
            return 1.0
        return 1.0 / (1.0 - self.strength * nearness / 16.0 * induced / (induced + speed * speed))


@spec
class RotorDrag:
    """Drag of the rotors against a cross wind, by flapping of the blades and by induced drag: F =
    -sum_i k w_i P v_i, k = C b / R.

    v_i is the hub's velocity against the air and P drops its part along the rotor's axis. With the
    advance ratio mu = v / (w R) it is F = C mu T. The X-4's blades flap by a1 = .31 mu
    (models/quadrotor.xml derives it), and induced drag of stiff blades is taken to be as much
    again: C = .62. Without this block both are part of `parameters.drag_area_m2`, which grows with
    v^2.

    Args:
        coefficient: C, drag over thrust and advance ratio [1].
        body_share: share of `parameters.drag_area_m2` that remains, since the rest stands for what
            is modelled here; the X-4's hub, arms and legs have .55 of it [1].

    Reference: Mahony, Kumar & Corke 2012, doi:10.1109/MRA.2012.2206474.
    """

    coefficient: Annotated[float, Ge(0), Le(10)] = 0.62
    body_share: Share = 0.55


@spec
class Downwash:
    """The wake that the ground, or a deck, throws back into the rotors: each thrust fluctuates, T
    (1 + s (R/z)^2 x).

    x is a first-order Gauss-Markov process of unit variance, of each rotor its own. The decay is
    that of the ground effect; there is no published law of its size, so both values are chosen.
    Left out: steady forces along the deck, and the push on the deck itself.

    Args:
        turbulence: s, standard deviation of a rotor's thrust one radius over the ground, as a share
            of it [1].
        turbulence_s: correlation time of the fluctuation [s].
    """

    turbulence: Share = 0.02
    turbulence_s: Annotated[PositiveTime, TighterBounds(ge=1e-3, le=100)] = 0.15


def nearness(z: float, radius: float) -> float:
    """(R/z)^2 of a height z [m], 0 over nothing; under R/2 Cheeseman & Bennett's equation, infinite
    at R/4, does not hold: R/2 counts.
    """
    ratio = radius / z if z > 0.5 * radius else 2.0
    return ratio * ratio


# All blocks of a craft together.

# where front, right, back and left are, along x and y, in arms
ALONG = (1.0, 0.0, -1.0, 0.0)
ACROSS = (0.0, -1.0, 0.0, 1.0)
NOTHING: Vector = (0.0, 0.0, 0.0)
ALIKE: Four = (1.0, 1.0, 1.0, 1.0)


@spec
class FlightBlocks:
    """The imperfections of a craft that flies; each block is off where it is not given, and costs
    nothing then.

    Args:
        ground_effect: more thrust near the ground; e.g. `{strength: 1}`.
        rotor_drag: drag of the rotors against a cross wind, linear in the velocity; e.g.
            `{coefficient: 0.62}`.
        downwash: thrust that fluctuates where the wake comes back from the ground, or from a deck;
            e.g. `{turbulence: 0.05}`.
        rotor_inertia: gyroscopic and reaction torque of the rotors; e.g. `{inertia_kgm2: 6.5e-5}`.
        battery: voltage that falls under load and with the charge, and the rotors' speed with it;
            e.g. `{charge: 0.4}`.
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


LAB: dict[str, object] = {
    "ground_effect": GroundEffect(),
    "rotor_drag": RotorDrag(),
    "downwash": Downwash(),
    "rotor_inertia": RotorInertia(),
    "battery": Battery(),
    "vibration": Vibration(),
    "motors": MotorSpread(),
}
"""Preset of a craft with balanced rotors and a full battery;
values as in the blocks' own defaults.
"""
FIELD: dict[str, object] = LAB | {
    "downwash": Downwash(turbulence=0.05),
    "battery": Battery(charge=0.25, resistance_ohm=0.04),
    "vibration": Vibration(
        imbalance_mps2=4.0,
        blade_pass_mps2=4.0,
        gyro_radps=0.04,
        accel_sigma_mps2=1.5,
        gyro_sigma_radps=0.015,
    ),
    "motors": MotorSpread(thrust_sigma=0.04, limit_sigma=0.04),
}
"""Preset of a worn craft late in its flight: chipped rotors, a nearly empty battery that is old;
values chosen.
"""


@dataclass(frozen=True, eq=False)
class FlightEffects(Effect):
    """All of a craft's blocks together: the thrust of a rotor is multiplied by several of them.

    craft: its parameters. blocks: its blocks.
    """

    craft: _Craft
    blocks: FlightBlocks

    def actor(self, body: RobotBody, rng: np.random.Generator) -> Actor:
        """Forces on the base, at the rate of the onboard controller."""
        return OnBase(body, Airframe(self.craft, self.blocks, rng))


class Airframe:
    """The imperfections of one craft in one run in plain floats, since it is computed at the rate
    of the onboard controller.

    Args:
        craft: its parameters. given: its blocks. rng: draws what differs from run to run, each
            block from a stream of its own.

    Attributes:
        probes: points in the base frame (k, 3) [m] below which the free height is measured; () for
            none.
    """

    def __init__(self, craft: _Craft, given: FlightBlocks, rng: np.random.Generator):
        self._craft = craft
        self._given = given
        spread, gusts, noise = rng.spawn(3)
        self._thrust, self._limit = given.motors.drawn(spread) if given.motors else (ALIKE, ALIKE)
        self._gusts = _normal(gusts, 4)
        self._noise = _normal(noise, 6)
        self._rough: Sequence[float] = gusts.standard_normal(4).tolist()
        self._angles: Four = _four(noise.uniform(0.0, 2 * math.pi, 4).tolist())
        self._W: Four = _four([craft.hover] * 4)
        self._charge = 1.0
        self._voltage = 0.0
        if given.battery:
            self._charge = given.battery.charge
            self._voltage = given.battery.hovering(craft, self._charge)
        self._drag = 0.0
        if given.rotor_drag:
            drag = given.rotor_drag.coefficient
            self._drag = drag * craft.thrust_coefficient / craft.rotor_radius_m
        self._spin = given.rotor_inertia.of(craft) if given.rotor_inertia else 0.0
        self.probes: Sequence[Vector] = ()
        if given.ground_effect or given.downwash:
            self.probes = _probes(craft)

    def act(
        self,
        air: Vector,
        rates: Vector,
        W: Sequence[float],
        below: Sequence[float],
        orders: Sequence[float],
        dt: float,
    ) -> tuple[Vector, Vector, Four]:
        """Force and torque on the base about its origin, base axes (3,) [N, Nm], and what reaches
        the actuators, for dt [s].

        air: velocity of the base's origin against the air, rates: angular velocity, base axes (3,)
        [m/s, rad/s]. W, orders: squared speeds of the rotors, and those ordered (4,) [(rad/s)^2].
        below: how far below each of `probes` something is, inf over nothing [m].
        """
        self._W = _four([x if x > 0 else 0.0 for x in W])
        speeds = _four([math.sqrt(x) for x in self._W])
        reached = self._driven(orders, speeds, dt)
        force, torque = self._lifted(air, below, dt)
        if self._drag:
            fx, fy, turn = self._dragged(air, rates, speeds)
            force = force[0] + fx, force[1] + fy, force[2]
            torque = torque[0] - ROTOR_M * fy, torque[1] + ROTOR_M * fx, torque[2] + turn
        if self._spin:  # the equation of `RotorInertia`; omega x z = (w_y, -w_x, 0)
            wx, wy, _ = rates
            momentum = self._spin * _about_z(speeds)
            change = self._spin * _about_z(self._accelerations(reached, speeds))
            torque = torque[0] - momentum * wy, torque[1] + momentum * wx, torque[2] - change
        if self._given.vibration:
            turned = [phi + w * dt for phi, w in zip(self._angles, speeds, strict=True)]
            self._angles = _four([phi % (2 * math.pi) for phi in turned])
        return force, torque, reached

    def _dragged(self, air: Vector, rates: Vector, speeds: Four) -> Vector:
        """Forces of the rotors' drag along x and y [N], and their torque about z [Nm]."""
        vx, vy, _ = air
        wx, wy, wz = rates
        arm = self._craft.arm_m
        h = ROTOR_M
        fx = fy = turn = 0.0
        for i in range(4):
            x = ALONG[i] * arm
            y = ACROSS[i] * arm
            k = self._drag * speeds[i]
            px = -k * (vx + wy * h - wz * y)
            py = -k * (vy + wz * x - wx * h)
            fx += px
            fy += py
            turn = turn + x * py - y * px
        return fx, fy, turn

    def _accelerations(self, reached: Four, speeds: Four) -> Sequence[float]:
        """Of the rotors (4,) [rad/s^2], by their lag; of one that stands none."""
        half = 0.5 / self._craft.rotor_lag_s
        rotors = zip(reached, self._W, speeds, strict=True)
        return [half * (u - W) / w if w > 1.0 else 0.0 for u, W, w in rotors]

    def felt(self, sensors: dict[str, list[float]]) -> dict[str, list[float]]:
        """The IMU's readings with the vibration, and the battery's `voltage` [V]."""
        if self._given.vibration:
            noise = next(self._noise)
            moved = self._given.vibration.at(self._angles, self._W, self._craft.hover, noise)
            for name, change in zip(("accelerometer", "gyro"), moved, strict=True):
                sensors[name] = [x + d for x, d in zip(sensors[name], change, strict=True)]
        if self._given.battery:
            sensors["voltage"] = [self._voltage]
        return sensors

    def _driven(self, orders: Sequence[float], speeds: Four, dt: float) -> Four:
        """What the motors make of the orders (4,): less by a battery's voltage, and each up to its
        own limit.
        """
        battery = self._given.battery
        most = self._craft.limit
        share = 1.0
        if battery:
            power = battery.power(speeds, self._craft)
            self._voltage = battery.voltage(self._charge, power)
            self._charge = battery.drained(self._charge, power / self._voltage, dt)
            share = battery.share(self._voltage, self._craft)
        limits = zip(orders, self._limit, strict=True)
        return _four([min(most, share * min(u, most * f)) for u, f in limits])

    def _lifted(self, air: Vector, below: Sequence[float], dt: float) -> tuple[Vector, Vector]:
        """Force and torque of what the thrusts are more than those of the model's file."""
        given = self._given
        wash = given.downwash
        if not (given.ground_effect or wash or given.motors):
            return NOTHING, NOTHING
        if wash:
            keep = math.exp(-dt / wash.turbulence_s)
            fresh = math.sqrt(1.0 - keep * keep)
            gusts = zip(self._rough, next(self._gusts), strict=True)
            self._rough = [keep * x + fresh * n for x, n in gusts]
        arm = self._craft.arm_m
        speed = math.hypot(air[0], air[1])
        up = x = y = 0.0
        for i in range(4):
            usual = self._craft.thrust_coefficient * self._W[i]
            thrust = usual * self._thrust[i]
            if self.probes:
                thrust *= self._share(i, below, thrust, speed)
            more = thrust - usual
            up += more
            x += ACROSS[i] * arm * more
            y -= ALONG[i] * arm * more
        return (0.0, 0.0, up), (x, y, 0.0)

    def _share(self, i: int, below: Sequence[float], thrust: float, speed: float) -> float:
        """What the ground, and the wake from it, make of the thrust of rotor i [N], a factor: the
        mean over its probes. speed: horizontal, against the air [m/s].
        """
        ground = self._given.ground_effect
        wash = self._given.downwash
        R = self._craft.rotor_radius_m
        near = [nearness(z, R) for z in below[4 * i : 4 * i + 4]]
        share = 1.0
        if ground:
            share = 0.25 * sum([ground.gain(n, R, thrust, speed) for n in near])
        if wash:
            share += wash.turbulence * 0.25 * sum(near) * self._rough[i]
        return share


def _about_z(rotors: Sequence[float]) -> float:
    """The sum of the rotors' rates (4,), or of their accelerations, by their sense of rotation."""
    front, right, back, left = rotors
    return front - right + back - left


def _probes(craft: _Craft) -> tuple[Vector, ...]:
    """Four points of each disc, of front, right, back and left in turn, at R / sqrt(2) from its
    hub, in the base frame (16, 3) [m].
    """
    d = craft.arm_m
    r = craft.rotor_radius_m / math.sqrt(2)
    directions = tuple(zip(ALONG, ACROSS, strict=True))
    probes = list[Vector]()
    for x, y in directions:
        probes += [(x * d + r * u, y * d + r * v, ROTOR_M) for u, v in directions]
    return tuple(probes)


def _normal(rng: np.random.Generator, n: int) -> Iterator[list[float]]:
    """Normal numbers (n,), one instant after the other."""
    while True:
        yield from rng.standard_normal((64, n)).tolist()  # for so many instants at once


DOWN = np.array([0.0, 0.0, -1.0])


class OnBase(Actor):
    """A floating robot with its imperfections. body: the robot, with the free joint `root`.
    airframe: its imperfections.
    """

    def __init__(self, body: RobotBody, airframe: Airframe):
        model = body.model
        data = body.data
        self._model = model
        self._data = data
        self._airframe = airframe
        self._body = model.body("robot/base").id
        dof = int(model.joint("robot/root").dofadr[0])
        # Views of MuJoCo's own memory, taken once: each takes as long as ten operations on floats.
        self.force = np.zeros(model.nv)
        self._velocity = data.qvel[dof : dof + 6]
        self._applied = self.force[dof : dof + 6]
        self._place = data.xpos[self._body]
        self._turn = data.xmat[self._body]
        self._wind = model.opt.wind
        self._activations = data.act
        self._acting = body.at.act.tolist()
        self._probes = airframe.probes
        self._below = [math.inf] * len(airframe.probes)
        self._next = 0
        self._from = np.zeros(3)
        self._geom = np.zeros(1, dtype=np.int32)

    def start(self) -> None:
        """Measure all heights: the craft is at its start."""
        for i in range(len(self._probes)):
            self._look(i, self._turn.tolist())

    def driven(self, orders: Sequence[float], dt: float) -> Sequence[float]:
        """Put force and torque on the base for the next control period; what the controller's
        orders (nu,) become.
        """
        R = self._turn.tolist()
        # one ray a period: of 16 the oldest is as old as 16 ms, in which a craft that lands sinks 5
        # mm
        if self._probes:
            self._look(self._next, R)
            self._next = (self._next + 1) % len(self._probes)
        vx, vy, vz, p, q, r = self._velocity.tolist()
        wx, wy, wz = self._wind.tolist()
        a, b, c, d, e, f, g, h, i = R
        x = vx - wx
        y = vy - wy
        z = vz - wz
        activations = self._activations.tolist()
        air = a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z
        W = [activations[k] for k in self._acting]
        (x, y, z), (p, q, r), reached = self._airframe.act(
            air, (p, q, r), W, self._below, orders, dt
        )
        # A free joint's generalised force: linear along world axes at the base's origin, angular in
        # the base's own.
        world = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
        self._applied[:] = (*world, p, q, r)
        return reached

    def felt(self, sensors: dict[str, list[float]]) -> dict[str, list[float]]:
        return self._airframe.felt(sensors)

    def _look(self, number: int, R: list[float]) -> None:
        """Cast the ray from a probe straight down, with the base's orientation R (9,)."""
        import mujoco

        x, y, z = self._probes[number]
        a, b, c, d, e, f, g, h, i = R
        self._from[:] = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
        self._from += self._place
        hit = mujoco.mj_ray(
            self._model, self._data, self._from, DOWN, None, 1, self._body, self._geom
        )
        self._below[number] = hit if hit >= 0 else math.inf
