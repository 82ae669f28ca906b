"""Places of matches below a pixel: each point's patch of the goal's picture, laid over this one."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array

HALF = 10
"""Half the side of a patch, without its middle [px of the goal's picture]."""
ROUNDS, SETTLED_PX = 8, 0.005
"""Most Gauss-Newton steps, and the step under which none follows [px]."""
REACH_PX = 3.0
"""A patch that moves farther than this from its match has found something else [px]."""
ALIKE = 0.8
"""Least correlation of a patch with the goal's [1]."""
TEXTURE = 1e-3
"""Least of the smaller eigenvalue of a patch's normal equations, as a share of the larger one: an edge alone is no place."""
SMOOTH_PX = 0.8
"""Standard deviation of the Gaussian over both pictures, without which interpolation between pixels adds a bias [px]."""


def smooth(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """A picture (H, W) as `refined` takes it."""
    return np.asarray(cv2.GaussianBlur(grey.astype(np.float32), (0, 0), SMOOTH_PX), np.float32)


def refined(goal: NDArray[np.float32], image: NDArray[np.float32], uv_goal: Array, uv: Array, A: Array) -> Array:
    """Places (K, 2) at which the patches round uv_goal (K, 2) of the goal's picture are found; NaN where not alike, or cut by a border.

    Minimises over d the squared difference of I(uv + A (x + d)) and I*(uv_goal + x) over the patch's pixels x, both less their mean and
    over their standard deviation, so that brightness and contrast may differ: Gauss-Newton with the goal's gradient (inverse
    compositional Lucas-Kanade).

    Args:
        goal, image: the pictures (H, W), `smooth`.
        A: d uv / d uv_goal (K, 2, 2) of the map between the pictures at each point.

    Reference: Baker & Matthews 2004, doi:10.1023/B:VISI.0000011205.11775.fd.
    """
    x = np.stack(np.meshgrid(np.arange(-HALF, HALF + 1.0), np.arange(-HALF, HALF + 1.0)), axis=-1).reshape(-1, 2)
    template, contrast = _normalised(_sampled(goal, uv_goal[:, None] + x))
    gradient = np.stack([(_sampled(goal, uv_goal[:, None] + x + s) - _sampled(goal, uv_goal[:, None] + x - s)) / 2 for s in np.eye(2)], -1)
    gradient = gradient - gradient.mean(axis=1, keepdims=True)
    normal = gradient.mT @ gradient
    usable = _textured(normal) & np.isfinite(A).all(axis=(1, 2)) & np.isfinite(uv).all(axis=1)
    normal[~usable] = np.eye(2)
    over = np.einsum("kij,pj->kpi", np.where(usable[:, None, None], A, np.eye(2)), x)
    start, A = np.where(usable[:, None], uv, 0.0), np.where(usable[:, None, None], A, 0.0)
    at = start.copy()
    alike = np.zeros(len(uv))
    for _ in range(ROUNDS):
        patch, _ = _normalised(_sampled(image, at[:, None] + over))
        alike = np.mean(patch * template, axis=1)
        d = np.linalg.solve(normal, np.einsum("kpi,kp->ki", gradient, (patch - template) * contrast[:, None])[..., None])
        step = (A @ d)[..., 0]
        at = at - step
        if np.abs(step).max(initial=0.0) < SETTLED_PX:
            break
    usable &= _inside(goal, uv_goal[:, None] + x) & _inside(image, at[:, None] + over)
    found = usable & (alike > ALIKE) & (np.linalg.norm(at - start, axis=1) < REACH_PX)
    return np.where(found[:, None], at, np.nan)


def whole(image: NDArray[Any], uv_goal: Array, uv: Array, A: Array) -> NDArray[np.bool_]:
    """Which patches (K,) lie wholly in both pictures, of the size (H, W) of `image`; the others `refined` does not find.

    Args:
        uv_goal, uv, A: as of `refined`.
    """
    corners = HALF * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return _inside(image, uv_goal[:, None] + corners) & _inside(image, uv[:, None] + np.einsum("kij,pj->kpi", A, corners))


def _sampled(image: NDArray[np.float32], uv: Array) -> Array:
    """Brightness (K, P) at uv (K, P, 2), linear between pixels; outside, that of the border.

    OpenCV's own rounds places to a 32nd of a pixel.
    """
    height, width = image.shape
    u, v = np.clip(uv[..., 0], 0, width - 1.001), np.clip(uv[..., 1], 0, height - 1.001)
    i, j = u.astype(np.intp), v.astype(np.intp)
    a, b, k = u - i, v - j, j * width + i
    flat = image.ravel()
    top = flat[k] * (1 - a) + flat[k + 1] * a
    return top * (1 - b) + (flat[k + width] * (1 - a) + flat[k + width + 1] * a) * b


def _inside(image: NDArray[Any], uv: Array) -> NDArray[np.bool_]:
    """Which patches (K,) with pixels uv (K, P, 2) lie wholly in the picture: beyond its border nothing is known."""
    size = np.array([image.shape[1], image.shape[0]]) - 1
    return np.asarray(((uv >= 0) & (uv <= size)).all(axis=(1, 2)))


def _normalised(patches: Array) -> tuple[Array, Array]:
    """Patches (K, P) less their mean and over their standard deviation (K,), and that; a flat one stays zero."""
    off = patches - patches.mean(axis=1, keepdims=True)
    contrast = np.sqrt(np.mean(off**2, axis=1))
    return off / np.maximum(contrast, 1e-6)[:, None], contrast


def _textured(normal: Array) -> NDArray[np.bool_]:
    """Whether patches with the normal equations (K, 2, 2) have structure in both directions."""
    eigenvalues = np.linalg.eigvalsh(normal)
    return np.asarray(eigenvalues[:, 0] > np.maximum(TEXTURE * eigenvalues[:, 1], 1e-3))
