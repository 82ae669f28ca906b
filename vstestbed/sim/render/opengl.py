"""Rendering with OpenGL: a camera of the scene kept by dm_control, and the servo camera's images
through its lens.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import cached_property
from typing import Any, Literal

import mujoco
import numpy as np
from dm_control import mujoco as dm
from dm_control.mujoco import wrapper
from numpy.typing import NDArray

from vstestbed.camera import Camera, DepthImage, Image, Perspective, Regions, Window
from vstestbed.core.errors import EnvironmentLackError, ParameterError, lack_of
from vstestbed.core.geometry import Array, pixel_grid
from vstestbed.core.lazy import cv2
from vstestbed.imaging.depth import EDGE, DepthLens
from vstestbed.imaging.shutter import Rows
from vstestbed.sim import gl_probe as gl
from vstestbed.sim.render.cube_map import Pinhole, cube_of, drawn_for, resampling_maps
from vstestbed.sim.scene.meshes import LENS_GROUP, RANGE_GROUP
from vstestbed.sim.scene.scene import Scene

# Rendering of a window of the image: with software OpenGL the cost is in the pixels, and a tracker
# needs few of them.


# Margin around the windows of a band of rows, as a share of the image's width: a little more of a
# marker is rendered
REACH = 0.05
DRAW_PX = 8000
"""Pixels that take as long as one more draw: windows nearer than that are drawn as one (software
OpenGL: .12 ms and 15 ns a pixel).
"""


PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
LABEL = int(mujoco.mjtGeom.mjGEOM_LABEL)
GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
SKYBOX = int(mujoco.mjtRndFlag.mjRND_SKYBOX)


class PartCamera(dm.Camera):
    """dm_control's camera with windows: only those parts of the image are drawn and read back; the
    rest is black.

    A window is drawn through its own share of the frustum. Vertices land where they do in the whole
    image, up to the rounding of single floats: of the rasteriser's 1/256 px positions one in fifty
    is off by one.

    windows: the parts (left, top, right, bottom) [px] of the next image; None for all of it.
    local: there are no shadows and mirrors, by which a geom changes the image elsewhere as well.
    reads_depth: with the next image, which is a whole one, its depth is read (`depth`).
    beyond: a part of the image plane, as a window, that is drawn in place of the image.
    """

    windows: tuple[Window, ...] | None = None
    local: bool = False
    reads_depth: bool = False
    beyond: tuple[float, float, float, float] | None = None
    _drawn: tuple[tuple[slice, slice], ...] = ((slice(None), slice(None)),)

    def update(self, scene_option: Any = None) -> None:
        """Update the scene. Planes are made decoration, which casts no shadow.

        Nothing lies below a floor to be shaded, and software OpenGL would speckle it with its own
        shadow (shadow acne).
        """
        super().update(scene_option)
        self._geoms = self._scene.ptr.geoms[: self._scene.ptr.ngeom]
        self._planes = [geom for geom in self._geoms if geom.type == PLANE]
        for geom in self._planes:
            geom.category = int(mujoco.mjtCatBit.mjCAT_DECOR)
        if self.windows is None:
            self._look_at(self.beyond)

    def _look_at(self, part: tuple[float, float, float, float] | None) -> None:
        """Narrow the frustum to a part of the image, and leave out what is not in it."""
        if part is not None:
            for camera in self._scene.ptr.camera:
                _narrow(camera, part, self._width, self._height)
        if self.local:
            self._leave_out()

    def _leave_out(self) -> None:
        """Leave out geoms whose bounding sphere is outside of the frustum, and the sky where a
        plane fills the image.
        """
        model = self._physics.model.ptr
        data = self._physics.data.ptr
        camera = self._render_camera.fixedcamid
        R = data.cam_xmat[camera].reshape(3, 3)
        place = data.cam_xpos[camera]
        eyes = self._scene.ptr.camera
        aspect = self._width / self._height
        left, right, bottom, top = np.mean([_frustum(eye, aspect) for eye in eyes], axis=0).tolist()
        normals = np.array(
            [[-1, 0, -left], [1, 0, right], [0, -1, -bottom], [0, 1, top], [0, 0, 1]]
        )
        heights = (data.geom_xpos - place) @ R @ normals.T
        reach = np.outer(model.geom_rbound, np.sqrt((normals**2).sum(axis=1)))
        outside = (heights > reach).any(axis=1).tolist()
        for geom in self._geoms:
            if geom.type != PLANE and geom.objtype == GEOM and outside[geom.objid]:
                # of which nothing is drawn; MuJoCo would take all its vertices to OpenGL
                geom.type = LABEL
        corners = np.array([[x, y, -1] for x in (left, right) for y in (bottom, top)]) @ R.T
        far = SKY * eyes[0].frustum_far
        filled = any(_fills(plane, place, corners, far) for plane in self._planes)
        self._scene.ptr.flags[SKYBOX] = not filled

    def _render_on_gl_thread(self, depth: bool, overlays: Any) -> None:
        """As dm_control's, within the windows.
        The buffer has the lowest row first, as OpenGL does.
        """
        if self.windows is None:
            self._drawn = ((slice(None), slice(None)),)
            super()._render_on_gl_thread(depth, overlays)
            if not self.reads_depth:
                return
        contexts = self._physics.contexts
        assert contexts is not None and contexts.mujoco is not None
        context = contexts.mujoco.ptr
        if self.windows is None:
            # floats are finest at 0, where the depths are coarsest
            context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
            mujoco.mjr_readPixels(None, self._depth_buffer, self._rect, context)
            return
        for part in self._drawn:
            self._rgb_buffer[part] = 0  # only what was drawn last: the rest is black already
        self._drawn = tuple(self._draw_part(window, context) for window in self.windows)

    def _draw_part(self, window: Window, context: Any) -> tuple[slice, slice]:
        """Draw one window; where it is in the buffer. The scene is left as it was."""
        left, top, right, bottom = window
        scene = self._scene.ptr
        kinds = [geom.type for geom in self._geoms]
        self._look_at(window)
        rect = mujoco.MjrRect(0, 0, right - left, bottom - top)
        mujoco.mjr_render(rect, scene, context)
        part = np.empty((rect.height, rect.width, 3), np.uint8)
        mujoco.mjr_readPixels(part, None, rect, context)
        where = slice(self._height - bottom, self._height - top), slice(left, right)
        self._rgb_buffer[where] = part
        model = self._physics.model.ptr
        mujoco.mjv_updateCamera(model, self._physics.data.ptr, self._render_camera.ptr, scene)
        for geom, kind in zip(self._geoms, kinds, strict=True):
            geom.type = kind
        return where

    def depth(self) -> DepthImage:
        """Depth Z (H, W) [m] along the optical axis of the last image drawn with `reads_depth`; inf
        where nothing was drawn.

        With near and far planes at n and f the buffer holds b = n (f - Z) / (Z (f - n)).
        """
        model = self._physics.model
        near, far = (
            float(plane) * model.stat.extent for plane in (model.vis.map.znear, model.vis.map.zfar)
        )
        b = self._depth_buffer[::-1].astype(float)
        return np.where(b > 0, near * far / (near + b * (far - near)), np.inf).astype(np.float32)


def _fills(plane: Any, place: Array, corners: Array, far: float) -> bool:
    """Whether an opaque plane fills the image of a camera at `place` (3,): it is hit, nearer than
    `far` [m], along all corners.
    """
    R = plane.mat.reshape(3, 3)
    p = (place - plane.pos) @ R
    d = corners @ R
    if plane.rgba[3] < 1 or p[2] <= 0 or (d[:, 2] >= 0).any():
        return False
    t = -p[2] / d[:, 2]
    return bool(
        t.max() < far and (np.abs(p[:2] + t[:, None] * d[:, :2]) < 0.99 * plane.size[:2]).all()
    )


def _frustum(eye: mujoco.MjvGLCamera, aspect: float) -> tuple[float, ...]:
    """Left, right, lower and upper end of a camera's frustum, at a distance of 1."""
    # MuJoCo: 0 means "from the viewport's aspect ratio"
    half = eye.frustum_width or (eye.frustum_top - eye.frustum_bottom) * aspect / 2
    ends = eye.frustum_center - half, eye.frustum_center + half, eye.frustum_bottom, eye.frustum_top
    return tuple(end / eye.frustum_near for end in ends)


