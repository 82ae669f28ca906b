"""The parts of an experiment that a task has to do with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array
from vstestbed.laws import Law
from vstestbed.robots import Robot
from vstestbed.sim.scene.world import World
from vstestbed.targets import Target
from vstestbed.tasks.stop import Stop
from vstestbed.vision import Detector


# eq=False: compared by identity, since the comparison of its arrays has no single truth value.
@dataclass(frozen=True, eq=False)
class Setup:
    """The parts of an experiment that a task uses.

    Attributes:
        robot, camera, target, law, detector, stop, world: as the scenario has them. believed_camera: the camera as the robot knows it.
        depth_scale: ratio of each marker's assumed depth to the true one, (N,); None for exact depths.
        goal_shown: the goal image was taken by the true camera (teaching by showing); else it is computed with the believed one.
    """

    robot: Robot
    camera: Camera
    believed_camera: Camera
    target: Target
    law: Law[Any]
    detector: Detector[Any]
    stop: Stop
    world: World
    depth_scale: Array | None = None
    goal_shown: bool = False
