"""Roll, pitch and yaw of a rotation matrix, R = Rz(yaw) Ry(pitch) Rx(roll), and back: the convention of `Pose`."""

from __future__ import annotations

import math

import numpy as np

from vstestbed.core.quantity import Angles
from vstestbed.core.spatial import Array


def rotation_from_rpy(rpy: Array) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll) (..., 3, 3) of angles (roll, pitch, yaw) (..., 3) [rad]: the convention of `Pose`."""
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(rpy), -1, 0), np.moveaxis(np.sin(rpy), -1, 0)
    rows = [
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rpy_of(R: list[list[float]]) -> Angles:
    """Roll, pitch, yaw [deg] of a rotation matrix R = Rz(yaw) Ry(pitch) Rx(roll) of rows; roll is 0 at a pitch of 90 degrees."""
    angles = _rpy_from_largest(R)
    # near a pitch of 90 degrees roll and yaw, each taken alone, are uncertain, and the two errors must cancel
    if abs(R[2][0]) > 1 - 1e-4 and np.abs(rotation_from_rpy(np.radians(angles)) - R).max() > 1e-14:
        return _rpy_in_turn(R)
    return angles


def _rpy_in_turn(R: list[list[float]]) -> Angles:
    """`rpy_of` with each angle taken from what the ones before leave: R is met at every pitch, to rounding."""
    (xx, xy, xz), (yx, yy, yz), (zx, _, _) = R
    yaw = math.atan2(yx, xx)
    c, s = math.cos(yaw), math.sin(yaw)
    pitch, roll = math.atan2(-zx, c * xx + s * yx), math.atan2(s * xz - c * yz, c * yy - s * xy)
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


def _rpy_from_largest(R: list[list[float]]) -> Angles:
    """`rpy_of` by the formulas of the logs of earlier versions, whose bits they are."""
    (xx, xy, xz), (yx, _, _), (zx, zy, zz) = R
    if abs(abs(zx) - 1) < 20 * np.finfo(float).eps:
        yaw = -math.atan2(xy, xz) if zx < 0 else math.atan2(-xy, -xz)
        return 0.0, -math.asin(min(max(zx, -1.0), 1.0)) * (180 / math.pi), yaw * (180 / math.pi)
    roll, yaw = math.atan2(zy, zz), math.atan2(yx, xx)
    # the largest of the four that are the pitch's cosine times a sine or cosine of another angle
    largest, of_angle = max(((xx, math.cos(yaw)), (yx, math.sin(yaw)), (zy, math.sin(roll)), (zz, math.cos(roll))), key=lambda p: abs(p[0]))
    rad = roll, -math.atan(zx * of_angle / largest), yaw
    return tuple(a * (180 / math.pi) for a in rad)  # pyright: ignore[reportReturnType] - three, as `rad` has
