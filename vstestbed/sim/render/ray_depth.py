"""Depth pictures by ray casting."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from vstestbed.camera import DepthImage
from vstestbed.core.geometry import Array

ROWS = 32
"""Rows of an image that are cast at a time: of a narrow bundle most geoms are culled."""


def ray_depth(rays: Array, T_world_camera: Array, hits: Callable[..., Any]) -> DepthImage:
    """Depth (H, W) [m] along the optical axis of what the unit rays (H, W, 3) in the camera's frame hit; inf for nothing.

    hits: `Caster.hits`.
    """
    return np.concatenate([_of(rays[top : top + ROWS], T_world_camera, hits) for top in range(0, len(rays), ROWS)])


def _of(rays: Array, T_world_camera: Array, hits: Callable[..., Any]) -> DepthImage:
    """The depths (h, w) of unit rays (h, w, 3) in the camera's frame."""
    along, n = rays[..., 2], rays[..., 2].size
    geoms, distance, normal = np.empty(n, np.int32), np.empty(n), np.empty((n, 3))
    in_world = rays.reshape(-1, 3) @ np.ascontiguousarray(T_world_camera[:3, :3].T)
    hits(np.ascontiguousarray(T_world_camera[:3, 3]), in_world, geoms, distance, normal)
    return np.where(geoms.reshape(along.shape) >= 0, distance.reshape(along.shape) * along, np.inf).astype(np.float32)
