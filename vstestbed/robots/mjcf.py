"""Any arm by its MJCF or URDF file: 2 to 7 hinges and slides between a fixed base and a flange."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.named_files import absolute_file
from vstestbed.core.quantity import Broadcast, PositiveSpeed, Stiffness, Torque
from vstestbed.core.spec import spec
from vstestbed.effects.joints import CurrentLoops, Encoders, Gears, Ripple
from vstestbed.effects.links import GeometryError
from vstestbed.robots.allocation import Actuation, Servo
from vstestbed.robots.arm import Arm, ArmStart
from vstestbed.robots.chain import JointChain, reader
from vstestbed.robots.realism import Presets

# position gain of a velocity servo over the joint's inertia [1/s^2]; the Puma's have 3500 to 5800
STIFFNESS = 4500.0
# its velocity gain over that [s], as the Puma's: 40 ms of rise, under 5 % of overshoot
RATIO_S = 1 / 40
# most that friction may wind up an added servo before its joint moves: of a hinge, of a slide
WIND_UP_RAD = float(np.radians(0.5))
WIND_UP_M = 1e-3
# Cycles of the errors of a strain wave gear in a turn of the joint: two in a turn of the motor
# (Tuttle & Seering 1996, doi:10.1109/70.499819), at a ratio of 100.
WAVES = (200.0,)
PRESETS: Presets = {
    "lab": {
        "gears": Gears(),
        "ripple": Ripple(share=0.01, cycles=WAVES),
        "encoders": Encoders(counts=(1 << 18,), eccentricity_deg=(0.0083,), turns=WAVES),
        "drives": CurrentLoops(bandwidth_hz=500.0),
        "geometry_error": GeometryError(sigma_m=3e-4, sigma_deg=0.02),
    },
    "field": {
        "gears": Gears(backlash_deg=(0.017,)),
        "ripple": Ripple(share=0.02, cycles=WAVES),
        "encoders": Encoders(counts=(1 << 14,), eccentricity_deg=(0.0125,), turns=WAVES),
        "drives": CurrentLoops(bandwidth_hz=200.0, delay_s=1e-3),
        "geometry_error": GeometryError(sigma_m=1e-3, sigma_deg=0.1),
    },
}
"""Those of an arm with strain wave gears, whose springs are in `strain_wave`. The wave of the
encoders is the gears' kinematic error: half of a positioning accuracy of 1 and of 1.5 arc minutes,
which the catalogue of the gears CSF and CSG has for sizes from 20 on and from 11 to 17 (Harmonic
Drive LLC, table 40). The play of `field` is 1 arc minute, of the order of the hysteresis loss of
such gears; new ones have no backlash. The other values are chosen.
"""


def _check_drives(chain: JointChain) -> None:
    """Refuse joints whose own actuators follow no speed."""
    for name, drive in zip(chain.names, chain.drives, strict=True):
        if drive not in ("velocity", "position"):
            found = f"a {drive} actuator" if drive else "no actuator"
            words = (
                f"must not be file: {name} has {found} there, which follows no speed;"
                " works: velocity, which adds servos"
            )
            raise ParameterError("actuation", words)


@spec
class Mjcf(Arm):
    """An arm of one's own, driven by joint velocities; masses, gears, friction and torque limits
    are those of its file.

    Args:
        file: MJCF or URDF, absolute, relative to the scenario's file, or `package:NAME/path` inside
            an installed package.
        flange: the site, or the body, that carries the camera or the target.
        joints: those between root and flange, in their order; by default as the file has them; e.g.
            `[shoulder, elbow, wrist]`.
        actuation: `velocity` adds a servo to each joint, which integrates the commanded speed to a
            position that it holds (`servo_kp`); `ideal` servos are stiff and without limits, the
            joints without friction and weight; `file` uses the file's own velocity servos, or
            position servos fed with the integrated speed.
        speed_limits: largest speed of each joint, one for all or one for each [rad/s, m/s], which
            such files do not have.
        torque_limits: largest torque of each added servo, one for all or one for each (force in N
            where the joint slides), in place of the file's; by default the file's [Nm]; e.g.
            `[87, 87, 87, 87, 12, 12, 12]`.
        servo_kp: position gain of each added servo, one for all or one for each (N/m where the
            joint slides); by default `servo_gains` at the nominal start, which random and displaced
            starts keep [Nm/rad]; e.g. `[2000, 2000, 500, 100, 100, 100]`.
        servo_kv: velocity gain of each added servo, one for all or one for each (N s/m where the
            joint slides); by default servo_kp times 1/40 s [Nm s/rad]; e.g.
            `[50, 50, 12, 3, 3, 3]`.
        start: joint positions at the start.
        avoid_limits: gain of joint-limit avoidance [1/s] in the null space of the law
            (`law.redundant`) and of a seventh joint.
    """

    kind: Literal["mjcf"] = "mjcf"
    file: str
    flange: str = "flange"
    joints: tuple[str, ...] = ()
    actuation: Literal["velocity", "ideal", "file"] = "velocity"
    speed_limits: Annotated[tuple[PositiveSpeed, ...], Len(1, 7), Broadcast()]
    torque_limits: Annotated[tuple[Torque, ...], Len(0, 7), Broadcast()] = ()
    servo_kp: Annotated[tuple[Stiffness, ...], Len(0, 7), Broadcast()] = ()
    servo_kv: Annotated[tuple[Stiffness, ...], Len(0, 7), Broadcast()] = ()
    start: ArmStart
    avoid_limits: Annotated[float, Ge(0), Le(10)] = 0.5
    presets = PRESETS

    def __post_init__(self) -> None:
        """Read the file, and refuse what does not fit it."""
        # frozen: a run remembers where its arm is
        object.__setattr__(self, "file", absolute_file(self.file, Path.cwd()))
        chain = self.chain
        # frozen: what the file has is part of the scenario from here on
        object.__setattr__(self, "joints", chain.names)
        n = len(chain.names)
        # A number for each joint, also where one was given for all of them.
        for field in ("speed_limits", "torque_limits", "servo_kp", "servo_kv"):
            given = getattr(self, field)
            if len(given) == 1:
                object.__setattr__(self, field, given * n)  # frozen, as above
            elif given and len(given) != n:
                words = {"speed_limits": "speeds", "torque_limits": "torques"}.get(field, "gains")
                what = f"{words}, of {', '.join(chain.names)}, or one for all"
                raise ParameterError.count(field, n, what, list(given))
        self._check()
        if self.actuation == "file":
            _check_drives(chain)
        if self.actuation == "velocity":
            self._fill_gains(chain)

    def _fill_gains(self, chain: JointChain) -> None:
        """Gains that are not given become those of this start: a run's copies, started elsewhere,
        keep them.
        """
        if not self.servo_kp:
            gains = map(servo_gains, self._inertia(chain), chain.friction.tolist(), chain.slides)
            # frozen, as above
            object.__setattr__(self, "servo_kp", tuple(kp for kp, _ in gains))
        if not self.servo_kv:
            kv = tuple(four_digits(kp * RATIO_S) for kp in self.servo_kp)
            object.__setattr__(self, "servo_kv", kv)

    def _inertia(self, chain: JointChain) -> tuple[float, ...]:
        q = tuple(self.configuration().tolist())
        M, own = reader().inertia_at(self.file, chain.names, q)
        inertia = M.diagonal()
        given = self.elastic and self.elastic.rotors
        if given is not None:
            inertia = inertia - own + given
        return tuple(inertia.tolist())

    @property
    def chain(self) -> JointChain:
        """The joints as plain numbers."""
        return reader().joint_chain(self.file, self.flange, self.joints)

    @property
    def servo_set(self) -> Actuation:
        """The servos: added, or the file's own."""
        chain = self.chain
        n = len(chain.names)
        torques = [None] * n  # the file's own
        kp = [0.0] * n
        kv = [0.0] * n
        ideal = self.actuation == "ideal"
        if ideal:
            torques = [np.inf] * n
            kv = [5000.0 * m for m in self._inertia(chain)]  # stiff: [1/s] times the inertia
        elif self.actuation == "velocity":
            torques = self.torque_limits or chain.torque.tolist()
            kp = self.servo_kp
            kv = self.servo_kv
        servos = map(Servo, chain.names, self.speed_limits, torques, kp, kv)
        return Actuation(None, friction=not ideal, gravity_compensated=ideal, servos=tuple(servos))

    @property
    def largest_torques(self) -> Array:
        """`torque_limits`, by default the file's."""
        return np.array(self.torque_limits) if self.torque_limits else self.chain.torque

    @property
    def joint_speeds(self) -> Array:
        """`speed_limits`, as an array."""
        return np.array(self.speed_limits)


