"""Minimum-speed monitor of continuing tasks: line following, car following."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

WINDOW_S = 2.0
"""Window of the mean speed [s]: longer than a start from standstill takes (.6 s to .8 m/s)."""
STEADY = 0.8
"""Least share of a commanded speed. Measured: steady driving .98 and more, a straight approach to a line at 25 degrees .91, a start
within the first two seconds .87."""
FOLLOWS = 0.5
"""Least share of the leader's speed for a follower, which cuts corners, and waits where it is too near."""


@dataclass(frozen=True, slots=True)
class MinSpeed:
    """A minimum speed: `who`, in words, must reach `least_mps` where `commanded_mps` are commanded [m/s]."""

    who: str
    commanded_mps: float
    least_mps: float


class SpeedMonitor:
    """Tests mean speeds over WINDOW_S, and keeps the first violation.

    Args:
        speeds: the minimum speeds. from_s: start of the test [s]; the time before fills the first window.

    Attributes:
        slow: time [s] and reason of the first violation; None without one.
    """

    def __init__(self, speeds: tuple[MinSpeed, ...], from_s: float):
        self._speeds, self._from_s = speeds, from_s
        self._past: deque[tuple[float, tuple[float, ...]]] = deque()
        self.slow: tuple[float, str] | None = None

    def update(self, t: float, travelled: tuple[float, ...], at_the_end: bool) -> None:
        """Add the distances so far [m] at a time [s]. A run shorter than the window is tested as a whole."""
        past = self._past
        past.append((t, travelled))
        # The first entry left is the newest that is a whole window old: the mean is over WINDOW_S, whatever the frame rate.
        while len(past) > 2 and past[1][0] <= t - WINDOW_S + 1e-9:
            past.popleft()
        began, before = past[0]
        whole = t - began >= WINDOW_S - 1e-9 or (at_the_end and t > began)
        if self.slow or t < self._from_s or not whole:
            return
        for speed, now, then in zip(self._speeds, travelled, before, strict=True):
            mean = (now - then) / (t - began)
            if not mean >= speed.least_mps:  # `not >=`: a mean of NaN is a violation, too
                commanded = f"{speed.commanded_mps:g} m/s were commanded, {speed.least_mps:.2g} are the least that counts"
                self.slow = t, f"{speed.who} made {mean:.2f} m/s in the {t - began:.2g} s before {t:.3g} s; {commanded}"
                return
