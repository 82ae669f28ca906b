"""Paint on the floor: one flat mesh for each line."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.core.geometry import Array

LIFT_M = 2e-4
"""How far the paint lies over the floor [m]: seen from .3 m up at 60 degrees it is .35 mm too far out."""
SEGMENT = 4
"""Samples of the way, a centimetre apart, that make a segment: its chord leaves a bend of 2 m by .1 mm."""


def add_stripe(scene: mujoco.MjSpec, body: mujoco.MjsBody, edges: tuple[Array, Array], i: int, group: int) -> mujoco.MjsGeom:
    """Line i between its edges (K, 2) as a geom of `body`, a strip of triangles whose upper side shows: it is seen and touches nothing."""
    left, right = edges
    kept = np.unique(np.append(np.arange(0, len(left), SEGMENT), len(left) - 1))
    n = len(kept)
    vertices = np.full((2 * n, 3), LIFT_M)
    vertices[0::2, :2], vertices[1::2, :2] = left[kept], right[kept]
    at = 2 * np.arange(n - 1)[:, None]
    faces = np.concatenate([at + [0, 1, 2], at + [1, 3, 2]])  # counter-clockwise from above
    mesh = scene.add_mesh(name=f"target/line_{i}", uservert=vertices.ravel(), userface=faces.ravel())
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # a sheet has no volume
    return body.add_geom(
        name=f"target/line_{i}",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=f"target/line_{i}",
        group=group,
        contype=0,
        conaffinity=0,
        mass=0,
    )
