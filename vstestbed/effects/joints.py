"""What the drives of an arm's joints lack of ideal ones: stiff gears without play, smooth torque,
exact encoders, torque at once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Le, Len
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Broadcast, Frequency, PositiveTime
from vstestbed.core.spec import spec
from vstestbed.effects.base import MOTOR, Actor, Effect, RobotBody, RobotModel

if TYPE_CHECKING:
    import mujoco

Springs = Annotated[tuple[Annotated[float, Ge(0), Le(1e9)], ...], Len(0, 7), Broadcast()]
Torques = Annotated[tuple[Annotated[float, Ge(0), Le(1e6)], ...], Len(1, 7), Broadcast()]
SmallAngles = Annotated[tuple[Annotated[float, Ge(0), Le(10)], ...], Len(1, 7), Broadcast()]
Cycles = Annotated[tuple[Annotated[float, Ge(0), Le(1e6)], ...], Len(1, 7), Broadcast()]
Counts = Annotated[tuple[Annotated[int, Ge(0), Le(2**31)], ...], Len(1, 7), Broadcast()]
MilliSeconds = Annotated[float, Ge(0), Le(0.1)]


def each(
    field: str, given: Sequence[float], slides: NDArray[np.bool_], turns: bool = True
) -> Array:
    """A value for each joint (n,), from one for all of them or one for each. Of an angle (`turns`)
    joints that slide get 0.

    Raises ParameterError: another number of values, or an angle for a joint that slides.
    """
    n = len(slides)
    if len(given) not in (1, n):
        raise ParameterError.count(
            field, f"one value for all joints, or {n},", "one for each", list(given)
        )
    values = np.resize(np.array(given, dtype=float), n)
    if not turns:
        return values
    if len(given) == n and values[slides].any():
        raise ParameterError.fixed(field, "0", list(given), where="for a joint that slides")
    return np.where(slides, 0.0, values)


@spec
class Gears:
    """Elastic gears with play: a joint is two masses, the rotor of its motor and the link, with a
    spring and a damper between them.

    J theta'' = tau - f,  M(q) q'' + ... = f,  f = k s + c (theta' - q'),
    s = theta - q beyond the play: 0 within +-b/2,

    with the rotor's inertia J (the armature of the file, times the squared gear ratio), its angle
    theta on the joint's side, and c = k damping_s. Motor, its friction, servo and encoder are on
    the rotor's side, as in industrial arms; the camera is behind the spring. A link alone, of
    inertia M, vibrates at sqrt(k/M) before a rotor that stands and at sqrt(k (1/J + 1/M)) before a
    free one, with the damping ratio w damping_s / 2 at w. The damping acts within the play, too, as
    that of the lubricant.

    The stiffness of `strain_wave` grows with the torque, in stages: k is its first one, and s bends
    at the stages' ends.

    Reference: Spong 1987, Modeling and control of elastic joint robots, doi:10.1115/1.3143860.

    Args:
        stiffness_nmprad: stiffness k of each joint, one for all or one for each; 0: rigid (N/m
            where the joint slides); default: that of `robot.strain_wave` [Nm/rad]; e.g.
            `[25000, 25000, 10000, 0, 0, 0]`.
        damping_s: c / k of all joints [s].
        backlash_deg: b, the whole play of each joint, as its link moves before a rotor that stands,
            one for all or one for each [deg].
    """

    stiffness_nmprad: Springs = ()
    damping_s: MilliSeconds = 0.0005
    backlash_deg: SmallAngles = (0.0,)

    def play(self, k: Array, slides: NDArray[np.bool_]) -> Array:
        """Play (n,) [rad] of joints of stiffness k (n,), of which some slide; one that is given
        alone holds for the elastic ones.

        Raises ParameterError: another number of values, or play in a rigid joint.
        """
        play = np.radians(each("gears.backlash_deg", self.backlash_deg, slides))
        if len(self.backlash_deg) > 1 and play[k == 0].any():
            words = "a stiffness for it in gears.stiffness_nmprad"
            raise ParameterError.fixed(
                "gears.backlash_deg",
                "0",
                list(self.backlash_deg),
                where="for a rigid joint",
                works=words,
            )
        return np.where(k > 0, play, 0.0)


@spec
class Ripple:
    """Cogging of the motors, a torque that depends on the rotor's angle theta alone, and the ripple
    of the torque that they give.

    tau = (1 + share sin(cycles theta)) tau_servo + cogging_nm sin(cycles theta), all on the joint's
    side of the gears.

    Reference: Jahns & Soong 1996, Pulsating torque minimization techniques for permanent magnet AC
    motor drives, doi:10.1109/41.491356.

    Args:
        cogging_nm: amplitude of the cogging torque of each joint, one for all or one for each [Nm];
            e.g. `0.5`.
        share: ripple of the torque as a share of it [1].
        cycles: cycles in a turn of the joint: those in a turn of the motor times the gear ratio,
            one for all or one for each [1].
    """

    cogging_nm: Torques = (0.0,)
    share: Annotated[float, Ge(0), Le(0.5)] = 0.0
    cycles: Cycles = (600.0,)


@spec
class Encoders:
    """What the encoders read: the angle in whole counts, with the error of a graduation that is not
    centred on its shaft.

    q = c round(p / c),  p = theta + e sin(turns theta),  c = 2 pi / counts;
    q' = c round(p' window_s / c) / window_s:

    the counts of a window, as counters measure speed. e [rad] is the eccentricity over the
    graduation's radius, divided by `turns`. The servos have the angle without these errors. Joints
    that slide are read exactly.

    The kinematic error of a strain wave gear between an encoder on the motor and the link has the
    same form: twice in a turn of the motor, so that `turns` is twice the ratio (Tuttle & Seering
    1996, doi:10.1109/70.499819), with half of the catalogue's positioning accuracy as e.

    Args:
        counts: in a turn of the joint, those in a turn of the encoder times `turns`, one for all or
            one for each; 0: no steps [1].
        eccentricity_deg: e, amplitude of the error on the joint's side, one for all or one for each
            [deg].
        turns: of the encoder in a turn of the joint: 1 on the joint, the gear ratio on the motor;
            one for all or one for each [1].
        window_s: in which counts are a speed [s].
    """

    counts: Counts = (0,)
    eccentricity_deg: SmallAngles = (0.0,)
    turns: Cycles = (1.0,)
    window_s: PositiveTime = 0.01

    def read(self, q: Array, qd: Array, slides: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Measured positions and velocities (n,) each of joints at q, qd (n,) [rad, rad/s]."""
        e = np.radians(each("encoders.eccentricity_deg", self.eccentricity_deg, slides))
        N = each("encoders.turns", self.turns, slides)
        p = q + e * np.sin(N * q)
        pd = qd * (1 + e * N * np.cos(N * q))
        counts = each("encoders.counts", self.counts, slides)
        steps = counts > 0
        step = 2 * np.pi / np.where(steps, counts, 1.0)
        speed_step = step / self.window_s
        counted = np.where(steps, step * np.round(p / step), p)
        return counted, np.where(steps, speed_step * np.round(pd / speed_step), pd)


