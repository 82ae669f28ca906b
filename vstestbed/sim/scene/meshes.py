"""The visible geoms of a scene: their groups,
and their triangles for viewers that have no MuJoCo.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import FLIP, Array
from vstestbed.effects.base import RANGE_GROUP
from vstestbed.sim.scene.joint_chain import placed, turned

__all__ = [
    "CORNERS",
    "FACE_VIEWER",
    "GLOW",
    "HAND_PLATE",
    "LENS_GROUP",
    "OF_FILES",
    "ROBOT_GROUP",
    "SITE_GROUP",
    "TARGET_GROUP",
    "Pane",
    "Solid",
    "own_colours",
    "panes",
    "solids",
    "texels_of",
    "texture_of",
]

# MuJoCo's default colour of a geom, for which its material's is used
PLAIN_RGBA = (0.5, 0.5, 0.5, 1.0)
PAPER_RGB = (0.96, 0.96, 0.96)
PRINT_M = 2e-4  # distance of a print before its box [m]
ENDLESS_M = 20.0
CORNERS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # of a box of half sizes 1
# facets of round geoms round the axis, and from the equator to a pole
AROUND = 24
ALONG = 8


@dataclass(frozen=True)
class Solid:
    """Triangles of one colour that are fixed to a body.

    body: number of the body. vertices: (V, 3) in its frame [m]. faces: (F, 3) counter-clockwise
    from outside.
    """

    body: int
    vertices: Array
    faces: NDArray[np.int_]
    rgb: tuple[float, float, float]


@dataclass(frozen=True)
class Pane:
    """A picture on a flat geom that is fixed to a body.

    body: number of the body. T_body_pane: its middle, x to the picture's right, y down, z away from
    who sees it, shape (4, 4).
    width, height: [m]. image: (H, W, 3) uint8 RGB.
    """

    body: int
    T_body_pane: Array
    width: float
    height: float
    image: NDArray[np.uint8]


def panes(model: mujoco.MjModel) -> list[Pane]:
    """The pictures of a scene: what is printed on the front of a target's boxes, as tags are."""
    found = []
    for i in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX):
        texture = texture_of(model, int(i))
        if texture < 0 or not _shows_print(model, int(i)):
            continue
        R = turned(model.geom_quat[i])
        half = model.geom_size[i].astype(float)
        # of a geom's texture y is up
        T = placed(model.geom_pos[i] + (half[2] + PRINT_M) * R[:, 2], R) @ FLIP
        share = np.minimum(model.mat_texrepeat[model.geom_matid[i]], 1.0)
        image = texels_of(model, texture)
        columns = max(1, round(image.shape[1] * share[0].item()))
        rows = max(1, round(image.shape[0] * share[1].item()))
        width, height = (2 * half[:2]).tolist()
        shown = image[:rows, :columns].copy()
        found.append(Pane(int(model.geom_bodyid[i]), T, width, height, shown))
    return found


def texels_of(model: mujoco.MjModel, texture: int) -> NDArray[np.uint8]:
    """A texture's pixels (H, W, 3), which may be written to where it has colours."""
    height = model.tex_height[texture]
    width = model.tex_width[texture]
    channels = model.tex_nchannel[texture]
    start = model.tex_adr[texture]
    pixels = model.tex_data[start : start + height * width * channels]
    pixels = pixels.reshape(height, width, channels)
    return pixels[..., :3] if channels >= 3 else np.broadcast_to(pixels, (height, width, 3))


def _shows_print(model: mujoco.MjModel, i: int) -> bool:
    box = model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX
    return bool(box and model.geom_group[i] == TARGET_GROUP)


def texture_of(model: mujoco.MjModel, i: int) -> int:
    """The number of the texture on a geom; -1 for none."""
    material = int(model.geom_matid[i])
    return (
        int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]) if material >= 0 else -1
    )


def solids(model: mujoco.MjModel) -> list[Solid]:
    """The visible geoms of a scene but its own floor, joined by body and colour; of infinite planes
    ENDLESS_M to each side.

    What is printed on a target is in `panes`.
    """
    found: dict[tuple[int, tuple[float, float, float]], list[Array]] = {}
    for i in range(model.ngeom):
        unseen = (
            model.geom_group[i] == RANGE_GROUP
            or model.geom_rgba[i, 3] == 0
            or model.geom(i).name == HAND_PLATE
        )
        # viewers have their own
        if unseen or (
            model.geom_type[i] == mujoco.mjtGeom.mjGEOM_PLANE and model.geom(i).name == "floor"
        ):
            continue
        triangles = _triangles(model, i) @ turned(model.geom_quat[i]).T + model.geom_pos[i]
        found.setdefault((int(model.geom_bodyid[i]), _colour(model, i)), []).append(triangles)
    joined = []
    for (body, rgb), parts in found.items():
        # corners are not shared: every face keeps its own normal
        vertices = np.concatenate(parts).reshape(-1, 3)
        joined.append(Solid(body, vertices, np.arange(len(vertices)).reshape(-1, 3), rgb))
    return joined


