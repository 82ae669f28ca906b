"""Puma 560: kinematics in standard Denavit-Hartenberg frames, and resolved-rate control.

A_i = Rz(q_i) Tz(d_i) Tx(a_i) Rx(alpha_i),  T_base_flange = A_1 ... A_6.

The flange is frame 6, which the table leaves at the wrist's centre (d_6 = 0). The base frame stands on the floor.
Dynamics, gears and friction are in `models/puma560.xml`; a test holds the two files together.
"""

from __future__ import annotations

import numpy as np

from vstestbed.geometry import Array

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
"""Reference: Corke & Armstrong-Helouvry 1994, doi:10.1109/ROBOT.1994.351360, Table 1; d_1 is the shoulder's height
above the floor, 26.45 inch, as in Corke's Robotics Toolbox."""

JOINT_LIMITS = np.radians([[-160, 160], [-45, 225], [-225, 45], [-110, 170], [-100, 100], [-266, 266]])
"""[rad], (6, 2). Source: Corke's Robotics Toolbox, model puma560 (after Fu, Gonzalez & Lee 1987)."""

SPEED_LIMITS = np.array([1.92, 1.51, 2.40, 5.34, 5.09, 5.74])
"""[rad/s]. Source: Corke 1996, Visual Control of Robots, Table 2.21: where the amplifiers' voltage saturates."""

REACH_UNIT = 0.4318
"""[m]. A metre and a radian cannot be compared; singular values here are of v / REACH_UNIT (the upper arm's length) and w."""

_SIN_ALPHA, _COS_ALPHA = np.round(np.sin(DH[:, 2])), np.round(np.cos(DH[:, 2]))
"""Exact: every alpha is a multiple of a quarter turn."""


def kinematics(q: Array) -> tuple[Array, Array]:
    """Pose and geometric Jacobian of the flange together.

    With z_i and o_i the axis and origin of the frame before joint i, and o the flange's origin:
    v = sum z_i x (o - o_i) dq_i,  w = sum z_i dq_i, both turned into the flange's axes.

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
    J = np.empty((6, 6))
    J[0] = axes[1] * arms[2] - axes[2] * arms[1]
    J[1] = axes[2] * arms[0] - axes[0] * arms[2]
    J[2] = axes[0] * arms[1] - axes[1] * arms[0]
    J[3:] = axes
    return T, J


def _frames(q: Array) -> Array:
    """T_base_i of the frames 0 to 6, shape (7, 4, 4)."""
    c, s = np.cos(q), np.sin(q)
    A = np.zeros((6, 4, 4))
    A[:, 0, 0], A[:, 0, 1], A[:, 0, 2], A[:, 0, 3] = c, -s * _COS_ALPHA, s * _SIN_ALPHA, DH[:, 1] * c
    A[:, 1, 0], A[:, 1, 1], A[:, 1, 2], A[:, 1, 3] = s, c * _COS_ALPHA, -c * _SIN_ALPHA, DH[:, 1] * s
    A[:, 2, 1], A[:, 2, 2], A[:, 2, 3], A[:, 3, 3] = _SIN_ALPHA, _COS_ALPHA, DH[:, 0], 1.0
    frames = np.empty((7, 4, 4))
    frames[0] = np.eye(4)
    for i in range(6):
        np.dot(frames[i], A[i], out=frames[i + 1])
    return frames


def forward(q: Array) -> Array:
    """T_base_flange (4, 4) at the joint angles q (6,) [rad]."""
    return _frames(q)[6]


def jacobian(q: Array) -> Array:
    """Geometric Jacobian (6, 6) of the flange in the flange's frame, rows (v, w), at the joint angles q (6,) [rad]."""
    return kinematics(q)[1]


def resolved_rate(
    J: Array, twist: Array, speed_limits: Array = SPEED_LIMITS, threshold: float = 0.1, damping_max: float = 0.1
) -> Array:
    """Joint speeds that make a flange twist, damped near singularities and scaled as a whole into the speed limits.

    dq = Js^T (Js Js^T + lambda^2 I)^-1 ts,  where Js and ts have v divided by REACH_UNIT and
    lambda^2 = (1 - (s_min / threshold)^2) damping_max^2 for s_min < threshold, else 0:
    exact away from singularities, continuous across the threshold, |dq| bounded by
    |ts| / (2 damping_max) in the singular direction at the singularity itself.

    Args:
        J: Jacobian, shape (6, 6), rows (v, w).
        twist: (vx, vy, vz, wx, wy, wz) of the flange in the Jacobian's frame, [m/s, rad/s].
        speed_limits: largest size of each joint speed, shape (6,), [rad/s].
        threshold: smallest singular value of Js that is left undamped.
        damping_max: lambda at a singularity.

    Returns:
        dq (6,) [rad/s]; `J @ dq` is the twist that is really made.

    Reference: Nakamura & Hanafusa 1986, doi:10.1115/1.3143764; the law of lambda is that of
    Maciejewski & Klein 1988, doi:10.1002/rob.4620050603, as given by Chiaverini et al. 1994, doi:10.1109/87.294335.
    """
    scale = np.array([1 / REACH_UNIT] * 3 + [1.0] * 3)
    U, s, Vt = np.linalg.svd(J * scale[:, None])
    damping2 = max(0.0, 1 - (s[-1] / threshold) ** 2) * damping_max**2
    weight = s / (s**2 + damping2) if damping2 else 1 / s
    dq = Vt.T @ (weight * (U.T @ (twist * scale)))
    return dq / max(1.0, float(np.max(np.abs(dq) / speed_limits)))
