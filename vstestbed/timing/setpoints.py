"""Setpoints between two orders: held, or led from one to the next, at the rate at which the robot takes setpoints."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vstestbed.core.geometry import Array, all_finite

Between = Literal["hold", "ramp", "smooth"]
"""Held until the next order; led to it in a straight line; led to it with limited jerk."""


@dataclass(frozen=True, slots=True)
class Interpolation:
    """How the robot goes from one order to the next.

    between: what lies between them. every: steps between two setpoints that reach the actuators. over: steps from the old order to the new
    one, a camera period; of no meaning for `hold`.
    """

    between: Between
    every: int
    over: int

    def next_tick(self, step: int) -> int:
        """The first step from `step` on at which the actuators get a setpoint."""
        return -(-step // self.every) * self.every


class Blend:
    """The way from a value to another within a time T: with s = t / T from 0 to 1,

        hold    u = u1
        ramp    u = u0 + (u1 - u0) s                                           (first-order hold, late by a period)
        smooth  u = u0 + T u0' (s - 2 s^2 + s^3) + (u1 - u0) (3 s^2 - 2 s^3)   (a cubic that ends with slope 0)

    and u1 from then on. Of velocities, `smooth` has a continuous acceleration and a jerk of at most 6 |u1 - u0| / T^2 + 4 |u0'| / T. Both
    cover (u0 + u1) T / 2 in the time T (smooth: from rest, u0' = 0), which a held order would have covered as u1 T: they are late by T / 2.

    References: Franklin, Powell & Workman 1998, Digital Control of Dynamic Systems (holds); Siciliano, Sciavicco, Villani & Oriolo 2009,
    doi:10.1007/978-1-84628-642-1 (cubic polynomials between two values and their slopes).

    between: see above. before: u0 (n,). slope: u0' (n,), by the unit of time of T. after: u1 (n,). duration: T.
    """

    __slots__ = ("_parts", "after", "before", "duration", "start")

    def __init__(self, between: Between, before: Array, slope: Array, after: Array, duration: float):
        self.before, self.start, self.after = before, slope, after
        # From or to infinity, by which a craft's rotors are switched off, there is no way.
        self.duration = 0.0 if between == "hold" or not (all_finite(before) and all_finite(after)) else duration
        if self.duration:
            rise, at_first = after - before, slope * duration
            smooth = (before, at_first, 3 * rise - 2 * at_first, at_first - 2 * rise)
            self._parts = smooth if between == "smooth" else (before, rise, np.zeros_like(rise), np.zeros_like(rise))

    def at(self, t: float) -> Array:
        """The value (n,) at a time from the start on; `after` itself at the end."""
        if t >= self.duration:
            return self.after
        s, (a, b, c, d) = t / self.duration, self._parts
        return a + s * (b + s * (c + s * d))

    def slope(self, t: float) -> Array:
        """Its derivative (n,) by time."""
        if t >= self.duration:
            return np.zeros_like(self.after)
        s, (_, b, c, d) = t / self.duration, self._parts
        return (b + s * (2 * c + s * 3 * d)) / self.duration

    def way(self, t: float) -> Array:
        """Its integral (n,) from the start to a time."""
        if self.duration == 0:
            return self.after * t
        s, (a, b, c, d) = min(t / self.duration, 1.0), self._parts
        return self.duration * s * (a + s * (b / 2 + s * (c / 3 + s * d / 4))) + self.after * max(t - self.duration, 0.0)


class Led:
    """What the actuators get of the orders: a setpoint every few steps of the physics clock, on the way to the last order.

    Each is the mean of the way (`Blend`) over the steps for which it is held, so that the robot covers what the way does, at any rate of
    setpoints; its value at the first of them would be late by half of them.

    how: rate and interpolation.
    """

    def __init__(self, how: Interpolation):
        self._how = how
        self._begins, self._until_then = 0, np.zeros(0)
        self.blend: Blend | None = None  # none before the first order

    def toward(self, step: int, setpoint: Array, now: Array | None, lapsed: bool) -> None:
        """A new order at this step; it begins to act with the next setpoint that the actuators get.

        now: the setpoint in force; None before the first order, which is led to from rest. lapsed: it is no longer an order's, but the
        robot's own way to stop.
        """
        how, blend = self._how, self.blend
        begins = how.next_tick(step)
        held = np.zeros_like(setpoint) if now is None else now
        before, slope = held, np.zeros_like(setpoint)
        if blend is not None and not lapsed:
            t = begins - self._begins
            # Of two orders before one setpoint the later one counts: both set out from the same value.
            before, slope = (blend.at(t), blend.slope(t)) if step >= self._begins else (blend.before, blend.start)
        self.blend, self._begins, self._until_then = Blend(how.between, before, slope, setpoint, how.over), begins, held

    def at(self, step: int) -> Array:
        """The setpoint at this step."""
        assert self.blend is not None
        if step < self._begins:
            return self._until_then
        every, blend = self._how.every, self.blend
        t = step // every * every - self._begins
        return blend.after if t >= blend.duration else (blend.way(t + every) - blend.way(t)) / every

    def unchanged(self, step: int) -> float:
        """For how many steps from this one on it stays as it is; infinite at the end of the way."""
        if self.blend is not None and step < self._begins + self._how.next_tick(int(self.blend.duration)):
            return self._how.next_tick(step + 1) - step
        return np.inf


Stop = Literal["", "stop", "off"]
"""No stop; in the robot's own way (`Robot.stopping`); the motors of a craft that stands go off for good."""

REFRESH_S = 0.01
"""How often the setpoint of a robot that stops is renewed [s], where it has no onboard controller with a period of its own."""


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
        assert self._order is not None
        return self._order if self._led is None or self._led.blend is None else self._led.at(int(step))

    def unchanged(self, step: int, ahead: int) -> int:
        """For how many of the next `ahead` steps (at least one) the setpoint at this step may stay as it is."""
        if self._order is not None and self._led is not None and step <= self._until:
            ahead = int(min(ahead, self._led.unchanged(step)))
        if self._order is None or step + ahead <= self._until + 1:
            return ahead
        if step <= self._until:
            return int(self._until) + 1 - step
        return min(ahead, self._refresh)
