"""Pose of markers in all directions around the camera, which no pinhole image holds: from rays alone."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from vstestbed.core.geometry import Array, exp, skew

ROUNDS = 20
"""Most Gauss-Newton steps; five suffice from the pose a frame ago."""
SETTLED = 1e-11
"""Converged when a step is smaller than this [m, rad]."""
AT_THE_LENS = 1e-9
"""Least distance of a marker from the camera [m]: a guess may put one at the camera's centre, where it has no direction."""
FITS = 0.05
"""A pose whose angular errors have a larger root mean square than this [rad] is no solution."""


def solve_pose_all_round(rays: Array, points: Array, previous: Array | None = None) -> Array | None:
    """Pose T_camera_target (4, 4) that minimises the angles between rays d and points p; None where none fits.

    Iterated from the previous pose; without one (N >= 4), from each of the 24 rotations R of a cube, with the translation that
    solves sum (I - d d^T) (R p + t) = 0.

    Args:
        rays: unit rays in the camera frame, shape (N, 3), N >= 3 with a previous pose, else N >= 4.
        points: the markers in the target frame, shape (N, 3) [m].
        previous: the pose a frame ago, shape (4, 4).

    Reference: minimising the object-space error over rotations, Lu, Hager & Mjolsness 2000, doi:10.1109/34.862199.
    """
    if previous is not None:
        T, error = _refined(rays, points, previous)
        if error < FITS:
            return T
    if len(rays) < 4:
        return None
    found = [_refined(rays, points, _placed(rays, points, R)) for R in _turns()]
    T, error = min(found, key=lambda f: f[1])
    return T if error < FITS else None


@cache
def _turns() -> list[Array]:
    """The 24 rotations of a cube."""
    axes = np.eye(3)
    turns = []
    for i in range(3):
        for j in range(3):
            for a in (1, -1) if i != j else ():
                turns += [np.stack([a * axes[i], b * axes[j], a * b * np.cross(axes[i], axes[j])], axis=1) for b in (1, -1)]
    return turns


def _placed(rays: Array, points: Array, R: Array) -> Array:
    """The pose (4, 4) of a given rotation whose translation fits the rays best."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    T = np.eye(4)
    T[:3, :3] = R
    turned = points @ R.T
    T[:3, 3] = np.linalg.lstsq(across.sum(axis=0), -(across @ turned[:, :, None])[..., 0].sum(axis=0), rcond=1e-9)[0]
    return T


def _refined(rays: Array, points: Array, T: Array) -> tuple[Array, float]:
    """The pose after Gauss-Newton on SE(3) from T, T <- exp(x) T, and the root mean square of its angles [rad]."""
    across = np.eye(3) - rays[:, :, None] * rays[:, None, :]
    error = math.inf
    for _ in range(ROUNDS):
        p = points @ T[:3, :3].T + T[:3, 3]
        reach = np.maximum(np.linalg.norm(p, axis=1), AT_THE_LENS)
        unit = p / reach[:, None]
        cosine = np.sum(unit * rays, axis=1)
        e = (across @ unit[:, :, None])[..., 0]
        error = math.sqrt(float(np.mean(np.arccos(np.clip(cosine, -1, 1)) ** 2)))
        dp = np.concatenate([np.broadcast_to(np.eye(3), (len(p), 3, 3)), -skew(p)], axis=2)
        dunit = (dp - unit[:, :, None] * (unit[:, None] @ dp)) / reach[:, None, None]
        # Least squares of minimum norm: directions that the markers leave open do not move.
        x = np.linalg.lstsq((across @ dunit).reshape(-1, 6), -e.ravel(), rcond=1e-9)[0]
        size = float(np.abs(x).max())
        T = exp(x / max(1.0, size)) @ T  # steps are limited to 1 m and 1 rad, beyond which the linearisation is void
        if size < SETTLED:
            break
    return T, error
