"""A plane's template found anywhere in a picture: keypoints matched, and the homography on which most of them agree."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Panel, Picture
from vstestbed.core.geometry import Array
from vstestbed.vision.detect.esm import normalised
from vstestbed.vision.detect.template import SIFT, Template
from vstestbed.vision.match.mutual import mutual_matches

RATIO = 0.8
"""A match counts if its distance is below this share of the second best one's (Lowe 2004, section 7.1)."""
WITHIN_PX = 3.0
"""Largest distance of a keypoint from its place by the homography [px]."""
LEAST_MATCHES = 10
"""Fewest matches that must agree."""
TRIALS = 2000
AHEAD = 0.1
"""Least cosine of the angle between a ray and the middle of all."""
STEP = 1e-3
"""Tangent by which the picture's scale in its middle is measured."""


def found(template: Template, picture: Picture, camera: Camera) -> Array | None:
    """The homography (3, 3) from a template's plane to the directions of its image, as `esm.align` takes it; None where it is not found.

    SIFT keypoints of all panels are matched with the template's. Their directions are turned to a virtual pinhole camera which looks at
    their middle, so that any lens will do.

    Args:
        template: the plane's. picture: the whole exposure. camera: its calibrated lens.
    """
    places, _ = template.features
    pairs = [_matched(image, panel, template) for image, panel in zip(picture.images, camera.panels, strict=True) if image is not None]
    rays, index = np.concatenate([p[0] for p in pairs]), np.concatenate([p[1] for p in pairs])
    if len(rays) < LEAST_MATCHES:
        return None
    R = _looking(np.median(rays, axis=0))
    turned = rays @ R
    ahead = turned[:, 2] > AHEAD
    xy = turned[ahead, :2] / turned[ahead, 2:]
    if len(xy) < LEAST_MATCHES:
        return None
    f = _focal_px(camera)
    H, inliers = cv2.findHomography(places[index[ahead]], f * xy, cv2.RANSAC, WITHIN_PX, maxIters=TRIALS, confidence=0.999)
    return None if H is None or np.count_nonzero(inliers) < LEAST_MATCHES else _in_front(H, R, f, template)


def _in_front(H: NDArray[Any], R: Array, f: float, template: Template) -> Array | None:
    """The homography to directions from one to the pixels of a virtual camera turned by R (3, 3); None of a plane seen from behind."""
    G = normalised(R @ np.diag([1 / f, 1 / f, 1]) @ H)
    # A plane seen from behind, or points on both sides of the camera, come of wrong matches.
    return G if G.any() and (template.corners @ (R.T @ G)[2] > 0).all() else None


def _matched(image: Image, panel: Panel, template: Template) -> tuple[Array, NDArray[np.intp]]:
    """Unit rays (M, 3) in the camera's frame of a panel's keypoints that match one of the template's, and its number (M,)."""
    px, descriptors = SIFT.extract(image)
    mine, number, _ = mutual_matches(descriptors, template.features[1], RATIO)
    rays = panel.lens.ray(px[mine]) @ panel.R_camera_panel.T
    known = np.isfinite(rays).all(axis=1)
    return rays[known], number[known]


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
