"""Supervisor: what may override the law for the robot's safety, by what the robot measures of itself."""

from __future__ import annotations

from typing import ClassVar

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Verdict
from vstestbed.robots.reading import Reading


class Supervisor:
    """Lets the law's setpoint through: the supervisor of every robot that is safe when it stands still.

    Attributes:
        sets_down: a lost target makes the robot set down first, so that the run ends when it is down and not before.
        mode: what it does now, as the log has it; 0: the law's setpoint is followed.
        aborted: why the task was given up, if it was.
    """

    sets_down: ClassVar[bool] = False
    mode: int = 0
    aborted: Verdict | None = None

    def filter(self, t: float, rest_reason: str, reading: Reading, setpoint: Array) -> Array:
        """The setpoint that goes to the actuators.

        Args:
            t: time of exposure [s].
            rest_reason: why the law orders rest ("" while it has something to go by).
            reading: what the robot measures of itself.
            setpoint: what the law asks for.
        """
        return setpoint

    @property
    def may_touch(self) -> bool:
        """Whether the robot's feet may be on something now."""
        return True

    def down(self, t: float) -> bool:
        """Whether the robot has set down for good."""
        return False
