"""Camera latency on the physics clock: a line of frames on their way to the law."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class DelayLine(Generic[T]):
    """What was captured at step k is delivered at step k + delay, in order.

    Args:
        delay_steps: whole physics steps between exposure and delivery, >= 0.
    """

    def __init__(self, delay_steps: int):
        self.delay_steps = delay_steps
        self._waiting: deque[tuple[int, T]] = deque()

    def push(self, step: int, item: T) -> None:
        """Something was captured at this step."""
        self._waiting.append((step + self.delay_steps, item))

    def pop_due(self, step: int) -> list[T]:
        """What arrives at or before this step, oldest first."""
        due = []
        while self._waiting and self._waiting[0][0] <= step:
            due.append(self._waiting.popleft()[1])
        return due

    def next_due(self) -> int | None:
        """The step of the next delivery, None when nothing is on its way."""
        return self._waiting[0][0] if self._waiting else None
