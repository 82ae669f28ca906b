"""Pictures of many runs drawn together on a device: rays cast by MuJoCo Warp, shaded by the kernels
of `warp_kernels`.

The same tiles, lenses, materials and antialiasing as `rays`, in single floats. A run asks for its
picture with a `PictureRequest`; whoever has those of many runs draws them all by one `Device.draw`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, TypeVar

import mujoco
import numpy as np
import warp
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Panel, Window
from vstestbed.core.geometry import Array
from vstestbed.effects.base import RANGE_GROUP
from vstestbed.sim.render.rays import Raster, RayRenderer
from vstestbed.sim.render.shade import Paint
from vstestbed.sim.scene.meshes import LENS_GROUP
from vstestbed.sim.scene.scene import Scene

wp: Any = warp  # whose types are made as it runs
wp.config.log_level = wp.LOG_ERROR
import mujoco_warp as mjw  # noqa: E402 - it begins Warp, which would introduce itself on standard output

from vstestbed.apps.gpu import warp_kernels as kernels  # noqa: E402 - as it

T = TypeVar("T")
PLACES = 8192  # rays of a slot: pixels of the tiles in it, with their rims
MOST_TILES = 16  # of a slot
SIDE = math.isqrt(PLACES) - 2  # of a square tile without its rim [px]
LIGHTS = "place", "along", "ambient", "diffuse", "specular"  # of `warp_kernels.Lamps`
SLOTS = {"cpu": 8, "cuda": 256}  # slots that are drawn together, at most
# looks and lenses that are kept on the device: a look with its buffers is 150 MB of a card, a lens
# up to 20
MOST_LOOKS = 4
MOST_LENSES = 16
# prefixes of the arrays of a model that say what its pictures show
LOOKS = ("geom_", "mat_", "tex_", "mesh_", "hfield_", "light_")
MOVED = (
    "geom_pos",
    "geom_quat",
    "light_pos",
    "light_dir",
    "light_pos0",
    "light_poscom0",
    "light_dir0",
    "geom_friction",
    "geom_margin",
)
"""Those among them that do not, or whose effect is in the state."""


@dataclass(frozen=True)
class PictureRequest:
    """A picture that a run asks for, of which `tiles` are wanted.

    stage: the scene in its state, which stays until the picture is drawn, with what identifies its
    `look` and its paint. T_world_camera: pose (4, 4). raster: the rays of its pixels, with `lens`
    what identifies them. outside: show what encloses the servo camera's lens.
    """

    stage: Scene
    look: bytes
    paint: Paint
    T_world_camera: Array
    raster: Raster
    lens: tuple[object, ...]
    tiles: tuple[Window, ...]
    outside: bool


def cut(window: Window) -> Iterator[Window]:
    """Tiles of a window, each of PLACES pixels at most with a rim of one pixel: wide ones of few
    rows, else squares.
    """
    left, top, right, bottom = window
    across = min(right - left, max(SIDE, PLACES // (bottom - top + 2) - 2))
    down = PLACES // (across + 2) - 2
    for v in range(top, bottom, down):
        for u in range(left, right, across):
            yield u, v, min(u + across, right), min(v + down, bottom)


class DrawsPictures(Protocol):
    """Draws pictures, maybe together with those of other runs. name: of what draws them."""

    name: str

    def draw(self, request: PictureRequest, /) -> Sequence[Image]:
        """The tiles of a picture."""
        ...


class WarpRenderer(RayRenderer):
    """The servo camera's images through any lens, of the same rays as `RayRenderer`, drawn together
    with those of other runs.

    together: draws them; other arguments as of `RayRenderer`. The depth of a depth camera is cast
    by MuJoCo. Raises as `RayRenderer`.
    """

    def __init__(
        self,
        stage: Scene,
        camera: Camera,
        together: DrawsPictures,
        noisy: bool = False,
        share: float = 1.0,
        eye: str = "eye",
    ):
        super().__init__(stage, camera, noisy, share, eye)
        self.name = together.name
        self._ask = together.draw
        self._outside = stage.parts.stands(eye)
        self._look = look_of(stage)

    def _fill(
        self, image: Image, raster: Raster, panel: Panel, windows: tuple[Window, ...]
    ) -> None:
        tiles: list[Window] = []
        for window in windows:
            if window[0] < window[2] and window[1] < window[3]:
                tiles.extend(cut(window))
        if not tiles:
            return
        lens = repr(panel.lens), panel.R_camera_panel.tobytes(), raster.width, raster.height
        shot = PictureRequest(
            self._stage,
            self._look,
            self._caster.paint,
            self._stage.camera_pose(self._eye),
            raster,
            lens,
            tuple(tiles),
            self._outside,
        )
        for (left, top, right, bottom), drawn in zip(tiles, self._ask(shot), strict=True):
            image[top:bottom, left:right] = drawn


class _Table:
    """The rays of a raster on the device: through the centres of pixels, and through their parts
    where edges are smoothed.
    """

    def __init__(self, raster: Raster):
        self.n = len(raster.within)
        self.lens = kernels.Lens()
        self.lens.width = raster.width
        rays = raster.rays((0, 0, raster.width, raster.height))
        self.lens.rays = wp.array(rays.reshape(-1, 3).astype(np.float32), dtype=wp.vec3)
        self.lens.angles = wp.array(raster.apart.ravel().astype(np.float32), dtype=float)
        self._raster = raster

    @cached_property
    def within(self) -> Any:
        """Rays (pixels, n) through the parts of pixels."""
        return wp.array(
            self._raster.parts().reshape(-1, self.n, 3).astype(np.float32), dtype=wp.vec3
        )


class _Filling:
    """What is drawn in a slot: some tiles of one picture. number: the picture's.
    places: taken up.
    """

    def __init__(self, number: int, shot: PictureRequest):
        self.number = number
        self.shot = shot
        self.places = 0
        # first place, pixels with the rim, pixels
        self.tiles: list[tuple[int, Window, Window]] = []

    def takes(self, tile: Window, grown: Window) -> bool:
        """Take a tile, if there is room."""
        room = (grown[2] - grown[0]) * (grown[3] - grown[1])
        if len(self.tiles) == MOST_TILES or self.places + room > PLACES:
            return False
        self.tiles.append((self.places, grown, tile))
        self.places += room
        return True

    def images(self, drawn: Image) -> Iterator[Image]:
        """The tiles' pixels, as copies, of the colours (PLACES, 3) that the device has drawn."""
        for start, (left, top, right, bottom), (a, b, c, d) in self.tiles:
            whole = drawn[start : start + (right - left) * (bottom - top)].reshape(
                bottom - top, right - left, 3
            )
            # the next tiles are drawn into the same memory
            yield whole[b - top : d - top, a - left : c - left].copy()


