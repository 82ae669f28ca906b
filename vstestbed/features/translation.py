"""The translation between two frames."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from vstestbed.core.geometry import Array, skew
from vstestbed.core.spec import spec


@spec
class Translation:
    """The translation t [m] of a pose: three rows, computed from the pose.

    Args:
        pose: "cdMc" is T_goal_camera, with t_dot = R v; "cMcd" T_camera_goal and "cMo" T_camera_target, with
            t_dot = -v - w x t.

    Reference: Chaumette & Hutchinson 2006, section on PBVS, doi:10.1109/MRA.2006.250573.
    """

    kind: Literal["translation"] = "translation"
    pose: Literal["cdMc", "cMcd", "cMo"] = "cdMc"
    inputs: ClassVar[tuple[str, ...]] = ("T_camera_target",)
    rows_per_marker: ClassVar[int] = 0

    def measure(self, T: Array) -> Array:
        """The vector s (..., 3) [m] of the pose T (..., 4, 4) that `pose` names."""
        return np.asarray(T, dtype=float)[..., :3, 3].copy()

    def interaction(self, T: Array) -> Array:
        """L (..., 3, 6) of the pose T (..., 4, 4) that `pose` names: [R, 0] for cdMc, [-I, [t]x] for the others."""
        T = np.asarray(T, dtype=float)
        L = np.zeros((*T.shape[:-2], 3, 6))
        if self.pose == "cdMc":
            L[..., :3] = T[..., :3, :3]
        else:
            L[..., :3] = -np.eye(3)
            L[..., 3:] = skew(T[..., :3, 3])
        return L

    def error(self, s: Array, s_star: Array) -> Array:
        """The difference s - s* (..., 3) [m]; at the goal s* = 0 for cdMc and cMcd."""
        return np.subtract(s, s_star, dtype=float)