@spec
class CurrentLoops:
    """Current loops: the motor's torque follows the servo's with a lag of the first order and a
    delay.

    tau' = (u(t - delay_s) - tau) 2 pi bandwidth_hz, with the servo's torque u within its limits.
    The servo then is a sampled one, at the physics step, of 1 ms at most. Its velocity loop has a
    crossover at kv over the rotor's inertia; where lag, delay and sampling take its phase margin,
    it oscillates.

    Args:
        bandwidth_hz: at which the torque has fallen by 3 dB [Hz].
        delay_s: between the servo's torque and the motor's, in whole physics steps [s].
    """

    bandwidth_hz: Frequency = 500.0
    delay_s: MilliSeconds = 0.0


def _add_spring(
    model: mujoco.MjSpec,
    name: str,
    prefix: str,
    free: float,
    stiffness: float,
    damping: float = 0.0,
) -> None:
    """A spring between the rotor of a joint and its link, which acts where they differ by more than
    `free` [rad].
    """
    spring = model.add_tendon(name=f"{prefix}{name}", springlength=[-free, free])
    spring.stiffness[0] = stiffness
    spring.damping[0] = damping
    spring.wrap_joint(f"{MOTOR}{name}", 1.0)
    spring.wrap_joint(name, -1.0)


def _add_rotor(model: mujoco.MjSpec, name: str) -> None:
    """The rotor of a joint, turning about the joint's own axis on the same parent.

    Its inertia is the armature of its hinge, which counts for its own turning alone. As the inertia
    of a body the squared gear ratio would be in it for all joints before it, too, where the motor's
    rotor counts as it is (Spong 1987, assumption 2, doi:10.1115/1.3143860).
    """
    import mujoco

    link = model.joint(name)
    body = link.parent.parent.add_body(
        name=f"{MOTOR}{name}", pos=link.parent.pos, quat=link.parent.quat, mass=1e-6
    )
    # which MuJoCo asks for
    body.inertia = [1e-9] * 3
    body.explicitinertial = True
    body.ipos = link.pos  # on the axis: its weight turns nothing
    # the orientation as the file writes it
    for field in ("type", "axisangle", "euler", "xyaxes", "zaxis"):
        setattr(body.alt, field, getattr(link.parent.alt, field))
    rotor = body.add_joint(
        name=f"{MOTOR}{name}", type=link.type, pos=link.pos, axis=link.axis, armature=link.armature
    )
    rotor.damping = link.damping
    rotor.frictionloss = link.frictionloss
    rotor.solref_friction = link.solref_friction
    rotor.solimp_friction = link.solimp_friction
    rotor.actfrclimited = link.actfrclimited
    rotor.actfrcrange = link.actfrcrange
    rotor.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    link.armature = 0.0
    link.frictionloss = 0.0
    link.damping = [0.0] * len(link.damping)
    link.actfrclimited = mujoco.mjtLimited.mjLIMITED_FALSE
    for actuator in model.actuators:
        if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT and actuator.target == name:
            actuator.target = rotor.name


