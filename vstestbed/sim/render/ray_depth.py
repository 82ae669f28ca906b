"""Depth pictures by ray casting."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vstestbed.camera import DepthImage
from vstestbed.core.geometry import Array

if TYPE_CHECKING:
    from vstestbed.sim.render.rays import Caster, Raster

ROWS = 32
"""Rows of an image that are cast at a time: of a narrow bundle most geoms are culled."""


def ray_depth(caster: Caster, raster: Raster, T_world_camera: Array) -> DepthImage:
    """Depth (H, W) [m] along the optical axis of what the ray through each pixel's centre hits; inf for nothing."""
    rows = range(0, raster.height, ROWS)
    return np.concatenate([_of(caster, raster.rays((0, top, raster.width, top + ROWS)), T_world_camera) for top in rows])


def _of(caster: Caster, rays: Array, T_world_camera: Array) -> DepthImage:
    """The depths (h, w) of unit rays (h, w, 3) in the camera's frame."""
    along, n = rays[..., 2], rays[..., 2].size
    geoms, distance, normal = np.empty(n, np.int32), np.empty(n), np.empty((n, 3))
    in_world = rays.reshape(-1, 3) @ np.ascontiguousarray(T_world_camera[:3, :3].T)
    caster.hits(np.ascontiguousarray(T_world_camera[:3, 3]), in_world, geoms, distance, normal)
    return np.where(geoms.reshape(along.shape) >= 0, distance.reshape(along.shape) * along, np.inf).astype(np.float32)
