"""Lines in the image as lines on the floor, for a camera with a known mount on a vehicle."""

from __future__ import annotations

import numpy as np

from vstestbed.core.geometry import Array


def floor_plane(T_base_camera: Array) -> Array:
    """The floor as the plane A X + B Y + C Z + D = 0 in the camera frame, for a mount (4, 4) above it, shape (4,)."""
    # The third row of T_base_camera gives the height Z_base of a point (X, Y, Z, 1), which is 0 on the floor.
    return T_base_camera[2].copy()


def floor_point(xy: Array, T_base_camera: Array) -> Array:
    """Intersections (..., 2) of rays with normalised coordinates xy (..., 2) with the floor, in the base frame [m].

    NaN for rays that do not descend to it. The camera's mount is T_base_camera (4, 4).
    """
    xy = np.asarray(xy, dtype=float)
    d = np.concatenate([xy, np.ones_like(xy[..., :1])], axis=-1) @ T_base_camera[:3, :3].T
    t = T_base_camera[:3, 3]
    reach = t[2] / np.where(d[..., 2] < 0, -d[..., 2], np.nan)
    return t[:2] + reach[..., None] * d[..., :2]


def line_on_floor(rho: Array, theta: Array, T_base_camera: Array, ahead: Array | float) -> tuple[Array, Array]:
    """A line of the image projected on the floor, s = (y, phi), and ds/d(rho, theta).

    The line x cos theta + y sin theta - rho = 0 and the camera's centre t span a plane with the normal
    N = R (cos theta, sin theta, -rho) in the base frame, which meets the floor in N_x X + N_y Y = N . t:

        y   = (N . t - N_x X) / N_y          lateral position (left positive) at X = `ahead`
        phi = atan(-N_x / N_y)               direction, in (-pi/2, pi/2)
        dy   = -dN . ((X, y, 0) - t) / N_y,  dphi = (N_x dN_y - N_y dN_x) / (N_x^2 + N_y^2)

    Args:
        rho, theta: the line, shape (...) [1, rad].
        T_base_camera: the camera's mount (4, 4).
        ahead: X, shape (...) [m].

    Returns:
        (y, phi), shape (..., 2) [m, rad], and their derivatives J (..., 2, 2). The interaction matrix of (y, phi) is J L, with L
        (..., 2, 6) that of (rho, theta).
    """
    rho, theta, ahead = np.broadcast_arrays(rho, theta, ahead)
    R, t = T_base_camera[:3, :3], T_base_camera[:3, 3]
    cos, sin, none = np.cos(theta), np.sin(theta), np.zeros_like(theta)
    N = np.stack([cos, sin, -rho], axis=-1) @ R.T  # not normalised: y, phi and their derivatives are ratios of its components
    dN = np.stack([np.stack([none, none, none - 1], axis=-1), np.stack([-sin, cos, none], axis=-1)], axis=-2) @ R.T
    y = (N @ t - N[..., 0] * ahead) / N[..., 1]
    phi = np.arctan(-N[..., 0] / N[..., 1])
    lever = np.stack([ahead, y, none], axis=-1) - t
    dy = -np.einsum("...ij,...j->...i", dN, lever) / N[..., 1:2]
    dphi = (N[..., :1] * dN[..., 1] - N[..., 1:2] * dN[..., 0]) / (N[..., :1] ** 2 + N[..., 1:2] ** 2)
    return np.stack([y, phi], axis=-1), np.stack([dy, dphi], axis=-2)