@dataclass(frozen=True, eq=False)
class ElasticJoints(Effect):
    """`Gears` of an arm of n joints in plain numbers.

    A fixed tendon of length theta - q is the spring; its rest lengths from -b/2 to b/2 are the play
    b. Each further stage of the stiffness is one more tendon, whose rest lengths reach to the
    stage's beginning. Armature, friction, torque limit and actuators of an elastic joint go to the
    side of its rotor, the joint `rotor_<joint>`.

    Attributes:
        joints: names in the file. stiffness, damping, play: (n,) [Nm/rad, Nm s/rad, rad]; a joint
            of stiffness 0 is rigid.
        stages: (n, m, 2), beyond which torsion the stiffness of a gear grows by how much [rad,
            Nm/rad]; in the order of the torsion; (n, 0, 2) where it does not grow.
        rotors: inertia of the motors' rotors on the joint's side (n,) [kg m^2]; None: as the file
            has it.
        longest_step: computes the longest physics step that resolves the vibrations [s], which
            takes the inertia of the links.
    """

    joints: tuple[str, ...]
    stiffness: Array
    damping: Array
    play: Array
    stages: Array
    rotors: Array | None
    longest_step: Callable[[], float]

    @property
    def longest_step_s(self) -> float:
        """What resolves the quickest vibration of the gears [s]."""
        return self.longest_step()

    def edit(self, robot: RobotModel) -> None:
        """Divide each elastic joint into rotor and link, with a spring between the two."""
        model = robot.spec
        for i, name in enumerate(self.joints):
            if self.rotors is not None:
                model.joint(name).armature = self.rotors[i]
            if self.stiffness[i] > 0:
                _add_rotor(model, name)
                play = self.play[i] / 2
                _add_spring(model, name, "gear_", play, self.stiffness[i], self.damping[i])
                for j, (torsion, more) in enumerate(self.stages[i].tolist(), start=2):
                    _add_spring(model, name, f"gear_{j}_", play + torsion, more)

    def settle(self, body: RobotBody, load: Array) -> None:
        """Wind the gears up by the load, which then is the rotors'."""
        soft = self.stiffness > 0
        at = body.at
        if not soft.any():
            return
        asked = load[at.qvel][soft]
        # Without a load a gear lies in the middle of its play; rounding leaves less than 1e-6 Nm of
        # the weight on a vertical axis.
        play = np.where(np.abs(asked) > 1e-6, np.sign(asked) * self.play[soft] / 2, 0.0)
        body.data.qpos[at.motor_qpos[soft]] += self.torsion(load[at.qvel])[soft] + play
        load[at.motor_qvel] = load[at.qvel]

    def springs(self, load: Array) -> tuple[Array, Array] | None:
        return (self._under(load)[1], self.damping) if self.stiffness.any() else None

    @property
    def stiffest(self) -> Array:
        """Stiffness of the gears under a large torque (n,) [Nm/rad]."""
        return self.stiffness + self.stages[:, :, 1].sum(axis=1)

    def torsion(self, torque: Array) -> Array:
        """Torsion of the gears (n,) [rad] under a torque (n,) [Nm], beyond their play; 0 where they
        are rigid.
        """
        return self._under(torque)[0]

    def _under(self, torque: Array) -> tuple[Array, Array]:
        k = self.stiffness.copy()
        left = np.abs(torque)
        at = np.zeros(len(k))
        torsion = np.zeros(len(k))
        for stage in self.stages.transpose(1, 2, 0):
            # the torque at which this stage begins, beyond that of the former one
            held = k * (stage[0] - at)
            beyond = (left > held) & (stage[1] > 0)
            torsion = torsion + np.where(beyond, stage[0] - at, 0.0)
            left = left - np.where(beyond, held, 0.0)
            at = np.where(beyond, stage[0], at)
            k = k + np.where(beyond, stage[1], 0.0)
        rest = np.divide(left, k, out=np.zeros(len(k)), where=k > 0)
        return np.sign(torque) * (torsion + rest), k


