"""Forces of slipping tyres (`robots/tyres.py`) on a vehicle's wheels, at each physics step."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from vstestbed.robots.tyres import Pair, Tyres
from vstestbed.robots.wheels import WHEELS
from vstestbed.sim.scene.stage import Stage


class TyreForces:
    """Applies the forces where the wheels touch the floor. Their contacts carry the load alone, without friction.

    The load of a wheel is the force of constraints on the slide of its spring, in the last step: that of its contact.

    Args:
        stage: the scene with the vehicle under `robot/`. tyres: of all its wheels.
    """

    def __init__(self, stage: Stage, tyres: Tyres):
        model, self._data, self._model, self._tyres = stage.model, stage.data, stage.model, (tyres, tyres, tyres.rear, tyres.rear)
        self._bodies = [int(model.body(f"robot/{name}_wheel").id) for name in WHEELS]
        self._slides = np.array([model.joint(f"robot/{name}_spring").dofadr[0] for name in WHEELS])
        contacts = [model.geom(f"robot/{name}_contact").id for name in WHEELS]
        self._radius, self._friction = model.geom_size[contacts, 0].tolist(), model.geom_friction[contacts, 0].tolist()
        self._deflection: list[Pair] = [(0.0, 0.0)] * len(WHEELS)
        self._twist, self._wrench = np.zeros(6), np.zeros((len(WHEELS), 6))

    def act(self, dt: float) -> None:
        """The forces of the next physics step, of dt [s]."""
        # Plain numbers, wheel by wheel: arrays of four take five times as long.
        data, twist = self._data, self._twist
        loads, axles = data.qfrc_constraint[self._slides].tolist(), data.xmat[self._bodies][:, [1, 4]].tolist()
        for i, body in enumerate(self._bodies):
            mujoco.mj_objectVelocity(self._model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
            self._wrench[i] = self._wheel(i, loads[i], axles[i], twist.tolist(), dt)
        data.xfrc_applied[self._bodies] = self._wrench

    def _wheel(self, i: int, load: float, axle: list[float], twist: list[float], dt: float) -> tuple[float, ...]:
        """Force and torque at the centre of wheel i [N, Nm], from the horizontal part of its axle and its twist (w, v)."""
        if load <= 0:  # in the air: it lands with a patch that is not deflected
            self._deflection[i] = 0.0, 0.0
            return (0.0,) * 6
        size, r, tyre = math.hypot(*axle), self._radius[i], self._tyres[i]
        x, y = axle[1] / size, -axle[0] / size  # along: axle x up; across is (-y, x)
        wx, wy, _, vx, vy, _ = twist
        # Of the point of the wheel under its centre: v + w x (0, 0, -r).
        px, py = vx - r * wy, vy + r * wx
        sliding, speed = (px * x + py * y, py * x - px * y), abs(vx * x + vy * y)
        u = self._deflection[i] = tyre.deflected(self._deflection[i], sliding, speed, self._friction[i], dt)
        along, across = tyre.force(u, sliding, speed, self._friction[i], load)
        fx, fy = along * x - across * y, along * y + across * x
        return fx, fy, 0.0, r * fy, -r * fx, 0.0
