"""The shape of a law's command over time: a smooth start, a low-pass filter, and the last command where nothing can be measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.laws.base import Command, TwistLimits


@dataclass(frozen=True, slots=True)
class Shaped:
    """What the next command depends on.

    Attributes:
        t0: time of the first command [s]. u0: that command without the smooth start (n,).
        t: time of the last command [s]. u: that command, before limits (n,).
    """

    t0: float = math.nan
    u0: Array | None = None
    t: float = math.nan
    u: Array | None = None


BEGIN = Shaped()
"""The state before the first command."""


@dataclass(frozen=True, slots=True)
class CommandShape:
    """From rest with u - u(0) exp(-t/start_s), then through the filter u_k = u_(k-1) + (1 - exp(-dt/smoothing_s)) (u - u_(k-1)).

    The filter begins at the first command. Time constants in seconds give the same motion at every camera rate.

    Attributes:
        start_s, smoothing_s: time constants [s]; 0: none. keep: whether the last command is kept where nothing can be measured.
    """

    start_s: float = 0.0
    smoothing_s: float = 0.0
    keep: bool = False

    def __call__(self, before: Shaped, t: float, u: Array) -> tuple[Shaped, Array]:
        """The next state, and the command for the law's u (n,) at a time t [s]."""
        t0, u0 = before.t0, before.u0
        if self.start_s > 0:
            t0, u0 = (t, u) if u0 is None else (t0, u0)
            u = u - u0 * math.exp(-(t - t0) / self.start_s)
        if self.smoothing_s > 0 and before.u is not None:
            u = before.u + (1 - math.exp(-(t - before.t) / self.smoothing_s)) * (u - before.u)
        return Shaped(t0, u0, t, u), u

    def unseen(self, before: Shaped, limits: TwistLimits, basis: Array, why: str) -> tuple[Shaped, Command]:
        """The state and the command of a frame without a measurement: rest, or the last command; why: in words."""
        if not self.keep or before.u is None:
            return BEGIN, Command.rest(basis, why)  # from rest the next command starts smoothly again
        return before, replace(limits.command(before.u, basis), rest_reason=why)

    @property
    def size(self) -> int:
        """Numbers of the state of one of many runs: u0, u and t."""
        return 13 if self.start_s > 0 or self.smoothing_s > 0 else 0

    def of_many(self, state: Array, t: float, u: Array) -> tuple[Array, Array]:
        """The next states (M, size) of many runs, NaN before the first frame, and their commands for the law's u (M, 6)."""
        if not self.size:
            return state, u
        u0, last, since = state[:, :6], state[:, 6:12], t - state[:, 12:]
        if self.start_s > 0:
            u0 = np.where(np.isnan(u0), u, u0)
            u = u - u0 * math.exp(-t / self.start_s)
        if self.smoothing_s > 0:
            u = np.where(np.isnan(last), u, last + (1 - np.exp(-since / self.smoothing_s)) * (u - last))
        return np.column_stack([u0, u, np.full(len(u), t)]), u
