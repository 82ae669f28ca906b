"""Whether what shall keep going does: a vehicle along its line, another one ahead and the one that follows it."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

WINDOW_S = 2.0
"""Speeds are means over this time [s]: longer than a start from standstill takes (.6 s to .8 m/s)."""


@dataclass(frozen=True, slots=True)
class Pace:
    """What shall keep going: `who`, in words, at `least_mps` or more where `told_mps` are ordered [m/s]."""

    who: str
    told_mps: float
    least_mps: float


@dataclass
class PaceMaker:
    """Watches ways grow, and remembers who first went too slowly: when [s], and the reason.

    Attributes:
        paces: of whom. from_s: when the judgement begins [s]; the time before tells the first means.
    """

    paces: tuple[Pace, ...]
    from_s: float
    slow: tuple[float, str] | None = None
    past: deque[tuple[float, tuple[float, ...]]] = field(default_factory=deque)

    def watch(self, t: float, ways: tuple[float, ...], at_the_end: bool) -> None:
        """The ways so far [m] at a time [s]. A run shorter than the window is judged as a whole."""
        self.past.append((t, ways))
        while len(self.past) > 2 and self.past[1][0] <= t - WINDOW_S + 1e-9:
            self.past.popleft()
        began, before = self.past[0]
        whole = t - began >= WINDOW_S - 1e-9 or (at_the_end and t > began)
        if self.slow or t < self.from_s or not whole:
            return
        for pace, now, then in zip(self.paces, ways, before, strict=True):
            speed = (now - then) / (t - began)
            if not speed >= pace.least_mps:
                told = f"{pace.told_mps:g} m/s were ordered, {pace.least_mps:.2g} are the least that counts"
                self.slow = t, f"{pace.who} made {speed:.2f} m/s in the {t - began:.2g} s before {t:.3g} s; {told}"
                return
