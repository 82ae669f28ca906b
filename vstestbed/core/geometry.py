"""Frames, twists and adjoints.

Poses are 4x4 arrays `T_a_b` that map b-coordinates to a (inner names cancel:
`T_world_camera @ T_camera_target`). Spatialmath's SE3 is what scripts give and get
(`core.spatial`); it takes .8 s to import, so the loop goes without.
A twist is (vx, vy, vz, wx, wy, wz) of a frame, expressed in that frame unless the name says
otherwise.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from vstestbed.core.errors import ParameterError
from vstestbed.core.quantity import Angles, Position
from vstestbed.core.spatial import Array, as_se3, is_matrix, pose_matrix, tidy, tidy_position
from vstestbed.core.spec import spec

if TYPE_CHECKING:
    from spatialmath import SE3

__all__ = [
    "FLIP",
    "Array",
    "DepthImage",
    "Image",
    "Images",
    "Pose",
    "adjoint",
    "all_finite",
    "angles",
    "clip",
    "direction",
    "exp",
    "inverse",
    "joined",
    "lengths",
    "log",
    "pixel_grid",
    "pose_block",
    "pose_from",
    "quaternion_wxyz",
    "rigid_error",
    "rotation_angle",
    "rotation_from_quaternion",
    "rotation_from_rpy",
    "rpy_of",
    "skew",
    "transform",
    "turn_between",
    "unit_of",
    "unit_quaternion",
]


def rotation_from_rpy(rpy: Array) -> Array:
    """R = Rz(yaw) Ry(pitch) Rx(roll) (..., 3, 3) of angles (roll, pitch, yaw) (..., 3) [rad]: the
    convention of `Pose`.
    """
    (cr, cp, cy), (sr, sp, sy) = np.moveaxis(np.cos(rpy), -1, 0), np.moveaxis(np.sin(rpy), -1, 0)
    rows = [
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rpy_of(R: list[list[float]]) -> Angles:
    """Roll, pitch, yaw [deg] of a rotation matrix R = Rz(yaw) Ry(pitch) Rx(roll) of rows; roll is 0
    at a pitch of 90 degrees.
    """
    angles = _rpy_from_largest(R)
    # near a pitch of 90 degrees roll and yaw, each taken alone, are uncertain, and the two errors
    # must cancel
    if abs(R[2][0]) > 1 - 1e-4 and np.abs(rotation_from_rpy(np.radians(angles)) - R).max() > 1e-14:
        # each angle from what the ones before leave: R is met at every pitch, to rounding
        (xx, xy, xz), (yx, yy, yz), (zx, _, _) = R
        yaw = math.atan2(yx, xx)
        c = math.cos(yaw)
        s = math.sin(yaw)
        pitch = math.atan2(-zx, c * xx + s * yx)
        roll = math.atan2(s * xz - c * yz, c * yy - s * xy)
        return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)
    return angles


def _rpy_from_largest(R: list[list[float]]) -> Angles:
    """`rpy_of` by the formulas of the logs of earlier versions, whose bits they are."""
    (xx, xy, xz), (yx, _, _), (zx, zy, zz) = R
    if abs(abs(zx) - 1) < 20 * np.finfo(float).eps:
        yaw = -math.atan2(xy, xz) if zx < 0 else math.atan2(-xy, -xz)
        return 0.0, -math.asin(min(max(zx, -1.0), 1.0)) * (180 / math.pi), yaw * (180 / math.pi)
    roll = math.atan2(zy, zz)
    yaw = math.atan2(yx, xx)
    # the largest of the four that are the pitch's cosine times a sine or cosine of another angle
    largest, of_angle = max(
        ((xx, math.cos(yaw)), (yx, math.sin(yaw)), (zy, math.sin(roll)), (zz, math.cos(roll))),
        key=lambda p: abs(p[0]),
    )
    rad = roll, -math.atan(zx * of_angle / largest), yaw
    return tuple(a * (180 / math.pi) for a in rad)  # pyright: ignore[reportReturnType] - three, as `rad` has


Image = NDArray[np.uint8]  # a picture (H, W, 3), RGB
DepthImage = NDArray[np.float32]  # depths (H, W) [m] along the axis
Images = tuple[Image | None, ...]
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""From OpenGL's camera axes (z backward, y up) to those of computer vision (z forward, y down), and
back: its own inverse.
"""


