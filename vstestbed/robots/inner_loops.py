"""Inner loops of arms: from the joint speeds that a law's command asks for to torques of the
motors.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from vstestbed.core.geometry import Array, Pose, adjoint, inverse, log
from vstestbed.core.quantity import Frequency
from vstestbed.core.registry import Contract, Registry
from vstestbed.core.spec import spec
from vstestbed.robots.base import Reading
from vstestbed.robots.chain import ArmDynamics, JointChain

Bandwidth = Annotated[float, Gt(0), Le(1e3)]
DampingRatio = Annotated[float, Ge(0), Le(10)]
Stiffness = Annotated[float, Gt(0), Le(1e6)]
WRENCH = 6  # numbers of a wanted wrench, after the joint speeds of a setpoint for an impedance
LEAST_MOBILITY = 1e-6
"""Added to the diagonal of J M^-1 J^T [1/kg, 1/(kg m^2)]: at a singularity the mass that is felt is
a million kg, and not without bound.
"""
# with which motions that leave the frame where it is follow the reference, critically damped
# [rad/s]
POSTURE_RADPS = 5.0


class InnerLoop(ABC):
    """A law of torques: tau (n,) from where the joints are
    and where the ordered speeds have led.
    """

    kind: Any  # the word in a scenario: a field of each
    rate_hz: Any = 1000.0  # at which it is computed [Hz]; a field of each that has torques
    takes_wrench: ClassVar[bool] = False  # a setpoint has a wrench after the joint speeds
    torques: ClassVar[bool] = True  # False: the joints' own velocity servos, nothing is computed

    @abstractmethod
    def torque(self, arm: ArmModel, q: Array, qd: Array, q_ref: Array, setpoint: Array) -> Array:
        """Torques (n,) [Nm, N] at joints q and speeds qd (n,), for the reference q_ref and the
        setpoint (n,) or (n + 6,).
        """


@spec
class VelocityServos(InnerLoop):
    """The joints' own velocity servos (`actuation`), each for itself."""

    kind: Literal["velocity"] = "velocity"
    torques = False

    def torque(self, arm: ArmModel, q: Array, qd: Array, q_ref: Array, setpoint: Array) -> Array:
        """Never asked."""
        raise NotImplementedError


@spec
class ComputedTorque(InnerLoop):
    """tau = M(q) (w^2 (q_ref - q) + 2 zeta w (v - qd)) + h(q, qd), with the reference q_ref that
    the ordered speeds v have led to.

    M and h are the arm's own model: inertia, Coriolis forces and weight by its file, with a
    declared payload. Where they are true the errors of all joints decay alike, with the poles of
    s^2 + 2 zeta w s + w^2. Friction, elastic gears and an undeclared payload are not in the model.

    Args:
        rate_hz: at which it is computed [Hz].
        bandwidth_radps: w [rad/s].
        damping: zeta [1].

    Reference: Luh, Walker & Paul 1980, doi:10.1109/TAC.1980.1102367 (resolved acceleration); Lynch
    & Park 2017, Modern Robotics, section 11.4.
    """

    kind: Literal["computed_torque"] = "computed_torque"
    rate_hz: Frequency = 1000.0
    bandwidth_radps: Bandwidth = 40.0
    damping: DampingRatio = 1.0

    def torque(self, arm: ArmModel, q: Array, qd: Array, q_ref: Array, setpoint: Array) -> Array:
        w = self.bandwidth_radps
        qdd = w * w * (q_ref - q) + 2 * self.damping * w * (setpoint - qd)
        return arm.dynamics.inverse(q, qd, qdd)


