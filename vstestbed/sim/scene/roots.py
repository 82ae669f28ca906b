"""The pose of a movable base in MuJoCo's state: a free joint, or planar joints x, y and yaw."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array, quaternion_wxyz
from vstestbed.core.planar import place_of

PLANAR = ("root_x", "root_y", "root_yaw")


class Root:
    """The movable base of the robot under a prefix.

    Args:
        model: the compiled scene. prefix: the robot's (`robot/`).
    """

    def __init__(self, model: mujoco.MjModel, prefix: str):
        self.body = model.body(f"{prefix}base").id
        names = [model.joint(i).name for i in range(model.njnt)]
        self.free = f"{prefix}root" in names
        joints = [model.joint(prefix + name) for name in (("root",) if self.free else PLANAR)]
        self._qpos = np.concatenate([np.arange(j.qposadr[0], j.qposadr[0] + (7 if self.free else 1)) for j in joints])
        self._qvel = np.concatenate([np.arange(j.dofadr[0], j.dofadr[0] + (6 if self.free else 1)) for j in joints])

    def put(self, qpos: NDArray[np.float64], T_world_base: Array) -> None:
        """Write a pose (4, 4) into the state `qpos`; of a planar base x, y and yaw alone."""
        qpos[self._qpos] = (
            np.concatenate([T_world_base[:3, 3], quaternion_wxyz(T_world_base[:3, :3])]) if self.free else place_of(T_world_base)
        )

    def rest(self, qvel: NDArray[np.float64]) -> None:
        """Set the base's velocity in the state `qvel` to zero."""
        qvel[self._qvel] = 0.0

    def pose(self, data: mujoco.MjData) -> Array:
        """T_world_base (4, 4) now."""
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.xmat[self.body].reshape(3, 3), data.xpos[self.body]
        return T
