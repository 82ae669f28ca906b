"""Films beside a run: which frames they get, in which order; that a film that fails or waits
neither changes nor blocks the run.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vstestbed.core.errors import EnvironmentLackError
from vstestbed.core.outcome import Outcome
from vstestbed.report.video import film as beside
from vstestbed.report.video.film import FilmThread, Pace


def frame(k: int, image: np.ndarray | None = None) -> Any:
    """Frame k of a camera at 25 Hz, with what films use of it."""
    truth = SimpleNamespace(T_world_target=np.eye(4), T_world_camera=np.eye(4), q=np.zeros(2))
    seen = SimpleNamespace(uv=np.zeros((4, 2)), image=None)
    return SimpleNamespace(
        t=k / 25,
        truth=truth,
        error=SimpleNamespace(rms_px=1.0, lost=False),
        observation=seen,
        goal=seen,
        image=image,
        row=np.zeros(0),
        cameras={},
    )


class Takes:
    """A film that notes what it gets; it stops before each frame while `go` is not set, and fails
    at one of them.
    """

    def __init__(self, fails_at: float = np.inf):
        self.times: list[float] = []
        self.images: list[np.ndarray | None] = []
        self.fails_at, self.ended, self.state = fails_at, None, "open"
        self.go = threading.Event()
        self.go.set()
        self.spent_s = 0.5

    def show(self, m: Any) -> None:
        assert self.go.wait(10)
        if m.t >= self.fails_at:
            raise EnvironmentLackError("no room", "make some")
        self.times.append(m.t)
        self.images.append(m.image)

    def end(self, *ending: object) -> None:
        self.ended = ending

    def abort(self) -> None:
        self.state = "aborted"


def filming(film: Takes, every: int = 2) -> FilmThread:
    @contextmanager
    def opened() -> Iterator[list[Takes]]:
        try:
            yield [film]
            film.state = "closed" if film.state == "open" else film.state
        except BaseException:
            film.abort()
            raise

    return FilmThread(opened, Pace(25.0, every))  # type: ignore[arg-type] - films that only count


def test_every_second_frame_in_order_and_the_last_one():
    film = Takes()
    films = filming(film)
    for k in range(100):
        films.frame(frame(k))
    films.close((Outcome.converged, "converged"))
    assert film.times == [*(k / 25 for k in range(0, 100, 2)), 99 / 25]
    assert (film.ended, film.state, films.spent_s) == (
        (Outcome.converged, "converged"),
        "closed",
        0.5,
    )
    films.abort()
    assert film.state == "closed"


def test_no_frame_twice_and_no_ending_unless_given():
    film = Takes()
    films = filming(film)
    for k in range(3):
        films.frame(frame(k))
    films.close(None)
    assert (film.times, film.ended) == ([0.0, 2 / 25], None)


def test_a_film_gets_its_own_copy_of_the_picture():
    film, image = Takes(), np.zeros((2, 2, 3), np.uint8)
    film.go.clear()
    films = filming(film)
    films.frame(frame(0, image))
    image[:] = 7  # the next frame's, in the same buffer
    film.go.set()
    films.close(None)
    assert film.images[0] is not None and not film.images[0].any()


def test_the_run_waits_for_a_slow_film_with_a_bounded_queue(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(beside, "WAITING", 4)
    film = Takes()
    film.go.clear()
    films = filming(film, every=1)
    given = []

    def run() -> None:
        for k in range(20):
            films.frame(frame(k))
            given.append(k)

    loop = threading.Thread(target=run)
    loop.start()
    loop.join(0.2)
    assert loop.is_alive() and len(given) <= 5  # one is being drawn, four wait
    film.go.set()
    loop.join(10)
    films.close(None)
    assert film.times == [k / 25 for k in range(20)]


def test_an_error_reaches_the_run_and_never_blocks_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(beside, "WAITING", 2)
    film = Takes(fails_at=0.2)
    films = filming(film, every=1)
    with pytest.raises(EnvironmentLackError, match="no room; make some"):
        for k in range(10_000):
            films.frame(frame(k))
    films.abort()
    assert film.state == "aborted" and not films._thread.is_alive()


def test_an_error_at_the_end_is_raised_by_close():
    film = Takes(fails_at=0.04)
    film.go.clear()
    films = filming(film)
    films.frame(frame(0))
    films.frame(frame(1))
    film.go.set()
    with pytest.raises(EnvironmentLackError, match="no room"):
        films.close(None)
    assert film.state == "aborted"


def test_abort_discards_what_waits_and_ends_the_thread(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(beside, "WAITING", 8)
    film = Takes()
    film.go.clear()
    films = filming(film, every=1)
    for k in range(8):
        films.frame(frame(k))
    threading.Timer(0.05, film.go.set).start()
    films.abort()
    assert film.state == "aborted" and len(film.times) <= 1 and not films._thread.is_alive()
