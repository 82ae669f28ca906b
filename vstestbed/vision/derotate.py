"""Derotation: image features of a tilted craft rotated into its level frame, by the roll and pitch
of its IMU.

A multirotor tilts to accelerate; its camera then sees the world rotate, which a law of (vx, vy, vz,
wz) takes for an error and answers with more acceleration. So goals, poses and interaction matrices
are in the level frame, which shares the craft's position and heading, and rays are rotated into it.
With phi = R_camera_base (roll, pitch, 0):

  exact        ray_level = R_level_camera ray,
               R_level_camera = R_camera_base Ry(pitch) Rx(roll) R_base_camera.
  first_order  s_level = s - L_w phi, L_w the rotational columns of the interaction matrix at the
               measured s: those of the angles (theta, phi) on the sphere, or of (x, y) for a
               pinhole. Good for small tilts away from the axis.
  as_printed   the same with the matrix as printed (Corke 2017, section 16.4.3): its two rows are
               swapped, and that of phi lacks 1/sin theta. For comparison only.

References: Hamel & Mahony 2002, doi:10.1109/TRA.2002.999647 (visual servoing of an underactuated
craft, on the sphere); Lee, Ryan & Kim 2012, doi:10.1109/ICRA.2012.6225103 (virtual image plane);
Corke 2017, doi:10.1007/978-3-319-54413-7.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from vstestbed.camera import Camera, Perspective
from vstestbed.core.geometry import Array
from vstestbed.features import Point, Spherical

Derotation = Literal["none", "exact", "first_order", "as_printed"]
_ANGLES = Spherical()
_PLANE = Point()


def level_from_tilt(tilt: Array, R_base_camera: Array) -> Array:
    """R_level_camera (3, 3): rotation from the camera's frame to that of the level craft's camera,
    for (roll, pitch) (2,) [rad].
    """
    cr, cp = np.cos(tilt).tolist()
    sr, sp = np.sin(tilt).tolist()
    R_level_base = np.array([[cp, sp * sr, sp * cr], [0.0, cr, -sr], [-sp, cp * sr, cp * cr]])
    return R_base_camera.T @ R_level_base @ R_base_camera


def level_twist(twist: Array, tilt: Array, R_base_camera: Array) -> Array:
    """Twist (6,) of the level camera in its own frame, from the camera's (6,): same velocity,
    rotation by the heading's rate alone.

    The heading's rate is w_z + w_x tan(pitch), with w the craft's angular velocity in level axes;
    tilt: roll and pitch (2,) [rad].
    """
    R = level_from_tilt(tilt, R_base_camera)
    wx, _, wz = (R_base_camera @ R @ twist[3:]).tolist()
    # cos is limited: at a pitch of 90 degrees the heading has no rate.
    heading = wz + wx * math.sin(tilt[1]) / max(math.cos(tilt[1]), 0.1)
    return np.concatenate([R @ twist[:3], heading * R_base_camera[2]])


# estimated correction of the IMU's roll and pitch (2,) [rad], and the number of pictures that it is
# from
Trim = tuple[Array, int]
NO_TRIM: Trim = np.zeros(2), 0


def trimmed(
    trim: Trim,
    tilt: Array,
    T_camera_target: Array,
    T_goal_target: Array,
    R_base_camera: Array,
    gain: float,
) -> Trim:
    """The trim after one more picture: it removes the steady tilt error of a biased accelerometer
    and averages image noise.

    The goal view is that of a level craft, so it gives the direction of gravity in the target's
    frame, R_goal_target^T R_camera_base (0, 0, -1), and the measured pose takes it to the camera's
    frame.

    trim <- trim + k (tilt by the pose - tilt - trim).

    Args:
        tilt: roll and pitch by the IMU, shape (2,) [rad]. R_base_camera: the mount's rotation (3,
            3).
        gain: k of later pictures; the first ones are averaged.
    """
    down = R_base_camera.T @ np.array([0.0, 0.0, -1.0])
    up = -R_base_camera @ T_camera_target[:3, :3] @ T_goal_target[:3, :3].T @ down
    seen = np.array([math.atan2(up[1], up[2]), -math.asin(max(-1.0, min(1.0, float(up[0]))))])
    # 1/n is the running mean of the first n pictures, until the constant gain is larger.
    angles, count = trim
    return angles + max(gain, 1 / (count + 1)) * (seen - tilt - angles), count + 1


def level_rays(ray: Array, tilt: Array, camera: Camera, how: Derotation) -> Array:
    """Unit rays (N, 3) in the level camera's frame from those in the camera's, for roll and pitch
    (2,) [rad]; NaN stays NaN.
    """
    R = camera.mount.T[:3, :3]
    if how == "none":
        return ray
    if how == "exact":
        return ray @ level_from_tilt(tilt, R).T
    turn = R.T @ np.array([tilt[0], tilt[1], 0.0])
    out = np.full_like(ray, np.nan)
    seen = np.isfinite(ray[:, 0])
    if not seen.any():
        return out
    rays = ray[seen]
    one = np.ones(np.count_nonzero(seen))
    if how == "first_order" and isinstance(camera, Perspective):
        xy = rays[:, :2] / rays[:, 2:]
        xy = xy - _PLANE.interaction(xy, one).reshape(-1, 2, 6)[..., 3:] @ turn
        level = np.column_stack([xy, one])
        out[seen] = level / np.linalg.norm(level, axis=1, keepdims=True)
        return out
    s = _ANGLES.measure(rays).reshape(-1, 2)
    L = _ANGLES.interaction(rays, one).reshape(-1, 2, 6)[..., 3:]
    if how == "as_printed":  # wrong, see the module's docstring
        theta, phi = s.T
        turn = turn[:2]
        rows = [
            [np.cos(phi) * np.cos(theta), np.sin(phi) * np.cos(theta)],
            [np.sin(phi), -np.cos(phi)],
        ]
        L = np.ascontiguousarray(np.moveaxis(np.array(rows), -1, 0))
    theta, phi = (s - L @ turn).T
    out[seen] = np.column_stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]
    )
    return out
