"""A chain of hinges and slides as plain numbers: pose and Jacobian of its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, inverse
from vstestbed.effects.body import Change


class ChainReader(Protocol):
    """Reads an arm's file into plain numbers: MuJoCo, in the simulator's room, which this one never
    imports.
    """

    def joint_chain(self, file: str, flange: str, names: tuple[str, ...]) -> JointChain:
        """The joints from the root to a flange; names: in their order, () for all."""
        ...

    def mounted(
        self,
        platform: str,
        changes: tuple[Change, ...],
        arm: str,
        place: tuple[float, float, float],
    ) -> str:
        """The file of a platform with an arm on it at a place [m]; platform, arm: their files;
        changes: of the platform.
        """
        ...

    def dynamics(
        self, file: str, flange: str, joints: tuple[str, ...], load: Load | None
    ) -> ArmDynamics:
        """Masses by an arm's file, with a load at its flange. joints: in their order."""
        ...

    def inertia_at(
        self, file: str, joints: tuple[str, ...], q: tuple[float, ...]
    ) -> tuple[Array, Array]:
        """The mass matrix (n, n) at positions q [rad, m], and what of its diagonal are the joints'
        rotors (n,) [kg m^2, kg].
        """
        ...


# mass [kg], x, y and z of its centre in the flange's frame [m], edge of the cube [m]
Load = tuple[float, ...]


class ArmDynamics(Protocol):
    """An arm's masses by its own model: no friction, no elasticity."""

    def inverse(self, q: Array, qd: Array, qdd: Array) -> Array:
        """Torques (n,) [Nm, N] for accelerations qdd at joints q and speeds qd, (n,) each: M(q)
        qdd + h(q, qd).
        """
        ...

    def mass(self, q: Array) -> Array:
        """M(q), shape (n, n) [kg m^2, kg]."""
        ...


# imports the reader when one is needed; `vstestbed.sim` enters it
READERS: list[Callable[[], ChainReader]] = []


def reader() -> ChainReader:
    """What reads such files."""
    if not READERS:
        raise ParameterError("file", "is read by the simulator's room; import vstestbed.sim first")
    return READERS[-1]()


@dataclass(frozen=True)
class JointChain:
    """The joints between a base that stands still and a flange, in the order in which they follow
    each other.

    With the frame G_i of joint i where all joints are at 0, z along its axis and the origin in its
    anchor, and G_0 the world's,

        T_world_flange(q) = A_1(q_1) ... A_n(q_n) G_n^-1 T_0,  A_i = G_(i-1)^-1 G_i E(q_i),

    where E turns about z, or slides along it. That is the product of exponentials of the joints'
    twists, in frames of their own.
    Reference: Brockett 1984, doi:10.1007/BFb0031048; Lynch & Park 2017, Modern Robotics, chapter 4
    and 5.

    Attributes:
        names: of the joints. slides: which of them slide, (n,).
        axes, anchors: unit vectors and points (n, 3) in the world, all joints at q = 0 [m]. T_0:
            pose (4, 4) of the flange there.
        limits: lowest and highest position (n, 2) [rad, m]; infinite for a joint that turns without
            end.
        torque: largest torque or force by the file (n,) [Nm, N]; infinite where it says none.
            friction: Coulomb friction (n,) [Nm, N].
        drives: the file's own actuator of each joint, `velocity`, `position` or another word; ""
            where it has none.
    """

    names: tuple[str, ...]
    slides: NDArray[np.bool_]
    axes: Array
    anchors: Array
    T_0: Array
    limits: Array
    torque: Array = field(default_factory=lambda: np.zeros(0))
    friction: Array = field(default_factory=lambda: np.zeros(0))
    drives: tuple[str, ...] = ()

    @cached_property
    def unit_m(self) -> float:
        """The longest link [m]: distance between neighbouring anchors, or of the flange from the
        last.
        """
        points = np.vstack([self.anchors, self.T_0[:3, 3]])
        return max(float(np.linalg.norm(np.diff(points, axis=0), axis=1).max()), 1e-3)

    @cached_property
    def _parts(self) -> tuple[Array, Array, Array, Array, Array]:
        """A_i = fixed + cosine cos q_i + sine sin q_i + along q_i, (n, 4, 4) each, and G_n^-1 T_0
        (4, 4).
        """
        G = [
            np.eye(4),
            *(_frame(axis, anchor) for axis, anchor in zip(self.axes, self.anchors, strict=True)),
        ]
        M = np.array([inverse(before) @ now for before, now in pairwise(G)])
        fixed = M.copy()
        cosine = np.zeros_like(M)
        sine = np.zeros_like(M)
        along = np.zeros_like(M)
        turns = ~self.slides
        fixed[turns, :, :2] = 0.0
        cosine[turns, :, :2] = M[turns, :, :2]
        sine[turns, :, 0] = M[turns, :, 1]
        sine[turns, :, 1] = -M[turns, :, 0]
        along[self.slides, :, 3] = M[self.slides, :, 2]
        return fixed, cosine, sine, along, inverse(G[-1]) @ self.T_0

    def _frames(self, q: Array) -> Array:
        """The frame of each joint in the world (n, 4, 4)."""
        fixed, cosine, sine, along, _ = self._parts
        frames = (
            fixed
            + np.cos(q)[:, None, None] * cosine
            + np.sin(q)[:, None, None] * sine
            + q[:, None, None] * along
        )
        for i in range(1, len(q)):
            frames[i] = frames[i - 1] @ frames[i]
        return frames

    def flange(self, q: Array) -> Array:
        """T_world_flange (4, 4) at positions q (n,)."""
        return self._frames(q)[-1] @ self._parts[-1]

    def kinematics(self, q: Array) -> tuple[Array, Array]:
        """T_world_flange (4, 4), and the Jacobian (6, n): twist (v, w) of the flange in its own
        frame = J @ dq, at positions q (n,).

        With the axis z_i and the origin o_i of the frame of joint i, and the flange's origin o, a
        joint that turns gives v = z_i x (o - o_i) dq_i and w = z_i dq_i, one that slides v = z_i
        dq_i.
        """
        frames = self._frames(q)
        T = frames[-1] @ self._parts[-1]
        R_t = T[:3, :3].T
        axes = R_t @ frames[:, :3, 2].T
        arms = R_t @ (T[:3, 3] - frames[:, :3, 3]).T
        J = np.empty((6, len(q)))
        # axes x arms, row by row: np.cross takes as long as all the rest
        J[0] = axes[1] * arms[2] - axes[2] * arms[1]
        J[1] = axes[2] * arms[0] - axes[0] * arms[2]
        J[2] = axes[0] * arms[1] - axes[1] * arms[0]
        J[3:] = axes
        if self.slides.any():
            J[:3, self.slides] = axes[:, self.slides]
            J[3:, self.slides] = 0.0
        return T, J


def _frame(axis: Array, anchor: Array) -> Array:
    """A frame (4, 4) with its origin at a point (3,) and z along a unit vector (3,); exact for one
    along an axis of the world.
    """
    G = np.eye(4)
    x = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
    x /= np.linalg.norm(x)
    G[:3, 0] = x
    G[:3, 1] = np.cross(axis, x)
    G[:3, 2] = axis
    G[:3, 3] = anchor
    return G
