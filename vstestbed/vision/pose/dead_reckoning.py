"""Planar pose of a ground vehicle: odometry, corrected by a compass and by landmarks (complementary filter)."""

from __future__ import annotations

import numpy as np

from vstestbed.core.geometry import Array, inverse
from vstestbed.core.planar import place_of, pose_on_ground, wrapped

COMPASS_S = 0.5
"""Time constant with which the heading by odometry follows the compass [s]."""
LANDMARKS_S = 0.25
"""Time constant with which the position by odometry follows the landmarks [s]."""


def corrections(dt: float) -> Array:
    """Gains (2,) of one filter step, 1 - exp(-dt / tau), for the compass and for the landmarks."""
    return -np.expm1([-dt / tau for tau in (COMPASS_S, LANDMARKS_S)])


def fused_place(
    predicted: Array | None, T_map_camera: Array | None, T_base_camera: Array, compass: float | None, gains: Array
) -> Array | None:
    """Planar pose (x, y, heading) of a vehicle; None where it has never been known.

    heading <- heading + k_c wrap(compass - heading),   (x, y) <- (x, y) + k_l ((x, y) by landmarks - (x, y))

    The landmarks give the position of the lens whatever the heading is; that of the base follows from it by the mount's lever
    arm at the filtered heading. Noise is averaged by the filter; biases of compass and landmarks remain.

    Args:
        predicted: by odometry from the last frame, shape (3,) [m, rad]; None where it was not known then.
        T_map_camera: camera pose by the landmarks, shape (4, 4); None where they are not seen.
        T_base_camera: the mount, shape (4, 4).
        compass: measured heading [rad]; None without a compass.
        gains: k_c and k_l of this frame, shape (2,).
    """
    known = predicted if T_map_camera is None else place_of(T_map_camera @ inverse(T_base_camera))
    if known is None:
        return None
    heading = float(known[2])
    if compass is not None:
        heading = compass if predicted is None else float(predicted[2] + gains[0] * wrapped(compass - predicted[2]))
    if T_map_camera is None:
        return np.array([known[0], known[1], heading])
    lever = pose_on_ground(np.array([0.0, 0.0, heading])) @ T_base_camera[:, 3]
    xy = T_map_camera[:2, 3] - lever[:2]
    if predicted is not None:
        xy = predicted[:2] + gains[1] * (xy - predicted[:2])
    return np.array([xy[0], xy[1], heading])
