"""One OpenGL context a process, and MuJoCo's rendering contexts in it, kept from one scene to the next that looks the same."""

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
"""The rendering context whose buffer is drawn into."""
_kept: OrderedDict[tuple[object, ...], wrapper.MjrContext] = OrderedDict()


class Physics(dm.Physics):
    """dm_control's physics, whose pictures are drawn in the process's one OpenGL context.

    A rendering context holds what goes to the graphics memory: textures, shadow map, buffers, no state of the scene. It takes
    .1 to .5 s to make, which a worker that runs one start after the other pays once.
    """

    @property
    def contexts(self) -> Contexts | None:
        """The contexts, this scene's the one that is drawn into; None where dm_control has switched rendering off."""
        contexts = super().contexts
        if contexts is not None and _target[0] is not contexts.mujoco:
            with contexts.gl.make_current() as thread:
                thread.call(mujoco.mjr_setBuffer, mujoco.mjtFramebuffer.mjFB_OFFSCREEN, contexts.mujoco.ptr)
            _target[0] = contexts.mujoco
        return contexts

    def fitting_contexts(self) -> Contexts | None:
        """The contexts, with a buffer of the model's offscreen size, which may have grown: who else holds them keeps theirs."""
        contexts = self.contexts
        if contexts is None:
            return None
        size, buffer = self.model.ptr.vis.global_, contexts.mujoco.ptr
        if (buffer.offWidth, buffer.offHeight) != (size.offwidth, size.offheight):
            self._free_rendering_contexts()
        return self.contexts

    def _make_rendering_contexts(self) -> None:
        """Take the kept rendering context of a model that looks the same, or make one."""
        if not _contexts or _contexts[0].terminated:
            _kept.clear()
            _contexts[:] = [_render.Renderer(max_width=64, max_height=64)]  # pictures are drawn off its screen
            _contexts[0].increment_refcount()  # it goes when the process does
        key = _looks(self.model.ptr)
        if key not in _kept:
            _kept[key] = wrapper.MjrContext(self.model, _contexts[0])
            with _contexts[0].make_current() as thread:
                thread.call(_plain_sky, _kept[key].ptr)
        _kept.move_to_end(key)
        self._contexts = Contexts(gl=_contexts[0], mujoco=_kept[key])

    def _free_rendering_contexts(self) -> None:
        """Leave the contexts to the next; of the kept ones the oldest goes."""
        self._contexts = None
        while len(_kept) > MOST_KEPT:
            _kept.popitem(last=False)  # freed when no other scene holds it


def _plain_sky(context: mujoco.MjrContext) -> None:
    """Take the sky's texture as it is, not from a pyramid of smaller ones: it is drawn larger than it is.

    The picture has the same bytes, and software OpenGL, which looks for the level of each pixel, saves a third of its time.
    """
    from OpenGL import GL

    for kind, texture in zip(context.textureType, context.texture, strict=True):
        if kind == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            GL.glBindTexture(GL.GL_TEXTURE_CUBE_MAP, texture)
            GL.glTexParameteri(GL.GL_TEXTURE_CUBE_MAP, GL.GL_TEXTURE_MIN_FILTER, GL.GL_LINEAR)


def _looks(model: mujoco.MjModel) -> tuple[object, ...]:
    """All of a model that may go into a rendering context: sizes, shapes (planes have lists of their own), materials, textures."""
    quality, size = model.vis.quality, model.vis.global_
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
