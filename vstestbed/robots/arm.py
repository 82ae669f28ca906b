"""Serial arms with a camera or a target at the flange, driven by joint velocities: what all of them
share.

Without imperfections an arm is that of its file, and knows itself exactly. They are elastic gears,
ripple, encoders, current loops, errors of the geometry and of the gravity compensation, and a
payload.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import ParameterError, UnreachableError
from vstestbed.core.geometry import Array, adjoint, inverse, log, rigid_error
from vstestbed.core.quantity import Angle
from vstestbed.core.spec import spec
from vstestbed.effects.base import Effect, Sensors
from vstestbed.effects.joints import (
    FINEST,
    CurrentLoops,
    ElasticJoints,
    Encoders,
    Gears,
    Motors,
    Ripple,
    StrainWave,
    each,
    quickest,
)
from vstestbed.effects.links import GeometryError, Payload
from vstestbed.effects.tool import FORCE, PLUG, TORQUE, Plug, Tool, WristSensor
from vstestbed.robots.allocation import ALL_SIX, Actuation, Allocation, Limit, Mount, Servo, differs
from vstestbed.robots.base import (
    LARGEST_STEP_S,
    STOP_S,
    BodyFile,
    Reading,
    RobotLog,
    RobotState,
    SensorModel,
    Supervisor,
    random_of,
)
from vstestbed.robots.chain import JointChain, reader
from vstestbed.robots.inner_loops import (
    WRENCH,
    ArmModel,
    Impedance,
    Inner,
    TorqueControl,
    VelocityServos,
)
from vstestbed.robots.own_model import OwnModel
from vstestbed.robots.realism import Realistic

__all__ = ["INNER", "Arm", "ArmStart", "Positions", "singularity_damping2", "unit_scale"]

# smallest singular value that is left undamped, with lengths in the arm's own unit
THRESHOLD = 0.05


def resolved_rate(J: Array, twist: Array, unit_m: float, threshold: float = THRESHOLD) -> Array:
    """Damped resolved-rate control: joint speeds for a flange twist.

    dq = Js^T (Js Js^T + lambda^2 I)^-1 ts,  where Js and ts have v divided by unit_m, and
    lambda^2 = (1 - (s_min / threshold)^2) threshold^2 where s_min < threshold, else 0.

    Exact away from singularities, continuous across the threshold, and |dq| <= |ts| / threshold
    everywhere (the largest damping equals the threshold, so the gain along the weakest direction is
    s_min / threshold^2).
    With fewer than six joints the twist is met in the least-squares sense, with more dq is the
    smallest.

    J: Jacobian, shape (6, n), rows (v, w). twist: (vx, vy, vz, wx, wy, wz) of the flange in the
    Jacobian's frame, [m/s, rad/s].
    unit_m: length that makes metres and radians comparable [m]. threshold: smallest singular value
    of Js that is left undamped. Returns dq (n,) [rad/s, m/s]; `J @ dq` is the realised twist.

    Reference: Nakamura & Hanafusa 1986, doi:10.1115/1.3143764; this law of lambda from Maciejewski
    & Klein 1988, doi:10.1002/rob.4620050603, as written by Chiaverini, Siciliano & Egeland 1994,
    doi:10.1109/87.294335.
    """
    scale = unit_scale(unit_m)
    U, s, Vt = np.linalg.svd(J * scale[:, None], full_matrices=False)
    damping2 = max(0.0, threshold**2 - float(s[-1]) ** 2)
    return Vt.T @ (s / (s**2 + damping2) * (U.T @ (twist * scale)))


def singularity_damping2(J: Array, unit_m: float) -> float:
    """The lambda^2 of `resolved_rate`: 0 away from singularities."""
    s = np.linalg.svd(J * unit_scale(unit_m)[:, None], compute_uv=False)
    return max(0.0, THRESHOLD**2 - float(s[-1]) ** 2)


@functools.cache
def unit_scale(unit_m: float) -> Array:
    """Factors (6,) that give the linear part of a twist in lengths of unit_m."""
    return np.array([1 / unit_m] * 3 + [1.0] * 3)


def share(realised: Array, commanded: Array, unit_m: float) -> float:
    """Projection of a realised twist (6,) on the commanded one, as a share of it, 0 to 1, lengths
    in unit_m; 1 for a zero command.
    """
    scale = unit_scale(unit_m)
    a = realised * scale
    b = commanded * scale
    size = float(b @ b)
    return min(1.0, max(0.0, float(a @ b) / size)) if size > 0 else 1.0


# from the wanted pose, where the joints count as found: a ten-thousandth of what a camera can tell
NEAR_M = 1e-7
NEAR_RAD = 1e-7


def joints_at(
    kinematics: Callable[[Array], tuple[Array, Array]],
    T_world_flange: Array,
    near: Array,
    limits: Array,
    unit_m: float,
    inward: Callable[[Array], Array] = np.zeros_like,
) -> Array:
    """Joint positions (n,) [rad, m] of a flange pose (4, 4).

    q <- clip(q + J^+ log(T(q)^-1 T) + N inward(q)), with the damped inverse J^+ of `resolved_rate`,
    without the columns of joints that stand at a limit and would move beyond it, and N the null
    space of J for more than six joints. Raises UnreachableError: the arm does not get there; with
    how near it comes.

    Args:
        kinematics: T_world_flange (4, 4) and the flange's Jacobian (6, n) of joints (n,).
            T_world_flange: the pose that is wanted.
        near: joints to begin at: of several postures the one that Newton's steps reach from there
            is found.
        limits: lowest and highest position of each joint (n, 2). unit_m: length that makes metres
            and radians comparable [m].
        inward: motion of the joints (n,) away from their limits, in the null space of a seventh
            joint.

    Reference: Siciliano, Sciavicco, Villani & Oriolo 2009, Robotics, section 3.7,
    doi:10.1007/978-1-84628-642-1.
    """
    q = np.clip(near, *limits.T)
    away_m = np.inf
    away_rad = np.inf
    for _ in range(200):
        T, J = kinematics(q)
        away_m, away_rad = rigid_error(T, T_world_flange)
        if away_m < NEAR_M and away_rad < NEAR_RAD:
            return q
        step = _step(J, log(inverse(T) @ T_world_flange), q, limits, unit_m)
        if len(q) > 6:
            # it fades: with the damped inverse it moves the flange a little
            free = inward(q) * min(1.0, away_rad + away_m / unit_m)
            step = step + free - resolved_rate(J, J @ free, unit_m)
        # By .3 rad or m at most: within it the Jacobian is a fair guess.
        q = np.clip(q + step * min(1.0, 0.3 / max(float(np.abs(step).max()), 1e-12)), *limits.T)
    words = (
        "is out of its reach:"
        f" it stays {1000 * away_m:.0f} mm and {np.degrees(away_rad):.1f} deg away"
    )
    raise UnreachableError("robot.start", words)


def _step(J: Array, twist: Array, q: Array, limits: Array, unit_m: float) -> Array:
    """Motion of the joints (n,) for a twist (6,) of the flange: joints at their limits stay, and
    the others make up for them.
    """
    low, high = limits.T
    step = resolved_rate(J, twist, unit_m)
    for _ in q:
        blocked = ((q <= low) & (step < 0)) | ((q >= high) & (step > 0))
        if not blocked.any():
            break
        J = np.where(blocked, 0.0, J)
        step = resolved_rate(J, twist, unit_m)
    return step


# distance from its hard stop at which a joint comes to rest [rad; m for one that slides]
LIMIT_MARGIN = math.radians(1.0)
# velocity damper: near its limit a joint may approach no faster than to reach the margin in this
# time [s]
LIMIT_HORIZON_S = 0.25
INNER = 0.8  # central share of a joint's range in which limit avoidance leaves it alone
# shortest physics step that elastic gears may ask for [s]: twenty times the time of a run at 2 ms
SHORTEST_STEP_S = 1e-4


@spec
class Positions:
    """Joint positions of the arm.

    Args:
        q_deg: the positions in the order of `joints` [deg; m for a joint that slides].
    """

    q_deg: Annotated[tuple[Angle, ...], Len(2, 10)]


@spec
class PositionBox:
    """The box round the nominal positions from which random starts are drawn.

    Args:
        q_deg: half width for every hinge [deg].
        slide_m: half width for every joint that slides [m].
    """

    q_deg: Annotated[float, Ge(0), Le(180)] = 15.0
    slide_m: Annotated[float, Ge(0), Le(10)] = 0.05


@spec
class ArmStart:
    """Joint positions at the start.

    Args:
        nominal: joint positions at the start of a run without a seed.
        random: the box; None: a seed cannot draw a start.
    """

    nominal: Positions
    random: PositionBox | None = None


@spec
class Arm(Realistic):
    """A chain of joints on a base that stands at the world's origin. Fewer than six joints are
    motions of their own.

    A subclass gives `chain`, `joint_speeds`, `actuation` with its `servo_set`, and the gain
    `avoid_limits` of joint-limit avoidance [1/s].

    Args:
        gears: elasticity and backlash; None: rigid, without play.
        strain_wave: the strain wave gears in its joints, of which `realism`, and `gears` without a
            stiffness, make springs and rotors; None: its joints are rigid with a preset that has no
            stiffness of its own; e.g. `{sizes: [20, 20, 20, 20, 14, 14, 0]}`.
        ripple: cogging and torque ripple of the motors; None: none.
        encoders: steps and eccentricity of what the joints read; None: exact.
        drives: lag and delay of the motors' torque; None: none.
        geometry_error: the true geometry where it differs from the arm's own model; None: it does
            not.
        gravity_error: share of the weight that the drives' gravity compensation leaves uncarried,
            negative for too much [1]; servos that hold a position without compensation then have
            one, and sag by what it leaves over kp; e.g. `0.05`.
        payload: a load at the flange; None: none.
        tool: a plug at the flange; None: none; e.g. `{radius: 0.01, length: 0.15}`.
        wrist: a sensor of forces and moments between the flange and what it carries, whose reading
            is in the log; None: none; e.g. `{noise_n: 0.1}`.
        controller: what makes torques of the ordered joint speeds: the joints' own servos
            (`velocity`), or `computed_torque` or `impedance` on motors with the same limits and
            friction.
    """

    gears: Gears | None = None
    strain_wave: StrainWave | None = None
    ripple: Ripple | None = None
    encoders: Encoders | None = None
    drives: CurrentLoops | None = None
    geometry_error: GeometryError | None = None
    gravity_error: Annotated[float, Ge(-1), Le(1)] | None = None
    payload: Payload | None = None
    tool: Plug | None = None
    wrist: WristSensor | None = None
    controller: Inner = VelocityServos()

    start: ClassVar[ArmStart]
    file: ClassVar[str]
    actuation: ClassVar[str]
    flange: ClassVar[str] = "flange"
    avoid_limits: ClassVar[float]
    chain: ClassVar[JointChain]  # its joints in plain numbers
    joint_speeds: ClassVar[Array]  # largest speed of each joint, (n,) [rad/s, m/s]
    servo_set: ClassVar[Actuation]  # its servos, without an error of their gravity compensation
    # by the velocity gain of its servos over the inertia: 112 / s for the Puma and for added servos
    lag_s: ClassVar[float] = 0.009

    @property
    def unit_m(self) -> float:
        """Length that makes metres and radians comparable [m]: the longest link."""
        return self.chain.unit_m

    def _check(self) -> None:
        """Refuse effects that do not fit the joints or the actuation, and a start outside of the
        limits.
        """
        if self.realism != "none" and self.actuation == "ideal":
            raise ParameterError.fixed(
                "realism",
                "none",
                self.realism,
                where="with actuation: ideal",
                works="another actuation",
            )
        chain = self.chain
        n = len(chain.names)
        self._check_start(chain)
        if self.controller.takes_wrench and n < 6:
            able = "arms of six joints and more, which can yield in all directions"
            raise ParameterError.only_for("controller", able, self.controller.kind)
        self.acting  # noqa: B018 - refuses what does not fit
        if self.encoders is not None:
            self.encoders.read(np.zeros(n), np.zeros(n), chain.slides)
        for field in ("drives", "ripple", "gravity_error"):
            if getattr(self, field) is not None:
                self._check_actuators(field)

    def _check_actuators(self, field: str) -> None:
        """Refuse an effect that the actuators have not got."""
        if field == "gravity_error" and self.controller.torques:
            able = (
                f"servos, and controller {self.controller.kind} has a model of the masses;"
                " works: payload: {declared: false}"
            )
            raise ParameterError.only_for(field, able)
        if self.actuation == "ideal":
            able = (
                "actuators with limits, and `actuation: ideal` has none; works: another actuation"
            )
            raise ParameterError.only_for(field, able)

    def _check_start(self, chain: JointChain) -> None:
        given = self.start.nominal.q_deg
        names = chain.names
        if len(given) != len(names):
            what = f"positions, of {', '.join(names)}"
            raise ParameterError.count("start.nominal.q_deg", len(names), what, list(given))
        # Beyond a limit MuJoCo's constraint would push the joint back before the first command.
        for i, (q, (low, high)) in enumerate(zip(self.configuration(), chain.limits, strict=True)):
            if not low <= q <= high:
                words = f"{low:g} to {high:g} m"
                if not chain.slides[i]:
                    words = f"{math.degrees(low):g} to {math.degrees(high):g} deg"
                words = f"{names[i]}'s range, {words}"
                raise ParameterError.bound(f"start.nominal.q_deg.{i}", "within", words, given[i])

    @property
    def body(self) -> BodyFile:
        """Its file, with a gripper in place of the camera."""
        actuation = self._actuation
        names = self.chain.names
        loop = self.controller
        step = min(LARGEST_STEP_S, 1 / loop.rate_hz) if loop.torques else LARGEST_STEP_S
        return BodyFile(
            self.file,
            names,
            sensors=(FORCE, TORQUE) if self.wrist is not None else (),
            flange=self.flange,
            actuation=actuation,
            limits=self.chain.limits,
            largest_step_s=step,
            feet=(PLUG,) if self.tool is not None else (),
            gripper=True,
        )

    @property
    def _actuation(self) -> Actuation:
        """Its servos, or motors without servos for an inner loop of torques; those carry the
        weight, too.
        """
        if not self.controller.torques:
            if self.gravity_error is None:
                return self.servo_set
            return replace(self.servo_set, gravity_error=self.gravity_error)
        speeds = self.joint_speeds.tolist()
        torques = self.motor_torques.tolist()
        motors = map(Servo, self.chain.names, speeds, torques)
        return Actuation(
            None,
            friction=self.servo_set.friction,
            gravity_compensated=False,
            servos=tuple(motors),
        )

    @property
    def motor_torques(self) -> Array:
        """Largest torques of its motors (n,) [Nm, N]; infinite where it has no limits."""
        if self.servo_set.friction:
            return self.largest_torques
        return np.full(len(self.chain.names), np.inf)

    @property
    def largest_torques(self) -> Array:
        """Those by its file (n,) [Nm, N]."""
        return self.chain.torque

    @property
    def onboard(self) -> Any:
        """Its inner loop of torques; None where the joints have servos."""
        if not self.controller.torques:
            return None
        load = self.payload if self.payload is not None and self.payload.declared else None
        known = None if load is None else (load.mass_kg, *load.com_m, load.edge_m)

        def model() -> ArmModel:
            return ArmModel(
                self.chain,
                reader().dynamics(self.file, self.flange, self.chain.names, known),
                self.motor_torques,
            )

        return TorqueControl(self.controller, len(self.chain.names), model)

    @property
    def draws(self) -> bool:
        """Errors of its geometry."""
        return self.geometry_error is not None and self.geometry_error.draws

    def drawn(self, rng: np.random.Generator) -> Self:
        given = self.geometry_error
        error = given and given.drawn(len(self.chain.names), rng)
        return self if error is given else replace(self, geometry_error=error)

    def idealised(self) -> Self:
        """The same arm with stiff servos and gears and without friction; its geometry and its
        payload stay what they are.
        """
        rigid = dict.fromkeys(("gears", "ripple", "encoders", "drives", "gravity_error"))
        return replace(self, **{"actuation": "ideal", "realism": "none", **rigid})

    @cached_property
    def elastic(self) -> ElasticJoints | None:
        """Its gears in plain numbers; None where it has none."""
        gears = self.gears
        slides = self.chain.slides
        if gears is None:
            return None
        k, stages, rotors = self._springs(gears)
        play = gears.play(k, slides)
        step = functools.cache(self._gears_step)
        return ElasticJoints(self.chain.names, k, k * gears.damping_s, play, stages, rotors, step)

    @cached_property
    def acting(self) -> tuple[Effect, ...]:
        """Motors, gears, links, payload, and further ones."""
        found = list[Effect]()
        slides = self.chain.slides
        if self.ripple is not None or self.drives is not None:
            ripple = self.ripple or Ripple()
            cogging = each("ripple.cogging_nm", ripple.cogging_nm, slides)
            cycles = each("ripple.cycles", ripple.cycles, slides)
            found.append(Motors(cogging, cycles, ripple.share, self.drives))
        if self.elastic is not None:
            found.append(self.elastic)
        error = self.geometry_error
        if error is not None and error.displacements(len(slides)) is not None:
            found.append(error)
        if self.tool is not None or self.wrist is not None:
            found.append(Tool(self.tool, self.wrist))
        if self.payload is not None:
            found.append(self.payload)
        return *found, *self.effects

    def _springs(self, gears: Gears) -> tuple[Array, Array, Array | None]:
        """Stiffness (n,) and stages (n, m, 2) of the gears, inertia of the rotors (n,); None where
        there are none of its own.
        """
        preset = self.presets.get(self.realism, {}).get("gears")
        slides = self.chain.slides
        none = np.zeros((len(slides), 0, 2))  # stages
        if gears.stiffness_nmprad:
            if self.strain_wave is not None and gears == preset:
                words = (
                    f"is given by realism {self.realism} and by strain_wave;"
                    " works: robot.gears.stiffness_nmprad=[]"
                )
                raise ParameterError("gears.stiffness_nmprad", words)
            k = each("gears.stiffness_nmprad", gears.stiffness_nmprad, slides, turns=False)
            return k, none, None
        if self.strain_wave is not None:
            return *self.strain_wave.curves(slides), self.strain_wave.rotors(slides)
        if gears != preset:
            words = (
                "is missing; or give the catalogue sizes of its gears, e.g."
                " robot.strain_wave: {sizes: [20]}"
            )
            raise ParameterError("gears.stiffness_nmprad", words)
        return np.zeros(len(slides)), none, None

    def _gears_step(self) -> float:
        """The longest physics step that resolves the quickest vibration of the gears [s].

        Raises ParameterError: a stiffness that needs a shorter step than SHORTEST_STEP_S, or a
        joint without rotor.
        """
        assert self.elastic is not None
        whole, own = reader().inertia_at(
            self.file, self.chain.names, tuple(self.configuration().tolist())
        )
        M = whole - np.diag(own)
        rotors = own if self.elastic.rotors is None else self.elastic.rotors
        k = self.elastic.stiffest
        for i in np.flatnonzero((k > 0) & (rotors <= 0)).tolist():
            words = (
                f"must be 0 for {self.chain.names[i]}, which has no rotor that could move by"
                " itself; give it an `armature` in its file"
            )
            if not self._listed_springs:
                words += ", or its inertia in strain_wave.rotor_kgm2"
            raise self._too_stiff(float(k[i]), words)
        w, joint = quickest(M, rotors, k)
        step = FINEST / w if w else np.inf
        if step < SHORTEST_STEP_S:
            softer = ""
            if self._listed_springs:
                most = float(f"{k[joint] * (step / SHORTEST_STEP_S) ** 2:.2g}")
                softer = f" or at most {most:g}"
            words = (
                f"must be 0 (rigid){softer} for {self.chain.names[joint]}:"
                f" it vibrates at {w / 2 / np.pi:.0f} Hz,"
                f" which needs physics steps of {1e6 * step:.0f} us"
            )
            raise self._too_stiff(float(k[joint]), words)
        return step

    @property
    def _listed_springs(self) -> tuple[float, ...]:
        """The stiffness of its gears where it is listed; () where the catalogue has it."""
        return () if self.gears is None else self.gears.stiffness_nmprad

    def _too_stiff(self, k: float, words: str) -> ParameterError:
        """The error for a gear of stiffness k [Nm/rad], by the field that has it."""
        if not self._listed_springs:
            return ParameterError("robot.strain_wave.sizes", words)
        if len(self._listed_springs) == 1:
            words += "; works: a list, with a value for each joint"
        return ParameterError("robot.gears.stiffness_nmprad", words, k)

    def instruments(self, rng: np.random.Generator) -> SensorModel:
        """What the encoders read of the rotors' angles q and speeds qd (n,) each."""
        encoders = self.encoders
        wrist = self.wrist
        slides = self.chain.slides
        if encoders is None and wrist is None:
            return super().instruments(rng)

        def read(q: Array, qd: Array, sensors: Sensors) -> Reading:
            if encoders is not None:
                q, qd = encoders.read(q, qd, slides)
            return Reading(q, qd, wrench=None if wrist is None else wrist.read(sensors, rng))

        return read

    def log(self, supervisor: Supervisor) -> RobotLog:
        return RobotLog(supervisor) if self.wrist is None else WristLog(supervisor)

    def configuration(self) -> Array:
        """Joint positions of the nominal start, shape (n,) [rad, m]."""
        given = np.array(self.start.nominal.q_deg)
        return np.where(self.chain.slides, given, np.radians(given))

    def started_at(self, configuration: Array) -> Self:
        """The same arm from other joint positions (n,) [rad, m]."""
        return self._from(np.where(self.chain.slides, configuration, np.degrees(configuration)))

    def _from(self, given: Array) -> Self:
        """From positions (n,) [deg, m]."""
        nominal = Positions(q_deg=tuple(given.tolist()))
        return replace(self, start=replace(self.start, nominal=nominal))

    def randomised(self, rng: np.random.Generator) -> Self:
        box = random_of(self.start, "{q_deg: 15}")
        slides = self.chain.slides
        limits = self.chain.limits.T
        off = rng.uniform(-1, 1, len(slides)) * np.where(slides, box.slide_m, box.q_deg)
        drawn = np.array(self.start.nominal.q_deg) + off
        return self._from(np.clip(drawn, *np.where(slides, limits, np.degrees(limits))))

    def kinematics(self, q: Array) -> tuple[Array, Array]:
        """T_world_flange (4, 4) and the Jacobian (6, n): twist of the flange (v, w) in its own
        frame = J @ dq.
        """
        return self.chain.kinematics(q)

    def start_joints(self) -> Array:
        return self.configuration()

    def flange_pose(self, configuration: Array) -> Array:
        """T_world_flange (4, 4)."""
        return self.kinematics(configuration)[0]

    def configuration_at(self, T_world_flange: Array, near: Array) -> Array:
        """Joint positions (n,) by Newton steps from `near`, a margin within their limits."""
        inside = self.chain.limits + [LIMIT_MARGIN, -LIMIT_MARGIN]
        q = joints_at(
            self.kinematics, T_world_flange, near, inside, self.unit_m, self._away_from_limits
        )
        # 1.7 um at a metre: machines whose last digits differ begin alike
        return np.radians(np.round(np.degrees(q), 4))

    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """All six degrees of freedom, also near singularities, where `allocate` damps; of fewer
        joints their own twists (6, n).
        """
        return ALL_SIX if len(q) >= 6 else mount.to_camera @ self.kinematics(q)[1]

    def measured_twist(
        self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount
    ) -> Array:
        """Mean camera twist (6,) between two readings: J at the mean joint positions times dq /
        duration.
        """
        if duration <= 0:
            return np.zeros(6)
        # At the middle: the chord and the path differ in the third order of dq there, in the second
        # at either end.
        J = self.kinematics((before.q + now.q) / 2)[1]
        return mount.to_camera @ (J @ ((now.q - before.q) / duration))

    def own_model(self, reading: Reading, mount: Mount) -> OwnModel:
        """Its joints: encoders, limits, speeds, and the accelerations that stop it from them within
        STOP_S.
        """
        speeds = self.joint_speeds
        n = len(reading.q)

        def jacobian(q: Array) -> Array:
            return mount.to_camera @ self.kinematics(q)[1]

        return OwnModel(
            names=self.chain.names,
            J=jacobian(reading.q),
            jacobian=jacobian,
            q=reading.q,
            qd=reading.qd,
            low=self.chain.limits[:, 0],
            high=self.chain.limits[:, 1],
            nominal=self.configuration(),
            speed=speeds,
            acceleration=speeds / STOP_S,
            sums=np.zeros((0, n)),
            most=np.zeros(0),
            lag_s=self.lag_s,
            unit_m=self.unit_m,
            slides=self.chain.slides,
        )

    def allocate_rates(
        self, rates: Array, reading: Reading, mount: Mount, period: float
    ) -> Allocation:
        """Joint speeds, scaled as a whole into speed and position limits."""
        scale, limit = self._allowed(rates, reading.q, period)
        dq = rates * scale
        twist = mount.to_camera @ (self.kinematics(reading.q)[1] @ dq)
        return Allocation(self._setpoint(dq), twist, scale, limit, dq)

    def _setpoint(self, dq: Array) -> Array:
        """Joint speeds (n,), and no wanted wrench where the inner loop takes one."""
        return np.append(dq, np.zeros(WRENCH)) if self.controller.takes_wrench else dq

    def pressed(self, allocation: Allocation, wrench: Array, mount: Mount) -> Allocation:
        """The same with a wrench (6,), force and moment that the tool is to exert at the camera's
        origin, in the camera's frame [N, Nm].
        """
        assert isinstance(self.controller, Impedance)  # it `takes_wrench`
        # of the same power in the impedance's frame
        there = adjoint(inverse(mount.T_flange_camera) @ self.controller.at.T).T @ wrench
        return replace(allocation, setpoint=np.append(allocation.setpoint[:-WRENCH], there))

    def secondary_task(self, null_space: Array, reading: Reading, mount: Mount) -> Array:
        """Joint-limit avoidance in the null space of the law.

        Desired: `_away_from_limits`. The null-space motion J^-1 null_space z nearest to it in the
            least-squares sense is taken.

        References: Liegeois 1977, doi:10.1109/TSMC.1977.4309644; Chaumette & Marchand 2001,
            doi:10.1109/70.964671.
        """
        desired = self._away_from_limits(reading.q)
        if null_space.shape[1] == 0 or not desired.any():
            return np.zeros(6)
        J = self.kinematics(reading.q)[1]
        # A projection: dq . dq* >= 0, so this task on its own never moves the joints as a whole
        # nearer to their limits. The damped inverse for J^-1, as `allocate` will use it, so that
        # the fit is of motions that the joints are really given.
        joint_motions = np.column_stack(
            [resolved_rate(J, mount.to_flange @ twist, self.unit_m) for twist in null_space.T]
        )
        return null_space @ np.linalg.lstsq(joint_motions, desired, rcond=1e-6)[0]

    def _away_from_limits(self, q: Array) -> Array:
        """dq*_i = -avoid_limits (q_i - edge_i) beyond the edge of the middle four fifths of a
        joint's range, else 0.
        """
        limits = self.chain.limits
        # a joint that turns without end has no middle: nan, where it is always inside
        with np.errstate(invalid="ignore"):
            middle = limits.mean(axis=1)
            reach = INNER * np.ptp(limits, axis=1) / 2
            low = middle - reach
            high = middle + reach
        low[np.isnan(low)] = -np.inf
        high[np.isnan(high)] = np.inf
        return -self.avoid_limits * (q - np.clip(q, low, high))

    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """Joint speeds for a camera twist (6,): damped resolved rate, then scaled as a whole into
        speed and position limits.

        A seventh joint moves the arm away from its limits in the null space of the flange's motion.

        Near a position limit a joint's speed towards it is bounded by its distance over
        LIMIT_HORIZON_S (velocity damper: Faverjon & Tournassoud 1987,
        doi:10.1109/ROBOT.1987.1087982).
        """
        commanded = mount.to_flange @ twist
        J = self.kinematics(reading.q)[1]
        dq = resolved_rate(J, commanded, self.unit_m)
        if J.shape[1] > 6:
            away = self._away_from_limits(reading.q)
            # undamped, but for 0 / 0: what damping leaves of a motion in the null space would move
            # the flange
            dq = dq + away - resolved_rate(J, J @ away, self.unit_m, threshold=1e-9)
        realised = J @ dq
        along = share(realised, commanded, self.unit_m)
        scale, limit = self._allowed(dq, reading.q, period)
        # a limit met hides the singularity beside it: `scale` has both
        if not limit and differs(realised, commanded):
            limit = "singular"
        return Allocation(
            setpoint=self._setpoint(dq * scale),
            twist=mount.to_camera @ realised * scale,
            scale=scale * along,
            limit=limit,
            rates=dq * scale,
        )

    def _allowed(self, dq: Array, q: Array, period: float) -> tuple[float, Limit]:
        """The factor, 1 at most, that brings joint speeds dq (n,) within the speed limits and the
        velocity damper at the joints q (n,), and which of them it is.

        The joints are the measured ones, not integrated commands: the servos lag behind those.
        """
        # not shorter than a period: within one, no further command could slow a joint down
        horizon_s = max(LIMIT_HORIZON_S, period)
        speed = position = math.inf
        limits = zip(
            dq.tolist(),
            q.tolist(),
            self.chain.limits.tolist(),
            self.joint_speeds.tolist(),
            strict=True,
        )
        for u, at, (low, high), most in limits:  # numpy takes thrice as long
            size = max(abs(u), 1e-12)
            room = (high - at if u > 0 else at - low) - LIMIT_MARGIN
            speed = min(speed, most / size)
            position = min(position, max(room, 0.0) / horizon_s / size)
        if min(speed, position) >= 1.0:
            return 1.0, ""
        return (position, "joint_limit") if position < speed else (speed, "speed")


class WristLog(RobotLog):
    """The supervisor's mode and the wrist's reading, `wrist_fx` to `wrist_mz`: force and moment on
    the tool, in the flange's frame [N, Nm].
    """

    columns = (*RobotLog.columns, *(f"wrist_{part}{axis}" for part in "fm" for axis in "xyz"))

    def row(self, state: RobotState) -> Array:
        assert state.reading.wrench is not None
        return np.append(super().row(state), state.reading.wrench)
