"""What differs between an arm's true joints and links and those of its file, as plain numbers; the simulator's room builds it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.joint_effects import CurrentLoops
from vstestbed.robots.link_errors import Payload

FINEST = 0.5
"""Largest w h of an eigenfrequency w at a physics step h. The spring's force is that of the beginning of a step: the vibration then is
(w h)^2 / 24 too quick, 1 % here, and it grows from w h = 2 on."""
DRIVES_STEP_S = 0.001
"""Largest physics step with `drives`, which sample the servo at it [s]: half a millisecond on average beside a lag of as much."""


@dataclass(frozen=True, eq=False)
class Mechanics:
    """Imperfections of an arm of n joints. What is 0 or None is as in its file.

    Attributes:
        joints: names in the file.
        stiffness, damping, play: of the gears (n,) [Nm/rad, Nm s/rad, rad]; a joint of stiffness 0 is rigid.
        stages: (n, m, 2), beyond which torsion the stiffness of a gear grows by how much [rad, Nm/rad]; in the order of the torsion.
        rotors: inertia of the motors' rotors on the joint's side (n,) [kg m^2]; None: as the file has it.
        cogging, cycles: amplitude of the cogging torque and cycles in a turn of the joint (n,) [Nm, 1]. ripple: of the torque [1].
        drives: the current loops. links: D_i (n, 4, 4), displacement of the next joint or the flange in the frame of each link.
        gravity: the share of the weight that the compensation of the drives carries; None: as the actuation has it.
        payload: at the flange.
    """

    joints: tuple[str, ...]
    stiffness: Array
    damping: Array
    play: Array
    cogging: Array
    cycles: Array
    ripple: float = 0.0
    stages: Array | None = None
    rotors: Array | None = None
    drives: CurrentLoops | None = None
    links: Array | None = None
    gravity: float | None = None
    payload: Payload | None = None

    @property
    def acts(self) -> bool:
        """Whether torques are computed at each physics step: those of current loops, cogging, ripple."""
        return self.drives is not None or self.ripple > 0 or bool(self.cogging.any())

    @property
    def stiffest(self) -> Array:
        """Stiffness of the gears under a large torque (n,) [Nm/rad]."""
        return self.stiffness if self.stages is None else self.stiffness + self.stages[:, :, 1].sum(axis=1)

    def torsion(self, torque: Array) -> Array:
        """Torsion of the gears (n,) [rad] under a torque (n,) [Nm], beyond their play; 0 where they are rigid."""
        return self._under(torque)[0]

    def tangent(self, torque: Array) -> Array:
        """Stiffness of the gears (n,) [Nm/rad] for small motions about a torque (n,) [Nm]."""
        return self._under(torque)[1]

    def _under(self, torque: Array) -> tuple[Array, Array]:
        k, left = self.stiffness.copy(), np.abs(torque)
        at, torsion = np.zeros(len(k)), np.zeros(len(k))
        for stage in () if self.stages is None else self.stages.transpose(1, 2, 0):
            held = k * (stage[0] - at)  # the torque at which this stage begins, beyond that of the former one
            beyond = (left > held) & (stage[1] > 0)
            torsion, left = torsion + np.where(beyond, stage[0] - at, 0.0), left - np.where(beyond, held, 0.0)
            at, k = np.where(beyond, stage[0], at), k + np.where(beyond, stage[1], 0.0)
        rest = np.divide(left, k, out=np.zeros(len(k)), where=k > 0)
        return np.sign(torque) * (torsion + rest), k


def quickest(M: Array, rotors: Array, stiffness: Array) -> tuple[float, int]:
    """The highest eigenfrequency of the two-mass joints, servos off [rad/s], and the joint that moves most in it; (0, 0) if all are rigid.

    det([[K, -K], [-K, K]] - w^2 [[M, 0], [0, J]]) = 0; a rigid joint's rotor is part of its link.

    Args:
        M: inertia of the links (n, n). rotors: J, (n,). stiffness: diagonal of K, (n,), 0 for a rigid joint.
    """
    soft = np.flatnonzero(stiffness > 0)
    if not len(soft):
        return 0.0, 0
    n, k = len(stiffness), stiffness[soft]
    mass, spring = np.zeros((n + len(soft),) * 2), np.zeros((n + len(soft),) * 2)
    mass[:n, :n] = M + np.diag(np.where(stiffness > 0, 0.0, rotors))
    mass[n:, n:] = np.diag(rotors[soft])
    at = n + np.arange(len(soft))
    spring[soft, soft], spring[at, at] = k, k
    spring[soft, at], spring[at, soft] = -k, -k
    L_inverse = np.linalg.inv(np.linalg.cholesky(mass))
    w2, modes = np.linalg.eigh(L_inverse @ spring @ L_inverse.T)
    mode = L_inverse.T @ modes[:, -1]
    return math.sqrt(max(float(w2[-1]), 0.0)), int(soft[np.argmax(np.abs(mode[soft] - mode[at]))])
