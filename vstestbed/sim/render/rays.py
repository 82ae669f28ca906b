"""Rendering without OpenGL: one ray through the lens for each pixel,
cast into the scene by MuJoCo.
"""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator
from functools import cached_property
from itertools import chain
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, DepthImage, Image, Panel, Perspective, Regions, Window
from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.core.geometry import Array, lengths, pixel_grid
from vstestbed.imaging.shutter import Rows
from vstestbed.sim import gl_probe as gl
from vstestbed.sim.render.shade import Paint
from vstestbed.sim.scene.meshes import LENS_GROUP, RANGE_GROUP
from vstestbed.sim.scene.scene import Scene
from vstestbed.vision.colour import noise_rows

__all__ = ["Raster", "RayRenderer", "RaySceneCamera"]


def cone_of(rays: Array) -> tuple[Array, float]:
    """Axis (3,) and half angle [rad] of a cone that holds unit rays (n, 3): their mean, and the
    largest angle from it.
    """
    axis = rays.sum(axis=0)
    size = math.sqrt(float(axis @ axis))
    if size < 1e-6 * len(rays):
        return np.array([0, 0, 1.0]), math.pi
    axis /= size
    return axis, math.acos(max(-1.0, min(1.0, float((rays @ axis).min()))))


def meets(centres: Array, radii: Array, axis: Array, half_angle: float) -> NDArray[np.bool_]:
    """Which spheres, of centres (N, 3) relative to a cone's apex and radii (N,) [m], intersect the
    cone.
    """
    far = np.maximum(np.sqrt((centres * centres).sum(axis=1)), 1e-12)
    angle = np.arccos(np.clip(centres @ axis / far, -1, 1))
    return (far <= radii) | (angle <= half_angle + np.arcsin(np.minimum(radii / far, 1)) + 1e-6)


def angles_to_next(rays: Array) -> Array:
    """Angle [rad] from each ray (H, W, 3) to the farther of the next ones across and down, shape
    (H, W); 0 where there is none.
    """
    out = np.zeros(rays.shape[:2])
    for axis in (0, 1):
        if rays.shape[axis] > 1:  # a raster of a very flat picture has one row
            steps = lengths(np.diff(rays, axis=axis))[..., 0]
            last = steps[-1:] if axis == 0 else steps[:, -1:]
            np.fmax(out, np.concatenate([steps, last], axis=axis), out=out)
    return out


ROWS = 32  # rows of an image that are cast at a time: of a narrow bundle most geoms are culled


def ray_depth(rays: Array, T_world_camera: Array, hits: Callable[..., Any]) -> DepthImage:
    """Depth (H, W) [m] along the optical axis of what the unit rays (H, W, 3) in the camera's frame
    hit; inf for nothing.

    hits: `Caster.hits`.
    """
    turn = np.ascontiguousarray(T_world_camera[:3, :3].T)
    origin = np.ascontiguousarray(T_world_camera[:3, 3])
    found = []
    for part in (rays[top : top + ROWS] for top in range(0, len(rays), ROWS)):
        along = part[..., 2]
        n = part[..., 2].size
        geoms = np.empty(n, np.int32)
        distance = np.empty(n)
        normal = np.empty((n, 3))
        hits(origin, part.reshape(-1, 3) @ turn, geoms, distance, normal)
        depth = np.where(geoms >= 0, distance * along.ravel(), np.inf)
        found.append(depth.reshape(along.shape).astype(np.float32))
    return np.concatenate(found)


RENDERER = "rays (mj_multiRay)"
# Grey level outside of the regions of interest: without colour or pattern, so that no detector
# finds a marker there
BLANK = 128
# Rays shaded at a time: their hits and normals stay in the cache (640 x 480: 90 ms instead of 110)
MOST_RAYS = 1 << 15
# Side of the tiles in which an image is cast: a small one has few geoms in view, but each costs 40
# us
TILE_PX = 48
FAR = 1e10  # length of a ray [m]: unlimited in effect
# geom number where the lens has no ray; MuJoCo's -1 is a ray that hits nothing, the sky
NO_RAY = -2