def _narrow(
    camera: mujoco.MjvGLCamera, window: tuple[float, float, float, float], width: int, height: int
) -> None:
    """Narrow a camera's frustum to a window of its image (width x height), or widen it to one that
    reaches beyond.
    """
    left, top, right, bottom = window
    high = camera.frustum_top - camera.frustum_bottom
    # MuJoCo: 0 means "from the viewport's aspect ratio"
    half = camera.frustum_width or high * width / height / 2
    first = camera.frustum_center - half
    camera.frustum_center = first + half * (left + right) / width
    camera.frustum_width = half * (right - left) / width
    camera.frustum_bottom = camera.frustum_top - high * bottom / height
    camera.frustum_top = camera.frustum_top - high * top / height


def merged(
    windows: Sequence[Window], width: int, height: int, draw_px: float = DRAW_PX
) -> tuple[Window, ...]:
    """Windows within an image (width x height), of which those are joined that together take no
    longer to draw than apart.

    draw_px: how many pixels take as long as one more draw.
    """
    within = [
        (max(left, 0), max(top, 0), min(right, width), min(bottom, height))
        for left, top, right, bottom in windows
    ]
    rest = [window for window in within if window[0] < window[2] and window[1] < window[3]]
    done = list[Window]()
    while rest:
        one = rest.pop()
        for other in rest:
            both = (
                min(one[0], other[0]),
                min(one[1], other[1]),
                max(one[2], other[2]),
                max(one[3], other[3]),
            )
            if _area(both) <= _area(one) + _area(other) + draw_px:
                rest[rest.index(other)] = both
                break
        else:
            done.append(one)
    return tuple(done)


