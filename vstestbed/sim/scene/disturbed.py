"""A robot's imperfections (`Robot.disturbance`) in MuJoCo: its true state in, forces on its base out."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from vstestbed.core.geometry import Array
from vstestbed.robots.disturbance import BodyState, Disturbance
from vstestbed.sim.scene.stage import Stage

DOWN = np.array([0.0, 0.0, -1.0])


class Disturbed:
    """A floating robot with a disturbance.

    Args:
        stage: the scene; its robot has the free joint `root`. disturbance: of its robot.
    """

    def __init__(self, stage: Stage, disturbance: Disturbance):
        model = stage.model
        self._stage, self._disturbance = stage, disturbance
        self._body, self._dof = model.body("robot/base").id, int(model.joint("robot/root").dofadr[0])
        self._probes, self._below, self._next = [np.array(p) for p in disturbance.probes], [np.inf] * len(disturbance.probes), 0
        self._geom = np.zeros(1, dtype=np.int32)

    def start(self) -> None:
        """Measure all heights: the craft stands at its start."""
        for i in range(len(self._probes)):
            self._look(i)

    def act(self, orders: ArrayLike, dt: float) -> Sequence[float]:
        """Put force and torque on the base for the next control period; what the controller's orders (nu,) become."""
        # One ray a period: 16 of them are as old as 16 ms, in which a craft that lands sinks 5 mm.
        if self._probes:
            self._look(self._next)
            self._next = (self._next + 1) % len(self._probes)
        data, dof, state = self._stage.data, self._dof, self._state()
        force, torque, reached = self._disturbance.act(state, np.asarray(orders).tolist(), dt)
        # A free joint's generalised force: linear along world axes at the base's origin, angular in the base's own. `xfrc_applied`, where
        # a person's push acts, stays free.
        data.qfrc_applied[dof : dof + 3] = self._R() @ force
        data.qfrc_applied[dof + 3 : dof + 6] = torque
        return reached

    def felt(self, sensors: dict[str, list[float]]) -> dict[str, list[float]]:
        """What the sensors meet."""
        return self._disturbance.felt(sensors)

    def _R(self) -> Array:
        return self._stage.data.xmat[self._body].reshape(3, 3)

    def _state(self) -> BodyState:
        stage, dof = self._stage, self._dof
        x, y, z = ((stage.data.qvel[dof : dof + 3] - stage.model.opt.wind) @ self._R()).tolist()
        p, q, r = stage.data.qvel[dof + 3 : dof + 6].tolist()
        return BodyState((x, y, z), (p, q, r), stage.data.act[stage.at.act].tolist(), self._below)

    def _look(self, i: int) -> None:
        """Cast the ray from probe i straight down."""
        data = self._stage.data
        origin = data.xpos[self._body] + self._R() @ self._probes[i]
        hit = mujoco.mj_ray(self._stage.model, data, origin, DOWN, None, 1, self._body, self._geom)
        self._below[i] = hit if hit >= 0 else np.inf
