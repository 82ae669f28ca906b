"""The columns that only one kind of robot has in a log."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.reading import Reading
from vstestbed.robots.supervisor import Supervisor


@dataclass(frozen=True, slots=True)
class RobotState:
    """Input of a robot's own log columns at one exposure. It holds truth, which goes to the log and nowhere else.

    Attributes:
        t: time [s]. T_world_base: true pose of the base (4, 4).
        place, odometry: (x, y, heading) [m, m, rad] as the observer estimates them, NaN where it has none.
        reading: the robot's sensor reading.
        act: true activations of its actuators (nu,). wind: true velocity of the air in the world (3,) [m/s].
    """

    t: float
    T_world_base: Array
    place: Array
    odometry: Array
    reading: Reading
    act: Array
    wind: Array


class RobotLog:
    """The columns that only this robot has in a log, and their values frame by frame.

    Here `supervisor` alone: 0 follows the law, 1 holds (the law has no measurement: it rests, or goes on by what it knew), 2 stops
    for good. Each run makes its own: it may hold the last frame's state.

    Args:
        supervisor: the robot's.
    """

    columns: tuple[str, ...] = ("supervisor",)

    def __init__(self, supervisor: Supervisor):
        self.supervisor = supervisor

    def row(self, state: RobotState) -> Array:
        """Values of the columns at one exposure, shape (len(columns),)."""
        return np.array([self.supervisor.mode])

    def proprioception(self, log: Mapping[str, Array]) -> dict[str, Array]:
        """Entries of `Robot.proprioception` by name, shape (frames,) each, as far as the robot's own columns of a log tell them."""
        return {}