def _area(window: Window) -> int:
    return (window[2] - window[0]) * (window[3] - window[1])


def part_round(windows: Sequence[Window], width: int, height: int) -> Window | None:
    """The rectangle around all windows, with a margin, clipped to the image (width x height); None
    without windows.
    """
    if not windows:
        return None
    lefts, tops, rights, bottoms = zip(*windows, strict=True)
    more = round(REACH * width)
    return (
        max(min(lefts) - more, 0),
        max(min(tops) - more, 0),
        min(max(rights) + more, width),
        min(max(bottoms) + more, height),
    )


def part_of_rows(regions: Regions | None, rows: Rows, width: int, height: int) -> Window:
    """What is needed of rows of an image (width x height) of which windows are asked for, None for
    everything: one pixel at least.
    """
    if regions is None:
        return 0, rows[0], width, rows[1]
    more = round(REACH * width)
    near = [
        window for window in regions[0] if window[1] - more < rows[1] and window[3] + more > rows[0]
    ]
    left, top, right, bottom = part_round(near, width, height) or (0, rows[0], 1, rows[0] + 1)
    return left, max(top, rows[0]), right, min(bottom, rows[1])


ROUNDED = {
    int(kind)
    for kind in (
        mujoco.mjtGeom.mjGEOM_SPHERE,
        mujoco.mjtGeom.mjGEOM_CAPSULE,
        mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    )
}
"""Shapes that are curved along their axis too."""
DISC_FACETS = 96, 2
"""Facets round an axis and along it, where all that is round are discs and cylinders: as much work
as MuJoCo's 28 and 16.

With 28 a disc of 8 px radius lacks 2 of its 224 pixels, and its centroid is off by .03 px; with 96
by .01 px.
"""

MOST_MATERIALS = 997
MOST_TEXTURES = 1000
"""Most materials and textures of a scene that MuJoCo draws by OpenGL, measured: with a sky it
refuses 998 materials (and says 999), and 1001 textures.
"""
# Least distance of the sky, as a share of the distance at which MuJoCo's picture ends (measured:
# 0.699)
SKY = 0.69


