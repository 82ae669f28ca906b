"""Puma 560: kinematics in standard Denavit-Hartenberg frames, and resolved-rate control.

A_i = Rz(q_i) Tz(d_i) Tx(a_i) Rx(alpha_i),  T_base_flange = A_1 ... A_6.

The flange is frame 6, which the table leaves at the wrist's centre (d_6 = 0). The base frame stands on the floor.
Dynamics, gears and friction are in `models/puma560.xml`; a test compares the two files.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le, Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import Angle
from vstestbed.core.spec import spec
from vstestbed.robots.allocation import ALL_SIX, Actuation, Allocation, Limit, Mount
from vstestbed.robots.base import RobotBase
from vstestbed.robots.reading import Reading

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

_JOINT_LIMITS, _SPEED_LIMITS = JOINT_LIMITS.tolist(), SPEED_LIMITS.tolist()

REACH_UNIT = 0.4318
"""Length that makes metres and radians comparable [m], the upper arm's a_2: singular values are those of (v / REACH_UNIT, w)."""

_SCALE, _EYE = np.array([1 / REACH_UNIT] * 3 + [1.0] * 3), np.eye(4)

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

    Args:
        q: joint angles, shape (6,), [rad].

    Returns:
        T_base_flange (4, 4) and J (6, 6): twist of the flange (v, w) in its own frame = J @ dq.
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


def forward(q: Array) -> Array:
    """T_base_flange (4, 4) at the joint angles q (6,) [rad]."""
    return _frames(q)[6]


def jacobian(q: Array) -> Array:
    """Geometric Jacobian (6, 6) of the flange in the flange's frame, rows (v, w), at the joint angles q (6,) [rad]."""
    return kinematics(q)[1]


def resolved_rate(J: Array, twist: Array, speed_limits: Array | None = SPEED_LIMITS, threshold: float = 0.05) -> Array:
    """Damped resolved-rate control: joint speeds for a flange twist, scaled as a whole into the speed limits.

    dq = Js^T (Js Js^T + lambda^2 I)^-1 ts,  where Js and ts have v divided by REACH_UNIT, and
    lambda^2 = (1 - (s_min / threshold)^2) threshold^2 where s_min < threshold, else 0.
    Exact away from singularities, continuous across the threshold, and |dq| <= |ts| / threshold everywhere
    (the largest damping equals the threshold, so the gain along the weakest direction is s_min / threshold^2).

    Args:
        J: Jacobian, shape (6, 6), rows (v, w).
        twist: (vx, vy, vz, wx, wy, wz) of the flange in the Jacobian's frame, [m/s, rad/s].
        speed_limits: largest size of each joint speed, shape (6,), [rad/s]; None for none.
        threshold: smallest singular value of Js that is left undamped.

    Returns:
        dq (6,) [rad/s]; `J @ dq` is the realised twist.

    Reference: Nakamura & Hanafusa 1986, doi:10.1115/1.3143764; this law of lambda from Maciejewski & Klein 1988,
    doi:10.1002/rob.4620050603, as written by Chiaverini, Siciliano & Egeland 1994, doi:10.1109/87.294335.
    """
    U, s, Vt = np.linalg.svd(J * _SCALE[:, None])
    damping2 = max(0.0, threshold**2 - s[-1] ** 2)
    dq = Vt.T @ (s / (s**2 + damping2) * (U.T @ (twist * _SCALE)))
    if speed_limits is None:
        return dq
    # Scaled as a whole: joints clipped one by one would change the direction of the camera's motion, not only its speed.
    return dq / max(1.0, float(np.max(np.abs(dq) / speed_limits)))


LIMIT_MARGIN = math.radians(1.0)
"""Distance from its hard stop at which a joint comes to rest [rad]."""
LIMIT_HORIZON_S = 0.25
"""Velocity damper: near its limit a joint may approach no faster than to reach the margin in this time [s]."""
INNER = 0.8
"""Central share of a joint's range in which limit avoidance leaves it alone."""
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
    """Joint angles q_deg, shape (6,) [deg]."""

    q_deg: Six = (0.0, 45.0, -180.0, 0.0, 45.0, -45.0)


@spec
class JointBox:
    """Random starts: each joint within +- q_deg of the nominal angle [deg]."""

    q_deg: Annotated[float, Ge(0), Le(180)] = 15.0


@spec
class PumaStart:
    """Joint angles at the start: `nominal` (q_deg [deg]), and the box from which `random` starts are drawn."""

    nominal: JointAngles = JointAngles()
    random: JointBox | None = None


