"""The visible geoms of a scene as triangles, for viewers that have no MuJoCo."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.sim.scene.compose import HAND_PLATE
from vstestbed.sim.scene.groups import RANGE_GROUP, TARGET_GROUP

PLAIN_RGBA = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's default colour of a geom, for which its material's is used."""
ENDLESS_M = 20.0
AROUND, ALONG = 24, 8
"""Facets of round geoms round the axis, and from the equator to a pole."""


@dataclass(frozen=True)
class Solid:
    """Triangles of one colour that are fixed to a body.

    Attributes:
        body: number of the body. vertices: (V, 3) in its frame [m]. faces: (F, 3) counter-clockwise from outside.
    """

    body: int
    vertices: Array
    faces: NDArray[np.int_]
    rgb: tuple[float, float, float]


def solids(model: mujoco.MjModel) -> list[Solid]:
    """The visible geoms of a scene but its own floor, joined by body and colour; of infinite planes ENDLESS_M to each side."""
    found: dict[tuple[int, tuple[float, float, float]], list[Array]] = {}
    for i in range(model.ngeom):
        unseen = model.geom_group[i] == RANGE_GROUP or model.geom_rgba[i, 3] == 0 or model.geom(i).name == HAND_PLATE
        if unseen or (model.geom_type[i] == mujoco.mjtGeom.mjGEOM_PLANE and model.geom(i).name == "floor"):  # viewers have their own
            continue
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, model.geom_quat[i])
        for rgb, triangles in _coloured(model, i):
            placed = triangles @ R.reshape(3, 3).T + model.geom_pos[i]
            found.setdefault((int(model.geom_bodyid[i]), rgb), []).append(placed)
    return [_joined(body, rgb, parts) for (body, rgb), parts in found.items()]


def _joined(body: int, rgb: tuple[float, float, float], parts: list[Array]) -> Solid:
    vertices = np.concatenate(parts).reshape(-1, 3)  # corners are not shared: every face keeps its own normal
    return Solid(body, vertices, np.arange(len(vertices)).reshape(-1, 3), rgb)


def _coloured(model: mujoco.MjModel, i: int) -> list[tuple[tuple[float, float, float], Array]]:
    """Colours of geom i, each with its triangles (F, 3, 3) in the geom's frame."""
    triangles, rgba = _triangles(model, i), model.geom_rgba[i].astype(float)
    material = int(model.geom_matid[i])
    if material < 0:
        return [(_rgb(rgba), triangles)]
    texture = int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])
    if texture >= 0 and model.geom_group[i] == TARGET_GROUP and model.geom_type[i] == mujoco.mjtGeom.mjGEOM_BOX:
        return [((0.96, 0.96, 0.96), triangles), *_print(model, texture, model.geom_size[i])]
    colour = model.mat_rgba[material].astype(float) if np.allclose(rgba, PLAIN_RGBA) else rgba
    if texture >= 0:
        colour = colour.copy()
        colour[:3] *= _mean(model, texture)
    return [(_rgb(colour * max(1.0, float(model.mat_emission[material]))), triangles)]


def _mean(model: mujoco.MjModel, texture: int) -> Array:
    """Mean colour (3,) of a texture, 1 for full brightness."""
    count, channels = int(model.tex_height[texture] * model.tex_width[texture]), int(model.tex_nchannel[texture])
    texels = model.tex_data[model.tex_adr[texture] :][: count * channels].reshape(count, channels)
    return np.broadcast_to(texels[:, :3].mean(axis=0) / 255, (3,))


def _rgb(rgba: Array) -> tuple[float, float, float]:
    r, g, b = np.clip(np.round(rgba[:3], 3), 0.0, 1.0).tolist()
    return r, g, b