def slots_of(number: int, shot: PictureRequest) -> Iterator[_Filling]:
    """The slots of a picture, by its number."""
    slot = _Filling(number, shot)
    for tile in shot.tiles:
        grown = shot.raster.grown(tile)
        if not slot.takes(tile, grown):
            yield slot
            slot = _Filling(number, shot)
            slot.takes(tile, grown)
    yield slot


class _World:
    """Scenes of one look on the device, one in each slot: their shapes, materials and textures are
    the same, and their states their own.

    paint, stage: of one of them. slots: how many.
    """

    def __init__(self, stage: Scene, paint: Paint, slots: int):
        model = stage.model
        self._model = mjw.put_model(model)
        self._data = mjw.make_data(model, nworld=slots, nconmax=1, njmax=1)
        self._context = mjw.create_render_context(
            model, nworld=slots, cam_active=[], enabled_geom_groups=[0, 1, 2, 3, 4, 5]
        )
        self._on = np.flatnonzero(model.light_active)
        shape = slots, PLACES
        n = len(self._on)
        self._everything = wp.full(PLACES, -1, dtype=int)  # bodies that rays pass through: none
        self._rays = kernels.Rays()
        self._drawn = wp.zeros(shape, dtype=wp.vec3ub)
        kinds = {wp.vec3: ("origin", "ray", "normal"), float: ("apart", "distance"), int: ("geom",)}
        for dtype, names in kinds.items():
            for name in names:
                setattr(self._rays, name, wp.zeros(shape, dtype=dtype))
        self._slots = kernels.TileSlots()
        self._slots.views = wp.zeros(slots, dtype=kernels.SlotView)
        self._slots.tiles = wp.zeros((slots, MOST_TILES), dtype=kernels.Tile)
        lamps = kernels.Lamps()
        self._lights = [wp.zeros((slots, max(n, 1)), dtype=wp.vec3) for _ in LIGHTS]
        for name, lights in zip(LIGHTS, self._lights, strict=True):
            setattr(lamps, name, lights)
        self._world = kernels.DrawnWorlds()
        self._world.look = _look(model, paint, self._on)
        self._world.lamps = lamps
        self._world.xpos = self._data.geom_xpos
        self._world.xmat = self._data.geom_xmat
        self._world.rays = self._rays

    def draw(self, table: _Table, outside: bool, work: Sequence[_Filling]) -> NDArray[np.uint8]:
        """The colours (n, places) of what is in n slots, as many as there are at most, all of
        pictures with the same rays.
        """
        self._put(work)
        hidden = (RANGE_GROUP,) if outside else (RANGE_GROUP, LENS_GROUP)
        seen = wp.types.vector(6, float)(*(0.0 if group in hidden else 1.0 for group in range(6)))
        shape = len(work), max(slot.places for slot in work)
        wp.launch(kernels.aim, shape, [self._slots, table.lens, self._rays])
        self._cast(shape, seen)
        wp.launch(kernels.blind, shape, [self._slots, table.lens, self._rays])
        wp.launch(kernels.shade, shape, [self._world, self._drawn])
        if table.n:
            self._smooth(table, shape, seen)
        return self._drawn[: shape[0], : shape[1]].numpy()

    def _smooth(self, table: _Table, shape: tuple[int, int], seen: Any) -> None:
        """Draw the pixels at edges again, by the means of the rays through their parts."""
        slots, places = shape
        found = kernels.Edges()
        found.count = wp.zeros(slots, dtype=int)
        found.place = wp.empty(shape, dtype=int)
        wp.launch(kernels.edges, shape, [self._slots, self._rays, found])
        most = int(found.count.numpy().max())
        if not most:
            return
        total = wp.zeros((slots, most, 3), dtype=int)
        for first in range(0, most * table.n, places):
            aimed = [self._slots, table.lens, table.within, found, first, self._rays]
            wp.launch(kernels.aim_within, shape, aimed)
            self._cast(shape, seen)
            wp.launch(kernels.add_up, shape, [self._world, found, first, table.n, total])
        wp.launch(kernels.smooth, (slots, most), [found, table.n, total, self._drawn])

    def _put(self, work: Sequence[_Filling]) -> None:
        """Take the states, views and tiles to the device, in slots from the first on."""
        n = len(work)
        shots, at = _shots_of(work)
        poses = np.array([shot.T_world_camera for shot in shots], np.float32)[at]
        views = np.empty((n, 13), np.int32)
        views[:, :12] = np.concatenate(
            [poses[:, :3, 3], poses[:, :3, :3].reshape(n, 9)], axis=1
        ).view(np.int32)
        views[:, 12] = [len(slot.tiles) for slot in work]
        _copy(self._slots.views, views)
        _copy(self._slots.tiles, _rows_of_tiles(work))
        datas = [shot.stage.data for shot in shots]
        _copy(self._data.geom_xpos, np.array([d.geom_xpos for d in datas], np.float32)[at])
        _copy(self._data.geom_xmat, np.array([d.geom_xmat for d in datas], np.float32)[at])
        if len(self._on):
            for lights, values in zip(self._lights, self._lit(shots), strict=True):
                _copy(lights, values[at])
        mjw.refit_bvh(self._model, replace(self._data, nworld=n), self._context)

    def _lit(self, shots: Sequence[PictureRequest]) -> NDArray[np.float32]:
        """The lights of each scene now, in the order of LIGHTS, (5, shots, lights, 3)."""
        found = []
        for shot in shots:
            data = shot.stage.data
            model = shot.stage.model
            own = (
                data.light_xpos,
                data.light_xdir,
                model.light_ambient,
                model.light_diffuse,
                model.light_specular,
            )
            found.append([values[self._on] for values in own])
        return np.array(found, np.float32).swapaxes(0, 1)

    def _cast(self, shape: tuple[int, int], seen: Any) -> None:
        n, m = shape
        rays = self._rays
        data = replace(self._data, nworld=n)
        origin, ray, distance, geom, normal = (
            a[:n, :m] for a in (rays.origin, rays.ray, rays.distance, rays.geom, rays.normal)
        )
        mjw.rays(
            self._model,
            data,
            origin,
            ray,
            seen,
            True,
            self._everything[:m],
            distance,
            geom,
            normal,
            self._context,
        )


