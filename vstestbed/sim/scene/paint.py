"""Paint on the floor: one flat mesh for each line."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.core.geometry import Array

LIFT_M = 2e-4
"""Height of the paint over the floor, against z-fighting [m]: seen from .3 m up at 60 degrees, it appears .35 mm too far out."""
SEGMENT = 4
"""Samples of the route, a centimetre apart, in a segment: its chord deviates from a bend of 2 m radius by .1 mm."""


def add_stripe(scene: mujoco.MjSpec, body: mujoco.MjsBody, edges: tuple[Array, Array], i: int, group: int) -> mujoco.MjsGeom:
    """Line i between its edges (K, 2) as a geom of `body`: a strip of triangles, visible from above, without collisions."""
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
