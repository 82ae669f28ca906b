"""A chain of hinges and slides as plain numbers: pose and Jacobian of its end by the product of exponentials."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array


class ChainReader(Protocol):
    """Reads an arm's file into plain numbers: MuJoCo, in the simulator's room, which this one never imports."""

    def joint_chain(self, file: str, flange: str, names: tuple[str, ...]) -> JointChain:
        """The joints from the root to a flange; names: in their order, () for all."""
        ...

    def inertia_at(self, file: str, joints: tuple[str, ...], q: tuple[float, ...]) -> tuple[float, ...]:
        """What each joint's motor has to move at positions q [rad, m]: [kg m^2, kg]."""
        ...

    def inertias_at(self, file: str, joints: tuple[str, ...], q: tuple[float, ...]) -> tuple[Array, Array]:
        """Inertia of the links (n, n) at positions q [rad, m], and of the joints' rotors (n,) [kg m^2, kg]."""
        ...


READERS: list[Callable[[], ChainReader]] = []  # imports the reader when one is needed; `vstestbed.sim` enters it


def reader() -> ChainReader:
    """What reads such files."""
    if not READERS:
        raise ParameterError("file", "is read by the simulator's room; import vstestbed.sim first")
    return READERS[-1]()


@dataclass(frozen=True)
class JointChain:
    """The joints between a base that stands still and a flange, in the order in which they follow each other.

    T_world_flange(q) = E_1(q_1) ... E_n(q_n) T_0, where E_i turns about the axis of joint i through its anchor, or slides along it.
    Reference: Brockett 1984, doi:10.1007/BFb0031048; Lynch & Park 2017, Modern Robotics, chapter 4 and 5.

    Attributes:
        names: of the joints. slides: which of them slide, (n,).
        axes, anchors: unit vectors and points (n, 3) in the world, all joints at q = 0 [m]. T_0: pose (4, 4) of the flange there.
        limits: lowest and highest position (n, 2) [rad, m]; infinite for a joint that turns without end.
        torque: largest torque or force by the file (n,) [Nm, N]; infinite where it says none. friction: Coulomb friction (n,) [Nm, N].
        drives: the file's own actuator of each joint, `velocity`, `position` or another word; "" where it has none.
    """

    names: tuple[str, ...]
    slides: NDArray[np.bool_]
    axes: Array
    anchors: Array
    T_0: Array
    limits: Array
    torque: Array
    friction: Array
    drives: tuple[str, ...]

    @cached_property
    def _skew(self) -> Array:
        """Matrices [z]x (n, 3, 3) of the axes, zero for joints that slide."""
        x, y, z = self.axes.T
        K = np.zeros((len(x), 3, 3))
        K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -z, y, -x
        K = K - K.mT
        K[self.slides] = 0.0
        return K

    @cached_property
    def _skew2(self) -> Array:
        return self._skew @ self._skew

    @cached_property
    def unit_m(self) -> float:
        """The longest link [m]: distance between neighbouring anchors, or of the flange from the last."""
        points = np.vstack([self.anchors, self.T_0[:3, 3]])
        return max(float(np.linalg.norm(np.diff(points, axis=0), axis=1).max()), 1e-3)

    def _motions(self, q: Array) -> Array:
        """E_i (n, 4, 4)."""
        E = np.zeros((len(q), 4, 4))
        E[:, 3, 3] = 1.0
        R = np.eye(3) + np.sin(q)[:, None, None] * self._skew + (1 - np.cos(q))[:, None, None] * self._skew2
        along = np.where(self.slides, q, 0.0)[:, None] * self.axes
        E[:, :3, :3] = R
        E[:, :3, 3] = self.anchors - np.einsum("nij,nj->ni", R, self.anchors) + along
        return E

    def kinematics(self, q: Array) -> tuple[Array, Array]:
        """T_world_flange (4, 4), and the Jacobian (6, n): twist (v, w) of the flange in its own frame = J @ dq, at positions q (n,)."""
        n = len(q)
        before = np.empty((n + 1, 4, 4))
        before[0] = np.eye(4)
        for i, E in enumerate(self._motions(q)):
            np.dot(before[i], E, out=before[i + 1])
        T = before[n] @ self.T_0
        R, at = before[:n, :3, :3], before[:n, :3, 3]
        axes = np.einsum("nij,nj->ni", R, self.axes)
        arms = T[:3, 3] - (np.einsum("nij,nj->ni", R, self.anchors) + at)
        v = np.where(self.slides[:, None], axes, np.cross(axes, arms))
        w = np.where(self.slides[:, None], 0.0, axes)
        R_t = T[:3, :3].T
        return T, np.concatenate([R_t @ v.T, R_t @ w.T])
