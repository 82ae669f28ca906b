"""The velocities that were ordered, integrated over time: what a robot without sensors of its motion knows about its own way."""

from __future__ import annotations

from collections import deque

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.setpoints import Between, Blend

REMEMBERED = 500
"""Orders that are kept. The oldest time asked for is that of the last exposure but one, a few orders ago."""


class CommandHistory:
    """The velocities ordered so far, each in force from its time on until the next one.

    Args:
        size: number of velocities, 6 for a camera twist.
        between: how the robot goes from one order to the next, which its controller knows (`setpoints.Blend`). over_s: in this time [s].
    """

    def __init__(self, size: int = 6, between: Between = "hold", over_s: float = 0.0) -> None:
        self._between: Between = between
        self._over_s, rest = over_s, np.zeros(size)
        first = 0.0, self._blend(rest, rest, rest), rest
        self._orders: deque[tuple[float, Blend, Array]] = deque([first], maxlen=REMEMBERED)

    def _blend(self, before: Array, slope: Array, twist: Array) -> Blend:
        return Blend(self._between, before, slope, twist, self._over_s)

    def add(self, t: float, twist: Array) -> None:
        """Velocities (size,) are in force from t [s] on, which is not before the last order; one of the same time takes its place."""
        twist = twist.copy()  # a cycle's, to which its reader may write
        since, before, way = self._orders[-1]
        if t <= since:
            self._orders[-1] = since, self._blend(before.before, before.start, twist), way
        else:
            after = t - since
            self._orders.append((t, self._blend(before.at(after), before.slope(after), twist), way + before.way(after)))

    def displacement(self, t: float) -> Array:
        """Their integral until t, (size,) [m, rad]."""
        for since, blend, way in reversed(self._orders):
            if since <= t:
                return way + blend.way(t - since)
        return self._orders[0][2]
