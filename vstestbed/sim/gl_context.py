"""One OpenGL context for each process, with a cache of MuJoCo's rendering contexts for scenes that look the same."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import mujoco
import numpy as np
from dm_control import _render
from dm_control import mujoco as dm
from dm_control.mujoco import wrapper
from dm_control.mujoco.engine import Contexts

MOST_KEPT = 4
"""Rendering contexts kept: those of the servo camera and of the outside view, for two scenarios in turn."""
_contexts: list[Any] = []
_target: list[object] = [None]
"""The rendering context whose buffer is current."""
_kept: OrderedDict[tuple[object, ...], wrapper.MjrContext] = OrderedDict()


class Physics(dm.Physics):
    """dm_control's physics, whose pictures are drawn in the process's one OpenGL context.

    A rendering context holds what is uploaded to the graphics memory: textures, shadow map, buffers, no state of the scene. It
    takes .1 to .5 s to make, which a worker process pays once for all of its runs.
    """

    @property
    def contexts(self) -> Contexts | None:
        """The contexts, with this scene's made current; None where dm_control has switched rendering off."""
        contexts = super().contexts
        # Several rendering contexts share one OpenGL context, whose current buffer is global state: switched only where it is another's.
        if contexts is not None and _target[0] is not contexts.mujoco:
            with contexts.gl.make_current() as thread:
                thread.call(mujoco.mjr_setBuffer, mujoco.mjtFramebuffer.mjFB_OFFSCREEN, contexts.mujoco.ptr)
            _target[0] = contexts.mujoco
        return contexts

    def fitting_contexts(self) -> Contexts | None:
        """The contexts with a buffer of the model's offscreen size, which may have grown; other scenes keep the old ones."""
        contexts = self.contexts
        if contexts is None:
            return None
        size, buffer = self.model.ptr.vis.global_, contexts.mujoco.ptr
        if (buffer.offWidth, buffer.offHeight) != (size.offwidth, size.offheight):
            self._free_rendering_contexts()
        return self.contexts

    def _make_rendering_contexts(self) -> None:
        """Take the cached rendering context of a model that looks the same, or make one."""
        if not _contexts or _contexts[0].terminated:
            _kept.clear()
            _contexts[:] = [_render.Renderer(max_width=64, max_height=64)]  # its own size does not matter: images are rendered offscreen
            _contexts[0].increment_refcount()  # so that it lives as long as the process
        key = _looks(self.model.ptr)
        if key not in _kept:
            _kept[key] = wrapper.MjrContext(self.model, _contexts[0])
            with _contexts[0].make_current() as thread:
                thread.call(_plain_sky, _kept[key].ptr)
        _kept.move_to_end(key)
        self._contexts = Contexts(gl=_contexts[0], mujoco=_kept[key])

    def _free_rendering_contexts(self) -> None:
        """Return the context to the cache; the least recently used one is dropped."""
        self._contexts = None
        while len(_kept) > MOST_KEPT:
            _kept.popitem(last=False)  # freed when no other scene holds it


def _plain_sky(context: mujoco.MjrContext) -> None:
    """Switch off the sky texture's mipmap, which is never used: the sky is always magnified.

    The image has the same bytes, and software OpenGL, which computes the level of each pixel, saves a third of its time.
    """
    from OpenGL import GL

    for kind, texture in zip(context.textureType, context.texture, strict=True):
        if kind == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            GL.glBindTexture(GL.GL_TEXTURE_CUBE_MAP, texture)
            GL.glTexParameteri(GL.GL_TEXTURE_CUBE_MAP, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR)


def _looks(model: mujoco.MjModel) -> tuple[object, ...]:
    """A key of everything in a model that enters a rendering context: sizes, shapes, materials, textures."""
    quality, size = model.vis.quality, model.vis.global_
    # Planes are compiled to display lists by their size, hence the geoms beside the assets.
    names = [n for n in dir(model) if n.startswith(("tex_", "mat_", "mesh_", "hfield_", "skin_"))]
    arrays = [getattr(model, name) for name in (*names, "geom_type", "geom_size", "geom_dataid", "geom_matid")]
    numbers = (
        model.vis.map.shadowclip * model.stat.extent,
        size.offwidth,
        size.offheight,
        quality.offsamples,
        quality.shadowsize,
        quality.numslices,
        quality.numstacks,
        quality.numquads,
    )
    return *numbers, hash(tuple(np.asarray(a).tobytes() for a in arrays))