FINEST = 0.5
"""Largest w h of an eigenfrequency w at a physics step h. The spring's force is that of the
beginning of a step: the vibration then is (w h)^2 / 24 too quick, 1 % here, and it grows from w h =
2 on.
"""


def quickest(M: Array, rotors: Array, stiffness: Array) -> tuple[float, int]:
    """The highest eigenfrequency of the two-mass joints, servos off [rad/s], and the joint that
    moves most in it; (0, 0) if all are rigid.

    det([[K, -K], [-K, K]] - w^2 [[M, 0], [0, J]]) = 0; a rigid joint's rotor is part of its link.

    M: inertia of the links (n, n). rotors: J, (n,). stiffness: diagonal of K, (n,), 0 for a rigid
    joint.
    """
    soft = np.flatnonzero(stiffness > 0)
    if not len(soft):
        return 0.0, 0
    n = len(stiffness)
    k = stiffness[soft]
    mass = np.zeros((n + len(soft),) * 2)
    spring = np.zeros((n + len(soft),) * 2)
    mass[:n, :n] = M + np.diag(np.where(stiffness > 0, 0.0, rotors))
    mass[n:, n:] = np.diag(rotors[soft])
    at = n + np.arange(len(soft))
    spring[soft, soft] = k
    spring[at, at] = k
    spring[soft, at] = -k
    spring[at, soft] = -k
    L_inverse = np.linalg.inv(np.linalg.cholesky(mass))
    w2, modes = np.linalg.eigh(L_inverse @ spring @ L_inverse.T)
    mode = L_inverse.T @ modes[:, -1]
    return math.sqrt(max(float(w2[-1]), 0.0)), int(soft[np.argmax(np.abs(mode[soft] - mode[at]))])


@dataclass(frozen=True, eq=False)
class Motors(Effect):
    """`Ripple` and `CurrentLoops` of an arm of n joints in plain numbers.

    cogging, cycles: amplitude of the cogging torque and cycles in a turn of the joint (n,) [Nm, 1].
    ripple: of the torque [1].
    loops: the current loops; None: the torque follows at once.
    """

    cogging: Array
    cycles: Array
    ripple: float
    loops: CurrentLoops | None

    @property
    def longest_step_s(self) -> float:
        """With current loops, which sample the servo at it, 1 ms: half of that on average beside a
        lag of as much.
        """
        return np.inf if self.loops is None else 0.001

    def edit(self, robot: RobotModel) -> None:
        """With current loops MuJoCo's servos are left without force; integrals of commands and
        gains stay where they are.
        """
        import mujoco

        if self.loops is not None:
            for actuator in robot.spec.actuators:
                if actuator.name in robot.actuators:
                    actuator.biastype = mujoco.mjtBias.mjBIAS_NONE
                    actuator.gainprm[0] = 0.0

    def actor(self, body: RobotBody, rng: np.random.Generator) -> Actor | None:
        if self.loops is not None or self.ripple > 0 or self.cogging.any():
            return MotorTorques(body, self)
        return None


