"""Shading of ray hits: MuJoCo's materials under its lights, flat textures, the sky."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.sim.gl_context import repeated
from vstestbed.sim.scene.meshes import TARGET_GROUP, own_colours, texels_of

__all__ = ["Paint"]


class Mipmap:
    """A texture (H, W, 3) uint8 and its copies of half the size, a quarter, ... down to one texel,
    one after another in one table.

    It repeats itself beyond its edges.
    """

    def __init__(self, texels: NDArray[np.uint8]):
        levels = [texels]
        while max(levels[-1].shape[:2]) > 1:
            levels.append(_halved(levels[-1]))
        self.table = np.concatenate([level.reshape(-1, 3) for level in levels])
        self._height, self._width = np.array([level.shape[:2] for level in levels]).T
        self._start = np.concatenate([[0], np.cumsum(self._height * self._width)[:-1]])

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the texture [texel]."""
        return int(self._width[0]), int(self._height[0])

    @property
    def levels(self) -> list[tuple[int, int, int]]:
        """Of each level its first texel in the table, width and height."""
        return np.stack([self._start, self._width, self._height], axis=1).tolist()

    def at(self, place: Array, texels: Array) -> NDArray[np.float32]:
        """Colours (N, 3), 1 for full brightness, at places (N, 2), as shares of the width from the
        left and of the height from the top.

        texels: across a pixel there, (N,). Linear between the centres of texels, and between the
        two levels whose texels are next to a pixel's size (trilinear); the first level where a
        texel is larger than a pixel.

        Reference: Williams 1983, Pyramidal parametrics, doi:10.1145/800059.801126.
        """
        level = np.clip(np.log2(np.maximum(texels, 1e-9)), 0, len(self._start) - 1)
        fine = level.astype(int)
        part = (level - fine).astype(np.float32)
        colours = self._between(place, fine)
        mixed = np.flatnonzero(part)
        if len(mixed):
            share = part[mixed, None]
            coarse = self._between(place[mixed], fine[mixed] + 1)
            colours[mixed] = (1 - share) * colours[mixed] + share * coarse
        return colours

    def aslant(self, place: Array, steps: Sequence[Array], most: int) -> NDArray[np.float32]:
        """Colours (N, 3) of pixels that cover a long strip of the texture: means of up to `most`
        samples along it, each by `at`.

        steps: from one pixel to the next along two axes, as shares of the texture's width and
            height, (N, 2) each.

        Reference: McCormack, Perry, Farkas & Jouppi 1999, Feline: fast elliptical lines for
        anisotropic texture mapping, doi:10.1145/311535.311562.
        """
        lengths = [np.hypot(step[:, 0] * self.size[0], step[:, 1] * self.size[1]) for step in steps]
        first = (lengths[0] >= lengths[1])[:, None]
        along = np.where(first, *steps)
        longer = np.maximum(*lengths)
        shorter = np.minimum(*lengths)
        samples = np.clip(np.ceil(longer / np.maximum(shorter, 1e-9) - 0.01), 1, most).astype(int)
        texels = np.maximum(longer / samples, shorter)
        colours = np.zeros((len(place), 3), np.float32)
        for k in range(int(samples.max(initial=0))):
            on = np.flatnonzero(samples > k)
            n = samples[on]
            there = place[on] + along[on] * ((k + 0.5) / n - 0.5)[:, None]
            sample = self.at(there - np.floor(there), texels[on])
            colours[on] += sample / n[:, None].astype(np.float32)
        return colours

    def _between(self, place: Array, level: NDArray[np.int_]) -> NDArray[np.float32]:
        """Linear interpolation between the four texels round places (N, 2),
        each at its level (N,).
        """
        width = self._width[level]
        height = self._height[level]
        start = self._start[level]
        u = place[:, 0] * width - 0.5
        v = place[:, 1] * height - 0.5
        left = np.floor(u).astype(int)
        top = np.floor(v).astype(int)
        across = (u - left).astype(np.float32)[:, None]
        down = (v - top).astype(np.float32)[:, None]
        columns = left % width, (left + 1) % width
        rows = start + top % height * width, start + (top + 1) % height * width
        table = self.table
        upper, lower = (
            (1 - across) * table[row + columns[0]] + across * table[row + columns[1]]
            for row in rows
        )
        return np.asarray(((1 - down) * upper + down * lower) / 255, np.float32)


