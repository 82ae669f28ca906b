"""What of a target is drawn besides its markers: paint on the floor, a picture, a solid."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.sim.scene.groups import FACE_VIEWER, GLOW, TARGET_GROUP
from vstestbed.sim.scene.model_files import ASSETS
from vstestbed.targets.markers import HALF_THICKNESS_M
from vstestbed.targets.surfaces import Body, Globe, Sheet
from vstestbed.targets.triangles import as_stl

SHININESS = 0.5
"""Of a glossy picture, in MuJoCo's unit: the highlight of a lamp falls as cos^64, to a half at 8 degrees."""
LIFT_M = 2e-4
"""Height of the paint over the floor, against z-fighting [m]: seen from .3 m up at 60 degrees, it appears .35 mm too far out."""
FACETS = 90
"""Facets of a ball from pole to pole, and twice as many round it: its outline is within 2e-4 of its radius."""
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


def add_sheet(scene: mujoco.MjSpec, body: mujoco.MjsBody, sheet: Sheet, front: float) -> float:
    """A picture with its face at z = front in the target's frame; where its back is [m]."""
    scene.texturedir = ASSETS
    scene.assets = {**scene.assets, f"{ASSETS}/target_picture.png": sheet.png}
    scene.add_texture(name="target/picture", type=mujoco.mjtTexture.mjTEXTURE_2D, file="target_picture.png")
    grey = sheet.albedo * (1.0 if sheet.lit else 1 / GLOW)
    rgba = [grey, grey, grey, 1.0]
    paint = scene.add_material(
        name="target/picture", rgba=rgba, specular=sheet.gloss, shininess=SHININESS, emission=0.0 if sheet.lit else GLOW
    )
    paint.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "target/picture"
    paint.texrepeat = sheet.share
    body.add_geom(
        name="target/picture",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[sheet.width / 2, sheet.height / 2, HALF_THICKNESS_M],
        pos=[0, 0, front + HALF_THICKNESS_M],
        quat=FACE_VIEWER,
        rgba=rgba,
        material="target/picture",
        group=TARGET_GROUP,
        contype=0,
        conaffinity=0,
        mass=0,
    )
    return front + 2 * HALF_THICKNESS_M


def add_body(scene: mujoco.MjSpec, body: mujoco.MjsBody, solid: Body | Globe) -> None:
    """A target's solid, without collisions. MuJoCo smooths the shading of curved surfaces."""
    rgba = [*(c if solid.lit else c / GLOW for c in solid.rgb), 1.0]
    paint = scene.add_material(name="target/solid", rgba=rgba, specular=0, shininess=0, emission=0.0 if solid.lit else GLOW)
    geom = body.add_geom(name="target/solid", rgba=rgba, material=paint.name, group=TARGET_GROUP, contype=0, conaffinity=0, mass=0)
    if isinstance(solid, Globe):
        # Its outline is measured: with MuJoCo's own 28 facets round the equator it would be a polygon .6 % of the radius too small.
        scene.visual.quality.numslices, scene.visual.quality.numstacks = 2 * FACETS, FACETS
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [solid.radius, 0, 0]
        return
    scene.meshdir = ASSETS
    scene.assets = {**scene.assets, f"{ASSETS}/target_solid.stl": as_stl(solid.triangles)}
    mesh = scene.add_mesh(name="target/solid", file="target_solid.stl")
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # it need not be closed
    geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, "target/solid"
