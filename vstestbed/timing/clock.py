"""The physics clock: a step that divides the camera's period."""

from __future__ import annotations

import math
from bisect import insort
from collections import deque
from typing import Generic, Protocol, TypeVar

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.imaging.exposure import ExposureControl

LARGEST_STEP_S = 0.002  # largest default step [s]; the arm's actuators are tuned and tested at 1 and 2 ms


class _Shot(Protocol):
    """What is asked of a camera: when its rows are exposed, and for how long."""

    @property
    def rate_hz(self) -> float: ...
    @property
    def period(self) -> float: ...
    @property
    def readout_s(self) -> float: ...
    @property
    def latency_s(self) -> float: ...
    @property
    def height(self) -> int: ...
    @property
    def blurring(self) -> ExposureControl | None: ...
    def row_delay(self, v: Array) -> Array: ...


@spec
class Clock:
    """The physics clock, with a whole number of steps between pictures.

    Args:
        step_s: fixed step [s]; without it the largest step that divides the camera's period and is no longer than 2 ms; e.g. `0.001`.
    """

    step_s: PositiveTime | None = None

    def resolve(self, camera: _Shot, largest: float = LARGEST_STEP_S) -> tuple[float, int]:
        """(step [s], steps per camera frame). Raises ParameterError: step_s does not divide the camera's period."""
        if self.step_s is None:
            # The small number keeps a ratio of exactly n from being rounded up to n + 1.
            n = math.ceil(camera.period / largest - 1e-9)
            return camera.period / n, n
        n = round(camera.period / self.step_s)
        if n < 1 or abs(n * self.step_s - camera.period) > 1e-9 * camera.period:
            better = camera.period / max(1, math.ceil(camera.period / max(self.step_s, 1e-5)))
            words = f"must divide the camera's period {camera.period:.9g} s ({camera.rate_hz:g} Hz); {better:.12g} does"
            raise ParameterError("physics.step_s", words, self.step_s)
        return self.step_s, n


T = TypeVar("T")


class DelayLine(Generic[T]):
    """A queue: an item pushed at step k is due at step k + delay, and never before an earlier item, unless items may overtake.
    delay_steps: whole physics steps between in and out, >= 0. overtakes: an item that is due before an earlier one leaves first.
    """

    def __init__(self, delay_steps: int = 0, overtakes: bool = False):
        self.delay_steps, self._overtakes = delay_steps, overtakes
        self._waiting: deque[tuple[int, T]] = deque()

    def push(self, step: int, item: T) -> None:
        """Put an item in at this step."""
        due = step + self.delay_steps
        if self._overtakes:
            insort(self._waiting, (due, item), key=lambda waiting: waiting[0])
        else:
            self._waiting.append((max(due, self._waiting[-1][0]) if self._waiting else due, item))

    def pop_due(self, step: int) -> list[T]:
        """Take out the items due at or before this step, oldest first."""
        waiting = self._waiting
        due: list[T] = []
        while waiting and waiting[0][0] <= step:
            due.append(waiting.popleft()[1])
        return due

    def clear(self) -> None:
        """Drop all that is on its way."""
        self._waiting.clear()

    def next_due(self) -> int | None:
        """The step at which the next item is due, None when the queue is empty."""
        return self._waiting[0][0] if self._waiting else None
