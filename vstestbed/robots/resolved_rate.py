"""Resolved-rate control of serial arms: joint speeds for a flange twist, damped near singularities."""

from __future__ import annotations

import functools

import numpy as np

from vstestbed.core.geometry import Array

THRESHOLD = 0.05
"""Smallest singular value that is left undamped, with lengths in the arm's own unit."""


def resolved_rate(J: Array, twist: Array, unit_m: float, threshold: float = THRESHOLD) -> Array:
    """Damped resolved-rate control: joint speeds for a flange twist.

    dq = Js^T (Js Js^T + lambda^2 I)^-1 ts,  where Js and ts have v divided by unit_m, and
    lambda^2 = (1 - (s_min / threshold)^2) threshold^2 where s_min < threshold, else 0.
    Exact away from singularities, continuous across the threshold, and |dq| <= |ts| / threshold everywhere
    (the largest damping equals the threshold, so the gain along the weakest direction is s_min / threshold^2).
    With fewer than six joints the twist is met in the least-squares sense, with more dq is the smallest.

    Args:
        J: Jacobian, shape (6, n), rows (v, w).
        twist: (vx, vy, vz, wx, wy, wz) of the flange in the Jacobian's frame, [m/s, rad/s].
        unit_m: length that makes metres and radians comparable [m].
        threshold: smallest singular value of Js that is left undamped.

    Returns:
        dq (n,) [rad/s, m/s]; `J @ dq` is the realised twist.

    Reference: Nakamura & Hanafusa 1986, doi:10.1115/1.3143764; this law of lambda from Maciejewski & Klein 1988,
    doi:10.1002/rob.4620050603, as written by Chiaverini, Siciliano & Egeland 1994, doi:10.1109/87.294335.
    """
    scale = unit_scale(unit_m)
    U, s, Vt = np.linalg.svd(J * scale[:, None], full_matrices=False)
    damping2 = _damping2(float(s[-1]), threshold)
    return Vt.T @ (s / (s**2 + damping2) * (U.T @ (twist * scale)))


def singularity_damping2(J: Array, unit_m: float, threshold: float = THRESHOLD) -> float:
    """The lambda^2 of `resolved_rate`: 0 away from singularities."""
    return _damping2(float(np.linalg.svd(J * unit_scale(unit_m)[:, None], compute_uv=False)[-1]), threshold)


def _damping2(least: float, threshold: float) -> float:
    return max(0.0, threshold**2 - least**2)


@functools.cache
def unit_scale(unit_m: float) -> Array:
    """Factors (6,) that give the linear part of a twist in lengths of unit_m."""
    return np.array([1 / unit_m] * 3 + [1.0] * 3)


def share(realised: Array, commanded: Array, unit_m: float) -> float:
    """Projection of a realised twist (6,) on the commanded one, as a share of it, 0 to 1, lengths in unit_m; 1 for a zero command."""
    scale = unit_scale(unit_m)
    a, b = realised * scale, commanded * scale
    size = float(b @ b)
    return min(1.0, max(0.0, float(a @ b) / size)) if size > 0 else 1.0
