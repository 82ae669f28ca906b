"""A camera of which a part of the picture can be drawn: where nobody looks, software OpenGL need not paint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from dm_control import mujoco as dm

from vstestbed.camera import Window

REACH = 0.05
"""The part reaches beyond the windows by this share of the picture's width: what turns up beside its window is still seen."""


class PartCamera(dm.Camera):
    """dm_control's kept camera with a window: of the picture only that is drawn and read, and the rest is black.

    The part is drawn through its own share of the frustum, which puts every vertex where it is in the whole picture but for
    the rounding of single floats: on a grid of 1/256 px one in fifty comes to lie on the next knot.

    Attributes:
        window: the part (left, top, right, bottom) [px] of the next picture; None for all of it.
    """

    window: Window | None = None
    _drawn: tuple[slice, slice] = (slice(None), slice(None))

    def update(self, scene_option: Any = None) -> None:
        """Bring the scene up to date. Planes cast no shadow: nothing lies behind a floor, and software OpenGL would dot it with its own."""
        super().update(scene_option)
        for geom in self._scene.ptr.geoms[: self._scene.ptr.ngeom]:
            if geom.type == mujoco.mjtGeom.mjGEOM_PLANE:
                geom.category = int(mujoco.mjtCatBit.mjCAT_DECOR)

    def _render_on_gl_thread(self, depth: bool, overlays: Any) -> None:
        """As dm_control's, within the window; its buffer has the lowest row first."""
        if self.window is None:
            self._drawn = slice(None), slice(None)
            super()._render_on_gl_thread(depth, overlays)
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
        self._rgb_buffer[self._drawn] = 0
        self._drawn = slice(self._height - bottom, self._height - top), slice(left, right)
        self._rgb_buffer[self._drawn] = part


def _narrow(camera: mujoco.MjvGLCamera, window: Window, width: int, height: int) -> None:
    """Narrow a camera's frustum to a window of its picture (width x height)."""
    left, top, right, bottom = window
    high = camera.frustum_top - camera.frustum_bottom
    half = camera.frustum_width or high * width / height / 2
    first = camera.frustum_center - half
    camera.frustum_center = first + half * (left + right) / width
    camera.frustum_width = half * (right - left) / width
    camera.frustum_bottom, camera.frustum_top = camera.frustum_top - high * bottom / height, camera.frustum_top - high * top / height


def part_round(windows: Sequence[Window], width: int, height: int) -> Window | None:
    """The rectangle round all windows, and some more about it, within a picture; None where there is no window."""
    if not windows:
        return None
    lefts, tops, rights, bottoms = zip(*windows, strict=True)
    more = round(REACH * width)
    return max(min(lefts) - more, 0), max(min(tops) - more, 0), min(max(rights) + more, width), min(max(bottoms) + more, height)
