"""Orders: a setpoint lasts a stated time. After it, or at a stop order, the robot stops in its own way (`Robot.stopping`)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.setpoints import Interpolation, Led

REFRESH_S = 0.01
"""How often the setpoint of a robot that stops is renewed [s], where it has no onboard controller with a period of its own."""


def stop_order(setpoint: Array) -> Array:
    """The order to stop, in the shape of a setpoint (n,): NaN, so that no setpoint that went wrong can be followed either."""
    return np.full_like(setpoint, np.nan)


class Orders:
    """The setpoint in force at each step of the physics clock.

    Args:
        stopping: the robot's own way to stop, `Robot.stopping`. first: the setpoint before the first order; None for none.
        lasts: how long an order lasts, in steps; infinite: until the next. step_s: duration of a step [s].
        led: how the setpoint goes from one order to the next; None: an order is the setpoint at once.
    """

    def __init__(
        self,
        stopping: Callable[[Array, float], Array],
        first: Array | None,
        lasts: float,
        step_s: float,
        led: Interpolation | None = None,
    ):
        self._stopping, self._order, self._lasts, self._step_s = stopping, first, lasts, step_s
        self._led = None if led is None else Led(led)
        self._until: float = lasts
        """The last step at which the order is followed."""
        self._refresh = max(1, round(REFRESH_S / step_s))

    def give(self, step: int, setpoint: Array) -> None:
        """A new order at this step. A stop order while the robot already stops changes nothing."""
        if math.isnan(np.add.reduce(setpoint)):
            self._until = min(self._until, step - 1)
            return
        if self._led is not None:
            self._led.toward(step, setpoint, self.at(step), lapsed=step > self._until)
        self._order, self._until = setpoint, step + self._lasts

    def at(self, step: int) -> Array | None:
        """The setpoint at this step: the order, or the robot's own way to stop from it; None before the first order."""
        if self._order is None:
            return None
        if step <= self._until:
            return self._followed(step)
        return self._stopping(self._followed(self._until), (step - self._until) * self._step_s)

    def _followed(self, step: float) -> Array:
        """The setpoint by the orders alone."""
        assert self._order is not None
        return self._order if self._led is None or not self._led.begun else self._led.at(int(step))

    def unchanged(self, step: int, ahead: int) -> int:
        """For how many of the next `ahead` steps (at least one) the setpoint at this step may stay as it is."""
        if self._order is not None and self._led is not None and step <= self._until:
            ahead = int(min(ahead, self._led.unchanged(step)))
        if self._order is None or step + ahead <= self._until + 1:
            return ahead
        if step <= self._until:
            return int(self._until) + 1 - step
        return min(ahead, self._refresh)
