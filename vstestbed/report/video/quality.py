"""How films are drawn: quick drafts beside a run, or fine films; how large, and which frames they show."""

from __future__ import annotations

import functools
import logging
import math
from dataclasses import dataclass

from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.render.pictures import draws_rays


@dataclass(frozen=True, slots=True)
class Quality:
    """How films are drawn.

    Attributes:
        size: (width, height) of the film from outside [px]. longest: the servo camera's film is scaled down to this side [px].
        samples: multisampling of the view from outside. shadows: draw them there.
        most_hz: most pictures a second of simulated time [Hz].
    """

    size: tuple[int, int]
    longest: int
    samples: int
    shadows: bool
    most_hz: float

    def every(self, rate_hz: float) -> int:
        """Every how many frames of a camera the film has a picture."""
        return max(1, math.ceil(rate_hz / self.most_hz - 1e-9))

    def share(self, width: int, height: int) -> float:
        """Size of the servo camera's film as a share of its image's [px]."""
        return min(1.0, self.longest / max(width, height))


DRAFT = Quality((640, 360), longest=384, samples=0, shadows=False, most_hz=15.0)
FINE = Quality((1280, 720), longest=4320, samples=4, shadows=True, most_hz=math.inf)
RAYS = Quality((320, 180), longest=320, samples=0, shadows=False, most_hz=5.0)
"""Without OpenGL a picture takes some twenty times as long."""


def quality_of(scenario: Scenario, fine: bool = False) -> Quality:
    """The quality of a scenario's films: a draft, or fine films; small ones where rays draw them, with a warning that says so."""
    if fine:
        return FINE
    if not draws_rays(scenario.camera):
        return DRAFT
    _warn_once()
    return RAYS


@functools.cache
def _warn_once() -> None:
    """Say once that films are small."""
    words = "films by rays are small, %d x %d from outside with %g pictures a second; --fine makes large ones, which takes long"
    logging.getLogger("vstestbed").warning(words, *RAYS.size, RAYS.most_hz)


class Pace:
    """Which of a camera's frames a film shows: each that is the first one since the last picture was due."""

    def __init__(self, rate_hz: float, every: int):
        self._rate_hz, self._every = rate_hz, every
        self._began: float | None = None
        self._last = -1

    def place(self, t: float) -> int:
        """Number of the film's picture that shows time t [s], counted from the first frame's."""
        self._began = t if self._began is None else self._began
        return round((t - self._began) * self._rate_hz) // self._every

    def due(self, t: float) -> bool:
        """Whether the frame at t [s] is to be shown; to be called once for each frame, in their order."""
        before, self._last = self._last, self.place(t)
        return self._last > before
