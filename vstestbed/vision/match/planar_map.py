"""The homography between two views of one plane, robust against wrong matches, for any lens with one image."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array

LEAST_INLIERS = 8
"""A homography has eight unknowns; one that fewer pairs agree with may be a chance."""
SEED = 1
"""Of the random samples, so that a run repeats."""
CONFIDENCE, MOST_SAMPLES = 0.9999, 5000
STEP_PX = 0.5
"""Half the distance over which the map's derivatives are taken [px]."""


@dataclass(frozen=True, slots=True)
class PlanarMap:
    """The map of a plane's points from the goal's picture into another, by their rays: r ~ H r*.

    Attributes:
        H: homography (3, 3) of rays in the cameras' frames, from the goal's to this one's.
        camera: the lens of both pictures.
    """

    H: Array
    camera: Camera

    def __call__(self, uv_goal: Array) -> Array:
        """Pixels (..., 2) in this picture of pixels (..., 2) of the goal's; NaN where the lens does not see them."""
        return self.camera.project(self.camera.ray(uv_goal) @ self.H.T)

    def derivatives(self, uv_goal: Array) -> Array:
        """How the map turns, stretches and shears the picture's parts at uv_goal (K, 2): d uv / d uv_goal (K, 2, 2)."""
        steps = STEP_PX * np.eye(2)
        ahead, back = (self(uv_goal[:, None] + sign * steps) for sign in (1, -1))  # (K, 2 directions, 2 coordinates)
        return ((ahead - back) / (2 * STEP_PX)).mT


def planar_map(camera: Camera, uv_goal: Array, uv: Array, within_px: float) -> tuple[PlanarMap, NDArray[np.bool_]] | None:
    """The homography with which the most pairs uv_goal (M, 2), uv (M, 2) agree, and which do (M,); None where too few do.

    By random samples and a local optimisation of the best (LO-RANSAC with truncated squares), in the picture of a camera without
    distortion. Pairs agree if they are within `within_px` of the map there, at the scale of the picture's middle [px].

    Reference: Chum, Matas & Kittler 2003, doi:10.1007/978-3-540-45243-0_31; Torr & Zisserman 2000, doi:10.1006/cviu.1999.0832.
    """
    f = _focal_px(camera)
    a, b = camera.normalise(uv_goal), camera.normalise(uv)
    usable = np.isfinite(a[:, 0]) & np.isfinite(b[:, 0])
    if np.count_nonzero(usable) < LEAST_INLIERS:
        return None
    method = cv2.UsacParams()
    method.threshold, method.confidence = within_px, CONFIDENCE
    method.maxIterations, method.randomGeneratorState = MOST_SAMPLES, SEED
    H, mask = cv2.findHomography(f * a[usable], f * b[usable], method)  # in pixels: of smaller numbers it loses its way
    if H is None or mask is None or np.count_nonzero(mask) < LEAST_INLIERS:
        return None
    agree = np.zeros(len(a), dtype=bool)
    agree[usable] = mask.ravel() > 0
    # Its sign is the one that leaves the points in front of the camera.
    H = np.asarray(H, float) / np.array([[1, 1, f], [1, 1, f], [1 / f, 1 / f, 1]])
    ahead = np.column_stack([a[agree], np.ones(np.count_nonzero(agree))]) @ H[2]
    return PlanarMap(H * np.sign(np.median(ahead)), camera), agree


def _focal_px(camera: Camera) -> float:
    """Pixels per unit of the normalised coordinates at the middle of the picture."""
    middle = camera.project(np.array([[0.0, 0.0, 1.0], [0.01, 0.0, 1.0], [0.0, 0.01, 1.0]]))
    return float(np.linalg.norm(middle[1:] - middle[0], axis=1).mean() / 0.01)


def spread_out(uv: Array, most: int, first: int = 0) -> NDArray[np.intp]:
    """Indices of at most `most` of the points uv (M, 2), far from each other: the `first` ones, then always the farthest from all chosen.

    In the order in which they were chosen; points at one place are taken once.
    """
    chosen = list(range(min(first, most)))
    far = np.full(len(uv), np.inf)
    for k in chosen:
        far = np.minimum(far, np.sum((uv - uv[k]) ** 2, axis=1))
    while len(chosen) < min(most, len(uv)):
        k = int(np.argmax(far))
        if far[k] <= 0:
            break
        chosen.append(k)
        far = np.minimum(far, np.sum((uv - uv[k]) ** 2, axis=1))
    return np.array(chosen, dtype=np.intp)