@spec
class Pose:
    """A pose in YAML, a translation and a rotation R = Rz(yaw) Ry(pitch) Rx(roll).

    In Python every field of this class also takes spatialmath's SE3 or a matrix (4, 4), whose
    rotation the angles have to 1e-14.

    Args:
        xyz: translation (x, y, z) [m].
        rpy_deg: roll, pitch and yaw [deg].
    """

    xyz: Position = (0.0, 0.0, 0.0)
    rpy_deg: Angles = (0.0, 0.0, 0.0)

    @model_validator(mode="before")
    @classmethod
    def _from_matrix(cls, given: Any) -> Any:
        return pose_block(given) if is_matrix(given) else given

    @cached_property
    def T(self) -> Array:
        """The homogeneous matrix, shape (4, 4), read-only."""
        T = np.eye(4)
        for axis, angle in ((2, self.rpy_deg[2]), (1, self.rpy_deg[1]), (0, self.rpy_deg[0])):
            turn = np.eye(3)
            c = math.cos(math.radians(angle))
            s = math.sin(math.radians(angle))
            i, j = (axis + 1) % 3, (axis + 2) % 3
            turn[i, i], turn[j, j], turn[i, j], turn[j, i] = c, c, -s, s
            # not `rotation_from_rpy`, whose last bits are others: a log is made again byte for byte
            T[:3, :3] = T[:3, :3] @ turn
        T[:3, 3] = self.xyz
        T.setflags(write=False)  # kept: who writes to it would move the pose for good
        return T

    def SE3(self) -> SE3:
        """The same pose as a spatialmath object, for scripts that compute starts and goals."""
        return as_se3(self.T[None])

    @classmethod
    def of(cls, T: Array | SE3) -> Pose:
        """The pose with a homogeneous matrix (4, 4), or of a spatialmath object (`pose_matrix`); at
        a pitch of 90 degrees roll is 0.
        """
        matrix = pose_matrix(T, "T")
        return cls(xyz=tuple(matrix[:3, 3].tolist()), rpy_deg=rpy_of(matrix[:3, :3].tolist()))


def pose_block(value: Any) -> dict[str, Any]:
    """The fields of the Pose of an SE3 or a matrix (4, 4), without the last digits of rounding
    (`pose_matrix`).
    """
    T = pose_matrix(value)
    return {
        "xyz": tidy_position(T),
        "rpy_deg": [tidy(angle, 12) for angle in rpy_of(T[:3, :3].tolist())],
    }


# numbers up to which a sum in Python takes less time than the call of numpy's: 0.5 us in place of
# 1.3 for eight
FEW = 32


def all_finite(a: Array) -> bool:
    """Whether all numbers are finite, by their sum, which must not overflow: the usual test takes
    more time in a frame.
    """
    return math.isfinite(sum(a.ravel().tolist()) if a.size <= FEW else np.add.reduce(a, axis=None))


def joined(*parts: Any) -> Array:
    """Numbers, or arrays (...), side by side (..., n): as `np.stack(parts, axis=-1)`, in a third of
    the time for a few numbers.
    """
    out = np.empty((*np.shape(parts[0]), len(parts)))
    for i, part in enumerate(parts):
        out[..., i] = part
    return out


def lengths(p: Array) -> Array:
    """Lengths (..., 1) of vectors p (..., n): as `np.linalg.norm`, whose checks take twice as long
    as the rest for a few vectors.
    """
    return np.sqrt(np.add.reduce(p * p, axis=-1, keepdims=True))


ORDINARY_M = 1 / 32, 32.0  # lengths that are computed with in metres [m]


