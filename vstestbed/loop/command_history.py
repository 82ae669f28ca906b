"""The velocities that were ordered, integrated over time: what a robot without sensors of its motion knows about its own way."""

from __future__ import annotations

from collections import deque

import numpy as np

from vstestbed.core.geometry import Array

REMEMBERED = 500
"""Orders that are kept. The oldest time asked for is that of the last exposure but one, a few orders ago."""


class CommandHistory:
    """The velocities ordered so far, each in force from its time on until the next one.

    Args:
        size: number of velocities, 6 for a camera twist.
    """

    def __init__(self, size: int = 6) -> None:
        self._orders: deque[tuple[float, Array, Array]] = deque([(0.0, np.zeros(size), np.zeros(size))], maxlen=REMEMBERED)

    def add(self, t: float, twist: Array) -> None:
        """Velocities (size,) are in force from t [s] on, which is not before the last order; one of the same time takes its place."""
        twist = twist.copy()  # a cycle's, to which its reader may write
        since, before, way = self._orders[-1]
        if t <= since:
            self._orders[-1] = since, twist, way
        else:
            self._orders.append((t, twist, way + before * (t - since)))

    def displacement(self, t: float) -> Array:
        """Their integral until t, (size,) [m, rad]."""
        for since, twist, way in reversed(self._orders):
            if since <= t:
                return way + twist * (t - since)
        return self._orders[0][2]
