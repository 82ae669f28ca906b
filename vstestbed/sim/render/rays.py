"""Pictures without OpenGL: every pixel's own ray through the lens, cast into the scene by MuJoCo."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Look, Panel, Perspective, Window
from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.core.geometry import FLIP, Array
from vstestbed.sim.render import gl_probe as gl
from vstestbed.sim.render.noise import noisy
from vstestbed.sim.render.shade import Paint
from vstestbed.sim.scene.compose import LENS_GROUP
from vstestbed.sim.scene.stage import Stage

RENDERER = "rays (mj_multiRay)"
BLANK = 128
"""Grey level outside of the windows that somebody looks at: of no colour, and of no pattern."""
MOST_RAYS = 1 << 15
"""Rays shaded at a time: their hits and normals stay in the cache (640 x 480: 90 ms instead of 110)."""
TILE_PX = 48
"""Side of the pieces in which a picture is cast: small ones have few things before them, and each costs 40 us."""
FAR = 1e10
"""Rays have no end [m]."""
NO_RAY = -2
"""Instead of a geom where the lens has no ray; -1 is the sky, as MuJoCo says it."""


class Caster:
    """Casts rays from one point and tells their colours.

    Things whose bounding sphere no ray of a bundle can meet are left out of its cast. `mj_multiRay` has such a cut of its
    own, by angles of a thing's corners, which (MuJoCo 3.17) cuts off parts of things: it is switched off, in a model of
    its own, by taking away the bodies' bounding volumes.

    Args:
        stage: the scene. outside: whether what encloses the servo camera's lens is seen too.
    """

    def __init__(self, stage: Stage, outside: bool = False):
        self._data = stage.data
        self._model = copy.copy(stage.model)
        self._model.body_bvhadr[:] = -1
        self.paint = Paint(stage.model, stage.data)
        self._shown = np.ones(stage.model.ngeom, dtype=bool) if outside else stage.model.geom_group != LENS_GROUP
        self._endless = stage.model.geom_rbound <= 0
        self._groups = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)

    def cast(self, T_world_camera: Array, bundles: list[Array]) -> tuple[Image, NDArray[np.int32]]:
        """Colours (N, 3) and geoms (N,) of what unit rays in the camera's frame hit, bundle after bundle; -1 is the sky.

        Where there is no ray (NaN) the colour is black, the geom -2. A bundle (n, 3) is best narrow.
        """
        turn = np.ascontiguousarray(T_world_camera[:3, :3].T)
        rays = np.concatenate([bundle @ turn for bundle in bundles])  # one large product would be handed to threads: 30 times slower
        n = len(rays)
        geoms, distance, normal = np.full(n, NO_RAY, np.int32), np.zeros(n), np.zeros((n, 3))
        origin = np.ascontiguousarray(T_world_camera[:3, 3])
        seen = np.isfinite(rays[:, 0])
        whole, start = bool(seen.all()), 0
        for bundle in bundles:
            part = slice(start, start + len(bundle))
            start = part.stop
            if whole:
                self._hits(origin, rays[part], geoms[part], distance[part], normal[part])
            elif seen[part].any():
                at = part.start + np.flatnonzero(seen[part])
                hit = np.empty(len(at), np.int32), np.empty(len(at)), np.empty((len(at), 3))
                self._hits(origin, rays[at], *hit)
                geoms[at], distance[at], normal[at] = hit
        colours = self.paint.colours(origin, rays, geoms, distance, normal)
        if not whole:
            colours[~seen] = 0
        return colours, geoms

    def _hits(self, origin: Array, rays: Array, geoms: NDArray[np.int32], distance: Array, normal: Array) -> None:
        """Fill in what one bundle of rays (n, 3) hits, where, and with which normals."""
        model, n = self._model, len(rays)
        model.geom_group[:] = np.where(self._shown & self._within_reach(origin, _cone(rays)), 0, 1)
        flat, normals = rays.reshape(-1), normal.reshape(-1)
        mujoco.mj_multiRay(model, self._data, origin, flat, self._groups, True, -1, geoms, distance, normals, n, FAR)

    def _within_reach(self, origin: Array, cone: tuple[Array, float]) -> NDArray[np.bool_]:
        """Which geoms have a bounding sphere that reaches into a cone from `origin`."""
        return self._endless | _meets(self._data.geom_xpos - origin, self._model.geom_rbound, *cone)


def _cone(rays: Array) -> tuple[Array, float]:
    """Axis (3,) and half angle [rad] of a cone that holds unit rays (n, 3): their mean, and the farthest from it."""
    axis = rays.sum(axis=0)
    size = math.sqrt(float(axis @ axis))
    if size < 1e-6 * len(rays):
        return np.array([0, 0, 1.0]), math.pi
    axis /= size
    return axis, math.acos(max(-1.0, min(1.0, float((rays @ axis).min()))))


def _meets(centres: Array, radii: Array, axis: Array, half_angle: float) -> NDArray[np.bool_]:
    """Which spheres, of centres (N, 3) as seen from a cone's tip and radii (N,) [m], reach into the cone."""
    far = np.maximum(np.sqrt((centres * centres).sum(axis=1)), 1e-12)
    angle = np.arccos(np.clip(centres @ axis / far, -1, 1))
    return (far <= radii) | (angle <= half_angle + np.arcsin(np.minimum(radii / far, 1)) + 1e-6)