class Caster:
    """Casts rays from one point and shades what they hit.

    Geoms whose bounding sphere no ray of a bundle can meet are culled. `mj_multiRay` culls too, by
    the angles of a geom's corners, which in MuJoCo 3.17 cuts off parts of geoms: that is switched
    off, in a copy of the model, by removing the bodies' bounding volumes.

    stage: the scene. outside: show the geoms that enclose the servo camera's lens.
    """

    def __init__(self, stage: Scene, outside: bool):
        self._data = stage.data
        self._model = copy.copy(stage.model)
        self._model.body_bvhadr[:] = -1
        self.paint = Paint(stage.model, stage.data, stage.parts.camera.anisotropy)
        self._shown = stage.model.geom_group != RANGE_GROUP
        if not outside:
            self._shown &= stage.model.geom_group != LENS_GROUP
        self._endless = stage.model.geom_rbound <= 0
        self._groups = np.array([1, 0, 0, 0, 0, 0], dtype=np.uint8)

    def cast(
        self, T_world_camera: Array, bundles: list[Array], apart: Array
    ) -> tuple[Image, NDArray[np.int32]]:
        """Colours (N, 3) and geoms (N,) of what unit rays in the camera's frame hit, bundle after
        bundle; -1 is the sky.

        Where there is no ray (NaN) the colour is black, the geom -2. Narrow bundles (n, 3) are
        culled best. apart: angle from each ray to the next, (N,) [rad].
        """
        turn = np.ascontiguousarray(T_world_camera[:3, :3].T)
        # One product for all bundles would be handed to BLAS threads: 30 times slower.
        rays = np.concatenate([bundle @ turn for bundle in bundles])
        n = len(rays)
        geoms = np.full(n, NO_RAY, np.int32)
        distance = np.zeros(n)
        normal = np.zeros((n, 3))
        origin = np.ascontiguousarray(T_world_camera[:3, 3])
        seen = np.isfinite(rays[:, 0])
        start = 0
        for bundle in bundles:
            part = slice(start, start + len(bundle))
            start = part.stop
            if seen[part].all():
                self.hits(origin, rays[part], geoms[part], distance[part], normal[part])
            elif seen[part].any():
                at = part.start + np.flatnonzero(seen[part])
                hit = np.empty(len(at), np.int32), np.empty(len(at)), np.empty((len(at), 3))
                self.hits(origin, rays[at], *hit)
                geoms[at], distance[at], normal[at] = hit
        colours = self.paint.colours(origin, rays, geoms, distance, normal, apart)
        if not seen.all():
            colours[~seen] = 0
        return colours, geoms

    def hits(
        self, origin: Array, rays: Array, geoms: NDArray[np.int32], distance: Array, normal: Array
    ) -> None:
        """Fill in the geoms, distances and normals that one bundle of rays (n, 3) hits."""
        model = self._model
        n = len(rays)
        # A plane has no bounding sphere, and always counts.
        near = self._endless | meets(
            self._data.geom_xpos - origin, model.geom_rbound, *cone_of(rays)
        )
        model.geom_group[:] = np.where(self._shown & near, 0, 1)
        flat = rays.reshape(-1)
        normals = normal.reshape(-1)
        mujoco.mj_multiRay(
            model,
            self._data,
            origin,
            flat,
            self._groups,
            True,
            -1,
            geoms,
            distance,
            normals,
            n,
            FAR,
        )