def servo_gains(inertia: float, friction: float, slides: bool) -> tuple[float, float]:
    """Position and velocity gain (kp, kv) of the servo that `actuation: velocity` gives a joint,
    both to four digits.

    kp = max(STIFFNESS M, F / w),  kv = kp RATIO_S

    Where friction sets kp, the joint answers more slowly than its inertia would let it, but with
    the lag kv / kp of all the others.

    The joint holds still until the servo is wound up by F / kp, hence by w at most. No inertia is
    too small for this kp: MuJoCo's `implicitfast` takes the force of kp at the beginning of a step
    of h and that of kv at its end,

        M (q'' - 2 q' + q) = -h^2 kp q' - h kv (q'' - q')
        for positions q, q', q'' at successive steps,

    whose two modes decay where h^2 kp < 4 M + 2 h kv (Jury's criterion). kv >= h kp / 2 is enough
    for that whatever M: with this kv steps up to 50 ms, the physics' own being 2 ms. For a whole
    arm M, kp and kv are those of each mode x (x^T K x), and the same holds.

    inertia: M, what its motor moves [kg m^2, kg]. friction: F, Coulomb friction [Nm, N]. slides: w
    is WIND_UP_M, else WIND_UP_RAD.

    Reference: Jury 1964, Theory and Application of the z-Transform Method.
    """
    kp = four_digits(max(STIFFNESS * inertia, friction / (WIND_UP_M if slides else WIND_UP_RAD)))
    return kp, four_digits(kp * RATIO_S)


def four_digits(number: float) -> float:
    """A number as summaries and scenarios show it: the same on all machines, whose sums differ in
    the last digits.
    """
    return float(f"{number:.4g}")
