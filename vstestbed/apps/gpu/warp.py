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
from functools import cached_property, partial
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
        self.lens.rays = wp.array(rays.reshape(-1, 3), dtype=wp.vec3)
        self.lens.angles = wp.array(raster.apart.ravel(), dtype=float)
        self._raster = raster

    @cached_property
    def within(self) -> Any:
        """Rays (pixels, n) through the parts of pixels."""
        return wp.array(self._raster.parts().reshape(-1, self.n, 3), dtype=wp.vec3)


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
            width = right - left
            height = bottom - top
            whole = drawn[start : start + width * height].reshape(height, width, 3)
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
        self._lamps = kernels.Lamps()
        for name in LIGHTS:
            setattr(self._lamps, name, wp.zeros((slots, len(self._on)), dtype=wp.vec3))
        self._world = kernels.DrawnWorlds()
        self._world.look = _look(model, paint, self._on)
        self._world.lamps = self._lamps
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
        shots = list({slot.number: slot.shot for slot in work}.values())
        # the picture of each slot among them: its number, of those that rise from slot to slot
        at = np.unique([slot.number for slot in work], return_inverse=True)[1]
        poses = np.array([shot.T_world_camera for shot in shots])[at]
        views: NDArray[np.void] = np.zeros(n, kernels.SlotView.numpy_dtype())
        views["origin"] = poses[:, :3, 3]
        views["R"] = poses[:, :3, :3]
        tiles = np.zeros((n, MOST_TILES), kernels.Tile.numpy_dtype())
        for i, slot in enumerate(work):
            views["tiles"][i] = len(slot.tiles)
            tiles[i, : len(slot.tiles)] = slot.tiles
        _copy(self._slots.views, views)
        _copy(self._slots.tiles, tiles)
        datas = [shot.stage.data for shot in shots]
        _copy(self._data.geom_xpos, np.array([d.geom_xpos for d in datas], np.float32)[at])
        _copy(self._data.geom_xmat, np.array([d.geom_xmat for d in datas], np.float32)[at])
        if len(self._on):
            for name, values in self._lit(shots).items():
                _copy(getattr(self._lamps, name), np.array(values, np.float32)[at])
        mjw.refit_bvh(self._model, replace(self._data, nworld=n), self._context)

    def _lit(self, shots: Sequence[PictureRequest]) -> dict[str, list[Array]]:
        """The lights of each scene now, as `warp_kernels.Lamps` names them."""
        found: dict[str, list[Array]] = {}
        for shot in shots:
            data = shot.stage.data
            model = shot.stage.model
            now = {
                "place": data.light_xpos,
                "along": data.light_xdir,
                "ambient": model.light_ambient,
                "diffuse": model.light_diffuse,
                "specular": model.light_specular,
            }
            for name, values in now.items():
                found.setdefault(name, []).append(values[self._on])
        return found

    def _cast(self, shape: tuple[int, int], seen: Any) -> None:
        n, m = shape
        rays = self._rays
        origin, ray, distance, geom, normal = (
            a[:n, :m] for a in (rays.origin, rays.ray, rays.distance, rays.geom, rays.normal)
        )
        data = replace(self._data, nworld=n)
        everything = self._everything[:m]
        given = (self._model, data, origin, ray, seen, True, everything)
        mjw.rays(*given, distance, geom, normal, self._context)


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
    look = kernels.SceneLook()
    look.rgb = wp.array(paint.rgb[: model.ngeom], dtype=wp.vec3)
    look.glow = wp.array(paint.glow[: model.ngeom], dtype=float)
    look.box = wp.array(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX, dtype=int)
    look.half = wp.array(model.geom_size, dtype=wp.vec3)
    look.elevation = wp.array(elevation, dtype=float)
    look.tint = wp.array(tint, dtype=wp.vec3)
    look.light_type = wp.array(model.light_type[on], dtype=int)
    look.attenuation = wp.array(model.light_attenuation[on], dtype=wp.vec3)
    look.cone = wp.array(cone, dtype=wp.vec2)
    _put_prints(look, model, paint)
    _put_texels(look, paint)
    return look


def _put_prints(look: Any, model: mujoco.MjModel, paint: Paint) -> None:
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
    look.texture = wp.array(texture, dtype=int)
    look.times = wp.array(times, dtype=wp.vec2)
    look.uniform = wp.array(uniform, dtype=int)
    look.gloss = wp.array(gloss, dtype=wp.vec2)
    look.samples = wp.array(samples, dtype=int)


def _put_texels(look: Any, paint: Paint) -> None:
    """All textures in one table: of each the first of its levels, and of each level its first
    texel.
    """
    levels = []
    sizes = []
    tables = [np.zeros((0, 3), np.uint8)]
    start = 0
    for mipmap in paint.mipmaps.values():
        levels.append((len(sizes), len(mipmap.levels)))
        sizes += [(start + first, width, height) for first, width, height in mipmap.levels]
        tables.append(mipmap.table)
        start += len(mipmap.table)
    look.level = wp.array(np.reshape(levels, (-1, 2)), dtype=wp.vec2i)
    look.size = wp.array(np.reshape(sizes, (-1, 3)), dtype=wp.vec3i)
    look.texels = wp.array(np.concatenate(tables), dtype=wp.vec3ub)


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
            shot = work[0].shot
            new_world = partial(_World, shot.stage, shot.paint, self.slots)
            world = _kept(self._worlds, look, new_world, MOST_LOOKS)
            table = _kept(self._tables, lens, partial(_Table, shot.raster), MOST_LENSES)
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