@spec
class Puma560(RobotBase):
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
    actuators: ClassVar[tuple[str, ...]] = tuple(f"joint_{i}" for i in range(1, 7))
    gripper: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse a start outside the joint limits."""
        limits = np.degrees(JOINT_LIMITS)
        # Beyond a limit MuJoCo's constraint would push the joint back before the first command.
        for i, (q, (low, high)) in enumerate(zip(self.start.nominal.q_deg, limits, strict=True)):
            if not low <= q <= high:
                raise ParameterError(f"start.nominal.q_deg.{i}", f"must be within joint {i + 1}'s limits {low:g} to {high:g} deg", q)

    @property
    def model(self) -> str:
        """Its file."""
        return "puma560.xml"

    @property
    def joints(self) -> tuple[str, ...]:
        """All six; each has an actuator."""
        return self.actuators

    @property
    def actuator_set(self) -> Actuation:
        """The servo amplifiers of the chosen actuation."""
        return ACTUATIONS[self.actuation]

    def configuration(self) -> Array:
        """Joint angles of the nominal start, shape (6,) [rad]."""
        return np.radians(self.start.nominal.q_deg)

    def start_joints(self) -> Array:
        """The configuration itself."""
        return self.configuration()

    def started_at(self, configuration: Array) -> Puma560:
        """The same arm from other joint angles (6,) [rad]."""
        nominal = JointAngles(q_deg=tuple(np.degrees(configuration).tolist()))
        return replace(self, start=PumaStart(nominal=nominal, random=self.start.random))

    def idealised(self) -> Puma560:
        """The same arm with stiff servos and without friction."""
        return replace(self, actuation="ideal")

    def randomised(self, rng: np.random.Generator) -> Puma560:
        """The same arm with a start drawn within the box, clipped to the joint limits."""
        box = self.start.random
        if box is None:
            raise ParameterError("robot.start.random", "is missing: a seed draws the start from it, e.g. {q_deg: 15}")
        q = np.array(self.start.nominal.q_deg) + rng.uniform(-1, 1, 6) * box.q_deg
        q = np.clip(q, *np.degrees(JOINT_LIMITS).T)
        nominal = JointAngles(q_deg=tuple(q.tolist()))
        return replace(self, start=PumaStart(nominal=nominal, random=box))

    def flange_pose(self, configuration: Array) -> Array:
        """T_world_flange (4, 4); the base stands at the world's origin."""
        return forward(configuration)

    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """All six degrees of freedom, also near singularities: `allocate` damps there."""
        return ALL_SIX

    def measured_twist(self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount) -> Array:
        """Mean camera twist (6,) between two readings: J at the mean joint angles times dq / duration."""
        if duration <= 0:
            return np.zeros(6)
        # At the middle: the chord and the path differ in the third order of dq there, in the second at either end.
        J = jacobian((before.q + now.q) / 2)
        return mount.to_camera @ (J @ ((now.q - before.q) / duration))

    def secondary_task(self, null_space: Array, reading: Reading, mount: Mount) -> Array:
        """Joint-limit avoidance in the null space of the law.

        Desired: dq*_i = -avoid_limits (q_i - edge_i) beyond the edge of the middle four fifths of a joint's range, else 0. The
        null-space motion J^-1 null_space z nearest to dq* in the least-squares sense is taken.

        References: Liegeois 1977, doi:10.1109/TSMC.1977.4309644; Chaumette & Marchand 2001, doi:10.1109/70.964671.
        """
        low, high = (JOINT_LIMITS.mean(axis=1) + side * INNER * np.ptp(JOINT_LIMITS, axis=1) / 2 for side in (-1, 1))
        desired = -self.avoid_limits * (reading.q - np.clip(reading.q, low, high))
        if null_space.shape[1] == 0 or not desired.any():
            return np.zeros(6)
        J = jacobian(reading.q)
        # A projection: dq . dq* >= 0, so this task on its own never moves the joints as a whole nearer to their limits. The damped
        # inverse for J^-1, as `allocate` will use it, so that the fit is of motions that the joints are really given.
        joint_motions = np.column_stack([resolved_rate(J, mount.to_flange @ twist, None) for twist in null_space.T])
        return null_space @ np.linalg.lstsq(joint_motions, desired, rcond=1e-6)[0]

    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """Joint speeds for a camera twist (6,): damped resolved rate, then scaled as a whole into speed and position limits.

        Near a position limit a joint's speed towards it is bounded by its distance over LIMIT_HORIZON_S
        (velocity damper: Faverjon & Tournassoud 1987, doi:10.1109/ROBOT.1987.1087982).
        """
        commanded = mount.to_flange @ twist
        J = jacobian(reading.q)
        dq = resolved_rate(J, commanded, None)
        realised = J @ dq
        along = _share(realised, commanded)
        limit: Limit = "singular" if along < 0.5 else ""
        speed, position = _allowed(dq, reading.q, max(LIMIT_HORIZON_S, period))
        scale = min(1.0, speed, position)
        if scale < 1.0:  # a limit met hides the singularity beside it: `scale` has both
            limit = "joint_limit" if position < speed else "speed"
        return Allocation(setpoint=dq * scale, twist=mount.to_camera @ realised * scale, scale=scale * along, limit=limit)


def _allowed(dq: Array, q: Array, horizon_s: float) -> tuple[float, float]:
    """Largest factors of the joint speeds dq (6,) within the speed limits, and within the velocity damper at the joints q (6,) [rad].

    The horizon is not shorter than a period: within one, no further command could slow a joint down. The joints are the measured ones,
    not integrated commands: the servos lag behind those.
    """
    speed = position = math.inf
    for u, at, (low, high), most in zip(dq.tolist(), q.tolist(), _JOINT_LIMITS, _SPEED_LIMITS, strict=True):  # numpy takes thrice as long
        size = max(abs(u), 1e-12)
        room = (high - at if u > 0 else at - low) - LIMIT_MARGIN
        speed, position = min(speed, most / size), min(position, max(room, 0.0) / horizon_s / size)
    return speed, position


def _share(realised: Array, commanded: Array) -> float:
    """Projection of a realised twist (6,) on the commanded one, as a share of it, 0 to 1, lengths in REACH_UNIT; 1 for a zero command."""
    a, b = realised * _SCALE, commanded * _SCALE
    size = float(b @ b)
    return min(1.0, max(0.0, float(a @ b) / size)) if size > 0 else 1.0
