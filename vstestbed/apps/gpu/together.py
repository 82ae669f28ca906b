"""`--executor warp`: runs that fly together in one process, so that a device draws the pictures of
all of them at once.

Each run is a coroutine (a greenlet: the loop need not know of it), and goes on until it asks for a
picture, when the next one does. As all wait, their pictures are drawn by one call. What a run
computes, and in which order, is what it computes alone: its result does not depend on the others.
Imported only where it is asked for: it needs the extra `gpu`.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from functools import cache, partial
from pathlib import Path
from typing import Any

from greenlet import getcurrent, greenlet

from vstestbed.apps.gpu.warp import Device, PictureRequest, WarpRenderer
from vstestbed.camera import Camera, Image
from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.render.pictures import drawn_together
from vstestbed.sim.scene.scene import Scene
from vstestbed.studies.pools import Done, LocalPool, Request

TOGETHER = 32
"""Runs of one worker that fly together: of 32 pictures the calls of a device are a few per cent,
and so many are lost with a worker.
"""


class Together:
    """Flies runs together.

    device: draws their pictures. Attribute name: of what draws.
    """

    def __init__(self, device: Device):
        self._device = device
        self.name = device.name

    def renderer(
        self, stage: Scene, camera: Camera, noisy: bool, share: float, eye: str
    ) -> WarpRenderer:
        """The renderer of a run's camera; arguments as of `sim.render.pictures.servo_renderer`."""
        return WarpRenderer(stage, camera, self, noisy, share, eye)

    def draw(self, request: PictureRequest) -> Sequence[Image]:
        """The tiles of a picture that a run asks for: the others go on until each of them waits,
        too.
        """
        current = getcurrent()
        assert current.parent is not None, "pictures are drawn together for runs that `fly`"
        return current.parent.switch(request)

    def fly(self, tasks: Iterable[Callable[[], Any]]) -> list[Future[Any]]:
        """Do the runs; their results, or what they raised, in the same order."""
        done: list[Future[Any]] = []
        waiting: list[Waiting] = []
        for task in tasks:
            done.append(Future())
            run = greenlet(self._begin)
            waiting += _asked(run, run.switch(task, done[-1]))
        while waiting:
            runs, requests = zip(*waiting, strict=True)
            waiting = []
            try:
                drawn = self._device.draw(requests)
            except Exception as error:  # of the device, or of its memory: each run tells it
                lack = EnvironmentLackError(
                    f"the device draws no pictures: {error}", "use --executor local"
                )
                for run in runs:
                    waiting += _asked(run, run.throw(lack))
            else:
                for run, tiles in zip(runs, drawn, strict=True):
                    waiting += _asked(run, run.switch(tiles))
        return done

    def _begin(self, task: Callable[[], Any], done: Future[Any]) -> None:
        drawn_together.set(self)  # in the run's own context
        try:
            done.set_result(task())
        except BaseException as error:
            done.set_exception(error)


Waiting = tuple[greenlet, PictureRequest]  # a run, and what it waits for


def _asked(run: greenlet, request: PictureRequest) -> list[Waiting]:
    """What a run waits for, after it went on; nothing at its end."""
    return [] if run.dead else [(run, request)]


@cache
def device() -> Device:
    """This process's device. Raises EnvironmentLackError: Warp does not work here."""
    try:
        return Device()
    except RuntimeError as error:
        raise EnvironmentLackError(
            f"Warp does not work here: {error}", "use --executor local"
        ) from error


def fly(
    requests: Sequence[Request[Any]], place: str | None = None
) -> list[tuple[Any, BaseException | None]]:
    """Do requests together, in a worker: of each its result, or what it raised."""
    found: list[tuple[Any, BaseException | None]] = []
    for done in Together(device()).fly([partial(one.perform, place) for one in requests]):
        error = done.exception()
        found.append((done.result() if error is None else None, error))
    return found


class TogetherPool(LocalPool):
    """Processes of this machine, each with some runs that fly together; arguments as of
    `LocalPool`.

    A run whose process died flies alone when it is tried again: it shall not take others with it.
    OpenGL, which makes the films, does not share a process with a device's drawing.
    """

    films = False

    def __init__(self, jobs: int, folder: Path):
        super().__init__(jobs, folder)
        self.room = jobs * TOGETHER
        self._jobs = jobs
        self._waiting: list[tuple[Request[Any], Future[Any]]] = []
        self._guard = threading.Lock()

    def _start(self) -> None:
        room = self.room
        self.room = self._jobs  # of processes
        super()._start()
        self.room = room

    def submit(self, request: Request[Done]) -> Future[Done]:
        """Gather a run; `dispatch` sends it."""
        self._tries[request.folder] = self._tries.get(request.folder, 0) + 1
        outer: Future[Done] = Future()
        outer.set_running_or_notify_cancel()
        with self._guard:
            self._waiting.append((request, outer))
        return outer

    def dispatch(self) -> None:
        """Send what waits to the processes that are free, in equal parts."""
        self._start()
        with self._guard:
            while self._waiting and self._free:
                first = self._waiting[0][0]
                alone = self._tries[first.folder] > 1
                share = 1 if alone else min(TOGETHER, -(-len(self._waiting) // len(self._free)))
                requests, outers = zip(*self._waiting[:share], strict=True)
                self._waiting = self._waiting[share:]
                slot = self._free.pop()
                inner = slot.run(Request("", fly, (requests,)))
                inner.add_done_callback(partial(self._returned, slot, outers))

    def _returned(self, slot: Any, outers: Sequence[Future[Any]], inner: Future[Any]) -> None:
        """Free the slot, then complete the futures of all runs that were in it."""
        whole: Future[Any] = Future()
        self._hand_over(inner, slot, whole)
        error = whole.exception()
        results = whole.result() if error is None else [(None, error)] * len(outers)
        for outer, (result, own) in zip(outers, results, strict=True):
            if own is None:
                outer.set_result(result)
            else:
                outer.set_exception(own)


def must_fly_together(scenarios: Iterable[Scenario]) -> None:
    """Refuse what a device cannot draw, before anything runs.

    Raises ParameterError: with the field. EnvironmentLackError: Warp does not work here.
    """
    device()
    for scenario in scenarios:
        for camera in (scenario.camera, *(eye.camera for eye in scenario.eyes.values())):
            if camera.renderer != "auto":
                raise _only("camera.renderer", "auto", camera.renderer, "by rays of its own")
            if camera.shadows:
                raise _only("camera.shadows", "false", camera.shadows, "no shadows")
        mirror = scenario.world.floor.mirror
        if mirror:
            raise _only("world.floor.mirror", "0", mirror, "no mirrors")


def _only(field: str, value: str, found: object, drawn: str) -> ParameterError:
    return ParameterError.fixed(field, value, found, why=f"--executor warp draws {drawn}")
