"""A limit of the robot leaves nearly nothing of the command."""

from __future__ import annotations

import math

from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.endings.base import Ending
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import has_held, held_since

BLOCKED_S = 1.0  # how long a limit must block the robot before the run ends [s]
BLOCKED_SCALE = 0.02  # a command scaled to less than this is blocked by the limit


class Blocked(Ending):
    """A joint's limit or a singular configuration blocks the robot. "speed" is no such limit: a
    command that is merely too fast is carried out more slowly.
    """

    def __init__(self) -> None:
        self._since = math.inf

    def update(self, frame: Frame) -> Verdict | None:
        limit = frame.allocation.limit
        holds = limit in ("joint_limit", "singular") and frame.allocation.scale < BLOCKED_SCALE
        self._since = held_since(self._since, holds, frame.t)
        if not has_held(self._since, frame.t, BLOCKED_S):
            return None
        return Outcome[limit], f"for {BLOCKED_S:g} s {Outcome[limit].value}"
