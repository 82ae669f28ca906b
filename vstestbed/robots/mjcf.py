"""Any arm by its MJCF or URDF file: 2 to 7 hinges and slides between a fixed base and a flange."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.named_files import absolute_file
from vstestbed.core.quantity import Angle, PositiveSpeed
from vstestbed.core.spec import spec
from vstestbed.robots.allocation import Actuation, Servo
from vstestbed.robots.arm import Arm
from vstestbed.robots.chain import READERS, ChainReader, JointChain

STIFFNESS, RATIO_S = 4500.0, 1 / 40
"""Position gain of a velocity servo over the joint's inertia [1/s^2], and its velocity gain over that [s]. The Puma's servos have 3500 to
5800 and the same ratio: 40 ms of rise, under 5 % of overshoot."""
IDEAL_GAIN = 5000.0
"""Velocity gain of an ideal servo over the joint's inertia [1/s]."""


@spec
class Positions:
    """Joint positions of the arm.

    Args:
        q_deg: the positions in the order of `joints` [deg; m for a joint that slides].
    """

    q_deg: Annotated[tuple[Angle, ...], Len(2, 7)]


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
class Mjcf(Arm):
    """An arm of one's own, driven by joint velocities; masses, gears, friction and torque limits are those of its file.

    Args:
        file: MJCF or URDF, absolute, relative to the scenario's file, or `package:NAME/path` inside an installed package.
        flange: the site, or the body, that carries the camera or the target.
        joints: those between root and flange, in their order; by default as the file has them; e.g. `[shoulder, elbow, wrist]`.
        actuation: `velocity` adds a servo to each joint, which integrates the commanded speed to a position that it holds, with
            kp = STIFFNESS times the joint's inertia at the start; `ideal` servos are stiff and without limits, the joints without
            friction and weight; `file` uses the file's own velocity servos, or position servos fed with the integrated speed.
        speed_limits: largest speed of each joint [rad/s, m/s], which such files do not have.
        start: joint positions at the start.
        avoid_limits: gain of joint-limit avoidance [1/s] in the null space of the law (`law.redundant`) and of a seventh joint.
    """

    kind: Literal["mjcf"] = "mjcf"
    file: str
    flange: str = "flange"
    joints: tuple[str, ...] = ()  # pyright: ignore[reportIncompatibleMethodOverride] - a field in place of a property
    actuation: Literal["velocity", "ideal", "file"] = "velocity"
    speed_limits: Annotated[tuple[PositiveSpeed, ...], Len(2, 7)]
    start: ArmStart
    avoid_limits: Annotated[float, Ge(0), Le(10)] = 0.5
    actuators: ClassVar[tuple[str, ...]]

    def __post_init__(self) -> None:
        """Read the file, and refuse what does not fit it."""
        object.__setattr__(self, "file", absolute_file(self.file, Path.cwd()))  # frozen: a run remembers where its arm is
        chain = self.chain
        names, n = ", ".join(chain.names), len(chain.names)
        object.__setattr__(self, "joints", chain.names)  # frozen: what the file has is part of the scenario from here on
        object.__setattr__(self, "actuators", chain.names)
        if len(self.speed_limits) != n:
            raise ParameterError("speed_limits", f"must be {n} speeds, of {names}", list(self.speed_limits))
        if len(self.start.nominal.q_deg) != n:
            raise ParameterError("start.nominal.q_deg", f"must be {n} positions, of {names}", list(self.start.nominal.q_deg))
        for i, (q, (low, high), slides) in enumerate(zip(self.configuration(), chain.limits, chain.slides, strict=True)):
            if not low <= q <= high:
                size, unit = (1.0, "m") if slides else (float(np.degrees(1.0)), "deg")
                words = f"must be within {chain.names[i]}'s range, {low * size:g} to {high * size:g} {unit}"
                raise ParameterError(f"start.nominal.q_deg.{i}", words, self.start.nominal.q_deg[i])
        if self.actuation == "file":
            self._check_drives(chain)

    def _check_drives(self, chain: JointChain) -> None:
        for name, drive in zip(chain.names, chain.drives, strict=True):
            if drive not in ("velocity", "position"):
                found = f"a {drive} actuator" if drive else "no actuator"
                words = f"must not be file: {name} has {found} there, which follows no speed; works: velocity, which adds servos"
                raise ParameterError("actuation", words)

    @property
    def chain(self) -> JointChain:
        """The joints as plain numbers."""
        return _reader().joint_chain(self.file, self.flange, self.joints)

    @property
    def model(self) -> str:
        """Its file."""
        return self.file

    @property
    def actuator_set(self) -> Actuation:
        """The servos: added, or the file's own."""
        ideal, chain = self.actuation == "ideal", self.chain
        return Actuation(None, friction=not ideal, gravity_compensated=ideal, servos=tuple(self._servos(chain)))

    def _servos(self, chain: JointChain) -> list[Servo]:
        speeds, torques = self.speed_limits, chain.torque.tolist()
        inertia = _reader().inertia_at(self.file, chain.names, tuple(self.configuration().tolist()))
        if self.actuation == "file":
            return [Servo(name, speed, None) for name, speed in zip(chain.names, speeds, strict=True)]
        if self.actuation == "ideal":
            return [Servo(n, v, np.inf, kv=IDEAL_GAIN * m) for n, v, m in zip(chain.names, speeds, inertia, strict=True)]
        each = zip(chain.names, speeds, torques, inertia, strict=True)
        return [Servo(name, speed, torque, *servo_gains(m)) for name, speed, torque, m in each]

    @property
    def joint_limits(self) -> Array:
        """Those of the file."""
        return self.chain.limits

    @property
    def joint_speeds(self) -> Array:
        """`speed_limits`, as an array."""
        return np.array(self.speed_limits)

    @property
    def unit_m(self) -> float:
        """The longest link."""
        return self.chain.unit_m

    def kinematics(self, q: Array) -> tuple[Array, Array]:
        """Those of the file."""
        return self.chain.kinematics(q)

    def configuration(self) -> Array:
        """Joint positions of the nominal start, shape (n,) [rad, m]."""
        given = np.array(self.start.nominal.q_deg)
        return np.where(self.chain.slides, given, np.radians(given))

    def started_at(self, configuration: Array) -> Mjcf:
        """The same arm from other joint positions (n,) [rad, m]."""
        given = np.where(self.chain.slides, configuration, np.degrees(configuration))
        return replace(self, start=ArmStart(nominal=Positions(q_deg=tuple(given.tolist())), random=self.start.random))

    def idealised(self) -> Mjcf:
        """The same arm with stiff servos and without friction."""
        return replace(self, actuation="ideal")

    def randomised(self, rng: np.random.Generator) -> Mjcf:
        """The same arm with a start drawn within the box, clipped to the joint limits."""
        box = self.start.random
        if box is None:
            raise ParameterError("robot.start.random", "is missing: a seed draws the start from it, e.g. {q_deg: 15}")
        half = np.where(self.chain.slides, box.slide_m, np.radians(box.q_deg))
        q = self.configuration() + rng.uniform(-1, 1, len(half)) * half
        return self.started_at(np.clip(q, *self.chain.limits.T))


def servo_gains(inertia: float) -> tuple[float, float]:
    """Position and velocity gain (kp, kv) of the servo that `actuation: velocity` gives a joint with this inertia [kg m^2, kg]."""
    return STIFFNESS * inertia, STIFFNESS * RATIO_S * inertia


def _reader() -> ChainReader:
    """What reads such files."""
    if not READERS:
        raise ParameterError("file", "is read by the simulator's room; import vstestbed.sim first")
    return READERS[-1]()
