"""A robot's imperfections (`Robot.disturbance`) in MuJoCo: its true state in, forces on its base out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from vstestbed.robots.disturbance import BodyState, Disturbance
from vstestbed.sim.scene.stage import Stage

DOWN = np.array([0.0, 0.0, -1.0])


class Disturbed:
    """A floating robot with a disturbance.

    Args:
        stage: the scene; its robot has the free joint `root`. disturbance: of its robot.
    """

    def __init__(self, stage: Stage, disturbance: Disturbance):
        model, data = stage.model, stage.data
        self._model, self._data, self._disturbance = model, data, disturbance
        self._body, dof = model.body("robot/base").id, int(model.joint("robot/root").dofadr[0])
        # Views of MuJoCo's own memory, taken once: each takes as long as ten operations on floats.
        self._velocity, self._applied = data.qvel[dof : dof + 6], data.qfrc_applied[dof : dof + 6]
        self._place, self._turn, self._wind = data.xpos[self._body], data.xmat[self._body], model.opt.wind
        self._activations, self._acting = data.act, stage.at.act.tolist()
        self._probes, self._below, self._next = disturbance.probes, [math.inf] * len(disturbance.probes), 0
        self._from, self._geom = np.zeros(3), np.zeros(1, dtype=np.int32)

    def start(self) -> None:
        """Measure all heights: the craft is at its start."""
        for i in range(len(self._probes)):
            self._look(i, self._turn.tolist())

    def act(self, orders: Any, dt: float) -> Sequence[float]:
        """Put force and torque on the base for the next control period; what the controller's orders (nu,) become."""
        R = self._turn.tolist()
        if self._probes:  # one ray a period: of 16 the oldest is as old as 16 ms, in which a craft that lands sinks 5 mm
            self._look(self._next, R)
            self._next = (self._next + 1) % len(self._probes)
        (x, y, z), (p, q, r), reached = self._disturbance.act(self._state(R), orders, dt)
        # A free joint's generalised force: linear along world axes at the base's origin, angular in the base's own. `xfrc_applied`, where
        # a person's push acts, stays free.
        a, b, c, d, e, f, g, h, i = R
        self._applied[:] = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z, p, q, r
        return reached

    def felt(self, sensors: dict[str, list[float]]) -> dict[str, list[float]]:
        """What the sensors meet."""
        return self._disturbance.felt(sensors)

    def _state(self, R: list[float]) -> BodyState:
        vx, vy, vz, p, q, r = self._velocity.tolist()
        wx, wy, wz = self._wind.tolist()
        a, b, c, d, e, f, g, h, i = R
        x, y, z, all_act = vx - wx, vy - wy, vz - wz, self._activations.tolist()
        air = a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z
        return BodyState(air, (p, q, r), [all_act[k] for k in self._acting], self._below)

    def _look(self, number: int, R: list[float]) -> None:
        """Cast the ray from a probe straight down, with the base's orientation R (9,)."""
        x, y, z = self._probes[number]
        a, b, c, d, e, f, g, h, i = R
        self._from[:] = a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z
        self._from += self._place
        hit = mujoco.mj_ray(self._model, self._data, self._from, DOWN, None, 1, self._body, self._geom)
        self._below[number] = hit if hit >= 0 else math.inf