class SceneCamera:
    """One pinhole camera of a stage, kept between images.

    stage: the scene. camera: name in the scene (`eye`, `overview`, ...). width, height: size of the
    image [px]. shadows: draw shadows.
    style: `own` is what the servo camera sees (the geoms that enclose the lens are left out),
    `room` what a camera sees that stands in the room; `outside` shows everything, for films;
    `bare` is `own` as MuJoCo itself draws it: OpenGL gets all geoms, and not only what may be in
    the picture. Raises EnvironmentLackError: OpenGL does not work on this machine. ParameterError:
    the scene has more materials or textures than it draws.
    """

    def __init__(
        self,
        stage: Scene,
        camera: str,
        width: int,
        height: int,
        shadows: bool,
        style: Literal["own", "room", "outside", "bare"],
    ):
        gl.require()
        _must_be_drawable(stage)
        # MuJoCo allocates the offscreen buffer from the model's size when it makes a context; it
        # must hold the largest camera.
        vis = stage.model.vis.global_
        vis.offwidth = max(vis.offwidth, width)
        vis.offheight = max(vis.offheight, height)
        if style != "outside" and not ROUNDED & set(stage.model.geom_type.tolist()):
            stage.model.vis.quality.numslices, stage.model.vis.quality.numstacks = DISC_FACETS
        if not shadows:
            stage.model.vis.quality.shadowsize = 0  # the context would reserve its depth map
        try:
            self._option = wrapper.MjvOption()
            self._option.geomgroup[:] = 1
            self._option.geomgroup[LENS_GROUP] = style in ("room", "outside")
            self._option.geomgroup[RANGE_GROUP] = 0
            self._option.sitegroup[:] = 0
            self._flags = {"shadow": shadows, "reflection": stage.parts.world.floor.mirror > 0}
            self._camera, self.renderer = stage.physics.with_context(
                lambda: (
                    PartCamera(stage.physics, height, width, camera_id=camera),
                    gl.renderer_string(),
                )
            )
            self._camera.local = style != "bare" and not any(self._flags.values())
        except Exception as error:
            # EGL, PyOpenGL and MuJoCo raise half a dozen types when a driver is broken
            raise (
                lack_of(error)
                or EnvironmentLackError(f"OpenGL does not work here: {error}", gl.remedy())
            ) from error

    @property
    def size(self) -> tuple[int, int]:
        """Width and height [px]."""
        return self._camera.width, self._camera.height

    @property
    def local(self) -> bool:
        """There are no shadows and mirrors, so that a part can be drawn for itself."""
        return self._camera.local

    def full_image(self) -> Image:
        """The image now, shape (H, W, 3) uint8 RGB, as a copy that the caller may keep."""
        return np.ascontiguousarray(self.raw())

    def part(self, window: Window) -> Image | None:
        """The image now, valid within a window until the next call; None with shadows and mirrors,
        where things move elsewhere as well.
        """
        return self.raw((window,)) if self._camera.local else None

    def raw(self, windows: tuple[Window, ...] | None = None, with_depth: bool = False) -> Image:
        """The image now as a view of dm_control's buffer, which the next call overwrites.

        windows: the parts to be drawn; the rest is black. None draws the whole image.
        with_depth: of a whole image, read its depth as well (`depth`).
        """
        self._camera.windows = windows
        self._camera.reads_depth = with_depth
        return self._camera.render(scene_option=self._option, render_flag_overrides=self._flags)

    def depth(self) -> DepthImage:
        """Depth (H, W) [m] of the last image that was drawn with it; inf where there is nothing."""
        return self._camera.depth()

    def depth_through(self, lens: DepthLens, own: Pinhole) -> DepthImage:
        """Depth (H, W) [m] through another lens at the same place, its pixels from the upper left
        corner on; own: the camera's.
        """
        ends = np.array([(0, 0), self.size], dtype=float) - 0.5 - lens.centre
        (left, top), (right, bottom) = (ends / lens.f * own.f + own.centre + 0.5).tolist()
        self._camera.beyond = left, top, right, bottom
        try:
            self.raw(None, with_depth=True)
            return self.depth()
        finally:
            self._camera.beyond = None


def _must_be_drawable(stage: Scene) -> None:
    """Refuse a scene of more materials or textures than MuJoCo draws by OpenGL, which would end the
    context.

    Raises ParameterError: it has more.
    """
    model = stage.model
    for what, found, most in (
        ("materials", model.nmat, MOST_MATERIALS),
        ("textures", model.ntex, MOST_TEXTURES),
    ):
        if found > most:
            where = "world.scenery" if stage.parts.world.scenery is not None else "world"
            words = f"makes a scene of {found} {what}, and MuJoCo draws at most {most} by OpenGL"
            raise ParameterError(
                where, f"{words}; let its parts share {what}, or set camera.renderer=rays"
            )


