"""Metrics of runs in which pictures come out of order, or pictures and commands are lost in bursts."""

from __future__ import annotations

from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.base import Log as Columns
from vstestbed.tasks.metrics import Figures


class LinkFigures:
    """Pictures that never arrived, pictures that were refused, commands that never arrived; none of a run without such effects."""

    def __init__(self, scenario: Scenario):
        self._counts_pictures, self._columns = scenario.timing.link is not None, scenario.timing.columns
        self._used = self._refused = self._commands = 0
        self._sent = 0

    def add(self, log: Columns) -> None:
        """See `Part`."""
        self._used += len(log["t"])
        self._sent = max(self._sent, int(log["frame"].max()) + 1)
        if "refused" in self._columns:
            self._refused = int(log["refused"][-1])
        if "command_lost" in self._columns:
            self._commands += int(log["command_lost"].sum())

    def figures(self) -> Figures:
        """See `Part`."""
        found: Figures = {"pictures_lost": max(0, self._sent - self._used - self._refused)} if self._counts_pictures else {}
        found |= {"pictures_refused": self._refused} if "refused" in self._columns else {}
        return found | ({"commands_lost": self._commands} if "command_lost" in self._columns else {})
