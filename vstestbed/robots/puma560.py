"""Puma 560: kinematics in standard Denavit-Hartenberg frames, limits, servos.

A_i = Rz(q_i) Tz(d_i) Tx(a_i) Rx(alpha_i),  T_base_flange = A_1 ... A_6.

The flange is frame 6, which the table leaves at the wrist's centre (d_6 = 0). The base frame stands on the floor.
Dynamics, gears and friction are in `models/puma560.xml`; a test compares the two files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Angle
from vstestbed.core.spec import spec
from vstestbed.effects.joints import CurrentLoops, Encoders, Gears, Ripple
from vstestbed.effects.links import GeometryError
from vstestbed.robots.allocation import Actuation
from vstestbed.robots.base import random_of
from vstestbed.robots.real_arm import RealArm
from vstestbed.robots.realism import Level

DH = np.array(
    [
        # d [m]   a [m]   alpha [rad]
        [0.67183, 0.0, np.pi / 2],
        [0.0, 0.4318, 0.0],
        [0.15005, 0.0203, -np.pi / 2],
        [0.4318, 0.0, np.pi / 2],
        [0.0, 0.0, -np.pi / 2],
        [0.0, 0.0, 0.0],
    ]
)
"""Reference: Corke & Armstrong-Helouvry 1994, doi:10.1109/ROBOT.1994.351360; d_1 is the shoulder's height
above the floor, 26.45 inch, as in Corke's Robotics Toolbox."""

JOINT_LIMITS = np.radians([[-160, 160], [-45, 225], [-225, 45], [-110, 170], [-100, 100], [-266, 266]])
"""[rad], (6, 2). Source: Corke's Robotics Toolbox, model puma560."""

SPEED_LIMITS = np.array([1.92, 1.51, 2.40, 5.34, 5.09, 5.74])
"""[rad/s]. Source: Corke 1996, Visual Control of Robots, Table 2.21: where the amplifiers' voltage saturates."""

REACH_UNIT = 0.4318
"""Length that makes metres and radians comparable [m], the upper arm's a_2: singular values are those of (v / REACH_UNIT, w)."""

_EYE = np.eye(4)

# Exactly 0 or +-1, as every alpha is a multiple of a quarter turn; cos(pi / 2) alone is 6e-17 in floating point.
_SIN_ALPHA, _COS_ALPHA = np.round(np.sin(DH[:, 2])), np.round(np.cos(DH[:, 2]))


def _links() -> tuple[Array, Array, Array]:
    """A_i in parts: its lower half in (6, 4, 4), and the factors (6, 2, 4) of cos q_i and of sin q_i in its upper half."""
    rest, of_cosine, of_sine = np.zeros((6, 4, 4)), np.zeros((6, 2, 4)), np.zeros((6, 2, 4))
    rest[:, 2, 1], rest[:, 2, 2], rest[:, 2, 3], rest[:, 3, 3] = _SIN_ALPHA, _COS_ALPHA, DH[:, 0], 1.0
    of_cosine[:, 0, 0], of_cosine[:, 0, 3], of_cosine[:, 1, 1], of_cosine[:, 1, 2] = 1.0, DH[:, 1], _COS_ALPHA, -_SIN_ALPHA
    of_sine[:, 0, 1], of_sine[:, 0, 2], of_sine[:, 1, 0], of_sine[:, 1, 3] = -_COS_ALPHA, _SIN_ALPHA, 1.0, DH[:, 1]
    return rest, of_cosine, of_sine


_REST, _OF_COSINE, _OF_SINE = _links()