class Raster:
    """A picture's rays, in the frame that they are cast from; `draw` casts those of a window.

    Args:
        lens: through which the picture is seen. R_camera_lens: how it stands in the camera (3, 3).
        samples: n x n rays, n = ceil(sqrt(samples)), in pixels whose neighbours show another thing; 0: one ray through the
            centre of each pixel, as everywhere else.
    """

    def __init__(self, lens: Camera, R_camera_lens: Array, samples: int):
        self.width, self.height = lens.width, lens.height
        self._lens, self._R = lens, R_camera_lens
        n = math.ceil(math.sqrt(samples))
        steps = (np.arange(n) + 0.5) / n - 0.5 if n > 1 else np.zeros(0)
        self._within = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        grid = np.stack(np.meshgrid(np.arange(self.width), np.arange(self.height)), axis=-1).astype(float)
        self._rays = np.concatenate([self._of(rows) for rows in np.array_split(grid, max(1, self.height // 64))])

    def _of(self, uv: Array) -> Array:
        """Rays (..., 3) in the camera's frame of pixels (..., 2)."""
        return self._lens.ray(uv) @ self._R.T

    def rays(self, window: Window) -> Array:
        """Rays (h, w, 3) in the camera's frame of the pixels of a window."""
        left, top, right, bottom = window
        return self._rays[top:bottom, left:right]

    def draw(self, image: Image, windows: tuple[Window, ...], caster: Caster, T_world_camera: Array) -> None:
        """Fill windows of a picture (H, W, 3) with what is seen there."""
        waiting, rays = [], 0
        for tile in (tile for window in windows for tile in _tiles(window)):
            waiting.append(tile)
            rays += (tile[2] - tile[0]) * (tile[3] - tile[1])
            if rays > MOST_RAYS:
                self._draw(image, waiting, caster, T_world_camera)
                waiting, rays = [], 0
        if waiting:
            self._draw(image, waiting, caster, T_world_camera)

    def _draw(self, image: Image, tiles: list[Window], caster: Caster, T: Array) -> None:
        grow = 1 if len(self._within) else 0  # a border is told by a pixel's neighbours
        cut = [(max(0, a - grow), max(0, b - grow), min(self.width, c + grow), min(self.height, d + grow)) for a, b, c, d in tiles]
        parts = [self.rays(window) for window in cut]
        colours, geoms = caster.cast(T, [part.reshape(-1, 3) for part in parts])
        start = 0
        for (a, b, c, d), (left, top, _, _), part in zip(tiles, cut, parts, strict=True):
            end = start + part.shape[0] * part.shape[1]
            drawn = colours[start:end].reshape(part.shape)
            if grow:
                self._refine(drawn, geoms[start:end].reshape(part.shape[:2]), (left, top), caster, T)
            image[b:d, a:c] = drawn[b - top : d - top, a - left : c - left]
            start = end

    def _refine(self, drawn: Image, geoms: NDArray[np.int32], corner: tuple[int, int], caster: Caster, T: Array) -> None:
        """Give pixels at the borders of things the mean colour of many rays."""
        row, column = np.nonzero(_borders(geoms))
        if len(row):
            uv = np.stack([column + corner[0], row + corner[1]], axis=-1)[:, None] + self._within
            colours, _ = caster.cast(T, [self._of(uv).reshape(-1, 3)])
            drawn[row, column] = (colours.reshape(len(row), -1, 3).mean(axis=1) + 0.5).astype(np.uint8)


def _tiles(window: Window) -> Iterator[Window]:
    """A window, in pieces through which few things are seen."""
    left, top, right, bottom = window
    for v in range(top, bottom, TILE_PX):
        for u in range(left, right, TILE_PX):
            yield u, v, min(u + TILE_PX, right), min(v + TILE_PX, bottom)


def _borders(geoms: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which pixels (H, W) have another thing than their own among their eight neighbours."""
    wide = np.pad(geoms, 1, mode="edge")
    height, width = geoms.shape
    near = [wide[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    return np.logical_or.reduce([other != geoms for other in near])


class RayRenderer:
    """The servo camera's picture through any lens, by rays; the same as `OpenGLRenderer` makes with OpenGL, where both can.

    Only the windows that somebody looks at are cast. It has no shadows and no textures (see `refuse`).

    Args:
        stage: the scene. camera: the lens. image_sigma: standard deviation of the noise of each channel, in grey levels
        (of 255). rng: where the noise comes from.

    Raises:
        ParameterError, EnvironmentLackError: rays cannot draw what the scene or the camera asks for.
    """

    def __init__(self, stage: Stage, camera: Camera, image_sigma: float = 0.0, rng: np.random.Generator | None = None):
        self._stage, self._camera, self._caster = stage, camera, Caster(stage)
        refuse(camera, self._caster.paint.textured_target)
        self._sigma, self._rng = image_sigma, rng
        self._rasters: dict[int, Raster] = {}
        self.renderer = RENDERER
        self.spent_s = 0.0
        self.whole = True

    def full_image(self) -> Image:
        """The camera's own picture now, (H, W, 3) uint8 RGB, its own for good."""
        return self._draw(Panel(self._camera, np.eye(3)), -1 if self._camera.panels[0].lens is not self._camera else 0, None)

    def with_noise(self, image: Image) -> Image:
        """A clean picture with the sensor's noise."""
        return noisy(image, self._sigma, self._rng)

    def images(self, look: Look | None = None, clean: bool = False) -> tuple[Image | None, ...]:
        """The pictures now, one a panel, each its own for good.

        look: where somebody is going to look; a panel with no window is left out, others are blank outside of their windows.
        clean: without noise.
        """
        start = time.perf_counter()
        images = []
        for i, panel in enumerate(self._camera.panels):
            windows = None if look is None else look[i]
            images.append(None if windows == () else self._draw(panel, i, windows, clean))
        self.whole = look is None
        self.spent_s += time.perf_counter() - start
        return tuple(images)

    def _draw(self, panel: Panel, name: int, windows: tuple[Window, ...] | None, clean: bool = False) -> Image:
        if name not in self._rasters:
            self._rasters[name] = Raster(panel.lens, panel.R_camera_panel, self._camera.multisampling)
        raster = self._rasters[name]
        image = np.full((raster.height, raster.width, 3), BLANK, np.uint8)
        whole = ((0, 0, raster.width, raster.height),)
        raster.draw(image, whole if windows is None else windows, self._caster, self._stage.camera_pose())
        return image if clean else self.with_noise(image)


def refuse(camera: Camera, textured_target: bool) -> None:
    """Refuse what rays cannot draw.

    Raises:
        ParameterError: rays were asked for. EnvironmentLackError: they are what is left without OpenGL.
    """
    lacks = [words for words, asked in (("textured markers need", textured_target), ("shadows need", camera.shadows)) if asked]
    if lacks and camera.renderer == "rays":
        raise ParameterError("camera.renderer", f"must be gl or auto: {lacks[0]} OpenGL", camera.renderer)
    if lacks:
        raise EnvironmentLackError(f"{lacks[0]} OpenGL", gl.REMEDY)


class RaySceneCamera:
    """One camera of a stage, from outside, by rays: no shadows. Where the camera stands still, only what moved is drawn anew.

    Args:
        stage: the scene. camera: name in the scene. width, height: size of the picture [px]. samples: see Raster.
    """

    renderer = RENDERER

    def __init__(self, stage: Stage, camera: str, width: int, height: int, samples: int = 0):
        self._stage, self._camera, self._caster = stage, camera, Caster(stage, outside=True)
        lens = Perspective(width=width, height=height, fovy_deg=float(stage.model.camera(camera).fovy[0]))
        self._raster = Raster(lens, np.eye(3), samples)
        self._tiles = [(tile, _cone(self._raster.rays(tile).reshape(-1, 3))) for tile in _tiles((0, 0, width, height))]
        self._pixel = 2 / lens.f if samples else 0.0
        """What neighbours may add to a tile's cone [rad]."""
        self._image = np.empty((height, width, 3), np.uint8)
        self._before: tuple[Array, Array, Array] | None = None

    def full_image(self) -> Image:
        """The picture now, (H, W, 3) uint8 RGB, its own for good."""
        data = self._stage.data
        seen_from, T = data.camera(self._camera), np.eye(4)
        T[:3, :3], T[:3, 3] = seen_from.xmat.reshape(3, 3) @ FLIP[:3, :3], seen_from.xpos
        stale = tuple(tile for tile, cone in self._tiles if self._changed(T, cone))
        self._raster.draw(self._image, stale, self._caster, T)
        self._before = T, data.geom_xpos.copy(), data.geom_xmat.copy()
        return self._image.copy()

    def _changed(self, T: Array, cone: tuple[Array, float]) -> bool:
        """Whether something within a cone of the camera (axis in its frame) has moved since the last picture."""
        if self._before is None or not np.array_equal(self._before[0], T):
            return True
        data, bound = self._stage.data, self._stage.model.geom_rbound
        _, position, attitude = self._before
        moved = (data.geom_xpos != position).any(axis=1) | (data.geom_xmat != attitude).any(axis=1)
        spheres = np.concatenate([position[moved], data.geom_xpos[moved]]) - T[:3, 3]
        radii = np.tile(np.where(bound > 0, bound, np.inf)[moved], 2)
        return bool(_meets(spheres, radii, T[:3, :3] @ cone[0], cone[1] + self._pixel).any())
