"""Ellipses as images: of a circle in space, from points, and points on them in an order that the picture alone determines."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from vstestbed.core.geometry import Array


def circle_conic(T_camera_circle: Array, radius: float) -> Array:
    """The conic C (..., 3, 3) with m^T C m = 0 for the images m = (x, y, 1) of a circle in the plane z = 0 of a frame at T (..., 4, 4).

    A point of the plane has the image H (X, Y, 1) with H = [R ex, R ey, t]; the circle X^2 + Y^2 = radius^2 becomes
    C = H^-T diag(1, 1, -radius^2) H^-1.

    Reference: Hartley & Zisserman 2004, Multiple View Geometry, result 2.13 (conics under a homography).
    """
    H = np.concatenate([T_camera_circle[..., :3, :2], T_camera_circle[..., :3, 3:]], axis=-1)
    G = np.linalg.inv(H)
    return G.mT @ np.diag([1.0, 1.0, -(radius**2)]) @ G


def fitted_conic(xy: Array) -> Array:
    """The conic (3, 3) that fits points xy (K, 2) on an ellipse, by linear least squares about their mean, in units of their spread."""
    middle, spread = xy.mean(axis=0), float(xy.std())
    x, y = ((xy - middle) / spread).T
    a, b, c, d, e = np.linalg.lstsq(np.column_stack([x * x, x * y, y * y, x, y]), np.ones(len(x)), rcond=None)[0]
    C = np.array([[a, b / 2, d / 2], [b / 2, c, e / 2], [d / 2, e / 2, -1.0]])
    N = np.array([[1 / spread, 0, -middle[0] / spread], [0, 1 / spread, -middle[1] / spread], [0, 0, 1]])
    return N.T @ C @ N


def ellipse_points(C: Array, count: int) -> Array:
    """Points xy (..., count, 2) on the ellipses C (..., 3, 3), from the picture's right downwards; NaN where C is no ellipse.

    They are m + S (cos phi_i, sin phi_i), with the centre m and the symmetric root S of the ellipse's matrix,
    (x - m)^T S^-2 (x - m) = 1: of all maps of the unit circle onto the ellipse the one without a rotation. It depends on the ellipse
    alone, and on nothing that the picture of a circle does not show; the points of a circle begin at its right. Their polygon is an
    affine image of the regular one, so that its moments are those of the ellipse times constants.
    """
    A, b = C[..., :2, :2], C[..., :2, 2]
    with np.errstate(invalid="ignore", divide="ignore"):
        inverse = _inverse_2x2(A)
        middle = -(inverse @ b[..., None])[..., 0]
        level = -(C[..., 2, 2] + (b * middle).sum(axis=-1))
        S2 = inverse * level[..., None, None]
        det = S2[..., 0, 0] * S2[..., 1, 1] - S2[..., 0, 1] ** 2
        root = np.sqrt(np.where(S2[..., 0, 0] > 0, det, np.nan))  # of a hyperbola the determinant is negative
        S = (S2 + root[..., None, None] * np.eye(2)) / np.sqrt(S2[..., 0, 0] + S2[..., 1, 1] + 2 * root)[..., None, None]
    return middle[..., None, :] + unit_circle(count) @ S


def distance_to_conic(C: Array, xy: Array) -> Array:
    """Distance of points xy (K, 2) from a conic C (3, 3), to first order: m^T C m / |grad|, shape (K,); its sign is that side's of C.

    Reference: Sampson 1982, doi:10.1016/0146-664X(82)90101-0.
    """
    m = np.column_stack([xy, np.ones(len(xy))])
    line = m @ C
    return (line * m).sum(axis=1) / (2 * np.maximum(np.hypot(line[:, 0], line[:, 1]), 1e-300))


@lru_cache(maxsize=16)
def unit_circle(count: int) -> Array:
    """(cos, sin) at `count` equal angles from 0 on, shape (count, 2), read-only."""
    angle = np.arange(count) * (2 * np.pi / count)
    out = np.column_stack([np.cos(angle), np.sin(angle)])
    out.setflags(write=False)
    return out


def _inverse_2x2(A: Array) -> Array:
    det = A[..., 0, 0] * A[..., 1, 1] - A[..., 0, 1] * A[..., 1, 0]
    out = np.empty_like(A)
    out[..., 0, 0], out[..., 1, 1], out[..., 0, 1], out[..., 1, 0] = A[..., 1, 1], A[..., 0, 0], -A[..., 0, 1], -A[..., 1, 0]
    return out / det[..., None, None]
