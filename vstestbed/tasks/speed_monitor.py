"""Minimum-speed monitor of continuing tasks: line following, car following."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

WINDOW_S = 2.0
"""Speeds are means over this time [s]: longer than a start from standstill takes (.6 s to .8 m/s)."""
STEADY = 0.8
"""Who keeps a speed must make this share of it. A straight approach to a line, at 25 degrees, has .91; a start within the first
two seconds .87; steady driving .98 and more."""
FOLLOWS = 0.5
"""Who follows must make this share of the leader's: it cuts corners, and waits where it is too near."""


@dataclass(frozen=True, slots=True)
class MinSpeed:
    """A mover that must keep going: `who`, in words, at `least_mps` or more where `ordered_mps` are ordered [m/s]."""

    who: str
    ordered_mps: float
    least_mps: float


class SpeedMonitor:
    """Watches distances grow, and remembers who first went too slowly.

    Args:
        speeds: of whom. from_s: when the judgement begins [s]; the time before fills the first window.

    Attributes:
        slow: when [s] somebody first went too slowly, and the reason; None while nobody did.
    """

    def __init__(self, speeds: tuple[MinSpeed, ...], from_s: float):
        self._speeds, self._from_s = speeds, from_s
        self._past: deque[tuple[float, tuple[float, ...]]] = deque()
        self.slow: tuple[float, str] | None = None

    def update(self, t: float, travelled: tuple[float, ...], at_the_end: bool) -> None:
        """Take the distances so far [m] at a time [s]. A run shorter than the window is judged as a whole."""
        past = self._past
        past.append((t, travelled))
        while len(past) > 2 and past[1][0] <= t - WINDOW_S + 1e-9:
            past.popleft()
        began, before = past[0]
        whole = t - began >= WINDOW_S - 1e-9 or (at_the_end and t > began)
        if self.slow or t < self._from_s or not whole:
            return
        for speed, now, then in zip(self._speeds, travelled, before, strict=True):
            mean = (now - then) / (t - began)
            if not mean >= speed.least_mps:
                ordered = f"{speed.ordered_mps:g} m/s were ordered, {speed.least_mps:.2g} are the least that counts"
                self.slow = t, f"{speed.who} made {mean:.2f} m/s in the {t - began:.2g} s before {t:.3g} s; {ordered}"
                return