class MotorTorques(Actor):
    """Applies the torques of an arm's motors to its rotors, where they are not simply MuJoCo's
    servos.

    Ripple and cogging are added to MuJoCo's torque of the step before. With current loops MuJoCo's
    servos are out of force, but for the integrals of their commands: u = kp (act - theta) + kv (v -
    theta') within the limits, where v is the command of a servo without integral (of a motor that
    is told its torque, u is what it is told), delayed by whole steps and smoothed by the lag; over
    a step h of constant u the mean torque is u + (tau - u) (1 - exp(-h / T)) T / h with T = 1 / (2
    pi bandwidth).
    """

    of_motors = True

    def __init__(self, body: RobotBody, motors: Motors):
        import mujoco

        model = body.model
        at = body.at
        self.force = np.zeros(model.nv)
        self._data = body.data
        self._motors = motors
        self._qpos = at.motor_qpos
        self._qvel = at.motor_qvel
        self._actuators = np.array([model.actuator(f"robot/{name}").id for name in body.actuators])
        self._ctrl = model.actuator_ctrladr[self._actuators]
        self._kp = -model.actuator_biasprm[self._actuators, 1]
        self._kv = -model.actuator_biasprm[self._actuators, 2]
        self._told = (self._kp == 0) & (self._kv == 0)  # motors that are told their torque
        self._integrates = model.actuator_dyntype[self._actuators] == mujoco.mjtDyn.mjDYN_INTEGRATOR
        self._act = np.where(self._integrates, model.actuator_actadr[self._actuators], 0)
        joints = model.actuator_trnid[self._actuators, 0]
        self._most = np.where(
            model.jnt_actfrclimited[joints].astype(bool), model.jnt_actfrcrange[joints, 1], np.inf
        )
        self._limited = model.actuator_forcelimited[self._actuators].astype(bool)
        self._ranges = model.actuator_forcerange
        self._ripples = motors.ripple > 0 or bool(motors.cogging.any())
        if motors.loops is not None:
            h = body.step_s
            T = 1 / (2 * math.pi * motors.loops.bandwidth_hz)
            self._left = math.exp(-h / T)
            self._mean = (1 - self._left) * T / h
            self._delay = round(motors.loops.delay_s / h)

    def start(self) -> None:
        if self._motors.loops is not None:
            self._tau = self._servos()
            self._late = deque([self._tau] * self._delay)

    def act(self, t: float, dt: float) -> None:
        m = self._motors
        tau = 0.0
        if m.loops is not None:
            self._late.append(self._servos())
            u = self._late.popleft()
            tau = u + (self._tau - u) * self._mean
            self._tau = u + (self._tau - u) * self._left
        if self._ripples:
            wave = np.sin(m.cycles * self._data.qpos[self._qpos])
            given = tau if m.loops is not None else self._data.actuator_force[self._actuators]
            tau = tau + (m.ripple * given + m.cogging) * wave
        self.force[self._qvel] = tau

    def _servos(self) -> Array:
        data = self._data
        kv = self._kv
        at = data.qpos[self._qpos]
        speed = data.qvel[self._qvel]
        held = self._kp * (data.act[self._act] - at) if data.act.size else 0.0
        u = np.where(
            self._integrates,
            held - kv * speed,
            kv * (data.ctrl[self._ctrl] - speed) + self._told * data.ctrl[self._ctrl],
        )
        # of this step: another effect may lower it
        own = np.where(self._limited, self._ranges[self._actuators, 1], np.inf)
        most = np.minimum(own, self._most)
        return np.clip(u, -most, most)


# Strain wave gears by the sizes of their catalogue: stiffness in three stages, and the rotors
# before them.
Sizes = Annotated[tuple[Annotated[int, Ge(0), Le(100)], ...], Len(1, 7), Broadcast()]
Rotors = Annotated[tuple[Annotated[float, Ge(0), Le(1e3)], ...], Len(0, 7), Broadcast()]


