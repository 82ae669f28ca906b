"""A quadrotor with imperfections in its scene, as a run has it: the plant, and MuJoCo's state
beneath it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import mujoco
import numpy as np

import vstestbed as vs
from vstestbed.core.geometry import Array
from vstestbed.robots.flight import HOLD
from vstestbed.robots.quadrotor import FlightPose, FlightStart, Quadrotor
from vstestbed.robots.rotors import X4
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.plant import MujocoPlant
from vstestbed.sim.scene.scene import Scene
from vstestbed.targets.base import Pad

WEIGHT = X4.mass_kg * 9.81


class Craft:
    """A craft at rest at a height [m] over the floor.

    Args:
        robot: with its blocks. xyz, yaw_deg: where it hovers at the start [m], and its heading.
            pad_at: centre of a pad .9 m wide [m]; None: nothing but the floor.
    """

    def __init__(
        self,
        robot: Quadrotor,
        xyz: tuple[float, float, float] = (0, 0, 10),
        pad_at: tuple[float, float, float] | None = None,
        yaw_deg: float = 0.0,
    ):
        scenario = vs.load("quadrotor_hover")
        self.robot = replace(robot, start=FlightStart(nominal=FlightPose(xyz=xyz, yaw_deg=yaw_deg)))
        # The target is put aside: what is below the craft is the floor, or the pad.
        pose = replace(scenario.target.pose, xyz=pad_at or (0.0, 50.0, 0.13))
        target = replace(scenario.target, pose=pose, pad=Pad(side=0.9) if pad_at else None)
        self.stage = Scene(
            SceneDescription(self.robot, scenario.camera, target, scenario.world, 0.001)
        )
        self.plant = MujocoPlant(self.stage, None, False, np.random.default_rng(3))
        self.data, self.model = self.stage.data, self.stage.model

    @property
    def W(self) -> Array:
        """Squared rotor speeds (4,), true."""
        return self.data.act[self.stage.at.act]

    @property
    def up(self) -> float:
        """What the rotors lift [N], with the mass and MuJoCo's own acceleration of the craft, which
        is level.
        """
        mujoco.mj_forward(self.model, self.data)
        return X4.mass_kg * (9.81 + float(self.data.qacc[2]))

    def fly(
        self, seconds: float, setpoint: Array = HOLD, each: Callable[[], object] | None = None
    ) -> list[object]:
        """Fly under a setpoint; what `each` gives, every millisecond."""
        self.plant.apply(setpoint)
        found = []
        for _ in range(round(seconds / 0.001)):
            self.plant.advance(1)
            if each is not None:
                found.append(each())
        return found

    def close(self) -> None:
        """Free the scene."""
        self.plant.close()