def _halved(texels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Half of the rows and columns: means of two by two texels; of an odd number, interpolated so
    that nothing is shifted.
    """
    half = texels.astype(np.float32)
    for _ in ("rows", "columns"):
        n = len(half)
        if n > 1:
            at = (np.arange(n // 2) + 0.5) * n / (n // 2) - 0.5
            low = at.astype(int)
            share = (at - low).astype(np.float32)[:, None, None]
            half = (1 - share) * half[low] + share * half[low + 1]
        half = half.swapaxes(0, 1)
    return (half + 0.5).astype(np.uint8)


RGB_ROLE = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
SKYBOX = int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)
FLAT_TEXTURE = int(mujoco.mjtTexture.mjTEXTURE_2D)
DIRECTIONAL = int(mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
SPOT = int(mujoco.mjtLightType.mjLIGHT_SPOT)
BOX = int(mujoco.mjtGeom.mjGEOM_BOX)
FLAT = int(mujoco.mjtGeom.mjGEOM_PLANE), BOX  # shapes on whose faces a texture lies flat


class Paint:
    """Colours of a scene as OpenGL's fixed pipeline makes them, without shadows, mirrors, and
    highlights but of pictures and floor.

    colour = min(1, rgb (emission + sum over lights of (ambient + diffuse max(0, n . l)))) texture,
    l towards the light.

    A light that is not directional has l and its brightness by the place: over the attenuation a +
    b d + c d^2, of a spot light times cos(angle)^exponent within its cutoff. OpenGL has that at the
    corners of a surface alone, and its mean between them. On planes and boxes a flat texture
    (`type="2d"`) lies as it is (the floor's checker, tags, pictures); any other textured geom,
    round, of a mesh or with a cube texture, has its texture's mean colour (`averaged`).

    model, data: the scene; lights are where `data` has them. Its attributes are what the kernels of
    `warp_kernels` work with.
    anisotropy: samples of a texture that is not repeated in a pixel that sees it aslant, see
    `Camera`.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, anisotropy: int = 1):
        self._model = model
        self._data = data
        self.anisotropy = anisotropy
        material = model.geom_matid
        painted = material >= 0
        rgb = own_colours(model)[:, :3]
        emission = np.zeros(model.ngeom)
        emission[painted] = model.mat_emission[material[painted]]
        texture = np.full(model.ngeom, -1)
        texture[painted] = model.mat_texid[material[painted], RGB_ROLE]
        flat = np.append(model.tex_type == FLAT_TEXTURE, False)[texture]  # -1: none
        printed = flat & np.isin(model.geom_type, FLAT)
        self.printed: list[int] = np.flatnonzero(printed).tolist()
        self.averaged: list[int] = np.flatnonzero((texture >= 0) & ~printed).tolist()
        self.mipmaps = {
            i: Mipmap(texels_of(model, i)) for i in sorted({int(texture[g]) for g in self.printed})
        }
        self.texture = texture
        self.repeated = repeated(model)
        floor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "floor")
        shows = (model.geom_group == TARGET_GROUP) | (np.arange(model.ngeom) == floor)
        self.glossy = {g for g in self.printed if shows[g] and model.mat_specular[material[g]] > 0}
        self._local = bool((model.light_type[model.light_active] != DIRECTIONAL).any())
        for g in self.averaged:
            rgb[g] *= texels_of(model, int(texture[g])).mean(axis=(0, 1)) / 255
        self.rgb = np.vstack([rgb, [0, 0, 0]]).astype(np.float32)  # the last row: no hit, geom -1
        self.glow = np.append(emission, 0).astype(np.float32)
        self.sky = _sky(model)

    def colours(
        self,
        origin: Array,
        rays: Array,
        geom: NDArray[np.int32],
        distance: Array,
        normal: Array,
        apart: Array,
    ) -> NDArray[np.uint8]:
        """Colours (N, 3) uint8 of what unit rays (N, 3) from `origin` (3,) hit: geoms (N,), -1 for
        the sky, with outward normals (N, 3).

        apart: angle from each ray to the next (N,) [rad], by which textures are smoothed.
        """
        light = self._light(normal)
        if self._local:
            model = self._model
            points = origin + rays * distance[:, None]
            for i in np.flatnonzero(model.light_active & (model.light_type != DIRECTIONAL)):
                to, share = self._towards(int(i), points)
                facing = np.maximum((to * normal).sum(axis=1), 0.0)
                lit = model.light_ambient[i][:, None] + model.light_diffuse[i][:, None] * facing
                light += (share * lit).astype(np.float32)
        light += self.glow[geom]
        light *= self.rgb.T[:, geom]
        colour = np.minimum(light, 1, out=light)
        for printed in self.printed:
            at = np.flatnonzero(geom == printed)
            if len(at):
                points = origin + rays[at] * distance[at, None]
                seen = printed, points, rays[at], normal[at]
                colour[:, at] *= self._print(*seen, apart[at] * distance[at]).T
                if printed in self.glossy:
                    colour[:, at] = np.minimum(1, colour[:, at] + self._highlight(*seen))
        sky = np.flatnonzero(geom == -1)
        if len(sky):
            elevation, tints = self.sky
            up = rays[sky, 2]
            for channel, tint in zip(colour, tints.T, strict=True):
                channel[sky] = np.interp(up, elevation, tint)
        colour *= 255
        colour += 0.5
        return np.ascontiguousarray(colour.T.astype(np.uint8))

    def _light(self, normal: Array) -> NDArray[np.float32]:
        """Irradiance of surfaces with outward normals (N, 3) by directional lights: (3, N), 1 for
        full brightness.
        """
        model = self._model
        light = np.empty((3, len(normal)), np.float32)
        on = np.flatnonzero(model.light_active & (model.light_type == DIRECTIONAL))
        light[:] = model.light_ambient[on].sum(axis=0)[:, None]
        # Channels first and single floats: three long contiguous rows, which numpy adds up
        # quickest.
        x, y, z = np.ascontiguousarray(normal.T, dtype=np.float32)
        for i in on:
            a, b, c = -self._data.light_xdir[i].astype(np.float32)
            facing = np.maximum(a * x + b * y + c * z, 0)
            for channel, brightness in zip(light, model.light_diffuse[i], strict=True):
                channel += facing * np.float32(brightness)
        return light

    def _print(
        self, geom: int, points: Array, rays: Array, normal: Array, across: Array
    ) -> NDArray[np.float32]:
        """The texture of a plane or a box at points (N, 3) [m] in the world with normals (N, 3),
        seen by unit rays (N, 3): colours (N, 3).

        On a face with axes i < j it is stretched over its width from the upper left corner on,
        upright along j. It is repeated texrepeat times, with texuniform as often again as the
        geom's half sizes x and y have metres. On an endless plane it begins in the middle.

        across: size of a pixel there, across the ray (N,) [m].
        """
        model = self._model
        data = self._data
        R = data.geom_xmat[geom].reshape(3, 3)
        half = model.geom_size[geom]
        local = (points - data.geom_xpos[geom]) @ R
        k = np.arange(len(points))
        faces = np.full(len(points), 2)
        if model.geom_type[geom] == BOX:
            faces = np.abs(normal @ R).argmax(axis=1)
        i = np.array([1, 0, 0])[faces]
        j = np.array([2, 2, 1])[faces]
        size = np.where(half > 0, half, 1.0)
        material = model.geom_matid[geom]
        times = model.mat_texrepeat[material]
        if model.mat_texuniform[material]:
            times = times * size[:2]
        begins = np.where(half[:2] > 0, 0.5 * times, 0.5)
        edges = 2 * np.column_stack([size[i], size[j]])
        place = np.column_stack([local[k, i], -local[k, j]]) / edges * times + begins
        mipmap = self.mipmaps[self.texture[geom]]
        cosine = np.maximum(np.abs(np.einsum("ni,ni->n", rays, normal)), 1e-6)
        if self.anisotropy == 1 or self.repeated[self.texture[geom]]:
            texels = across / cosine * (times * mipmap.size / edges).max(axis=1)
            return mipmap.at(place - np.floor(place), texels)
        # A pixel covers `across` / cosine along the ray's shadow on the face, and `across` at a
        # right angle to it.
        shadow = rays - np.einsum("ni,ni->n", rays, normal)[:, None] * normal
        # seen at a right angle: any direction on the face will do
        steep = np.linalg.norm(shadow, axis=1) < 1e-9
        shadow[steep] = R.T[i[steep]]
        shadow /= np.linalg.norm(shadow, axis=1)[:, None]
        first = (shadow * (across / cosine)[:, None]) @ R
        second = (np.cross(normal, shadow) * across[:, None]) @ R
        steps = [
            np.column_stack([step[k, i], -step[k, j]]) / edges * times for step in (first, second)
        ]
        return mipmap.aslant(place, steps, self.anisotropy)

    def _towards(self, i: int, points: Array) -> tuple[Array, Array]:
        """Unit vectors (N, 3), or (3,), from points (N, 3) to light i, and what share of its light
        gets there (N,).
        """
        model = self._model
        data = self._data
        if model.light_type[i] == DIRECTIONAL:
            return -data.light_xdir[i], np.ones(len(points))
        to = data.light_xpos[i] - points
        far = np.maximum(np.linalg.norm(to, axis=1), 1e-9)
        to /= far[:, None]
        a, b, c = model.light_attenuation[i].tolist()
        share = 1.0 / np.maximum(a + b * far + c * far * far, 1e-9)
        if model.light_type[i] == SPOT:
            along = np.clip(-(to @ data.light_xdir[i]), 0.0, 1.0)
            within = along >= np.cos(np.radians(model.light_cutoff[i]))
            share *= np.where(within, along ** model.light_exponent[i], 0.0)
        return to, share

    def _highlight(
        self, geom: int, points: Array, rays: Array, normal: Array
    ) -> NDArray[np.float32]:
        """What a glossy geom mirrors of the lights at points (N, 3) with normals (N, 3), seen by
        unit rays (N, 3): (3, N).

        specular (h . n)^(128 shininess), with h halfway between the directions to the light and to
        the camera.

        Reference: Blinn 1977, Models of light reflection for computer synthesized pictures,
            doi:10.1145/563858.563893.
        """
        model = self._model
        total = np.zeros((3, len(points)))
        material = model.geom_matid[geom]
        for i in np.flatnonzero(model.light_active & (model.light_specular > 0).any(axis=1)):
            to, share = self._towards(int(i), points)
            half = to - rays
            half /= np.maximum(np.linalg.norm(half, axis=1), 1e-9)[:, None]
            cosine = np.clip((half * normal).sum(axis=1), 0, 1)
            lit = share * ((to * normal).sum(axis=-1) > 0)
            lit *= cosine ** (128 * model.mat_shininess[material])
            total += model.mat_specular[material] * model.light_specular[i][:, None] * lit
        return total.astype(np.float32)


def _sky(model: mujoco.MjModel) -> tuple[Array, NDArray[np.float32]]:
    """A sky that depends on the elevation alone: sines (M,) of elevations, rising, and colours (M,
    3) there; black without a skybox.
    """
    for texture in np.flatnonzero(model.tex_type == SKYBOX):
        faces = texels_of(model, int(texture)).astype(np.float32) / np.float32(255)
        side = faces.shape[1]
        if len(faces) != 6 * side:  # right, left, up, down, front, back
            continue
        # the middle column, from 1 (top) to -1
        middle = side // 2
        along = 1 - (2 * np.arange(side) + 1) / side
        sine = along / np.sqrt(1 + along * along)  # of rows of a wall
        slope = 1 / np.sqrt(1 + along * along)  # and of the ceiling's, which rise to its middle
        right, _, up, down, _, _ = np.split(faces, 6)
        sines = np.concatenate([-slope[:middle], sine[::-1], slope[:middle]])
        tints = np.concatenate([down[:middle, middle], right[::-1, middle], up[:middle, middle]])
        order = np.argsort(sines)
        return sines[order], tints[order]
    return np.zeros(1), np.zeros((1, 3), np.float32)