def own_colours(model: mujoco.MjModel) -> Array:
    """The colours (G, 4) of the geoms, without light and textures: their own, or where that is the
    default their material's.
    """
    rgba = model.geom_rgba.astype(float)
    painted = model.geom_matid >= 0
    plain = painted & np.isclose(rgba, PLAIN_RGBA).all(axis=1)
    rgba[plain] = model.mat_rgba[model.geom_matid[plain]]
    return rgba


def _colour(model: mujoco.MjModel, i: int) -> tuple[float, float, float]:
    colour = own_colours(model)[i]
    material = int(model.geom_matid[i])
    if material < 0:
        return _rgb(colour)
    texture = texture_of(model, i)
    if texture >= 0 and _shows_print(model, i):
        return PAPER_RGB
    if texture >= 0:
        colour[:3] *= texels_of(model, texture).mean(axis=(0, 1)) / 255
    return _rgb(colour * max(1.0, float(model.mat_emission[material])))


def _rgb(rgba: Array) -> tuple[float, float, float]:
    r, g, b = np.clip(np.round(rgba[:3], 3), 0.0, 1.0).tolist()
    return r, g, b


def _triangles(model: mujoco.MjModel, i: int) -> Array:
    """Triangles (F, 3, 3) in the geom's frame, counter-clockwise from outside."""
    kind = int(model.geom_type[i])
    size = model.geom_size[i].astype(float)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[i])
        first = int(model.mesh_vertadr[mesh])
        count = int(model.mesh_vertnum[mesh])
        faces = model.mesh_face[int(model.mesh_faceadr[mesh]) :][: int(model.mesh_facenum[mesh])]
        return model.mesh_vert[first : first + count].astype(float)[faces]
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        x, y = np.where(size[:2] > 0, size[:2], ENDLESS_M).tolist()
        corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        return corners[[[0, 1, 2], [0, 2, 3]]]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _hull(CORNERS * size)
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _hull(np.concatenate([_ring(size[0], z) for z in (-size[1], size[1])]))
    if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
        return _hull(_ball() * size)
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
        ball = _ball() * size[0]  # of a sphere the second size is 0
        return _hull(np.concatenate([ball + [0, 0, z] for z in (-size[1], size[1])]))
    return np.zeros((0, 3, 3))  # height fields and the like, which no bundled scene has


def _ring(radius: float, z: float) -> Array:
    """Points (AROUND, 3) on a circle about the z axis."""
    turn = np.arange(AROUND) * (2 * math.pi / AROUND)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn), np.full(AROUND, z)])


def _ball() -> Array:
    """Points on a unit sphere, from pole to pole."""
    angles = np.linspace(-math.pi / 2, math.pi / 2, 2 * ALONG + 1)
    return np.concatenate([_ring(math.cos(angle), math.sin(angle)) for angle in angles])


def _hull(points: Array) -> Array:
    """The surface of the convex hull of points (N, 3), as `_triangles`."""
    from scipy.spatial import ConvexHull  # here: viewers alone need it

    hull = ConvexHull(points)
    triangles = points[hull.simplices]
    a, b, c = triangles.transpose(1, 0, 2)
    # Qhull leaves open from which side they are counter-clockwise
    inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0
    triangles[inwards] = triangles[inwards, ::-1]
    return triangles


# Groups of the scene's geoms, by which renderers and rays choose (0 the room, and these), a name,
# and how flat things face and glow.
LENS_GROUP = 1
ROBOT_GROUP = 2
TARGET_GROUP = 3
SITE_GROUP = 4
"""What encloses the lens, the robot, the target, sites; besides them RANGE_GROUP, which no picture
shows.
"""
OF_FILES = {0: ROBOT_GROUP, 3: RANGE_GROUP, 4: RANGE_GROUP}
"""Groups of a robot's file in the scene: by the usual custom 0 to 2 are drawn, and from 3 on there
are shapes for contacts alone.
"""
HAND_PLATE = "hand_plate"  # name of the plate in reserve
FACE_VIEWER = (0, 1, 0, 0)
"""A half turn about x (wxyz): the face that MuJoCo draws a texture on upright, +z with y up, looks
at the viewer, y down.
"""
GLOW = 1000.0
"""Emission of an unlit marker, whose own colour is divided by it: emission gives the exact colour
255 * rgba, and what the scene's lights add (the plain colour times their brightness) is under half
a grey level.
"""