class OpenGLRenderer:
    """The servo camera's images through its lens.

    A pinhole image is drawn directly and a distorted one is resampled from a pinhole image. Any
    wider lens is drawn as the faces of a cube around it: a lens with panels returns the faces
    themselves, any other the image composed of them.

    Args:
        stage: the scene. camera: the lens.
        noisy: noise will be added to the images. Its level is estimated from whole images, which
            are then always drawn.
        share: size of the images as a share of the camera's; 1 for wide and distorted lenses, whose
            images are composed.
        eye: name of the camera in the scene.
    """

    def __init__(
        self,
        stage: Scene,
        camera: Camera,
        noisy: bool = False,
        share: float = 1.0,
        eye: str = "eye",
    ):
        drawn = drawn_for(camera, eye)
        self._maps = resampling_maps(camera, drawn[0]) if isinstance(camera, Perspective) else None
        self._cube = None if isinstance(camera, Perspective) else cube_of(camera)
        self._model = stage.model
        self._pinhole_lens = drawn[0]
        self._depth_lens = camera.depth_sensor.lens if camera.depth_sensor else None
        self._panels = len(camera.panels)
        self._size = camera.width, camera.height
        # Resampling needs pixels from beyond a window.
        self._parts = self._maps is None and not noisy
        share = share if self._maps is None and self._cube is None else 1.0
        sizes = [(p.name, round(share * p.width), round(share * p.height)) for p in drawn]
        style = "room" if stage.parts.stands(eye) else "own"
        self._views = [SceneCamera(stage, *size, camera.shadows, style) for size in sizes]
        self.name = self._views[0].renderer
        self.spent_s = 0.0
        self.whole = True
        self.depth: DepthImage | None = None

    @cached_property
    def _sky_m(self) -> Array:
        """Depth of the sky (H, W) [m], which MuJoCo draws as a solid;
        beyond it nothing is drawn.
        """
        model = self._model
        lens = self._depth_lens or self._pinhole_lens
        xy = (pixel_grid(*self._views[0].size) - lens.centre) / lens.f
        reach = SKY * float(model.vis.map.zfar * model.stat.extent)
        return reach / np.sqrt(1 + (xy**2).sum(axis=-1))

    def full_image(self) -> Image:
        """The camera's own image now, shape (H, W, 3) uint8 RGB, as a copy; the panels of a lens
        that has them are composed.
        """
        if self._cube is not None and self._panels > 1:
            return self._cube.compose(
                dict(enumerate(image for image in self.images() if image is not None))
            )
        return np.ascontiguousarray(self.images()[0])

    def images(
        self, regions: Regions | None = None, with_depth: bool = False, rows: Rows | None = None
    ) -> tuple[Image | None, ...]:
        """See `Renderer.images`. What is not drawn is black, or None for a whole panel.

        Of a camera without noise and shadows the windows are drawn, near ones as one. With shadows
        those of a pinhole camera are drawn as one. Else a pinhole's picture is whole, as is each
        panel with a window, and each of the cube's faces that reach into the windows.
        """
        start = time.perf_counter()
        if self._panels > 1:
            images = self._in_panels(regions)
        elif self._cube is not None:
            images = self._composed(regions, rows)
        elif with_depth:
            images = self._pinhole(None, True)
        else:
            images = self._pinhole(regions) if rows is None else self._band(regions, rows)
        self.spent_s += time.perf_counter() - start
        return images

    def _in_panels(self, regions: Regions | None) -> tuple[Image | None, ...]:
        """The images of all panels, or of those with a window,
        of which only the windows are drawn.
        """
        if regions is None:
            self.whole = True
            return tuple(view.raw() for view in self._views)
        in_parts = self._parts and self._views[0].local
        self.whole = all(regions) and not in_parts
        images: list[Image | None] = []
        for windows, view in zip(regions, self._views, strict=True):
            if in_parts:
                windows = merged(windows, *view.size)
            if not windows:
                images.append(None)
            else:
                images.append(view.raw(windows if in_parts else None))
        return tuple(images)

    def _band(self, regions: Regions | None, rows: Rows) -> tuple[Image]:
        """Rows of the image of a perspective lens, drawn at least in the rectangle around the
        windows.
        """
        self.whole = False
        window = part_of_rows(regions, rows, *self._size)
        if self._maps is None:
            return (self._views[0].raw((window,)),)
        part = slice(window[1], window[3]), slice(window[0], window[2])
        u, v = (axis[part] for axis in self._maps)
        width, height = self._views[0].size
        left, right = _read_of(u, width)
        top, bottom = _read_of(v, height)
        drawn = self._views[0].raw(((left, top, right, bottom),))
        image = np.zeros((self._size[1], self._size[0], 3), np.uint8)
        image[part] = cv2.remap(
            drawn[top:bottom, left:right],
            u - np.float32(left),
            v - np.float32(top),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REPLICATE,
        )
        return (image,)

    def _pinhole(self, regions: Regions | None, with_depth: bool = False) -> tuple[Image]:
        windows = None
        if regions is not None and self._parts:
            # Shadows and mirrors are drawn anew with each part. Without a window there is nothing
            # to be seen in parts.
            draw_px = DRAW_PX if self._views[0].local else math.inf
            windows = merged(regions[0], *self._size, draw_px) or None
        self.whole = windows is None
        image = self._views[0].raw(windows, with_depth)
        if with_depth:
            if self._depth_lens is not None:  # the same buffer is drawn into again
                image = np.ascontiguousarray(image)
            self.depth = self._depth_now()
        if self._maps is None:
            return (image,)
        linear = cv2.INTER_LINEAR
        return (cv2.remap(image, *self._maps, linear, borderMode=cv2.BORDER_REPLICATE),)

    def _depth_now(self) -> DepthImage:
        """The depth of the image just drawn, through the depth sensor's own lens where it has
        one.
        """
        view = self._views[0]
        lens = self._depth_lens
        depth = view.depth() if lens is None else view.depth_through(lens, self._pinhole_lens)
        seen = np.where(depth < self._sky_m, depth, np.float32(np.inf))
        return seen if self._maps is None or lens is not None else _resampled(seen, self._maps)

    def _composed(self, regions: Regions | None, rows: Rows | None) -> tuple[Image]:
        """The image of a wide lens, composed of the cube's faces, or of their parts, that the
        windows or rows need.
        """
        assert self._cube is not None
        if rows is not None:
            return self._composed_of([part_of_rows(regions, rows, *self._size)])
        if regions is not None and self._parts and self._views[0].local:
            windows = merged(regions[0], *self._size, 0)
            if windows:
                return self._composed_of(windows)
        faces = range(len(self._views)) if regions is None else self._cube.needed(regions[0])
        self.whole = len(faces) == len(self._views)
        return (self._cube.compose({i: self._views[i].raw() for i in faces}),)

    def _composed_of(self, windows: Sequence[Window]) -> tuple[Image]:
        """Windows of the image of a wide lens, of whose faces only what is in them is drawn."""
        assert self._cube is not None
        self.whole = False
        of = dict[int, list[Window]]()
        for window in windows:
            for i, part in self._cube.parts(window).items():
                of.setdefault(i, []).append(part)
        drawn = {
            i: self._views[i].raw(merged(parts, *self._views[i].size)) for i, parts in of.items()
        }
        return (self._cube.compose(drawn, windows),)


def _read_of(at: NDArray[np.float32], size: int) -> tuple[int, int]:
    """The first pixel of an axis, of so many, that an interpolation at these places reads, and the
    first that it does not.
    """
    first = min(max(math.floor(at.min()), 0), size - 1)
    return first, max(min(math.floor(at.max()) + 2, size), first + 1)


def _resampled(
    depth: DepthImage, maps: tuple[NDArray[np.float32], NDArray[np.float32]]
) -> DepthImage:
    """A depth picture with the distortion of a lens; at an edge it has the depth of one surface,
    and no mean of two.

    Within a surface 1/Z is interpolated, which is linear in a plane's picture.
    """
    w = 1 / depth
    square = np.ones((3, 3), np.uint8)
    smooth = (cv2.dilate(w, square) <= (1 + EDGE) * cv2.erode(w, square)).astype(np.uint8)
    nearest = cv2.remap(w, *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    linear = cv2.remap(w, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    within = cv2.remap(smooth, *maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    with np.errstate(divide="ignore"):
        return 1 / np.where(within > 0, linear, nearest)