class Raster:
    """The rays of an image in the camera's frame; `draw` casts those of a window.

    Args:
        lens: the lens of the image. R_camera_lens: its orientation in the camera's frame, shape (3,
            3).
        samples: antialiasing: n x n rays, n = ceil(sqrt(samples)), in pixels with a neighbour that
            shows another geom; 0: one ray through the centre of each pixel, as everywhere else.
        share: size of the image as a share of the lens's.
    """

    def __init__(self, lens: Camera, R_camera_lens: Array, samples: int, share: float = 1.0):
        self.width = round(share * lens.width)
        self.height = round(share * lens.height)
        self._lens = lens
        self._R = R_camera_lens
        n = math.ceil(math.sqrt(samples))
        steps = (np.arange(n) + 0.5) / n - 0.5 if n > 1 else np.zeros(0)
        self.within = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        self._share = share

    @cached_property
    def _rays(self) -> Array:
        grid = pixel_grid(self.width, self.height)
        grid = (grid + 0.5) / self._share - 0.5 if self._share < 1 else grid
        return np.concatenate(
            [self._of(rows) for rows in np.array_split(grid, max(1, self.height // 64))]
        )

    @cached_property
    def apart(self) -> Array:
        """Angle from each ray to the next, (H, W) [rad]."""
        return angles_to_next(self._rays)

    def parts(self) -> Array:
        """Rays (H, W, n, 3) through the parts of all pixels."""
        rows = np.array_split(pixel_grid(self.width, self.height), max(1, self.height // 64))
        return np.concatenate([self._of(part[..., None, :] + self.within) for part in rows])

    def _of(self, uv: Array) -> Array:
        return self._lens.ray(uv) @ self._R.T

    def rays(self, window: Window) -> Array:
        """Rays (h, w, 3) in the camera's frame of the pixels of a window."""
        left, top, right, bottom = window
        return self._rays[top:bottom, left:right]

    def grown(self, tile: Window) -> Window:
        """A tile with the pixels around it by which the edges in it are found; itself without
        antialiasing.
        """
        if not len(self.within):
            return tile
        left, top, right, bottom = tile
        return (
            max(0, left - 1),
            max(0, top - 1),
            min(self.width, right + 1),
            min(self.height, bottom + 1),
        )

    def draw(
        self, image: Image, windows: tuple[Window, ...], caster: Caster, T_world_camera: Array
    ) -> None:
        """Render windows of an image (H, W, 3) in place."""
        waiting = []
        rays = 0
        for tile in chain.from_iterable(map(tiles_of, windows)):
            waiting.append(tile)
            rays += (tile[2] - tile[0]) * (tile[3] - tile[1])
            if rays > MOST_RAYS:
                self._draw(image, waiting, caster, T_world_camera)
                waiting = []
                rays = 0
        if waiting:
            self._draw(image, waiting, caster, T_world_camera)

    def _draw(self, image: Image, tiles: list[Window], caster: Caster, T: Array) -> None:
        cut = [self.grown(tile) for tile in tiles]
        parts = [self.rays(window) for window in cut]
        apart = np.concatenate(
            [self.apart[top:bottom, left:right].ravel() for left, top, right, bottom in cut]
        )
        colours, geoms = caster.cast(T, [part.reshape(-1, 3) for part in parts], apart)
        start = 0
        for (a, b, c, d), (left, top, _, _), part in zip(tiles, cut, parts, strict=True):
            end = start + part.shape[0] * part.shape[1]
            drawn = colours[start:end].reshape(part.shape)
            if len(self.within):
                shown = geoms[start:end].reshape(part.shape[:2])
                self._refine(drawn, shown, (left, top), caster, T)
            image[b:d, a:c] = drawn[b - top : d - top, a - left : c - left]
            start = end

    def _refine(
        self,
        drawn: Image,
        geoms: NDArray[np.int32],
        corner: tuple[int, int],
        caster: Caster,
        T: Array,
    ) -> None:
        # pixels with a neighbour, of eight, that shows another geom
        near = np.lib.stride_tricks.sliding_window_view(np.pad(geoms, 1, mode="edge"), (3, 3))
        row, column = np.nonzero((near != geoms[..., None, None]).any(axis=(2, 3)))
        if len(row):
            at = np.stack([column + corner[0], row + corner[1]], axis=-1)
            uv = at[:, None] + self.within
            n = len(self.within)
            apart = np.repeat(self.apart[at[:, 1], at[:, 0]] / math.sqrt(n), n)
            colours, _ = caster.cast(T, [self._of(uv).reshape(-1, 3)], apart)
            mean = colours.reshape(len(row), -1, 3).mean(axis=1)
            drawn[row, column] = (mean + 0.5).astype(np.uint8)


def tiles_of(window: Window) -> Iterator[Window]:
    """The tiles of a window."""
    left, top, right, bottom = window
    for v in range(top, bottom, TILE_PX):
        for u in range(left, right, TILE_PX):
            yield u, v, min(u + TILE_PX, right), min(v + TILE_PX, bottom)


class RayRenderer:
    """The servo camera's images through any lens, by ray casting; the same as `OpenGLRenderer`'s,
    where both can render them.

    Only the regions of interest are cast. There are no shadows and mirrors (`refuse`); `Paint` says
    which textures are mapped. Raises ParameterError, EnvironmentLackError: rays cannot draw what
    the scene or the camera asks for.

    Args:
        stage: the scene. camera: the lens.
        noisy: noise will be added to the images: the rows from which detectors estimate its level
            are always cast.
        share: images for films are smaller (see `Raster`), without antialiasing. eye: name of the
            camera in the scene.
    """

    def __init__(
        self,
        stage: Scene,
        camera: Camera,
        noisy: bool = False,
        share: float = 1.0,
        eye: str = "eye",
    ):
        self._stage = stage
        self._camera = camera
        self._eye = eye
        self._share = share
        self._caster = Caster(stage, outside=stage.parts.stands(eye))
        refuse(camera, stage.parts.world.floor.mirror)
        self._noisy = noisy
        self._rasters: dict[int, Raster] = {}
        self.name = RENDERER
        self.spent_s = 0.0
        self.whole = True
        self.depth: DepthImage | None = None

    def full_image(self) -> Image:
        """The camera's own image now, shape (H, W, 3) uint8 RGB, as a copy."""
        # A lens with panels is cast through its own projection here; number -1 keeps that raster
        # beside those of the panels.
        number = 0 if self._camera.panels[0].lens is self._camera else -1
        return self._draw(Panel(self._camera, np.eye(3)), number, None)

    def images(
        self, regions: Regions | None = None, with_depth: bool = False, rows: Rows | None = None
    ) -> tuple[Image | None, ...]:
        """See `Renderer.images`; copies. A panel without a window is None, others are blank outside
        of theirs.
        """
        start = time.perf_counter()
        images = []
        if with_depth:
            regions = rows = None
        for i, panel in enumerate(self._camera.panels):
            windows = None if regions is None else regions[i]
            image = None if windows == () else self._draw(panel, i, windows, rows)
            images.append(image)
        if with_depth:
            T = self._stage.camera_pose(self._eye)
            self.depth = ray_depth(self._depth_rays, T, self._caster.hits)
        self.whole = regions is None and rows is None
        self.spent_s += time.perf_counter() - start
        return tuple(images)

    @cached_property
    def _depth_rays(self) -> Array:
        """Unit rays (H, W, 3) of the depth picture: those of the colour picture, or of as many
        pixels of the depth camera's own lens.
        """
        width = self._camera.width
        height = self._camera.height
        lens = self._camera.depth_sensor.lens if self._camera.depth_sensor else None
        if lens is None:
            return self._rasters[0].rays((0, 0, width, height))
        xy = (pixel_grid(width, height) - lens.centre) / lens.f
        ray = np.concatenate([xy, np.ones((height, width, 1))], axis=-1)
        return ray / lengths(ray)

    def _draw(
        self, panel: Panel, name: int, windows: tuple[Window, ...] | None, rows: Rows | None = None
    ) -> Image:
        if name not in self._rasters:
            samples = self._camera.multisampling if self._share == 1 else 0
            self._rasters[name] = Raster(panel.lens, panel.R_camera_panel, samples, self._share)
        raster = self._rasters[name]
        image = np.full((raster.height, raster.width, 3), BLANK, np.uint8)
        if windows is None:
            windows = ((0, 0, raster.width, raster.height),)
        elif self._noisy:
            windows += tuple((0, v, raster.width, v + 1) for v in noise_rows(raster.height))
        if rows is not None:
            windows = tuple(
                (a, max(b, rows[0]), c, min(d, rows[1]))
                for a, b, c, d in windows
                if b < rows[1] and d > rows[0]
            )
        self._fill(image, raster, panel, windows)
        return image

    def _fill(
        self, image: Image, raster: Raster, panel: Panel, windows: tuple[Window, ...]
    ) -> None:
        """Draw windows of an image (H, W, 3), the picture of a panel, in place."""
        raster.draw(image, windows, self._caster, self._stage.camera_pose(self._eye))


def refuse(camera: Camera, mirror: float) -> None:
    """Refuse shadows and a floor that mirrors, which rays cannot draw.

    Raises ParameterError: rays were asked for. EnvironmentLackError: they are what is left without
    OpenGL.
    """
    if camera.shadows:
        what = "shadows need OpenGL"
    elif mirror:
        what = "a floor that mirrors needs OpenGL"
    else:
        return
    if camera.renderer == "rays":
        raise ParameterError.fixed("camera.renderer", "gl or auto", camera.renderer, why=what)
    raise EnvironmentLackError(what, gl.remedy())


class RaySceneCamera:
    """A camera of a stage that films from outside, by rays, without shadows.

    stage: the scene. camera: name in the scene. width, height: size of the image [px]. samples:
    antialiasing, see `Raster`.
    """

    def __init__(self, stage: Scene, camera: str, width: int, height: int, samples: int):
        self._stage = stage
        self._camera = camera
        self._caster = Caster(stage, outside=True)
        fovy_deg = float(stage.model.camera(camera).fovy[0])
        lens = Perspective(width=width, height=height, fovy_deg=fovy_deg)
        self._raster = Raster(lens, np.eye(3), samples)

    def full_image(self) -> Image:
        """The image now, shape (H, W, 3) uint8 RGB."""
        return self.part((0, 0, self._raster.width, self._raster.height))

    def part(self, window: Window) -> Image:
        """The image now within a window; the rest is black."""
        image = np.zeros((self._raster.height, self._raster.width, 3), np.uint8)
        self._raster.draw(image, (window,), self._caster, self._stage.pose_of(self._camera))
        return image