def _print(model: mujoco.MjModel, texture: int, half: Array) -> list[tuple[tuple[float, float, float], Array]]:
    """The dark fields of a print on the face z = +half[2] of a box, a little before it."""
    height, width = int(model.tex_height[texture]), int(model.tex_width[texture])
    start, channels = int(model.tex_adr[texture]), int(model.tex_nchannel[texture])
    picture = model.tex_data[start : start + height * width * channels].reshape(height, width, channels)[:, :, 0] < 128
    edges = [np.flatnonzero((picture != np.roll(picture, 1, axis)).any(axis=1 - axis)) for axis in (0, 1)]
    module = max(1, math.gcd(height, width, *(int(e) for e in np.concatenate(edges))))
    rows, columns = np.nonzero(picture[module // 2 :: module, module // 2 :: module])
    dx, dy = 2 * half[0] * module / width, 2 * half[1] * module / height
    corners = np.array([[0, 0], [0, 1], [1, 1], [0, 0], [1, 1], [1, 0]])  # counter-clockwise seen from +z, y up
    x = -half[0] + (columns[:, None] + corners[:, 0]) * dx
    y = half[1] - (rows[:, None] + corners[:, 1]) * dy
    z = np.full_like(x, half[2] + 2e-4)
    return [((0.05, 0.05, 0.05), np.stack([x, y, z], axis=-1).reshape(-1, 3, 3))]


def _triangles(model: mujoco.MjModel, i: int) -> Array:
    """Triangles (F, 3, 3) of geom i in its own frame."""
    kind, size = int(model.geom_type[i]), model.geom_size[i].astype(float)
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = int(model.geom_dataid[i])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        faces = model.mesh_face[int(model.mesh_faceadr[mesh]) :][: int(model.mesh_facenum[mesh])]
        return model.mesh_vert[first : first + count].astype(float)[faces]
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return _box() * size
    if kind == mujoco.mjtGeom.mjGEOM_PLANE:
        return _box()[-2:] * [*np.where(size[:2] > 0, size[:2], ENDLESS_M), 0.0]
    if kind in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_ELLIPSOID):
        return _turned(*_arc(0.0)) * (size if kind == mujoco.mjtGeom.mjGEOM_ELLIPSOID else size[0])
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        radius, z = _arc(size[1] / size[0])
        return _turned(radius, z) * size[0]
    if kind == mujoco.mjtGeom.mjGEOM_CYLINDER:
        return _turned(np.array([0.0, 1.0, 1.0, 0.0]), np.array([-1.0, -1.0, 1.0, 1.0])) * size[[0, 0, 1]]
    return np.zeros((0, 3, 3))  # height fields and the like, which no bundled scene has


def _box() -> Array:
    """A box of half sizes 1."""
    faces = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            corners = np.full((4, 3), side)
            corners[:, (axis + 1) % 3], corners[:, (axis + 2) % 3] = (-1, 1, 1, -1), (-1, -1, 1, 1)  # counter-clockwise seen from +axis
            turned = corners[:: int(side)]
            faces += [turned[[0, 1, 2]], turned[[0, 2, 3]]]
    return np.array(faces)


def _arc(half: float) -> tuple[Array, Array]:
    """Profile of a capsule of radius 1 whose cylinder has this half length, from pole to pole: radii and heights."""
    angle = np.linspace(0, math.pi / 2, ALONG + 1)
    radius, z = np.sin(angle), half + np.cos(angle)
    return np.concatenate([radius, radius[::-1]])[::-1], np.concatenate([z, -z[::-1]])[::-1]


def _turned(radius: Array, z: Array) -> Array:
    """The surface of revolution of a profile from below to above, (F, 3, 3)."""
    turn = np.linspace(0, 2 * math.pi, AROUND + 1)
    points = np.stack([radius[:, None] * np.cos(turn), radius[:, None] * np.sin(turn), np.repeat(z[:, None], AROUND + 1, axis=1)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    faces = np.concatenate([np.stack([a, b, c], axis=-2).reshape(-1, 3, 3), np.stack([a, c, d], axis=-2).reshape(-1, 3, 3)])
    area = np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1)
    return faces[area > 1e-12]
