"""The relative pose: the feature of its rotation, the interaction matrices of its translation and
of the logarithm of a depth.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from vstestbed.core.geometry import Array, quaternion_wxyz, skew
from vstestbed.core.spec import spec


@spec
class ThetaU:
    """theta u of the rotation between the current camera frame and that at the goal: three rows,
    computed from a pose.

    Args:
        rotation: "cdRc" is R_goal_camera, "cRcd" its inverse R_camera_goal, with c for the camera
            and cd for the camera desired.

    Reference: Chaumette & Hutchinson 2006, section on PBVS, doi:10.1109/MRA.2006.250573.
    """

    kind: Literal["theta_u"] = "theta_u"
    rotation: Literal["cdRc", "cRcd"] = "cdRc"
    inputs = ("T_camera_target",)
    rows_per_marker = 0

    def measure(self, R: Array) -> Array:
        """The vector s (..., 3) [rad] of the rotation R (..., 3, 3) that `rotation` names."""
        return theta_u(R)

    def interaction(self, R: Array) -> Array:
        """L (..., 3, 6) of the rotation R (..., 3, 3) that `rotation` names: [0, L_w] for cdRc.

        R_dot is R [w]x for cdRc and -[w]x R for cRcd, so that the second is minus the first at
        -theta u.
        """
        return self.interaction_at(theta_u(R))

    def interaction_at(self, s: Array) -> Array:
        """The same for s = theta u (..., 3) [rad], without computing it again."""
        L = np.zeros((*s.shape, 6))
        if self.rotation == "cdRc":
            L[..., 3:] = rotation_interaction(s)
        else:
            L[..., 3:] = -rotation_interaction(-s)
        return L


def theta_u(R: Array) -> Array:
    """The vector theta u (..., 3) [rad], theta in [0, pi], of rotations R (..., 3, 3), exact near 0
    and near a half turn.

    From the unit quaternion (w, q), w >= 0: theta = 2 atan2(|q|, w). At an exact half turn the
    largest component of u is positive.
    """
    quaternion = quaternion_wxyz(np.asarray(R, dtype=float))
    w = quaternion[..., :1]
    q = quaternion[..., 1:]
    n = np.linalg.norm(q, axis=-1, keepdims=True)
    some = n > 0
    # 2: the limit of theta/|q| at 0
    return q * np.where(some, 2 * np.arctan2(n, w) / np.where(some, n, 1), 2.0)


def rotation_interaction(theta_u: Array) -> Array:
    """L_w (..., 3, 3) with (theta u)_dot = L_w w for R_dot = R [w]x, of theta u (..., 3) [rad],
    theta <= pi.

    L_w = I + S/2 + c S^2,  S = [theta u]x,  c = (1 - (theta/2) cot(theta/2))/theta^2;
    below 0.1 rad the series 1/12 + theta^2/720 + theta^4/30240, whose next term is under 1e-12.

    Reference: Malis, Chaumette & Boudet 1999, doi:10.1109/70.760345, in the frame of w.
    """
    theta2 = np.sum(np.square(theta_u), axis=-1)
    # theta < 0.1 rad, where the closed form would lose digits to 1 - x cot(x)
    small = theta2 < 1e-2
    half = 0.5 * np.sqrt(np.where(small, 1, theta2))
    series = 1 / 12 + theta2 / 720 + theta2**2 / 30240
    c = np.where(small, series, (1 - half * np.cos(half) / np.sin(half)) / (4 * half * half))
    S = skew(theta_u)
    return np.eye(3) + 0.5 * S + c[..., None, None] * (S @ S)


def translation_interaction(T: Array, pose: Literal["cdMc", "cMcd", "cMo"]) -> Array:
    """L (..., 3, 6) of the translation t [m] of a pose T (..., 4, 4).

    `cdMc`: T_goal_camera, t_dot = R v, [R, 0]. `cMcd`: T_camera_goal, and `cMo`: T_camera_target,
    t_dot = -v - w x t, [-I, [t]x].

    Reference: Chaumette & Hutchinson 2006, section on PBVS, doi:10.1109/MRA.2006.250573.
    """
    L = np.zeros((*T.shape[:-2], 3, 6))
    if pose == "cdMc":
        L[..., :3] = T[..., :3, :3]
    else:
        L[..., :3] = -np.eye(3)
        L[..., 3:] = skew(T[..., :3, 3])
    return L


def log_depth_interaction(xy: Array, depth: Array) -> Array:
    """L (..., N, 6) of the logarithm of each point's depth, xy (..., N, 2) and depth (..., N) [m].

    (log Z)_dot = -vz/Z - y wx + x wy.

    Reference: Malis, Chaumette & Boudet 1999, doi:10.1109/70.760345.
    """
    L = np.zeros((*depth.shape, 6))
    L[..., 2] = -1 / depth
    L[..., 3] = -xy[..., 1]
    L[..., 4] = xy[..., 0]
    return L
