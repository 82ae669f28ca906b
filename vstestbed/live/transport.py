"""Play, pause, single steps, and the pace: simulated time against the clock on the wall."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Verdict
from vstestbed.report.video.film_frame import FilmFrame

LATE_S = 0.25
"""How far behind its pace a run may be and still catch up; beyond, it goes on from where it is."""
MEASURED_S = 2.0
"""Time on the wall over which the pace is measured."""


@dataclass(frozen=True, slots=True)
class Sample:
    """What a page shows of one frame.

    Attributes:
        number: of the frame. film: poses, markers, picture. twist: commanded camera twist (6,), NaN where unknown.
        judged: the error by which the task is judged, in `unit`. verdict: how the run ended with it; None while it goes on.
        T_world_goal: the camera's pose (4, 4) at its goal, if it has one.
    """

    number: int
    film: FilmFrame
    twist: Array
    judged: float
    unit: str
    T_world_goal: Array | None
    verdict: Verdict | None = None


class Transport:
    """Whether time goes on, and how fast.

    Attributes:
        playing: frames follow each other by themselves. speed: simulated seconds a second; inf for as fast as the machine can.

    Args:
        clock: the time on the wall [s], monotonic.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self.playing, self.speed = True, 1.0
        self._steps = 0
        self._anchor: tuple[float, float] | None = None
        self._passed: deque[tuple[float, float]] = deque()

    def play(self, on: bool) -> None:
        """Go on, or pause; steps that wait are dropped."""
        self.playing, self._steps = on, 0
        self.restart_pace()

    def step(self) -> None:
        """One frame more, then pause."""
        if self.playing:
            self.play(False)
        self._steps += 1

    def set_speed(self, speed: float) -> None:
        """Simulated seconds a second, from now on."""
        self.speed = speed
        self.restart_pace()

    def begin(self) -> None:
        """Another run begins: steps that wait belong to the one before."""
        self._steps = 0
        self.restart_pace()

    def restart_pace(self) -> None:
        """The pace counts from the next frame on."""
        self._anchor = None
        self._passed.clear()

    def wait_s(self, t: float) -> float | None:
        """How long the next frame is not due [s], where t is the time of the last one; None where none is to come."""
        if self._steps:
            return 0.0
        if not self.playing:
            return None
        now = self._clock()
        if self._anchor is None:
            self._anchor = now, t
        due = self._anchor[0] + (t - self._anchor[1]) / self.speed
        if now - due > LATE_S:
            self._anchor = now, t
        return max(0.0, due - now)

    def passed(self, t: float) -> None:
        """A frame of time t [s] was made."""
        self._steps = max(0, self._steps - 1)
        now = self._clock()
        self._passed.append((now, t))
        while now - self._passed[0][0] > MEASURED_S and len(self._passed) > 2:
            self._passed.popleft()

    @property
    def pace(self) -> float:
        """Simulated seconds a second over the last moments; NaN while it is not known."""
        if len(self._passed) < 2:
            return math.nan
        (wall, t), (wall_now, t_now) = self._passed[0], self._passed[-1]
        return (t_now - t) / (wall_now - wall) if wall_now > wall else math.nan
