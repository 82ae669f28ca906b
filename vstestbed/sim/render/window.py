"""Rendering of a window of the image: with software OpenGL the cost is in the pixels, and a tracker needs few of them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from dm_control import mujoco as dm

from vstestbed.camera import DepthImage, Look, Window
from vstestbed.sim.row_weights import Rows

REACH = 0.05
"""Margin around the windows, as a share of the image's width: a marker a little outside of its window is still rendered."""


class PartCamera(dm.Camera):
    """dm_control's camera with a window: only that part of the image is drawn and read back; the rest is black.

    The window is drawn through its own share of the frustum. Vertices land where they do in the whole image, up to the rounding
    of single floats: of the rasteriser's 1/256 px positions one in fifty is off by one.

    Attributes:
        window: the part (left, top, right, bottom) [px] of the next image; None for all of it.
        reads_depth: with the next image, which is a whole one, its depth is read (`depth`).
    """

    window: Window | None = None
    reads_depth: bool = False
    _drawn: tuple[slice, slice] = (slice(None), slice(None))

    def update(self, scene_option: Any = None) -> None:
        """Update the scene. Planes are made decoration, which casts no shadow.

        Nothing lies below a floor to be shaded, and software OpenGL would speckle it with its own shadow (shadow acne).
        """
        super().update(scene_option)
        for geom in self._scene.ptr.geoms[: self._scene.ptr.ngeom]:
            if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
                geom.category = int(mujoco.mjtCatBit.mjCAT_DECOR)

    def _render_on_gl_thread(self, depth: bool, overlays: Any) -> None:
        """As dm_control's, within the window. The buffer has the lowest row first, as OpenGL does."""
        if self.window is None:
            self._drawn = slice(None), slice(None)
            super()._render_on_gl_thread(depth, overlays)
            if self.reads_depth:
                self._read_depth()
            return
        left, top, right, bottom = self.window
        for camera in self._scene.ptr.camera:
            _narrow(camera, self.window, self._width, self._height)
        contexts = self._physics.contexts
        assert contexts is not None and contexts.mujoco is not None
        rect, context = mujoco.MjrRect(0, 0, right - left, bottom - top), contexts.mujoco.ptr
        mujoco.mjr_render(rect, self._scene.ptr, context)
        part = np.empty((rect.height, rect.width, 3), np.uint8)
        mujoco.mjr_readPixels(part, None, rect, context)
        self._rgb_buffer[self._drawn] = 0  # only what was drawn last: the rest is black already
        self._drawn = slice(self._height - bottom, self._height - top), slice(left, right)
        self._rgb_buffer[self._drawn] = part

    def _read_depth(self) -> None:
        """Read the depth buffer of the image just drawn, while it is there."""
        contexts = self._physics.contexts
        assert contexts is not None and contexts.mujoco is not None
        context = contexts.mujoco.ptr
        # Far is 0: floats are finest there, where the depths are coarsest.
        context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR
        mujoco.mjr_readPixels(None, self._depth_buffer, self._rect, context)

    def depth(self) -> DepthImage:
        """Depth Z (H, W) [m] along the optical axis of the last image drawn with `reads_depth`; inf where nothing was drawn.

        With near and far planes at n and f the buffer holds b = n (f - Z) / (Z (f - n)).
        """
        model = self._physics.model
        near, far = (float(plane) * model.stat.extent for plane in (model.vis.map.znear, model.vis.map.zfar))
        b = self._depth_buffer[::-1].astype(float)
        return np.where(b > 0, near * far / (near + b * (far - near)), np.inf).astype(np.float32)


def _narrow(camera: mujoco.MjvGLCamera, window: Window, width: int, height: int) -> None:
    """Narrow a camera's frustum to a window of its image (width x height)."""
    left, top, right, bottom = window
    high = camera.frustum_top - camera.frustum_bottom
    half = camera.frustum_width or high * width / height / 2  # MuJoCo: 0 means "from the viewport's aspect ratio"
    first = camera.frustum_center - half
    camera.frustum_center = first + half * (left + right) / width
    camera.frustum_width = half * (right - left) / width
    camera.frustum_bottom, camera.frustum_top = camera.frustum_top - high * bottom / height, camera.frustum_top - high * top / height


def part_round(windows: Sequence[Window], width: int, height: int) -> Window | None:
    """The rectangle around all windows, with a margin, clipped to the image (width x height); None without windows."""
    if not windows:
        return None
    lefts, tops, rights, bottoms = zip(*windows, strict=True)
    more = round(REACH * width)
    return max(min(lefts) - more, 0), max(min(tops) - more, 0), min(max(rights) + more, width), min(max(bottoms) + more, height)


def part_of_rows(look: Look | None, rows: Rows, width: int, height: int) -> Window:
    """What is needed of rows of an image (width x height) of which windows are asked for, None for everything: one pixel at least."""
    if look is None:
        return 0, rows[0], width, rows[1]
    more = round(REACH * width)
    near = [window for window in look[0] if window[1] - more < rows[1] and window[3] + more > rows[0]]
    left, top, right, bottom = part_round(near, width, height) or (0, rows[0], 1, rows[0] + 1)
    return left, max(top, rows[0]), right, min(bottom, rows[1])
