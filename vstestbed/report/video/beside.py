"""Films a run while it goes on: what the loop hands over is drawn and encoded by a thread of its own."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np

from vstestbed.core.outcome import Verdict
from vstestbed.report.video.film import Film
from vstestbed.report.video.film_frame import FilmFrame
from vstestbed.report.video.quality import Pace
from vstestbed.tasks.frame import Frame

WAITING = 32
"""Most frames that wait to be drawn: two seconds of simulated time, 30 MB of pictures of 640 x 480."""


class FilmThread:
    """Films a run beside it (a Watcher).

    The state of each frame that the films show goes into a bounded queue, from which a thread takes it. The run waits while the
    queue is full, and computes the same numbers as without films. As all pictures by OpenGL are drawn in turn by the process's one
    rendering thread, the run's own pictures wait for at most one of a film.

    Args:
        opened: opens the films; left, it finishes them, or discards them on an exception.
        pace: which frames are shown.
    """

    def __init__(self, opened: Callable[[], AbstractContextManager[Sequence[Film]]], pace: Pace):
        self._opened, self._pace = opened, pace
        self._queue: queue.Queue[FilmFrame | None] = queue.Queue(WAITING)
        self._unshown: Frame | None = None
        self._error: BaseException | None = None
        self._aborted = False
        self._ending: Verdict | None = None
        self.spent_s = 0.0
        self._thread = threading.Thread(target=self._work, name="vstestbed films", daemon=True)
        self._thread.start()

    def frame(self, frame: Frame) -> None:
        """Hand over a frame of a running loop, if the films show it.

        Raises:
            EnvironmentLackError, OutputError: the films cannot be made.
        """
        if self._error is not None:
            raise self._error
        if self._pace.due(frame.t):
            self._hand_over(frame)
        else:
            self._unshown = frame

    def close(self, ending: Verdict | None) -> None:
        """Finish the films, which end with the run's last frame; `ending`: its outcome, which they show.

        Raises:
            EnvironmentLackError, OutputError: the films cannot be made.
        """
        if self._unshown is not None:
            self._hand_over(self._unshown)
        self._ending = ending
        self._queue.put(None)
        self._thread.join()
        if self._error is not None:
            raise self._error

    def abort(self) -> None:
        """Discard the films. Harmless after `close`."""
        self._aborted = True
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def _hand_over(self, frame: Frame) -> None:
        self._unshown, state = None, FilmFrame.of_frame(frame)
        # a copy: the next frame's image may overwrite it, and the overlay is drawn into it
        self._queue.put(state if state.image is None else replace(state, image=np.array(state.image)))

    def _work(self) -> None:
        frames = iter(self._queue.get, None)
        try:
            self._film(frames)
        except BaseException as error:  # belongs to the thread of the loop
            self._error = error
            for _ in frames:  # to the end, or the loop would wait for room in the queue
                pass

    def _film(self, frames: Iterator[FilmFrame]) -> None:
        with self._opened() as films:
            for frame in frames:
                for film in films if not self._aborted else ():
                    film.show(frame)
            for film in films:
                if self._aborted:
                    film.abort()
                elif self._ending is not None:
                    film.end(*self._ending)
        self.spent_s = sum(film.spent_s for film in films)
