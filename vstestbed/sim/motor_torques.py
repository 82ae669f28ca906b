"""Torques of an arm's motors, computed at each physics step: current loops, cogging, ripple."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable

import mujoco
import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.robots.mechanics import Mechanics
from vstestbed.sim.scene.stage import Stage


def motor_loops(stage: Stage) -> list[tuple[int, Callable[[float], None]]]:
    """What the plant must call at each physics step for a robot in equilibrium, with its period in steps; nothing for most robots."""
    mechanics = stage.parts.robot.mechanics
    return [(1, MotorTorques(stage, mechanics).act)] if mechanics is not None and mechanics.acts else []


class MotorTorques:
    """Applies the torques of an arm's motors to its rotors, where they are not simply MuJoCo's servos.

    Ripple and cogging are added to MuJoCo's torque of the step before. With current loops MuJoCo's servos are out of force
    (`servos.idle`), but for the integrals of their commands: u = kp (act - theta) + kv (v - theta') within the limits, where v is the
    command of a servo without integral, delayed by whole steps and smoothed by the lag; over a step h of constant u the mean torque is
    u + (tau - u) (1 - exp(-h / T)) T / h with T = 1 / (2 pi bandwidth).

    Args:
        stage: the scene, in equilibrium. mechanics: of its robot.
    """

    def __init__(self, stage: Stage, mechanics: Mechanics):
        model, at, robot = stage.model, stage.at, stage.parts.robot
        self._data, self._mechanics, self._qpos, self._qvel = stage.data, mechanics, at.motor_qpos, at.motor_qvel
        self._actuators = np.array([model.actuator(f"robot/{name}").id for name in robot.actuators])
        self._ctrl = model.actuator_ctrladr[self._actuators]
        self._kp, self._kv = -model.actuator_biasprm[self._actuators, 1], -model.actuator_biasprm[self._actuators, 2]
        self._integrates = model.actuator_dyntype[self._actuators] == mujoco.mjtDyn.mjDYN_INTEGRATOR
        self._act = np.where(self._integrates, model.actuator_actadr[self._actuators], 0)
        self._most = _limits(model, self._actuators)
        self._ripples = mechanics.ripple > 0 or bool(mechanics.cogging.any())
        loops, h = mechanics.drives, stage.parts.step
        if loops is not None:
            T = 1 / (2 * math.pi * loops.bandwidth_hz)
            self._left = math.exp(-h / T)
            self._mean = (1 - self._left) * T / h
            self._tau = self._servos()
            self._late = deque([self._tau] * round(loops.delay_s / h))

    def act(self, dt: float) -> None:
        """Apply the torques of the coming physics step."""
        tau = self._smoothed() if self._mechanics.drives is not None else 0.0
        if self._ripples:
            m = self._mechanics
            wave = np.sin(m.cycles * self._data.qpos[self._qpos])
            given = tau if m.drives is not None else self._data.actuator_force[self._actuators]
            tau = tau + (m.ripple * given + m.cogging) * wave
        self._data.qfrc_applied[self._qvel] = tau

    def _servos(self) -> Array:
        """The servos' torques now, within their limits (n,)."""
        data, kv = self._data, self._kv
        at, speed = data.qpos[self._qpos], data.qvel[self._qvel]
        held = self._kp * (data.act[self._act] - at) if data.act.size else 0.0
        u = np.where(self._integrates, held - kv * speed, kv * (data.ctrl[self._ctrl] - speed))
        return np.clip(u, -self._most, self._most)

    def _smoothed(self) -> Array:
        """The motors' mean torques over the coming step (n,)."""
        self._late.append(self._servos())
        u = self._late.popleft()
        mean = u + (self._tau - u) * self._mean
        self._tau = u + (self._tau - u) * self._left
        return mean


def _limits(model: mujoco.MjModel, actuators: Array) -> Array:
    """Largest torque of each actuator (n,): its own, and its joint's [Nm]."""
    joints = model.actuator_trnid[actuators, 0]
    own = np.where(model.actuator_forcelimited[actuators].astype(bool), model.actuator_forcerange[actuators, 1], np.inf)
    return np.minimum(own, np.where(model.jnt_actfrclimited[joints].astype(bool), model.jnt_actfrcrange[joints, 1], np.inf))
