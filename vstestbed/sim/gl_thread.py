"""The process's one OpenGL context, on a thread of its own, so that any thread may ask for pictures.

An OpenGL context is current on one thread at a time. dm_control makes it current on the first thread that draws and leaves it
there: a second one cannot draw, and if the first has ended, the context cannot even be freed. Here one thread owns the context from
its creation to the end of the process, and executes all calls of OpenGL in turn.
"""

from __future__ import annotations

import atexit
import os
import queue
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

from dm_control import _render
from dm_control._render import base, executor

from vstestbed.core.lacks import shortage
from vstestbed.sim.process_end import may_end_here
from vstestbed.sim.render import gl_probe

_making = threading.Lock()
_contexts: list[Any] = []


class RenderingThread(executor.BaseRenderExecutor):
    """dm_control's executor of OpenGL calls, on a daemon thread.

    Not dm_control's own one: its thread ends before the functions registered with `atexit`, one of which frees the context.
    """

    def __init__(self) -> None:
        super().__init__()
        self._mutex = threading.RLock()
        self._jobs: queue.SimpleQueue[tuple[Future[Any], Callable[[], object]] | None] = queue.SimpleQueue()
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
        # A job that asks for another one (a finaliser, for example) must not wait for whoever waits for the job.
        return threading.RLock() if threading.current_thread() is self._thread else self._mutex

    def _check_not_terminated(self) -> None:
        may_end_here(self._terminated)  # else a daemon thread that still draws while the process ends would raise
        super()._check_not_terminated()

    def call(self, func: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Execute a function on the rendering thread and return its result."""
        if threading.current_thread() is self._thread:
            return func(*args, **kwargs)
        self._check_not_terminated()  # again, with the lock: the process may have begun to end while this thread waited for it
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
                    self._thread.join()  # the driver unloads at exit: no thread of its own may be left

    def abandon(self) -> None:
        """Give up the context without freeing it: this process is a fork, in which the rendering thread does not exist."""
        self._terminated = True


class _OnRenderingThread(base.ContextBase):
    """Comes between a backend's context and its base class, and puts the rendering thread in the place of the calling one."""

    def __init__(self, max_width: int, max_height: int, render_executor_class: Any):
        # GLFW must be called from the main thread, says its manual (on macOS it crashes elsewhere).
        chosen: Any = render_executor_class if _render.BACKEND == "glfw" else RenderingThread
        super().__init__(max_width, max_height, chosen)


def context() -> Any:
    """The process's context (a dm_control `ContextBase`), made when first asked for; it lives as long as the process.

    Raises:
        EnvironmentLackError: the process is short of memory or of open files.
    """
    with _making:
        if not _contexts:
            if (lack := shortage()) is not None:
                raise lack  # a driver that loads its libraries without memory may end the process
            backend: Any = _render.Renderer
            kind: Any = type("Context", (backend, _OnRenderingThread), {})
            made = kind(max_width=64, max_height=64)  # its own size does not matter: images are rendered offscreen
            made.increment_refcount()
            _contexts.append(made)
        return _contexts[0]


def is_current() -> bool:
    """Whether the calling thread is the rendering thread."""
    executors = (made._render_executor for made in _contexts)
    return any(isinstance(one, RenderingThread) and one.thread is threading.current_thread() for one in executors)


def _after_fork() -> None:
    """In a fork, leave the parent's OpenGL alone: neither its rendering thread nor the driver's threads came along.

    A fork of a process that has not drawn yet may draw. In a fork of one that has, OpenGL would wait for these threads for ever.
    """
    if "OpenGL.EGL" in sys.modules:  # dm_control's exit function, which crashes where another thread than the main one has drawn
        atexit.unregister(sys.modules["OpenGL.EGL"].eglTerminate)
    for made in _contexts:
        made._render_executor.abandon()
        gl_probe.switch_off("this process is a fork of one that has drawn with it", "start processes with multiprocessing's method spawn")


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)
