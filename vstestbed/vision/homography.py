"""Homography between two views of a plane, and the rotation between the cameras from its
decomposition.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.features.observation import Relative

OPEN = 0.01
"""Share of the largest singular value below which one counts as zero: with three of four points
collinear, .3 px of noise makes .004; a square has .35, tilted by 70 degrees .1.
"""


def relative_view(goal_xy: Array, xy: Array, goal_normal: Array) -> Relative | None:
    """The Euclidean homography H = R + t n^T / d from the goal's view to this one, and R; None
    where the points leave it open.

    H maps m* (goal, normalised, third coordinate 1) to (Z/Z*) m: its scale is the one that makes
    the middle singular value 1, its sign the one that keeps the points in front of the camera.
    (OpenCV's own decomposition gives NaN at some half turns and loses half of the digits near the
    goal.) Points of which all but one are collinear in one of the views, such as a plane seen
    edge-on, leave it open.

    Args:
        goal_xy, xy: normalised coordinates of N >= 4 points of one plane in either view (N, 2); NaN
            where not seen.
        goal_normal: unit normal (3,) of the plane in the goal's frame, pointing away from the
            camera.
    Reference: Ma, Soatto, Kosecka & Sastry 2004, An Invitation to 3-D Vision, section 5.3.3,
    doi:10.1007/978-0-387-21779-6.
    """
    seen = np.isfinite(xy[:, 0]) & np.isfinite(goal_xy[:, 0])
    if np.count_nonzero(seen) < 4:
        return None
    goal_xy = goal_xy[seen]
    xy = xy[seen]
    H = homography(goal_xy, xy, OPEN)
    if H is None:
        return None
    H = H / np.linalg.svd(H, compute_uv=False)[1]
    ratios = goal_xy @ H[2, :2] + H[2, 2]
    if ratios.min() < 0 < ratios.max():  # points on both sides of the camera
        return None
    if ratios.min() <= 0:
        H = -H
    return H, _rotation(H, goal_xy, goal_normal)


def homography(a: Array, b: Array, least: float) -> Array | None:
    """The homography (3, 3) from points a to points b (N, 2), N >= 4, up to its factor; None where
    they leave it open.

    The normalised direct linear transformation: the right singular vector of the smallest singular
    value of b_i x H a_i = 0. (OpenCV takes the points in single precision, which costs half of the
    digits.) H is open if two of the nine singular values are below the share `least` of the
    largest.
    Reference: Hartley & Zisserman 2004, Multiple View Geometry, algorithm 4.2.
    """
    a_mean, a_size = _scaling(a)
    b_mean, b_size = _scaling(b)
    A = _equations((a - a_mean) / a_size, (b - b_mean) / b_size)
    s, Vt = np.linalg.svd(A)[1:]
    if not s[7] > least * s[0]:
        return None
    x, y = a_mean[0].tolist()
    size = a_size.item()
    to_a = np.array([(1 / size, 0, -x / size), (0, 1 / size, -y / size), (0, 0, 1)])
    x, y = b_mean[0].tolist()
    size = b_size.item()
    from_b = np.array([(size, 0, x), (0, size, y), (0, 0, 1)])
    return from_b @ Vt[8].reshape(3, 3) @ to_a


def left_open(a: Array, b: Array) -> NDArray[np.bool_]:
    """Whether points a, b (..., N, 2) of two views leave their homography open: two of nine
    singular values are (nearly) zero.
    """
    a_mean, a_size = _scaling(a)
    b_mean, b_size = _scaling(b)
    A = _equations(*np.broadcast_arrays((a - a_mean) / a_size, (b - b_mean) / b_size))
    s = np.linalg.svd(A, compute_uv=False)
    return np.asarray(s[..., 7] <= OPEN * s[..., 0])


def _equations(a: Array, b: Array) -> Array:
    """The matrix (..., 2 N, 9) of b_i x H a_i = 0 for the nine elements of H."""
    A = np.zeros((*a.shape[:-1], 2, 9))
    A[..., 0, :2] = A[..., 1, 3:5] = a
    A[..., 0, 2] = A[..., 1, 5] = 1
    A[..., 6:8] = -b[..., None] * a[..., None, :]
    A[..., 8] = -b
    return A.reshape(*a.shape[:-2], -1, 9)


def _scaling(xy: Array) -> tuple[Array, Array]:
    """Mean (..., 1, 2) and root mean square distance from it (..., 1, 1) of points (..., N, 2):
    Hartley's normalisation.
    """
    mean = np.add.reduce(xy, axis=-2, keepdims=True) / xy.shape[-2]
    size2 = np.add.reduce((xy - mean) ** 2, axis=(-2, -1), keepdims=True) / xy.shape[-2]
    return mean, np.maximum(np.sqrt(size2), 1e-12)


def _rotation(H: Array, goal_xy: Array, goal_normal: Array) -> Array:
    """R of H = R + t n^T/d: with v1, v2, v3 the right singular vectors of H and 1 the middle
    singular value,

    n = v2 x u,  R = [H v2, H u, H v2 x H u] [v2, u, v2 x u]^T,
    u = (a v1 +- b v3)/sqrt(a^2 + b^2),  a^2 = 1 - s3^2, b^2 = s1^2 - 1.

    H preserves the lengths of v2 and u, which lie in the plane. Of the two solutions that one is
    taken which has all points before the camera and its normal nearest to the goal's. A pure
    rotation has no normal, and any u gives R.
    """
    (s1, _, s3), Vt = np.linalg.svd(H)[1:]
    v1, v2, v3 = Vt
    a = np.sqrt(max(1 - s3 * s3, 0.0))
    b = np.sqrt(max(s1 * s1 - 1, 0.0))
    size = np.hypot(a, b)
    a, b = (a / size, b / size) if size > 0 else (1.0, 0.0)
    solutions = []
    for u in (a * v1 + b * v3, a * v1 - b * v3):
        n = np.cross(v2, u)
        # n . m > 0 of a point m of the plane: n points away from the camera. Far off the axis its z
        # may be negative.
        sides = goal_xy @ n[:2] + n[2]
        n = n if sides.sum() > 0 else -n
        visible = sides.min() > 0 or sides.max() < 0
        # n . n* lies in -1..1, so a penalty of 2 ranks every invisible plane behind every visible
        # one.
        solutions.append((float(n @ goal_normal) - (0.0 if visible else 2.0), u))
    u = max(solutions, key=lambda solution: solution[0])[1]
    plane = np.stack([v2, u, np.cross(v2, u)])
    seen = np.stack([H @ v2, H @ u, np.cross(H @ v2, H @ u)])
    # The nearest rotation to the product: rounding in v2 and u would leave it slightly off
    # orthogonal.
    U, _, Wt = np.linalg.svd(seen.T @ plane)
    return U @ Wt
