"""The two poses of a planar target: infinitesimal plane-based pose estimation (IPPE), which has no degenerate frontal view."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.vision.pose.homography import homography

ROUNDING = 1e-12
"""Elements and singular values below this share of the largest are rounding."""


class _Plane(NamedTuple):
    """Coplanar points as the plane has them: coordinates (N, 2) about their middle [m], and R_target_plane (3, 3)."""

    flat: Array
    R: Array


def planar_poses(xy: Array, points: Array) -> list[Array]:
    """Both poses T_camera_target (4, 4) of N >= 4 coplanar points, by closed form; none where the points determine no homography.

    H ~ [J | v] maps the plane to the image near the points' middle: v is the image of the middle, J (2, 2) the derivative there. With
    R_v the shortest rotation from the optical axis to v's ray, and B = [1 | -v] R_v its derivative in the image (first two columns),

    B^-1 J = s1 u1 v1^T + s2 u2 v2^T   (singular values),   1/s1 = depth along the ray,
    R = R_v [[B^-1 J / s1], [+-sqrt(1 - (s2/s1)^2) v2^T]]   (first two columns; the third is their cross product).

    The two signs are the mirror poses, which become one where the plane is orthogonal to the ray. OpenCV's IPPE takes the square root
    of 1 minus a squared column instead, which rounding makes negative in such a view (NaN for both poses at one roll in seven), and
    loses poses near a half turn besides. The translation is the least-squares one for the rotation.

    Args:
        xy: normalised image coordinates, shape (N, 2). points: coplanar, in the target frame, shape (N, 3) [m].

    Reference: Collins & Bartoli 2014, section 4, doi:10.1007/s11263-014-0725-5.
    """
    plane = _plane(np.ascontiguousarray(points, dtype=float).tobytes())
    H = homography(plane.flat, xy, ROUNDING)
    if H is None or abs(H[2, 2]) <= ROUNDING * np.abs(H).max():
        return []
    H = H / H[2, 2]
    v = H[:2, 2]
    R_v = _rotation_to(v)
    A = np.linalg.solve(R_v[:2, :2] - v[:, None] * R_v[2, :2], H[:2, :2] - v[:, None] * H[2, :2])
    (s1, s2), Vt = np.linalg.svd(A)[1:]
    if not s1 > 0:
        return []
    tilt = np.sqrt((1 - s2 / s1) * (1 + s2 / s1)) * Vt[1]
    columns = np.empty((2, 3, 2))
    columns[:, :2], columns[0, 2], columns[1, 2] = A / s1, tilt, -tilt
    R = np.array([_rotation_of(R_v @ both) for both in columns]) @ plane.R.T
    T = np.zeros((2, 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = R, _translations(R, points, xy), 1.0
    return list(T)


def _rotation_of(columns: Array) -> list[list[float]]:
    """The rotation, three rows, of given first two columns (3, 2)."""
    (a, d), (b, e), (c, f) = columns.tolist()
    return [[a, d, b * f - c * e], [b, e, c * d - a * f], [c, f, a * e - b * d]]


def _translations(R: Array, points: Array, xy: Array) -> Array:
    """The least-squares translations (2, 3) for rotations (2, 3, 3): x (r_z p + t_z) = r_x p + t_x, and alike for y."""
    p = points @ R.transpose(0, 2, 1)
    A = np.zeros((len(xy), 2, 3))
    A[:, 0, 0] = A[:, 1, 1] = 1.0
    A[:, :, 2] = -xy
    A = A.reshape(-1, 3)
    return np.asarray(np.linalg.solve(A.T @ A, A.T @ (xy * p[..., 2:] - p[..., :2]).reshape(2, -1).T).T, dtype=float)


def _rotation_to(v: Array) -> Array:
    """The shortest rotation (3, 3) from the optical axis to the ray (v, 1)."""
    x, y, z = np.array([*v, 1.0]) / np.sqrt(1 + v @ v)
    return np.array([[1 - x * x / (1 + z), -x * y / (1 + z), x], [-x * y / (1 + z), 1 - y * y / (1 + z), y], [-x, -y, z]])


@lru_cache(maxsize=4096)
def _plane(points: bytes) -> _Plane:
    """The plane of points (N, 3), given as bytes, which can be hashed: the same few subsets of markers recur at every frame."""
    p = np.frombuffer(points).reshape(-1, 3)
    p = p - p.mean(axis=0)
    axes = np.linalg.svd(p)[2]
    axes[2] *= np.linalg.det(axes)  # right-handed
    return _Plane(p @ axes[:2].T, axes.T)
