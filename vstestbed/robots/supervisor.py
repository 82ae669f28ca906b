"""Supervisor: may override the law's setpoint for the robot's safety, from proprioception alone."""

from __future__ import annotations

from typing import ClassVar

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Verdict
from vstestbed.robots.reading import Reading


class Supervisor:
    """Passes the law's setpoint on: the supervisor of every robot that is safe when it stands still.

    Attributes:
        sets_down: a lost target makes the robot set down first, so that the run ends when it is down and not before.
        mode: its state, as numbered in the log; 0: the law's setpoint is followed.
        aborted: why the task was aborted; None while it goes on.
    """

    sets_down: ClassVar[bool] = False
    mode: int = 0
    aborted: Verdict | None = None

    def filter(self, t: float, rest_reason: str, reading: Reading, setpoint: Array) -> Array:
        """The setpoint that goes to the actuators.

        Args:
            t: time of exposure [s].
            rest_reason: why the law commands rest ("" while it has measurements to work with).
            reading: the robot's sensor reading.
            setpoint: the law's, after allocation.
        """
        return setpoint

    @property
    def may_touch(self) -> bool:
        """Whether ground contact of the robot's feet is allowed now."""
        return True

    def down(self, t: float) -> bool:
        """Whether the robot has set down for good."""
        return False