def kinematics(q: Array) -> tuple[Array, Array]:
    """Pose and geometric Jacobian of the flange together.

    With z_i and o_i the axis and origin of the frame before joint i, and o the flange's origin:
    v = sum z_i x (o - o_i) dq_i,  w = sum z_i dq_i, both expressed in the flange's axes.

    q: joint angles, shape (6,), [rad]. Returns T_base_flange (4, 4) and J (6, 6): twist of the flange (v, w) in its own frame = J @ dq.
    """
    frames = _frames(q)
    T = frames[6]
    R_t = T[:3, :3].T
    axes = R_t @ frames[:6, :3, 2].T
    arms = R_t @ (T[:3, 3] - frames[:6, :3, 3]).T
    J = np.empty((6, 6))  # rows 0 to 2: axes x arms, column by column
    J[0] = axes[1] * arms[2] - axes[2] * arms[1]
    J[1] = axes[2] * arms[0] - axes[0] * arms[2]
    J[2] = axes[0] * arms[1] - axes[1] * arms[0]
    J[3:] = axes
    return T, J


def _frames(q: Array) -> Array:
    """T_base_i of the frames 0 to 6, shape (7, 4, 4)."""
    A = _REST.copy()
    A[:, :2] = np.cos(q)[:, None, None] * _OF_COSINE + np.sin(q)[:, None, None] * _OF_SINE
    frames = np.empty((7, 4, 4))
    frames[0], frames[1] = _EYE, A[0]
    for i in range(1, 6):
        np.dot(frames[i], A[i], out=frames[i + 1])
    return frames


GEAR_RATIOS = (62.6111, 107.815, 53.7063, 76.0364, 71.923, 76.686)
"""Turns of the motor in one of the joint [1]. Source: Corke & Armstrong-Helouvry 1994, as in `models/puma560.xml`."""


def _worn(k: float, play_deg: float, share: float, counts: int, off_deg: float) -> dict[str, object]:
    """Blocks of a preset: stiffness of joints 1 and 2, play of the elastic joints, cogging and ripple as a share of the largest torque,
    counts in a turn of a motor and eccentricity of its encoder.
    """
    most = (97.6, 186.4, 89.4, 24.2, 20.1, 21.3)
    return {
        "gears": Gears(stiffness_nmprad=(k, k, 0.4 * k, 0.0, 0.0, 0.0), backlash_deg=(play_deg,)),
        "ripple": Ripple(
            cogging_nm=tuple(round(share * torque / 2, 3) for torque in most),
            share=share,
            cycles=tuple(round(6 * ratio, 1) for ratio in GEAR_RATIOS),
        ),
        "encoders": Encoders(
            counts=tuple(round(counts * ratio) for ratio in GEAR_RATIOS),
            eccentricity_deg=tuple(round(off_deg / ratio, 6) for ratio in GEAR_RATIOS),
            turns=GEAR_RATIOS,
        ),
    }


PRESETS: Mapping[Level, Mapping[str, object]] = {
    "lab": {
        **_worn(k=40_000.0, play_deg=0.005, share=0.01, counts=4000, off_deg=0.05),
        "drives": CurrentLoops(bandwidth_hz=500.0),
        "geometry_error": GeometryError(sigma_m=3e-4, sigma_deg=0.02),
    },
    "field": {
        **_worn(k=25_000.0, play_deg=0.02, share=0.02, counts=1000, off_deg=0.2),
        "drives": CurrentLoops(bandwidth_hz=200.0, delay_s=1e-3),
        "geometry_error": GeometryError(sigma_m=1e-3, sigma_deg=0.1),
    },
}
"""Chosen, within what catalogues state for gears of such torques: strain wave gears of sizes 20 and 25 have 16000 to 57000 Nm/rad (Harmonic
Drive LLC, CSF and CSG), planetary gears for 100 Nm 29000 to 33000 Nm/rad and up to 8 arc minutes of play (Beckhoff AG3210, NP025). The
Puma's own are spur and bevel gears, whose play can be adjusted. `models/README.md` says more. Six cycles of cogging in a turn of a motor;
encoders on the motors."""

ACTUATIONS = {
    "ideal": Actuation("ideal", friction=False, gravity_compensated=True),
    "industrial": Actuation("industrial", friction=True, gravity_compensated=False),
    "raw": Actuation("raw", friction=True, gravity_compensated=True),
}
"""`ideal`: stiff and frictionless; `industrial`: velocity loop with integral action; `raw`: proportional velocity loop, in which friction
leaves a steady-state error."""

