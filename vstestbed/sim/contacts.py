"""What a robot touches."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.robots import Robot
from vstestbed.sim.scene.relief import AROUND, RELIEF


class RobotContacts:
    """Tells the contacts that a robot may have, of feet or wheels on the ground, from collisions.

    Args:
        model: the scene with the robot under `robot/`. robot: names its feet.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot):
        self._model = model
        bodies = [model.body(i).name.startswith("robot/") for i in range(model.nbody)]
        self._feet = np.zeros(model.ngeom, dtype=bool)
        self._feet[[model.geom(f"robot/{name}").id for name in robot.feet]] = True
        self._body = np.array(bodies)[model.geom_bodyid] & ~self._feet
        floors = ("floor", RELIEF, AROUND)
        self._floors = [geom for name in floors if (geom := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, name)) >= 0]
        self._on_wheels = robot.base == "planar"

    def touching(self, data: mujoco.MjData) -> tuple[str, str]:
        """What the robot touches: with anything but its feet, and with its feet; `forearm and floor`, "" where nothing."""
        if not data.ncon:
            return "", ""
        pairs = data.contact.geom
        feet = self._first(pairs, self._feet)
        if self._on_wheels:  # wheels and casters always touch the floor; whatever else of a vehicle does goes unnoticed
            pairs = pairs[~np.isin(pairs, self._floors).any(axis=1)]
        # A pair within the robot counts, too: the arm's own links are paired in its file to end a run at the first touch.
        return self._first(pairs, self._body), feet

    def _first(self, pairs: NDArray[np.int32], own: NDArray[np.bool_]) -> str:
        """The first pair of geoms (contacts, 2) one of which is among the robot's `own`, that one first; "" if there is none."""
        touching = own[pairs]
        found = np.flatnonzero(touching.any(axis=1))
        if not len(found):
            return ""
        pair = pairs[found[0]].tolist()
        return " and ".join(self._name(geom) for geom in (pair if touching[found[0], 0] else pair[::-1]))

    def _name(self, geom: int) -> str:
        """Name of a geom, or of the body it belongs to, without the prefix of its part of the scene."""
        name = self._model.geom(geom).name or self._model.body(self._model.geom_bodyid[geom]).name
        return (
            name.removeprefix("robot/").removeprefix("scenery/").strip("/").replace("/", " ").replace("_", " ")
            or "something without a name"
        )
