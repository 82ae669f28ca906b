"""The target's pose by the pictures of several cameras at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from vstestbed.camera import Camera
from vstestbed.camera.base import pixel_interaction
from vstestbed.core.geometry import Array, adjoint, exp, inverse, transform

ROUNDS, SETTLED = 10, 1e-9
"""Most steps of Gauss and Newton, and the step [m, rad] at which they end: from a pose of one picture it takes three or four."""
LEAST_MARKERS, LEAST_SHARE = 3, 1e-6
"""Fewest markers in all pictures together that tell a pose, and the least singular value of L, as a share of the largest, with which they
do."""


class CameraPixels(NamedTuple):
    """What one camera sees of a target.

    camera: the lens as calibrated. uv: its markers (N, 2) [px], NaN where one is not seen. T_this_reference: pose (4, 4) of the reference
    camera in this one's frame. weight: of its squared errors. T_this_target: the target's pose (4, 4) by this camera alone, if any.
    """

    camera: Camera
    uv: Array
    T_this_reference: Array
    weight: float = 1.0
    T_this_target: Array | None = None


def fused_pose(T: Array, points: Array, seen: Sequence[CameraPixels]) -> tuple[Array, Array] | None:
    """T_reference_target (4, 4) that minimises sum of w |uv - project(T_this_reference T P)|^2 over all cameras and markers, by
    Gauss-Newton steps from a pose T (4, 4); and its information (6, 6), sum of w L^T L: with w = 1 / sigma^2 the inverse of its
    covariance, of a displacement of the reference camera in its own frame. None where too little is seen, or the steps do not settle.

    To first order this is the mean of the poses by each camera alone, weighted by the inverses of their covariances; a camera that sees too
    few markers for a pose of its own still adds what it sees. points: the markers (N, 3) in the target's frame [m].

    Reference: Bar-Shalom, Li & Kirubarajan 2001, Estimation with Applications to Tracking and Navigation, section 3.4 (least squares and
    its covariance).
    """
    rows = [np.isfinite(one.uv[:, 0]) for one in seen]
    if sum(int(np.count_nonzero(of_one)) for of_one in rows) < LEAST_MARKERS:
        return None
    for _ in range(ROUNDS):
        information, gradient = np.zeros((6, 6)), np.zeros(6)
        for one, known in zip(seen, rows, strict=True):
            p = transform(one.T_this_reference @ T, points[known])
            error = one.uv[known] - one.camera.project(p)
            if not np.isfinite(error).all():  # beside the lens: the pose to begin with was a wrong one
                return None
            L = (pixel_interaction(one.camera, p) @ adjoint(one.T_this_reference)).reshape(-1, 6)
            information += one.weight * L.T @ L
            gradient += one.weight * L.T @ error.ravel()
        values = np.linalg.eigvalsh(information)
        if not values[0] > LEAST_SHARE**2 * values[-1]:
            return None
        step = np.linalg.solve(information, gradient).astype(float)
        T = exp(-step) @ T
        if np.abs(step).max() < SETTLED:
            return T, information
    return None


def pose_of_all(T: Array | None, points: Array, own: CameraPixels, others: Sequence[CameraPixels]) -> Array | None:
    """The pose (4, 4) by the pictures of a reference camera and others, from that of the camera that sees most; None where they tell none.

    T: the pose (4, 4) in the reference camera's frame by its own picture, or as it was; None where it has never been known.
    """
    most = np.count_nonzero(np.isfinite(own.uv[:, 0]))
    for other in others:
        n = np.count_nonzero(np.isfinite(other.uv[:, 0]))
        if other.T_this_target is not None and (T is None or n > most):
            most, T = n, inverse(other.T_this_reference) @ other.T_this_target
    found = None if T is None else fused_pose(T, points, [own, *others])
    return None if found is None else found[0]
