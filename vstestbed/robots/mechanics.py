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
    drives: CurrentLoops | None = None
    links: Array | None = None
    gravity: float | None = None
    payload: Payload | None = None

    @property
    def acts(self) -> bool:
        """Whether torques are computed at each physics step: those of current loops, cogging, ripple."""
        return self.drives is not None or self.ripple > 0 or bool(self.cogging.any())


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