class Torsion(NamedTuple):
    """Torque over torsion: k1 up to t1, k2 up to t2, k3 beyond [Nm, Nm/rad]."""

    t1: float
    t2: float
    k1: float
    k2: float
    k3: float

    @property
    def bends(self) -> tuple[float, float]:
        """Torsion at t1 and t2 [rad]."""
        first = self.t1 / self.k1
        return first, first + (self.t2 - self.t1) / self.k2


CURVES: Mapping[int, Torsion] = {
    8: Torsion(0.29, 0.75, 0.09e4, 0.10e4, 0.12e4),
    11: Torsion(0.80, 2.0, 0.27e4, 0.34e4, 0.44e4),
    14: Torsion(2.0, 6.9, 0.47e4, 0.61e4, 0.71e4),
    17: Torsion(3.9, 12.0, 1.0e4, 1.4e4, 1.6e4),
    20: Torsion(7.0, 25.0, 1.6e4, 2.5e4, 2.9e4),
    25: Torsion(14.0, 48.0, 3.1e4, 5.0e4, 5.7e4),
    32: Torsion(29.0, 108.0, 6.7e4, 11.0e4, 12.0e4),
    40: Torsion(54.0, 196.0, 13.0e4, 20.0e4, 23.0e4),
}
"""Of each size, at ratios of 80 and more. Source: Harmonic Drive LLC, catalogue of the cup type
gears CSF and CSG, engineering data, torsional stiffness.
"""


@spec
class StrainWave:
    """Strain wave gears, one in each joint, of ratios of 80 and more, as most light arms have them.

    Their torsional stiffness is the catalogue's, in three stages: k1 up to a torque t1, k2 up to
    t2, k3 beyond. Of size 20: 16000, 25000 and 29000 Nm/rad with t1 = 7 and t2 = 25 Nm. A gear
    whose size is not known is taken as the least whose limit for repeated peak torque carries the
    joint's largest torque: at a ratio of 100 that is 11 Nm of CSF-11, 36 of CSG-14, 70 of CSG-17,
    107 of CSG-20, 204 of CSG-25, 433 of CSG-32.

    It changes nothing by itself: `realism`, and `gears` without a stiffness, take their springs and
    rotors from it.

    Reference: Harmonic Drive LLC, catalogue of the cup type gears CSF and CSG: rating table and
    torsional stiffness.

    Args:
        sizes: of the catalogue, 8 to 40, one for all joints or one for each; 0: a joint that stays
            rigid, such as one before a link so light that it would vibrate at more than some 100 Hz
            [1]; e.g. `[20, 20, 20, 20, 14, 14, 0]`.
        rotor_kgm2: inertia of each rotor times the squared gear ratio, one for all or one for each;
            default: the `armature` of the file [kg m^2]; e.g.
            `[0.606, 0.606, 0.462, 0.462, 0.206, 0.206, 0.206]`.
    """

    sizes: Sizes
    rotor_kgm2: Rotors = ()

    def curves(self, slides: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Stiffness at rest (n,) [Nm/rad], and the stages (n, 2, 2): beyond which torsion [rad] it
        grows by how much [Nm/rad].

        Raises ParameterError: another number of sizes, or one that the catalogue has not.
        """
        sizes = each("strain_wave.sizes", self.sizes, slides)
        k = np.zeros(len(slides))
        stages = np.zeros((len(slides), 2, 2))
        for i, size in enumerate(sizes.astype(int).tolist()):
            if size == 0:
                continue
            if size not in CURVES:
                raise ParameterError.choice("strain_wave.sizes", (0, *CURVES), size)
            curve = CURVES[size]
            first, second = curve.bends
            k[i] = curve.k1
            stages[i] = (first, curve.k2 - curve.k1), (second, curve.k3 - curve.k2)
        return k, stages

    def rotors(self, slides: NDArray[np.bool_]) -> Array | None:
        """J (n,) [kg m^2]; None for those of the file."""
        if not self.rotor_kgm2:
            return None
        return each("strain_wave.rotor_kgm2", self.rotor_kgm2, slides, turns=False)