def unit_of(length: float) -> float:
    """The unit [m] in which something of a length [m] is computed, so that no tolerance and no rank
    depends on its scale.

    The metre for what is of the size of a hand or a room, else a power of two, which costs no
    digit.
    """
    if not length or ORDINARY_M[0] <= length <= ORDINARY_M[1]:
        return 1.0
    return math.ldexp(1.0, math.frexp(length)[1] - 1)


def clip(x: float, lowest: float, highest: float) -> float:
    """A number within its bounds; NaN becomes the highest. A third of the time of
    `max(lowest, min(highest, x))`.
    """
    if lowest <= x <= highest:
        return x
    return lowest if x < lowest else highest


def skew(w: Array) -> Array:
    """Cross-product matrix S of w (..., 3), shape (..., 3, 3): S p = w x p."""
    w = np.asarray(w, dtype=float)
    S = np.zeros((*w.shape[:-1], 3, 3))
    S[..., 2, 1] = w[..., 0]
    S[..., 0, 2] = w[..., 1]
    S[..., 1, 0] = w[..., 2]
    return S - np.swapaxes(S, -1, -2)


def inverse(T: Array) -> Array:
    """Inverse of a rigid transform, shape (..., 4, 4)."""
    if T.ndim == 2:  # one, for the time loop: as in `exp`
        (xx, xy, xz, x), (yx, yy, yz, y), (zx, zy, zz, z), _ = T.tolist()
        first = (xx, yx, zx, -(xx * x + yx * y + zx * z))
        second = (xy, yy, zy, -(xy * x + yy * y + zy * z))
        third = (xz, yz, zz, -(xz * x + yz * y + zz * z))
        return np.array([first, second, third, (0.0, 0.0, 0.0, 1.0)])
    # of a rigid transform: cheaper and more exact than a matrix inverse
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    out = np.zeros_like(T)
    out[..., :3, :3] = R_t
    out[..., :3, 3] = -(R_t @ T[..., :3, 3:])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def homogeneous(points: Array) -> Array:
    """Points (..., d) with a 1 after the coordinates of each, (..., d + 1)."""
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


def transform(T: Array, p: Array) -> Array:
    """Map points p (..., N, 3) by T (..., 4, 4)."""
    return p @ T[..., :3, :3].mT + T[..., None, :3, 3]


def exp(xi: Array) -> Array:
    """SE(3) exponential of a twist times a duration, xi (..., 6) to (..., 4, 4).

    With theta = |w|:  R = I + a S + b S^2,  t = (I + b S + c S^2) v,
    a = sin(theta)/theta, b = (1 - cos(theta))/theta^2, c = (1 - a)/theta^2 (series below 1e-4 rad).
    Reference: Lynch & Park 2017, Modern Robotics, eqs 3.51 and 3.88.
    """
    xi = np.asarray(xi, dtype=float)
    if xi.ndim == 1:  # one, for the time loop: numpy's overhead would be ten times the arithmetic
        twist = xi.tolist()
        x, y, z = twist[3:]
        theta2 = x * x + y * y + z * z
        theta = math.sqrt(theta2)
        if theta < 1e-4:
            a, b, c = 1 - theta2 / 6, 0.5 - theta2 / 24, 1 / 6 - theta2 / 120
        else:
            a = math.sin(theta) / theta
            b = 2 * math.sin(theta / 2) ** 2 / theta2
            c = (theta - math.sin(theta)) / (theta2 * theta)
        return np.array([*_exp_entries(twist, (a, b, c)), (0.0, 0.0, 0.0, 1.0)])
    twist = np.moveaxis(xi, -1, 0)
    x, y, z = twist[3:]
    theta2 = x * x + y * y + z * z
    theta = np.sqrt(theta2)
    # there the series are exact to rounding, and 1 - cos would lose all its digits
    small = theta < 1e-4
    safe = np.where(small, 1.0, theta)
    sine = np.sin(safe)
    a = np.where(small, 1 - theta2 / 6, sine / safe)
    b = np.where(small, 0.5 - theta2 / 24, 2 * np.square(np.sin(safe / 2) / safe))
    c = np.where(small, 1 / 6 - theta2 / 120, (safe - sine) / safe**3)
    out = np.zeros((*xi.shape[:-1], 4, 4))
    for row, values in enumerate(_exp_entries(twist, (a, b, c))):
        for column, value in enumerate(values):
            out[..., row, column] = value
    out[..., 3, 3] = 1.0
    return out


