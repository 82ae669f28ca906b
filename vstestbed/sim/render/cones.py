"""Bundles of rays: the cones round them, and which spheres these meet, so that only those geoms are cast at; how dense they are."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array, lengths


def cone_of(rays: Array) -> tuple[Array, float]:
    """Axis (3,) and half angle [rad] of a cone that holds unit rays (n, 3): their mean, and the largest angle from it."""
    axis = rays.sum(axis=0)
    size = math.sqrt(float(axis @ axis))
    if size < 1e-6 * len(rays):
        return np.array([0, 0, 1.0]), math.pi
    axis /= size
    return axis, math.acos(max(-1.0, min(1.0, float((rays @ axis).min()))))


def meets(centres: Array, radii: Array, axis: Array, half_angle: float) -> NDArray[np.bool_]:
    """Which spheres, of centres (N, 3) relative to a cone's apex and radii (N,) [m], intersect the cone."""
    far = np.maximum(np.sqrt((centres * centres).sum(axis=1)), 1e-12)
    angle = np.arccos(np.clip(centres @ axis / far, -1, 1))
    return (far <= radii) | (angle <= half_angle + np.arcsin(np.minimum(radii / far, 1)) + 1e-6)


def angles_to_next(rays: Array) -> Array:
    """Angle [rad] from each ray (H, W, 3) to the farther of the next ones across and down, shape (H, W); 0 where there is none."""
    out = np.zeros(rays.shape[:2])
    for axis in (0, 1):
        if rays.shape[axis] > 1:
            steps = lengths(np.diff(rays, axis=axis))[..., 0]
            last = steps[-1:] if axis == 0 else steps[:, -1:]
            np.fmax(out, np.concatenate([steps, last], axis=axis), out=out)
    return out
