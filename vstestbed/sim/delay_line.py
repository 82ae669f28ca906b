"""A queue in physics steps: pictures on their way to the controller, commands on their way to the robot."""

from __future__ import annotations

from bisect import insort
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class DelayLine(Generic[T]):
    """A queue: an item pushed at step k is due at step k + delay, and never before an earlier item, unless items may overtake.

    Args:
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
        due = []
        while self._waiting and self._waiting[0][0] <= step:
            due.append(self._waiting.popleft()[1])
        return due

    def clear(self) -> None:
        """Drop all that is on its way."""
        self._waiting.clear()

    def next_due(self) -> int | None:
        """The step at which the next item is due, None when the queue is empty."""
        return self._waiting[0][0] if self._waiting else None