def _shots_of(work: Sequence[_Filling]) -> tuple[list[PictureRequest], list[int]]:
    """The pictures of slots, each once, and the number of each slot's among them."""
    shots = {id(slot.shot): slot.shot for slot in work}
    numbers = {key: i for i, key in enumerate(shots)}
    return list(shots.values()), [numbers[id(slot.shot)] for slot in work]


def _rows_of_tiles(work: Sequence[_Filling]) -> NDArray[np.int32]:
    """The numbers (n, MOST_TILES, 9) of `warp_kernels.Tile` of what is in n slots."""
    rows = np.zeros((len(work), MOST_TILES, 9), np.int32)
    for i, slot in enumerate(work):
        tiles = [(start, *grown, *tile) for start, grown, tile in slot.tiles]
        rows[i, : len(tiles)] = tiles
    return rows


def _copy(there: Any, values: NDArray[Any]) -> None:
    """Copy numbers, bytes for bytes, into an array on the device; CUDA returns when it has read
    memory that is not pinned.
    """
    held = np.ascontiguousarray(values)
    shape = (held.nbytes // there.strides[-1],)
    source = wp.array(ptr=held.ctypes.data, shape=shape, dtype=there.dtype, device="cpu")
    wp.copy(there, source)


def _look(model: mujoco.MjModel, paint: Paint, on: NDArray[np.intp]) -> Any:
    """What all worlds of a scene share, as the shading kernel reads it. on: the lights that are
    lit.
    """
    elevation, tint = paint.sky
    cone = np.column_stack([np.cos(np.radians(model.light_cutoff[on])), model.light_exponent[on]])
    boxes = model.geom_type == mujoco.mjtGeom.mjGEOM_BOX
    arrays = {
        "rgb": _on_device(paint.rgb[: model.ngeom], wp.vec3, (1, 3)),
        "glow": _on_device(paint.glow[: model.ngeom], float, (1,)),
        "box": _on_device(boxes.astype(np.int32), int, (1,)),
        "half": _on_device(model.geom_size.astype(np.float32), wp.vec3, (1, 3)),
        "elevation": _on_device(elevation.astype(np.float32), float, (1,)),
        "tint": _on_device(tint.astype(np.float32), wp.vec3, (1, 3)),
        "light_type": _on_device(model.light_type[on].astype(np.int32), int, (0,)),
        "attenuation": _on_device(model.light_attenuation[on].astype(np.float32), wp.vec3, (0, 3)),
        "cone": _on_device(cone.astype(np.float32), wp.vec2, (0, 2)),
    }
    look = kernels.SceneLook()
    for name, array in (arrays | _prints(model, paint) | _texels(paint)).items():
        setattr(look, name, array)
    return look


def _on_device(values: object, dtype: Any, least: tuple[int, ...]) -> Any:
    """An array of the device; zeros of a shape in place of none."""
    array = np.asarray(values)
    return wp.array(array if array.size else np.zeros(least, array.dtype), dtype=dtype)


def _prints(model: mujoco.MjModel, paint: Paint) -> dict[str, Any]:
    """Of each geom its texture, -1 of none, and how it lies and shines."""
    n = model.ngeom
    numbers = {texture: i for i, texture in enumerate(paint.mipmaps)}
    texture = np.full(n, -1)
    times = np.ones((n, 2))
    uniform = np.zeros(n)
    gloss = np.zeros((n, 2))
    samples = np.ones(n)
    for g in paint.printed:
        m = model.geom_matid[g]
        number = int(paint.texture[g])
        texture[g] = numbers[number]
        times[g] = model.mat_texrepeat[m]
        uniform[g] = model.mat_texuniform[m]
        samples[g] = 1 if paint.repeated[number] else paint.anisotropy
        if g in paint.glossy:
            gloss[g] = model.mat_specular[m], 128 * model.mat_shininess[m]
    return {
        "texture": _on_device(texture.astype(np.int32), int, (1,)),
        "times": _on_device(times.astype(np.float32), wp.vec2, (1, 2)),
        "uniform": _on_device(uniform.astype(np.int32), int, (1,)),
        "gloss": _on_device(gloss.astype(np.float32), wp.vec2, (1, 2)),
        "samples": _on_device(samples.astype(np.int32), int, (1,)),
    }


def _texels(paint: Paint) -> dict[str, Any]:
    """All textures in one table: of each the first of its levels, and of each level its first
    texel.
    """
    levels = []
    sizes = []
    tables = []
    start = 0
    for mipmap in paint.mipmaps.values():
        levels.append((len(sizes), len(mipmap.levels)))
        sizes += [(start + first, width, height) for first, width, height in mipmap.levels]
        tables.append(mipmap.table)
        start += len(mipmap.table)
    table = np.concatenate(tables) if tables else np.zeros((1, 3), np.uint8)
    return {
        "level": _on_device(np.array(levels, np.int32), wp.vec2i, (1, 2)),
        "size": _on_device(np.array(sizes, np.int32), wp.vec3i, (1, 3)),
        "texels": _on_device(table, wp.vec3ub, (1, 3)),
    }


class Device:
    """Draws pictures on a device of Warp: a graphics card where there is one, else this processor.

    name: of the device and of what draws there.
    """

    def __init__(self) -> None:
        wp.init()
        device = wp.get_preferred_device()
        self.name = f"rays (mujoco_warp {mjw.__version__}, {device.name})"
        self.slots = SLOTS["cuda" if device.is_cuda else "cpu"]
        self._worlds = dict[bytes, _World]()
        self._tables = dict[tuple[object, ...], _Table]()

    def draw(self, shots: Sequence[PictureRequest]) -> list[list[Image]]:
        """The tiles of each picture, those of equal scenes and lenses together."""
        alike: dict[tuple[bytes, tuple[object, ...], bool], list[_Filling]] = {}
        for i, shot in enumerate(shots):
            key = shot.look, (*shot.lens, len(shot.raster.within)), shot.outside
            alike.setdefault(key, []).extend(slots_of(i, shot))
        drawn: list[list[Image]] = [[] for _ in shots]
        for (look, lens, outside), work in alike.items():
            first = work[0].shot
            world = _kept(
                self._worlds,
                look,
                lambda of=first: _World(of.stage, of.paint, self.slots),
                MOST_LOOKS,
            )
            table = _kept(self._tables, lens, lambda of=first: _Table(of.raster), MOST_LENSES)
            for start in range(0, len(work), self.slots):
                some = work[start : start + self.slots]
                for slot, colours in zip(some, world.draw(table, outside, some), strict=True):
                    drawn[slot.number].extend(slot.images(colours))
        return drawn


def _kept(store: dict[Any, T], key: Any, make: Callable[[], T], most: int) -> T:
    """What a store has of a key, made where it is missing; of more than `most` the one that was
    asked for longest ago goes.
    """
    found = store.pop(key) if key in store else make()
    store[key] = found
    if len(store) > most:
        del store[next(iter(store))]
    return found


def look_of(stage: Scene) -> bytes:
    """What identifies scenes whose pictures show the same shapes, materials, textures and lights,
    by as many samples of a texture.
    """
    model = stage.model
    names = [n for n in dir(model) if n.startswith(LOOKS) and n not in MOVED]
    found = hashlib.blake2b(str(stage.parts.camera.anisotropy).encode(), digest_size=16)
    for name in names:
        found.update(np.ascontiguousarray(getattr(model, name)).tobytes())
    return found.digest()