def _exp_entries(twist: Any, factors: tuple[Any, Any, Any]) -> tuple[tuple[Any, ...], ...]:
    """The first three rows of `exp`, from numbers or from arrays, by its factors a, b and c; S^2 v
    = w (w.v) - theta^2 v, S v = w x v.
    """
    vx, vy, vz, x, y, z = twist
    a, b, c = factors
    bx, by, bz = b * x, b * y, b * z
    xx, yy, zz, xy, xz, yz = bx * x, by * y, bz * z, bx * y, bx * z, by * z
    ax, ay, az = a * x, a * y, a * z
    one, along = 1 - c * (x * x + y * y + z * z), c * (x * vx + y * vy + z * vz)
    return (
        (1 - yy - zz, xy - az, xz + ay, one * vx + by * vz - bz * vy + along * x),
        (xy + az, 1 - xx - zz, yz - ax, one * vy + bz * vx - bx * vz + along * y),
        (xz - ay, yz + ax, 1 - xx - yy, one * vz + bx * vy - by * vx + along * z),
    )


def log(T: Array) -> Array:
    """The twist (6,) with exp(twist) = T (4, 4) and a rotation of at most pi.

    w = theta u, v = (I - S/2 + (1 - theta/2 cot(theta/2)) / theta^2 S^2) t with S = [w]x.
    Reference: Lynch & Park 2017, Modern Robotics, eq. 3.92.
    """
    q = quaternion_wxyz(T[:3, :3])
    t = T[:3, 3]
    sine = float(np.linalg.norm(q[1:]))
    # theta/2, exact near 0 and near pi, where an arc cosine loses half of the digits
    half = math.atan2(sine, float(q[0]))
    small = half < 1e-4
    w = q[1:] * (2.0 if small else 2 * half / sine)
    share = 1 / 12 if small else (1 - half / math.tan(half)) / (4 * half * half)
    S = skew(w)
    return np.concatenate([t - S @ t / 2 + share * (S @ (S @ t)), w])


def adjoint(T_a_b: Array) -> Array:
    """Twist transform [[R, [t]x R], [0, R]] between two frames on one body, twist_a = A twist_b.
    Reference: Corke 2017, Robotics, Vision & Control, eq. 3.16 (order (v, w)).
    """
    R = T_a_b[..., :3, :3]
    out = np.zeros((*T_a_b.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = skew(T_a_b[..., :3, 3]) @ R
    return out


def angles(p: Array) -> Array:
    """Directions p (..., 3), of any length, as colatitude and longitude (theta, phi) (..., 2)
    [rad].

    theta = atan2(hypot(X, Y), Z) in [0, pi], phi = atan2(Y, X): exact also near the axis; on it
    phi = 0. NaN for p = 0.
    """
    x, y, z = p[..., 0], p[..., 1], p[..., 2]
    across = np.hypot(x, y)
    theta = np.where((across > 0) | (z != 0), np.arctan2(across, z), np.nan)
    return joined(theta, np.where(across > 0, np.arctan2(y, x), 0.0 * theta))


def direction(theta_phi: Array) -> Array:
    """Unit vectors (..., 3) of angles (theta, phi) (..., 2) [rad]: the inverse of `angles`."""
    theta = theta_phi[..., 0]
    phi = theta_phi[..., 1]
    across = np.sin(theta)
    return joined(across * np.cos(phi), across * np.sin(phi), np.cos(theta))


def rotation_angle(R: Array) -> Array:
    """Angle of a rotation (..., 3, 3) in [0, pi] rad; exact near 0 and near pi (half-angle arc
    tangent).
    """
    sine = np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]],
        axis=-1,
    )
    return np.arctan2(np.linalg.norm(sine, axis=-1), np.trace(R, axis1=-2, axis2=-1) - 1)