@spec
class Impedance(InnerLoop):
    """tau = J^T (K x + D v + F) + h(q, qd): the frame `at` on the flange yields as if springs and
    dampers held it to its reference.

    x = log(T^-1 T_ref) is the displacement to the reference, in which the ordered joint speeds have
    led T_ref, v the velocity to it, both in the frame itself; F is a wanted wrench
    (`Command.wrench`). A static push f displaces it by K^-1 f. The mass that is felt is the arm's
    own, Lambda = (J M^-1 J^T)^-1, and D = 2 zeta in the modes of K over Lambda ("double
    diagonalization"). What more than six joints leave open follows the reference at 5 rad/s. What
    friction holds, springs do not move.

    Args:
        rate_hz: at which it is computed [Hz].
        stiffness_npm: K of translations, along each axis of the frame [N/m].
        stiffness_nmprad: K of rotations, about each axis [Nm/rad].
        damping: zeta, of all modes [1].
        at: the frame, in the flange's: the mount of a camera, or the tip of a tool.

    References: Hogan 1985, doi:10.1115/1.3140702; without a force sensor, and the damping:
    Albu-Schaeffer, Ott, Frese & Hirzinger 2003, doi:10.1109/ROBOT.2003.1242165.
    """

    kind: Literal["impedance"] = "impedance"
    rate_hz: Frequency = 1000.0
    stiffness_npm: tuple[Stiffness, Stiffness, Stiffness] = (1000.0, 1000.0, 1000.0)
    stiffness_nmprad: tuple[Stiffness, Stiffness, Stiffness] = (100.0, 100.0, 100.0)
    damping: DampingRatio = 1.0
    at: Pose = Pose()
    takes_wrench = True

    @cached_property
    def _constants(self) -> tuple[Array, Array]:
        """The flange's twist to that of the frame, and K, both (6, 6)."""
        return adjoint(inverse(self.at.T)), np.diag((*self.stiffness_npm, *self.stiffness_nmprad))

    def torque(self, arm: ArmModel, q: Array, qd: Array, q_ref: Array, setpoint: Array) -> Array:
        n = len(q)
        at = self.at.T
        to_frame, K = self._constants
        T, J = arm.chain.kinematics(q)
        T_ref = arm.chain.flange(q_ref)
        J = to_frame @ J
        M = arm.dynamics.mass(q)
        across = np.linalg.solve(M, J.T)  # M^-1 J^T
        felt = np.linalg.inv(J @ across + LEAST_MOBILITY * np.eye(6)).astype(float)  # Lambda
        x = log(inverse(T @ at) @ T_ref @ at)
        v = J @ (setpoint[:n] - qd)
        wrench = K @ x + damping_of(felt, K, self.damping) @ v + setpoint[n:]
        tau = J.T @ wrench + arm.dynamics.inverse(q, qd, np.zeros(n))
        if n > 6:  # torques that leave the frame alone, J M^-1 tau = 0
            w = POSTURE_RADPS
            posture = M @ (w * w * (q_ref - q) + 2 * w * (setpoint[:n] - qd))
            tau = tau + posture - J.T @ (felt @ (across.T @ posture))
        return tau


def damping_of(mass: Array, K: Array, zeta: float) -> Array:
    """D (k, k) with which the modes of mass x'' + D x' + K x = 0 have the damping ratio zeta: with
    mass = Q Q^T and Q^-1 K Q^-T = U diag(k) U^T it is 2 zeta Q U diag(sqrt k) U^T Q^T.
    """
    Q = np.linalg.cholesky(mass)
    inner = np.linalg.solve(Q, np.linalg.solve(Q, K).T)
    k, U = np.linalg.eigh((inner + inner.T) / 2)
    W = Q @ U
    return 2 * zeta * (W * np.sqrt(np.maximum(k, 0.0))) @ W.T


INNER_LOOPS = Registry(
    "inner_loop",
    VelocityServos,
    ComputedTorque,
    Impedance,
    default="velocity",
    contract=Contract(InnerLoop),
)
Inner = Annotated[InnerLoop, INNER_LOOPS]


@dataclass(frozen=True)
class ArmModel:
    """What the inner loop knows of its arm: its joints, and masses by its own model. most: largest
    torques (n,) [Nm, N].
    """

    chain: JointChain
    dynamics: ArmDynamics
    most: Array


class TorqueControl:
    """An arm's inner loop as an onboard controller (`robots.base.Onboard`), between ordered joint
    speeds and torques.

    The reference follows the ordered speeds, but for joints whose motor is at its limit: there it
    waits (anti-windup).

    loop: of torques. n: number of joints. model: makes what it knows of the arm, when it is first
    needed.
    """

    reading = Reading

    def __init__(self, loop: InnerLoop, n: int, model: Callable[[], ArmModel]):
        self._loop = loop
        self._model = model
        self.control_period_s = 1.0 / loop.rate_hz
        # it holds its start until the first command
        self.first_setpoint = np.zeros(n + (WRENCH if loop.takes_wrench else 0))

    @cached_property
    def _arm(self) -> ArmModel:
        return self._model()

    def begin(self) -> None:
        """No reference yet: it begins where the joints are."""

    def actuate(
        self, state: Array | None, setpoint: Array, reading: Reading, dt: float
    ) -> tuple[Array, Array]:
        """One step of dt [s]: the next reference, joints (n,) that the ordered speeds have led to
        [rad, m], and the torques (n,).
        """
        q = reading.q
        n = len(q)
        q_ref = q.copy() if state is None else state
        tau = self._loop.torque(self._arm, q, reading.qd, q_ref, setpoint)
        most = self._arm.most
        winds = (np.abs(tau) >= most) & (tau * setpoint[:n] > 0)
        low, high = self._arm.chain.limits.T
        ahead = np.clip(q_ref + np.where(winds, 0.0, setpoint[:n]) * dt, low, high)
        return ahead, np.clip(tau, -most, most)

    def reported(self, state: Array | None, reading: Reading) -> Reading:
        """What the instruments read: it estimates nothing."""
        return reading
