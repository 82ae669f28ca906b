"""A plane's template found anywhere in a picture: keypoints matched, and the homography on which most of them agree."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array
from vstestbed.vision.detect.esm import normalised
from vstestbed.vision.detect.sampling import Grey, GreyPicture
from vstestbed.vision.detect.template import Template, keypoints

RATIO = 0.8
"""A match counts if its distance is below this share of the second best one's (Lowe 2004, section 7.1)."""
WITHIN_PX = 3.0
"""Largest distance of a keypoint from its place by the homography [px]."""
LEAST_MATCHES = 10
"""Fewest matches that must agree."""
TRIALS = 2000
STEP = 1e-3
"""Tangent by which the picture's scale in its middle is measured."""


def found(template: Template, picture: GreyPicture) -> Array | None:
    """The homography (3, 3) from a template's plane to the directions of its image, as `esm.align` takes it; None where it is not found.

    SIFT keypoints of all panels are matched with the template's. Their directions are turned to a virtual pinhole camera which looks at
    their middle, so that any lens will do.
    """
    places, descriptors = template.features
    pairs = [_matched(k, picture, descriptors) for k in range(len(picture.images))]
    rays, index = np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])
    if len(rays) < LEAST_MATCHES:
        return None
    R = _looking(np.median(rays, axis=0))
    turned = rays @ R
    ahead = turned[:, 2] > 0.1
    xy = turned[ahead, :2] / turned[ahead, 2:]
    if len(xy) < LEAST_MATCHES:
        return None
    f = _focal_px(picture.camera)
    H, inliers = cv2.findHomography(places[index[ahead]], f * xy, cv2.RANSAC, WITHIN_PX, maxIters=TRIALS, confidence=0.999)
    if H is None or np.count_nonzero(inliers) < LEAST_MATCHES:
        return None
    G = normalised(R @ np.diag([1 / f, 1 / f, 1]) @ H)
    # A plane seen from behind, or points on both sides of the camera, come of wrong matches.
    return G if G.any() and (template.corners @ (R.T @ G)[2] > 0).all() else None


def _matched(panel: int, picture: GreyPicture, descriptors: Grey) -> tuple[Array, NDArray[np.intp]]:
    """Unit rays (M, 3) in the camera's frame of a panel's keypoints that match one of the descriptors (K, 128), and its number (M,)."""
    grey = picture.images[panel]
    nothing = np.empty((0, 3)), np.empty(0, np.intp)
    if grey is None or len(descriptors) < 2:
        return nothing
    px, seen = keypoints(grey)
    if not len(px):
        return nothing
    distance, number = cv2.batchDistance(seen, descriptors, cv2.CV_32F, normType=cv2.NORM_L2, K=2)
    good = distance[:, 0] < RATIO * distance[:, 1]
    own = picture.camera.panels[panel]
    rays = own.lens.ray(px[good] + picture.begin(panel)) @ own.R_camera_panel.T
    known = np.isfinite(rays).all(axis=1)
    return rays[known], np.asarray(number[good, 0], np.intp)[known]


def _looking(ray: Array) -> Array:
    """R_camera_virtual (3, 3) of a camera that looks along a ray."""
    z = ray / np.linalg.norm(ray)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _focal_px(camera: Camera) -> float:
    """Pixels per unit of tangent in the middle of the camera's (first) image."""
    lens = camera.panels[0].lens
    middle = lens.project(np.array([[0.0, 0.0, 1.0], [STEP, 0.0, 1.0]]))
    return float(np.linalg.norm(middle[1] - middle[0])) / STEP
