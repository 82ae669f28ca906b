"""Physics that draw in the process's one OpenGL context, with a cache of MuJoCo's rendering
contexts for scenes that look the same.
"""

from __future__ import annotations

import atexit
import os
import queue
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

import mujoco
import numpy as np
from dm_control import _render
from dm_control import mujoco as dm
from dm_control._render import base, executor
from dm_control.mujoco import wrapper
from dm_control.mujoco.engine import Contexts
from numpy.typing import NDArray

from vstestbed.core.errors import shortage
from vstestbed.sim import gl_probe

# The process's one OpenGL context, on a thread of its own, so that any thread may ask for pictures.
#
# An OpenGL context is current on one thread at a time. dm_control makes it current on the first
# thread that draws and leaves it there: a second one cannot draw, and if the first has ended, the
# context cannot even be freed. Here one thread owns the context from its creation to the end of the
# process, and executes all calls of OpenGL in turn.


_making = threading.Lock()
_contexts: list[Any] = []


class RenderingThread(executor.BaseRenderExecutor):
    """dm_control's executor of OpenGL calls, on a daemon thread.

    Not dm_control's own one: its thread ends before the functions registered with `atexit`, one of
    which frees the context.
    """

    def __init__(self) -> None:
        super().__init__()
        self._mutex = threading.RLock()
        self._jobs: queue.SimpleQueue[tuple[Future[Any], Callable[[], object]] | None] = (
            queue.SimpleQueue()
        )
        self._thread = threading.Thread(target=self._work, name="vstestbed rendering", daemon=True)
        self._thread.start()

    def _work(self) -> None:
        while (given := self._jobs.get()) is not None:
            future, job = given
            try:
                if not future.set_running_or_notify_cancel():
                    continue
                future.set_result(job())
            except BaseException as error:  # belongs to the thread that waits for the job
                future.set_exception(error)
            del given, future, job  # what a job holds must not live until the next one

    @property
    def thread(self) -> Any:
        """The thread with the context."""
        return self._thread

    @property
    def _lock_if_necessary(self) -> Any:
        # A job that asks for another one (a finaliser, for example) must not wait for whoever waits
        # for the job.
        return threading.RLock() if threading.current_thread() is self._thread else self._mutex

    def call(self, func: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Execute a function on the rendering thread and return its result."""
        if threading.current_thread() is self._thread:
            return func(*args, **kwargs)
        # again, with the lock: the process may have begun to end while this thread waited for it
        self._check_not_terminated()
        future: Future[Any] = Future()
        self._jobs.put((future, lambda: func(*args, **kwargs)))
        try:
            return future.result()
        except KeyboardInterrupt:
            future.cancel()  # if it has not begun
            raise

    def terminate(self, cleanup_callable: Callable[[], object] | None = None) -> None:
        """Execute a last function, which frees the context, and end the thread."""
        if self._terminated:
            return
        with self._lock_if_necessary:
            if not self._terminated:
                if cleanup_callable:
                    self.call(cleanup_callable)
                self._terminated = True
                self._jobs.put(None)
                if not is_current():
                    # the driver unloads at exit: no thread of its own may be left
                    self._thread.join()


class _OnRenderingThread(base.ContextBase):
    """Comes between a backend's context and its base class, and puts the rendering thread in the
    place of the calling one.
    """

    def __init__(self, max_width: int, max_height: int, render_executor_class: Any):
        # GLFW must be called from the main thread, says its manual (on macOS it crashes elsewhere).
        chosen: Any = render_executor_class if _render.BACKEND == "glfw" else RenderingThread
        super().__init__(max_width, max_height, chosen)


def context() -> Any:
    """The process's context (a dm_control `ContextBase`), made when first asked for; it lives as
    long as the process.

    Raises EnvironmentLackError: the process is short of memory or of open files.
    """
    with _making:
        if not _contexts:
            if (lack := shortage()) is not None:
                raise lack  # a driver that loads its libraries without memory may end the process
            backend: Any = _render.Renderer
            kind: Any = type("Context", (backend, _OnRenderingThread), {})
            # its own size does not matter: images are rendered offscreen
            made = kind(max_width=64, max_height=64)
            made.increment_refcount()
            _contexts.append(made)
        return _contexts[0]


def is_current() -> bool:
    """Whether the calling thread is the rendering thread."""
    executors = (made._render_executor for made in _contexts)
    return any(
        isinstance(one, RenderingThread) and one.thread is threading.current_thread()
        for one in executors
    )


def _after_fork() -> None:
    """In a fork, leave the parent's OpenGL alone: neither its rendering thread nor the driver's
    threads came along.

    A fork of a process that has not drawn yet may draw. In a fork of one that has, OpenGL would
    wait for these threads for ever.
    """
    # dm_control's exit function, which crashes where another thread than the main one has drawn
    if "OpenGL.EGL" in sys.modules:
        atexit.unregister(sys.modules["OpenGL.EGL"].eglTerminate)
    for made in _contexts:
        # given up without being freed: the rendering thread does not exist here
        made._render_executor._terminated = True
        gl_probe.switch_off(
            "this process is a fork of one that has drawn with it",
            "start processes with multiprocessing's method spawn",
        )


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


T = TypeVar("T")
# Rendering contexts kept: those of the servo camera and of the outside view, for two scenarios in
# turn
MOST_KEPT = 4
_target: list[object] = [None]
"""The rendering context whose buffer is current. This and `_kept` are used on the rendering thread
alone, and need no lock.
"""
# how OpenGL now draws highlights, see `Physics.glossy`; on the rendering thread alone
_glossy = [False]
_kept: OrderedDict[tuple[object, ...], wrapper.MjrContext] = OrderedDict()


class Physics(dm.Physics):
    """dm_control's physics, whose pictures are drawn in the process's one OpenGL context.

    A rendering context holds what is uploaded to the graphics memory: textures, shadow map,
    buffers, no state of the scene. It takes .1 to .5 s to make, which a worker process pays once
    for all of its runs.

    anisotropy: samples of a texture in a pixel that sees it aslant, see `Camera`; set before the
    first picture.
    glossy: highlights lie over the textures; else they are multiplied by their colours, as OpenGL
    does by itself.
    """

    anisotropy: int = 1
    glossy: bool = False

    @property
    def contexts(self) -> Contexts | None:
        """The contexts; on the rendering thread with this scene's made current. None where
        dm_control has switched rendering off.
        """
        contexts: Any = self._contexts
        if contexts is None and not is_current():
            # makes them; it takes a lock, for which the rendering thread must not wait
            contexts = super().contexts
        if contexts is None or contexts.gl.thread is not threading.current_thread():
            return contexts
        # Several rendering contexts share one OpenGL context, whose current buffer is global state:
        # switched only where it is another's, and within the job that draws, since another thread's
        # job may come before.
        if _target[0] is not contexts.mujoco:
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, contexts.mujoco.ptr)
            _target[0] = contexts.mujoco
        if _glossy[0] != self.glossy:
            from OpenGL.raw.GL.VERSION import GL_1_1, GL_1_2

            how = GL_1_2.GL_SEPARATE_SPECULAR_COLOR if self.glossy else GL_1_2.GL_SINGLE_COLOR
            GL_1_1.glLightModeli(GL_1_2.GL_LIGHT_MODEL_COLOR_CONTROL, how)
            _glossy[0] = self.glossy
        return contexts

    def with_context(self, job: Callable[[], T]) -> T:
        """The result of a function that is executed on the rendering thread, where the OpenGL
        context is current.

        The buffer has the model's offscreen size, which may have grown since the last call; other
        scenes keep the old ones.
        """
        contexts: Any = self.contexts
        if contexts is None:
            raise RuntimeError("dm_control's rendering is switched off")
        size = self.model.ptr.vis.global_
        buffer = contexts.mujoco.ptr
        if (buffer.offWidth, buffer.offHeight) != (size.offwidth, size.offheight):
            self._free_rendering_contexts()
            contexts = self.contexts
        with contexts.gl.make_current() as thread:
            return thread.call(job)

    def _make_rendering_contexts(self) -> None:
        gl = context()
        with gl.make_current() as thread:
            self._contexts = Contexts(
                gl=gl, mujoco=thread.call(_rendering_context, self.model, gl, self.anisotropy)
            )

    def _free_rendering_contexts(self) -> None:
        """Return the context to the cache; the least recently used one is dropped."""
        gl: Any = self._contexts and self._contexts.gl
        self._contexts = None
        if not gl.terminated:  # else the process ends, or is a fork
            with gl.make_current() as thread:
                thread.call(_drop_surplus)


def _rendering_context(model: wrapper.MjModel, gl: object, anisotropy: int) -> wrapper.MjrContext:
    """The cached rendering context of a model that looks the same, or a new one. On the rendering
    thread.
    """
    key = (anisotropy, *_looks(model.ptr))
    if key not in _kept:
        _kept[key] = wrapper.MjrContext(model, gl)
        _target[0] = _kept[key]  # MuJoCo makes the buffer of a new context current
        _plain_sky(_kept[key].ptr)
        if anisotropy > 1:
            _sample_aslant(_kept[key].ptr, model.ptr, anisotropy)
    _kept.move_to_end(key)
    return _kept[key]


def _drop_surplus() -> None:
    while len(_kept) > MOST_KEPT:
        _kept.popitem(last=False)  # freed when no other scene holds it


def _plain_sky(context: mujoco.MjrContext) -> None:
    """Switch off the sky texture's mipmap, which is never used: the sky is always magnified.

    The image has the same bytes, and software OpenGL, which computes the level of each pixel, saves
    a third of its time.
    """
    # not OpenGL.GL, which imports all extensions in .06 s
    from OpenGL.raw.GL.VERSION import GL_1_0, GL_1_1, GL_1_3

    for kind, texture in zip(context.textureType, context.texture, strict=True):
        if kind == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            GL_1_1.glBindTexture(GL_1_3.GL_TEXTURE_CUBE_MAP, texture)
            GL_1_0.glTexParameteri(
                GL_1_3.GL_TEXTURE_CUBE_MAP, GL_1_0.GL_TEXTURE_MIN_FILTER, GL_1_0.GL_LINEAR
            )


def _sample_aslant(context: mujoco.MjrContext, model: mujoco.MjModel, samples: int) -> None:
    """Let flat textures that are not repeated be sampled several times along the longer side of
    what a pixel covers.

    Mesa's software OpenGL visits each repeat within a pixel, and for what lies beyond a face's
    border, where a plane is seen from nearly within, extrapolates to any number of them: with a
    floor up to the horizon a picture would never end.
    """
    from OpenGL.raw.GL.EXT import texture_filter_anisotropic as aslant
    from OpenGL.raw.GL.VERSION import GL_1_0, GL_1_1

    flat = model.tex_type == mujoco.mjtTexture.mjTEXTURE_2D
    for texture in np.flatnonzero(flat & ~repeated(model)):
        GL_1_1.glBindTexture(GL_1_0.GL_TEXTURE_2D, context.texture[texture])
        GL_1_0.glTexParameterf(GL_1_0.GL_TEXTURE_2D, aslant.GL_TEXTURE_MAX_ANISOTROPY_EXT, samples)


def repeated(model: mujoco.MjModel) -> NDArray[np.bool_]:
    """Which textures (N,) a material lays in tiles, as the floor's does."""
    tiles = (model.mat_texrepeat > 1).any(axis=1) | (model.mat_texuniform > 0)
    return np.isin(np.arange(model.ntex), model.mat_texid[tiles])


def _looks(model: mujoco.MjModel) -> tuple[object, ...]:
    """A key of everything in a model that enters a rendering context: sizes, shapes, materials,
    textures.
    """
    quality = model.vis.quality
    size = model.vis.global_
    # Planes are compiled to display lists by their size, hence the geoms beside the assets.
    names = [n for n in dir(model) if n.startswith(("tex_", "mat_", "mesh_", "hfield_", "skin_"))]
    names += "geom_type", "geom_size", "geom_dataid", "geom_matid"
    return (
        model.vis.map.shadowclip * model.stat.extent,
        size.offwidth,
        size.offheight,
        quality.offsamples,
        quality.shadowsize,
        quality.numslices,
        quality.numstacks,
        quality.numquads,
        hash(tuple(np.asarray(getattr(model, name)).tobytes() for name in names)),
    )
