"""What a robot touches."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.robots import Robot


class RobotContacts:
    """Tells the contacts that a robot may have, of feet or wheels on the ground, from collisions.

    Args:
        model: the scene with the robot under `robot/`. robot: names its feet.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot):
        bodies = [model.body(i).name.startswith("robot/") for i in range(model.nbody)]
        self._feet = np.zeros(model.ngeom, dtype=bool)
        self._feet[[model.geom(f"robot/{name}").id for name in robot.feet]] = True
        self._body = np.array(bodies)[model.geom_bodyid] & ~self._feet
        self._floor = model.geom("floor").id
        self._on_wheels = robot.base == "planar"

    def touching(self, data: mujoco.MjData) -> tuple[bool, bool]:
        """Whether the robot touches something with anything but its feet, and whether a foot touches something."""
        if not data.ncon:
            return False, False
        pairs = data.contact.geom
        feet = bool(self._feet[pairs].any())
        if self._on_wheels:  # wheels and casters always touch the floor; whatever else of a vehicle does goes unnoticed
            pairs = pairs[(pairs != self._floor).all(axis=1)]
        # A pair within the robot counts, too: the arm's own links are paired in its file to end a run at the first touch.
        return bool(self._body[pairs].any()), feet
