"""`--executor warp`: runs that fly together in one process, so that a device draws the pictures of all of them at once.

Each run has a thread and only one goes on at a time: until it asks for a picture, when the next one goes on. As all wait, their pictures
are drawn by one call. What a run computes, and in which order, is what it computes alone: its result does not depend on the others.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vstestbed.camera import Image
from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.render.pictures import drawn_together
from vstestbed.studies.pools import Done, LocalPool, Request

if TYPE_CHECKING:
    from vstestbed.sim.render.warp import Device, PictureRequest

TOGETHER = 32
"""Runs of one worker that fly together: of 32 pictures the calls of a device are a few per cent, and so many are lost with a worker."""


class _Turn:
    """A run in its thread. asked: the picture that it waits for; ended: it waits for none any more."""

    def __init__(self, task: Callable[[], Any]):
        self.go, self.done = threading.Semaphore(0), Future[Any]()
        self.asked: PictureRequest | None = None
        self.given: Sequence[Image] | BaseException = ()
        self.ended, self.task = False, task


class Together:
    """Flies runs together.

    device: draws their pictures. Attribute name: of what draws.
    """

    def __init__(self, device: Device):
        self._device, self.name = device, device.name
        self._parked = threading.Semaphore(0)
        self._own = threading.local()

    def draw(self, shot: PictureRequest) -> Sequence[Image]:
        """The tiles of a picture that a run asks for: it waits until all others wait, too."""
        turn: _Turn = self._own.turn
        turn.asked = shot
        self._parked.release()
        turn.go.acquire()
        if isinstance(turn.given, BaseException):
            raise turn.given
        return turn.given

    def fly(self, tasks: Iterable[Callable[[], Any]]) -> list[Future[Any]]:
        """Do the runs; their results, or what they raised, in the same order."""
        turns = [_Turn(task) for task in tasks]
        for turn in turns:
            threading.Thread(target=self._begin, args=(turn,), daemon=True).start()
        going = turns
        while going:
            for turn in going:  # one after another, each until it waits for its picture or has ended
                turn.go.release()
                self._parked.acquire()
            if going := [turn for turn in going if not turn.ended]:
                self._draw(going)
        return [turn.done for turn in turns]

    def _draw(self, waiting: Sequence[_Turn]) -> None:
        shots = [turn.asked for turn in waiting if turn.asked is not None]
        try:
            for turn, given in zip(waiting, self._device.draw(shots), strict=True):
                turn.given = given
        except Exception as error:  # of the device, or of its memory: each run tells it, and none waits for ever
            for turn in waiting:
                turn.given = EnvironmentLackError(f"the device draws no pictures: {error}", "use --executor local")

    def _begin(self, turn: _Turn) -> None:
        self._own.turn = turn
        drawn_together.set(self)
        turn.go.acquire()
        try:
            turn.done.set_result(turn.task())
        except BaseException as error:
            turn.done.set_exception(error)
        turn.ended = True
        self._parked.release()


@cache
def device() -> Device:
    """This process's device. Raises EnvironmentLackError: MuJoCo Warp is not installed, or does not work here."""
    try:
        from vstestbed.sim.render.warp import Device
    except ImportError as error:
        raise EnvironmentLackError(f"MuJoCo Warp is not installed ({error})", "pip install 'vstestbed[gpu]'") from None
    try:
        return Device()
    except RuntimeError as error:
        raise EnvironmentLackError(f"Warp does not work here: {error}", "use --executor local") from error


def fly(requests: Sequence[Request[Any]], place: str | None = None) -> list[tuple[Any, BaseException | None]]:
    """Do requests together, in a worker: of each its result, or what it raised."""
    flown = Together(device()).fly([lambda request=request: request.perform(place) for request in requests])
    return [(None, error) if (error := done.exception()) is not None else (done.result(), None) for done in flown]


class TogetherPool(LocalPool):
    """Processes of this machine, each with some runs that fly together; arguments as of `LocalPool`.

    A run whose process died flies alone when it is tried again: it shall not take others with it. OpenGL, which makes the films, does not
    share a process with a device's drawing.
    """

    films = False

    def __init__(self, jobs: int, folder: Path):
        super().__init__(jobs, folder)
        self.room, self._jobs = jobs * TOGETHER, jobs
        self._waiting: list[tuple[Request[Any], Future[Any]]] = []
        self._guard = threading.Lock()

    def _start(self) -> None:
        self.room, room = self._jobs, self.room
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
                bunch, self._waiting = self._waiting[:share], self._waiting[share:]
                slot = self._free.pop()
                slot.run(Request("", fly, ([request for request, _ in bunch],))).add_done_callback(
                    lambda inner, slot=slot, bunch=bunch: self._returned(inner, slot, [outer for _, outer in bunch])
                )

    def _returned(self, inner: Future[Any], slot: Any, outers: Sequence[Future[Any]]) -> None:
        """Free the slot, then complete the futures of all runs that were in it."""
        whole: Future[Any] = Future()
        self._hand_over(inner, slot, whole)
        error = whole.exception()
        results = [(None, error)] * len(outers) if error is not None else whole.result()
        for outer, (result, own) in zip(outers, results, strict=True):
            if own is not None:
                outer.set_exception(own)
            else:
                outer.set_result(result)


def must_fly_together(scenarios: Iterable[Scenario]) -> None:
    """Refuse what a device cannot draw, before anything runs.

    Raises ParameterError: with the field. EnvironmentLackError: MuJoCo Warp is not installed.
    """
    device()
    for scenario in scenarios:
        for camera in (scenario.camera, *(eye.camera for eye in scenario.eyes.values())):
            if camera.renderer != "auto":
                raise ParameterError.fixed("camera.renderer", "auto", camera.renderer, why="--executor warp draws by rays of its own")
            if camera.shadows:
                raise ParameterError.fixed("camera.shadows", "false", camera.shadows, why="--executor warp draws no shadows")
        if scenario.world.floor.mirror:
            raise ParameterError.fixed("world.floor.mirror", "0", scenario.world.floor.mirror, why="--executor warp draws no mirrors")
