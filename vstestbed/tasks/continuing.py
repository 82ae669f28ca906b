"""Continuing tasks: the true error must stay within a tolerance from `settle_s` until the run's
duration is over.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.core.quantity import PositiveLength, Time
from vstestbed.robots.base import Supervisor
from vstestbed.tasks.base import Log, Task
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.judged import JudgedError, at_worst
from vstestbed.tasks.monitor import Setup, TaskMonitor, is_over
from vstestbed.tasks.stop import Stop

# window of the mean speed [s]: longer than a start from standstill takes (.6 s to .8 m/s)
WINDOW_S = 2.0
STEADY = 0.8
"""Least share of a commanded speed. Measured: steady driving .98 and more, a straight approach to a
line at 25 degrees .91, a start within the first two seconds .87.
"""
# least share of the leader's speed for a follower, which cuts corners, and waits where it is too
# near
FOLLOWS = 0.5

# who, in words, is commanded which speed, and must reach which [m/s]
MinSpeed = tuple[str, float, float]
Odometer = Callable[[Array, Array], tuple[float, ...]]
"""Distances so far [m] of the vehicles under a minimum speed, in their order, with vehicle and
target now at these true poses (4, 4).
"""


LeastSpeeds = tuple[tuple[MinSpeed, ...], Odometer | None]
"""Minimum speeds, and what measures them."""


class SpeedMonitor:
    """Tests mean speeds over WINDOW_S, and keeps the first violation.

    Attributes:
        slow: time [s] and reason of the first violation; None without one.
    """

    def __init__(self, speeds: tuple[MinSpeed, ...], from_s: float):
        self._speeds = speeds
        self._from_s = from_s
        self._past: deque[tuple[float, tuple[float, ...]]] = deque()
        self.slow: tuple[float, str] | None = None

    def update(self, t: float, travelled: tuple[float, ...], at_the_end: bool) -> None:
        """Add the distances so far [m] at a time [s]. A run shorter than the window is tested as a
        whole.
        """
        past = self._past
        past.append((t, travelled))
        # The first entry left is the newest that is a whole window old: the mean is over WINDOW_S,
        # whatever the frame rate.
        while len(past) > 2 and past[1][0] <= t - WINDOW_S + 1e-9:
            past.popleft()
        began, before = past[0]
        whole = t - began >= WINDOW_S - 1e-9 or (at_the_end and t > began)
        if self.slow or t < self._from_s or not whole:
            return
        for speed, now, then in zip(self._speeds, travelled, before, strict=True):
            who, commanded_mps, least_mps = speed
            mean = (now - then) / (t - began)
            if not mean >= least_mps:  # `not >=`: a mean of NaN is a violation, too
                words = (
                    f"{who} made {mean:.2f} m/s in the {t - began:.2g} s before {t:.3g} s;"
                    f" {commanded_mps:g} m/s were commanded,"
                    f" {least_mps:.2g} are the least that counts"
                )
                self.slow = t, words
                return


Tolerance = PositiveLength
Settle = Time


class Continuing(Task):
    """Defaults of continuing tasks; `band_m` and `settle_s` are fields of each."""

    continuing = True
    ends = Outcome.completed
    band_m: Any  # a field of each task, with its own default

    @property
    def tolerance_m(self) -> float:
        """Half the width of the band [m]."""
        return self.band_m

    def error_m(self, setup: Setup, T_world_base: Array, T_world_target: Array, t: float) -> float:
        """True task error at a time t [s], [m]."""
        raise NotImplementedError

    def least_speeds(self, setup: Setup) -> LeastSpeeds:
        """Minimum speeds, and the odometer that measures them; by default none."""
        return (), None

    @property
    def end_s(self) -> float:
        """Earliest time at which the task can be completed [s]."""
        return 0.0

    def monitor(self, setup: Setup, supervisor: Supervisor) -> TaskMonitor:
        views = len(self.goal_poses(setup.target, setup.camera.mount.T))
        return ToleranceMonitor(self, setup, views, supervisor)

    def metrics(self, log: Log) -> dict[str, float | None]:
        """`worst_task_error_m`: the largest true error after `settle_s` [m]."""
        worst = at_worst(log, "task_error_m", self.tolerance_m, self.settle_s).value
        return {"worst_task_error_m": None if np.isnan(worst) else worst}

    def judged(self, log: Log, stop: Stop) -> JudgedError:
        return at_worst(log, "task_error_m", self.tolerance_m, self.settle_s)


class ToleranceMonitor(TaskMonitor):
    """Completed at the end of the duration, unless the error left its tolerance once settled, or a
    vehicle was too slow.

    Column `task_error_m`: the true task error [m].
    """

    error_columns = ("task_error_m",)

    def __init__(self, task: Continuing, setup: Setup, views: int, supervisor: Supervisor):
        super().__init__(setup, views, supervisor)
        self.task = task
        speeds, self._odometer = task.least_speeds(setup)
        self._speeds = SpeedMonitor(speeds, task.settle_s) if speeds else None
        self._left_at: tuple[float, float] | None = None
        self._error_m = np.nan

    def task_error(self, frame: Frame) -> tuple[float, ...]:
        T_base = frame.T_world_base(self.mount_inverse)
        T_target = frame.truth.T_world_target
        self._error_m = self.task.error_m(self.setup, T_base, T_target, frame.t)
        return (self._error_m,)

    def reached(self, frame: Frame) -> Verdict | None:
        """Never before the end of the duration."""
        return None

    def missed(self, frame: Frame) -> Verdict | None:
        """At the end of the duration: completed, or the earliest violation."""
        t = frame.t
        duration = self.setup.stop.duration_s
        settled = t >= self.task.settle_s
        # `not <=`: an error of NaN is a violation, too.
        if settled and self._left_at is None and not abs(self._error_m) <= self.task.tolerance_m:
            self._left_at = t, self._error_m
        over = is_over(t, duration)
        if self._speeds and self._odometer:
            T_base = frame.T_world_base(self.mount_inverse)
            self._speeds.update(t, self._odometer(T_base, frame.truth.T_world_target), over)
        if not over:
            return None
        if not settled:
            words = (
                f"{duration:g} s ended before the {self.task.settle_s:g} s in which it may settle"
            )
            return Outcome.timed_out, words
        return self._at_the_end(duration)

    def _at_the_end(self, duration: float) -> Verdict:
        task = self.task
        slow = self._speeds.slow if self._speeds else None
        left = self._left_at
        if slow and (left is None or slow[0] < left[0]):
            return Outcome.timed_out, slow[1]
        band = f"{task.tolerance_m:g} m"
        if left is not None:
            t, error_m = left
            words = f"out of its band of {band} at {t:.3g} s, {abs(error_m):.3g} m off"
            return Outcome.timed_out, words
        if duration < task.end_s:
            words = f"{duration:g} s ended on the way: its end is reached at {task.end_s:.3g} s"
            return Outcome.timed_out, words
        return Outcome.completed, f"within {band} from {task.settle_s:g} s on"
