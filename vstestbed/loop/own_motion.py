"""The camera's own motion while a picture was under way, by the robot's own sensors."""

from __future__ import annotations

from vstestbed.core.geometry import Array
from vstestbed.loop.command_history import CommandHistory
from vstestbed.loop.exposure import Arrival, Exposure
from vstestbed.robots import Mount, Robot


def since_exposure(robot: Robot, mount: Mount, ordered: CommandHistory, shot: Exposure, now: Arrival) -> Array:
    """How far the camera has gone since an exposure (6,), in its own frame [m, rad]; mount: as it is now."""
    # Integrated commands stand in for a robot without sensors of its motion.
    moved, age = ordered.displacement(now.t) - ordered.displacement(shot.t), now.t - shot.t
    if age > 0:
        moved = robot.measured_twist(shot.reading, now.reading, age, moved / age, mount) * age
    return moved
