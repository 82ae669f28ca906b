"""Setpoints between two commands: held, or interpolated, at the rate at which the robot takes
setpoints.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from vstestbed.core.geometry import Array, all_finite

# held until the next command; led to it in a straight line; led to it with limited jerk
Mode = Literal["hold", "ramp", "smooth"]


class Profile:
    """The way from one value to another within a time T: with s = t / T from 0 to 1,

        hold    u = u1
        ramp    u = u0 + (u1 - u0) s
                (first-order hold, late by a period)
        smooth  u = u0 + T u0' (s - 2 s^2 + s^3) + (u1 - u0) (3 s^2 - 2 s^3)
                (a cubic that ends with slope 0)

    and u1 from then on. Of velocities, `smooth` has a continuous acceleration and a jerk of at most
    6 |u1 - u0| / T^2 + 4 |u0'| / T. Both cover (u0 + u1) T / 2 in the time T (smooth: from rest,
    u0' = 0), where a held command covers u1 T: they are late by T / 2.

    References: Franklin, Powell & Workman 1998, Digital Control of Dynamic Systems (holds);
    Siciliano, Sciavicco, Villani & Oriolo 2009, doi:10.1007/978-1-84628-642-1 (cubic polynomials
    between two values and their slopes).

    mode: see above. before: u0 (n,). slope: u0' (n,), by the unit of time of T. after: u1 (n,).
    duration: T.
    """

    __slots__ = ("_parts", "after", "before", "duration", "start")

    def __init__(self, mode: Mode, before: Array, slope: Array, after: Array, duration: float):
        self.before = before
        self.start = slope
        self.after = after
        # From or to infinity, by which a craft's rotors are switched off, there is no way.
        self.duration = (
            0.0 if mode == "hold" or not (all_finite(before) and all_finite(after)) else duration
        )
        if self.duration:
            rise = after - before
            at_first = slope * duration
            smooth = (before, at_first, 3 * rise - 2 * at_first, at_first - 2 * rise)
            self._parts = (
                smooth
                if mode == "smooth"
                else (before, rise, np.zeros_like(rise), np.zeros_like(rise))
            )

    def at(self, t: float) -> Array:
        """The value (n,) at a time from the start on; `after` itself at the end."""
        if t >= self.duration:
            return self.after
        s = t / self.duration
        (a, b, c, d) = self._parts
        return a + s * (b + s * (c + s * d))

    def slope(self, t: float) -> Array:
        """Its derivative (n,) by time."""
        if t >= self.duration:
            return np.zeros_like(self.after)
        s = t / self.duration
        (_, b, c, d) = self._parts
        return (b + s * (2 * c + s * 3 * d)) / self.duration

    def way(self, t: float) -> Array:
        """Its integral (n,) from the start to a time."""
        if self.duration == 0:
            return self.after * t
        s = min(t / self.duration, 1.0)
        (a, b, c, d) = self._parts
        return self.duration * s * (a + s * (b / 2 + s * (c / 3 + s * d / 4))) + self.after * max(
            t - self.duration, 0.0
        )


class Interpolator:
    """Setpoints on the way from one command to the next, one every few steps of the physics clock.

    Each is the mean of the profile over the steps for which it is held. The robot thus covers what
    the profile does, at any rate of setpoints; the value at the first of these steps would be late
    by half of them.

    mode: of the profile. every: steps from one setpoint to the next. over: steps from one command
    to the next one, a camera period; of no meaning for `hold`.
    """

    def __init__(self, mode: Mode, every: int, over: int):
        self._mode: Mode = mode
        self._every = every
        self._over = over
        self._begins = 0
        self._until_then = np.zeros(0)
        self.profile: Profile | None = None  # none before the first command

    def next_tick(self, step: int) -> int:
        """The first step from `step` on at which the actuators get a setpoint."""
        return -(-step // self._every) * self._every

    def toward(self, step: int, setpoint: Array, now: Array | None, lapsed: bool) -> None:
        """A new command at this step; it begins to act with the next setpoint that the actuators
        get.
        now: the setpoint in force; None before the first command, whose profile begins at rest.
        lapsed: the setpoint in force is the robot's own way to stop, no longer that of a command.
        """
        profile = self.profile
        begins = self.next_tick(step)
        held = np.zeros_like(setpoint) if now is None else now
        before = held
        slope = np.zeros_like(setpoint)
        if profile is not None and not lapsed:
            t = begins - self._begins
            # Of two commands before one setpoint the later one counts: both set out from the same
            # value.
            before, slope = (
                (profile.at(t), profile.slope(t))
                if step >= self._begins
                else (profile.before, profile.start)
            )
        self.profile = Profile(self._mode, before, slope, setpoint, self._over)
        self._begins = begins
        self._until_then = held

    def at(self, step: int) -> Array:
        """The setpoint at this step."""
        assert self.profile is not None
        if step < self._begins:
            return self._until_then
        every = self._every
        profile = self.profile
        t = step // every * every - self._begins
        return (
            profile.after
            if t >= profile.duration
            else (profile.way(t + every) - profile.way(t)) / every
        )

    def unchanged(self, step: int) -> float:
        """For how many steps from this one on it stays as it is; infinite at the end of the way."""
        if self.profile is not None and step < self._begins + self.next_tick(
            int(self.profile.duration)
        ):
            return self.next_tick(step + 1) - step
        return np.inf


# no stop; in the robot's own way (`Robot.stopping`); the motors of a craft that stands go off for
# good
Stop = Literal["", "stop", "off"]

# how often the setpoint of a robot that stops is renewed [s], where it has no onboard controller
# with a period of its own
REFRESH_S = 0.01


class SetpointBuffer:
    """The setpoint in force at each step of the physics clock.

    Args:
        stopping: the robot's own way to stop, `Robot.stopping`. first: the setpoint before the
            first command; None for none.
        lasts: how long a command lasts, in steps; infinite: until the next. step_s: duration of a
            step [s].
        interpolator: leads from one command to the next; None: a command is the setpoint at once.
    """

    def __init__(
        self,
        stopping: Callable[[Array, float], Array],
        first: Array | None,
        lasts: float,
        step_s: float,
        interpolator: Interpolator | None = None,
    ):
        self._stopping = stopping
        self._command = first
        self._lasts = lasts
        self._step_s = step_s
        self._interpolator = interpolator
        self._until: float = lasts  # the last step at which the command is followed
        self._refresh = max(1, round(REFRESH_S / step_s))

    def give(self, step: int, setpoint: Array, stop: Stop = "") -> None:
        """A new command at this step. A stop while the robot already stops changes nothing."""
        if stop == "stop":
            self._until = min(self._until, step - 1)
            return
        if stop == "off":  # no finite setpoint can be mistaken for it, nor is there a way to it
            setpoint = np.full_like(setpoint, -np.inf)
        if self._interpolator is not None:
            self._interpolator.toward(step, setpoint, self.at(step), lapsed=step > self._until)
        self._command = setpoint
        self._until = step + self._lasts

    def at(self, step: int) -> Array | None:
        """The setpoint at this step: that of the command, or of the robot's own way to stop from
        it; None before the first command.
        """
        if self._command is None:
            return None
        setpoint = self._command
        interpolator = self._interpolator
        if interpolator is not None and interpolator.profile is not None:
            setpoint = interpolator.at(int(min(step, self._until)))
        return (
            setpoint
            if step <= self._until
            else self._stopping(setpoint, (step - self._until) * self._step_s)
        )

    def unchanged(self, step: int, ahead: int) -> int:
        """For how many of the next `ahead` steps (at least one) the setpoint at this step may stay
        as it is.
        """
        if self._command is None:
            return ahead
        if self._interpolator is not None and step <= self._until:
            ahead = int(min(ahead, self._interpolator.unchanged(step)))
        if step + ahead <= self._until + 1:
            return ahead
        if step <= self._until:
            return int(self._until) + 1 - step
        return min(ahead, self._refresh)
