"""Orders: a velocity, which lasts a stated time, or a stop. After the time, or at a stop, the robot stops in its own way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.allocation import Allocation
from vstestbed.robots.setpoints import Interpolation, Led

Stop = Literal["", "stop", "off"]
"""No stop; in the robot's own way (`Robot.stopping`); the motors of a craft that stands go off for good."""

REFRESH_S = 0.01
"""How often the setpoint of a robot that stops is renewed [s], where it has no onboard controller with a period of its own."""


@dataclass(frozen=True, slots=True)
class Order:
    """What the robot is to do: a velocity, or a stop with its reason. All numbers are finite, and those of a stop are at rest.

    Attributes:
        setpoint: of the actuators or the onboard controller (joint velocities [rad/s], or a twist); of a stop the one at which the robot
            comes to rest (of a car: no speed, the steering as it was).
        twist: the camera twist (6,) that the setpoint realises by the robot's own model [m/s, rad/s]; of a stop zero.
        rates: the robot's own velocities (n,) that it orders (`OwnModel`); None: those of `twist`.
        stop: "" for a velocity, `stop`, or `off`: see `Stop`.
        reason: why the robot stops, or has another velocity than the law's; "" while it follows the law.
        latched: the supervisor has taken the robot from the law for good: nothing but `Controller.reset` gives it back.
    """

    setpoint: Array
    twist: Array
    rates: Array | None = None
    stop: Stop = ""
    reason: str = ""
    latched: bool = False

    @property
    def stopped(self) -> bool:
        """Whether it is a stop."""
        return bool(self.stop)

    @classmethod
    def of(cls, allocation: Allocation) -> Order:
        """The law's own, within the robot's limits."""
        return cls(allocation.setpoint, allocation.twist, allocation.rates)

    def copy(self) -> Order:
        """The same in arrays of its own: the reader of a cycle may write to those of the cycle."""
        rates = None if self.rates is None else self.rates.copy()
        return replace(self, setpoint=self.setpoint.copy(), twist=self.twist.copy(), rates=rates)

    def halted(self, reason: str, latched: bool = False, stop: Stop = "stop") -> Order:
        """A stop in its place."""
        return Order(np.zeros_like(self.setpoint), np.zeros(6), None, stop, reason, latched)


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

    def give(self, step: int, setpoint: Array, stop: Stop = "") -> None:
        """A new order at this step. A stop while the robot already stops changes nothing."""
        if stop == "stop":
            self._until = min(self._until, step - 1)
            return
        if stop == "off":  # no finite setpoint can be mistaken for it, nor is there a way to it
            setpoint = np.full_like(setpoint, -np.inf)
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