Six = Annotated[tuple[Angle, ...], Len(6, 6)]


@spec
class JointAngles:
    """Joint angles of the arm.

    Args:
        q_deg: the six angles from the base to the flange [deg].
    """

    q_deg: Six = (0.0, 45.0, -180.0, 0.0, 45.0, -45.0)


@spec
class JointBox:
    """The box round the nominal angles from which random starts are drawn.

    Args:
        q_deg: half width of the box for every joint [deg].
    """

    q_deg: Annotated[float, Ge(0), Le(180)] = 15.0


@spec
class PumaStart:
    """Joint angles at the start.

    Args:
        nominal: joint angles at the start of a run without a seed.
        random: the box; None: a seed cannot draw a start.
    """

    nominal: JointAngles = JointAngles()
    random: JointBox | None = None


@spec
class Puma560(RealArm):
    """The Puma 560 with a camera at its flange, driven by joint velocities.

    Args:
        actuation: `ideal`, `industrial` (default) or `raw`: which servo amplifiers the joints have.
        start: joint angles at the start; the textbook's by default (its +180 deg of joint 3 is -180 here, within the limits).
        avoid_limits: gain of joint-limit avoidance [1/s], by which joints in the outer fifth of their range move back towards its
            middle in the null space of the law (`law.redundant`); 0: none.
    """

    kind: Literal["puma560"] = "puma560"
    actuation: Literal["ideal", "industrial", "raw"] = "industrial"
    start: PumaStart = PumaStart()
    avoid_limits: Annotated[float, Ge(0), Le(10)] = 0.0
    presets: ClassVar[Mapping[Level, Mapping[str, object]]] = PRESETS
    model: ClassVar[str] = "puma560.xml"
    joints: ClassVar[tuple[str, ...]] = tuple(f"joint_{i}" for i in range(1, 7))
    actuators: ClassVar[tuple[str, ...]] = joints
    joint_limits: ClassVar[Array] = JOINT_LIMITS
    joint_speeds: ClassVar[Array] = SPEED_LIMITS
    unit_m: ClassVar[float] = REACH_UNIT

    def __post_init__(self) -> None:
        super().__post_init__()
        limits = np.degrees(JOINT_LIMITS)
        # Beyond a limit MuJoCo's constraint would push the joint back before the first command.
        for i, (q, (low, high)) in enumerate(zip(self.start.nominal.q_deg, limits, strict=True)):
            if not low <= q <= high:
                raise ParameterError(f"start.nominal.q_deg.{i}", f"must be within joint {i + 1}'s limits {low:g} to {high:g} deg", q)
        self._check_effects()

    @property
    def actuator_set(self) -> Actuation:
        """The servo amplifiers of the chosen actuation."""
        return self.compensated(ACTUATIONS[self.actuation])

    def configuration(self) -> Array:
        """Joint angles of the nominal start, shape (6,) [rad]."""
        return np.radians(self.start.nominal.q_deg)

    def kinematics(self, q: Array) -> tuple[Array, Array]:
        """Those of the table DH; the base stands at the world's origin."""
        return kinematics(q)

    def started_at(self, configuration: Array) -> Puma560:
        """The same arm from other joint angles (6,) [rad]."""
        nominal = JointAngles(q_deg=tuple(np.degrees(configuration).tolist()))
        return replace(self, start=PumaStart(nominal=nominal, random=self.start.random))

    def randomised(self, rng: np.random.Generator) -> Puma560:
        """The same arm with a start drawn within the box, clipped to the joint limits."""
        box = random_of(self.start, "{q_deg: 15}")
        q = np.array(self.start.nominal.q_deg) + rng.uniform(-1, 1, 6) * box.q_deg
        q = np.clip(q, *np.degrees(JOINT_LIMITS).T)
        nominal = JointAngles(q_deg=tuple(q.tolist()))
        return replace(self, start=PumaStart(nominal=nominal, random=box))