def quaternion_wxyz(R: Array) -> Array:
    """Unit quaternions (w, x, y, z) (..., 4), w >= 0, of rotation matrices (..., 3, 3). The column
    of 4 q q^T with the largest diagonal element, normalised, which never divides by a small number.
    Reference: Shepperd 1978, doi:10.2514/3.55767b.
    """
    if R.ndim == 2:  # one, for the time loop, as in `exp`
        columns = _quaternion_columns(*R.tolist())
        largest = max(range(4), key=lambda i: columns[i][i])
        w, x, y, z = columns[largest]
        size = math.sqrt(w * w + x * x + y * y + z * z)
        if w < 0:
            size = -size
        return np.array([w / size, x / size, y / size, z / size])
    columns = _quaternion_columns(*(np.moveaxis(row, -1, 0) for row in np.moveaxis(R, -2, 0)))
    four = np.stack([np.stack(column, axis=-1) for column in columns], axis=-1)  # 4 q q^T
    largest = np.diagonal(four, axis1=-2, axis2=-1).argmax(axis=-1)
    q = np.take_along_axis(four, largest[..., None, None], axis=-1)[..., 0]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    # q and -q are the same rotation; with w >= 0 the angle is at most pi.
    return np.where(q[..., :1] < 0, -q, q)


def _quaternion_columns(x: Any, y: Any, z: Any) -> tuple[tuple[Any, Any, Any, Any], ...]:
    """The columns of 4 q q^T by the rows of R, of numbers or of arrays."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = x, y, z
    return (
        (1 + xx + yy + zz, zy - yz, xz - zx, yx - xy),
        (zy - yz, 1 + xx - yy - zz, yx + xy, xz + zx),
        (xz - zx, yx + xy, 1 - xx + yy - zz, zy + yz),
        (yx - xy, xz + zx, zy + yz, 1 - xx - yy + zz),
    )


def rotation_from_quaternion(q_wxyz: Array) -> Array:
    """Rotation matrix (..., 3, 3) of a unit quaternion (..., 4) in the order (w, x, y, z)."""
    q = np.asarray(q_wxyz, dtype=float)
    w = q[..., 0, None, None]
    u = q[..., 1:]
    S = skew(u)
    return np.eye(3) + 2 * w * S + 2 * S @ S


def pose_from(position: Array, q_wxyz: Array) -> Array:
    """Homogeneous matrix (4, 4) from a position (3,) and a quaternion (w, x, y, z)."""
    T = np.eye(4)
    T[:3, :3] = rotation_from_quaternion(q_wxyz)
    T[:3, 3] = position
    return T


QUATERNION_NORM = 1e-3  # what three digits of each of the four numbers leave


def unit_quaternion(q: Array, field: str) -> Array:
    """A quaternion (4,) that a file gives, made exactly of norm 1. field: for messages.
    Raises ParameterError: it is zero or, by more than QUATERNION_NORM, of another norm.
    """
    norm = math.hypot(*q)
    if not abs(norm - 1) <= QUATERNION_NORM:  # not ">": NaN
        words = f"has the norm {norm:.4g}" if norm else "is zero, which is no rotation"
        raise ParameterError(field, f"is a quaternion that {words}; its norm must be 1", q.tolist())
    return q / norm


def rigid_error(T_a: Array, T_b: Array) -> tuple[float, float]:
    """Distance [m] of the origins and angle [rad] between two poses (4, 4)."""
    d = T_a[:3, 3] - T_b[:3, 3]
    return math.sqrt(float(d @ d)), turn_between(T_a, T_b)


def turn_between(T_a: Array, T_b: Array) -> float:
    """Angle [rad] of the rotation between two poses (4, 4)."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (T_a[:3, :3].T @ T_b[:3, :3]).tolist()
    return math.atan2(math.hypot(zy - yz, xz - zx, yx - xy), xx + yy + zz - 1)


def pixel_grid(width: int, height: int) -> Array:
    """The pixels (u, v) of a picture, shape (H, W, 2)."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(float)
