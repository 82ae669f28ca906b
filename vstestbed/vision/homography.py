"""Two views of a plane: their homography, and the rotation between the cameras that it holds."""

from __future__ import annotations

import cv2
import numpy as np

from vstestbed.geometry import Array
from vstestbed.observation import Relative

_K = np.eye(3)


def relative_view(goal_xy: Array, xy: Array, goal_normal: Array) -> Relative | None:
    """The Euclidean homography H = R + t n^T / d from the goal's view to this one, and R; None where it cannot be told.

    H maps m* (goal, normalised, third coordinate 1) to (Z/Z*) m: its scale is the one that makes the middle singular value
    1, its sign the one that keeps the points in front of the camera. It falls apart in up to four ways; of those that leave
    the points on the plane's visible side, the one whose normal is nearest to the goal's is taken.

    Args:
        goal_xy, xy: normalised coordinates of N >= 4 points of one plane in either view, shape (N, 2); NaN where not seen.
        goal_normal: unit normal (3,) of the plane in the goal's frame, away from the camera, as the goal view has it.

    References: Faugeras & Lustman 1988, doi:10.1142/S0218001488000285; Malis & Vargas 2007, INRIA report 6303 (the
    analytic decomposition that OpenCV uses).
    """
    seen = np.isfinite(xy[:, 0]) & np.isfinite(goal_xy[:, 0])
    if np.count_nonzero(seen) < 4:
        return None
    goal_xy, xy = goal_xy[seen], xy[seen]
    H = cv2.findHomography(goal_xy, xy, 0)[0]
    if H is None or not np.isfinite(H).all():
        return None
    H = H / np.linalg.svd(H, compute_uv=False)[1]
    ratios = goal_xy @ H[2, :2] + H[2, 2]
    if ratios.min() < 0 < ratios.max():
        return None
    H = H if ratios.min() > 0 else -H
    _, rotations, _, normals = cv2.decomposeHomographyMat(H, _K)
    best = max(range(len(rotations)), key=lambda i: _fit(np.asarray(normals[i], dtype=float).ravel(), goal_xy, goal_normal))
    return Relative(H=H, R_camera_goal=np.asarray(rotations[best], dtype=float))


def _fit(n: Array, goal_xy: Array, goal_normal: Array) -> float:
    """How well a normal suits: its cosine to the goal's; less than any cosine where it puts a point behind the plane."""
    visible = (goal_xy @ n[:2] + n[2]).min() > 0
    return float(n @ goal_normal) - (0.0 if visible or not n.any() else 2.0)
