"""Where a robot's joints and actuators stand in MuJoCo's arrays."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.robots import Robot
from vstestbed.sim.scene.gears import ROTOR


@dataclass(frozen=True)
class StateIndices:
    """Indices of one robot's quantities in the state of a scene that may hold two robots.

    Attributes:
        qpos, qvel: of its measured joints, in the order of `Robot.joints`, in `data.qpos` and `data.qvel`.
        ctrl: of its actuators, in the order of `Robot.actuators`, in `data.ctrl`; a slice, which is quicker, where they adjoin.
        motor_qpos, motor_qvel: of what its encoders read and its servos turn: the rotors of elastic joints, else the joints. Without any
            elastic joint they are `qpos` and `qvel` themselves.
        act: of those actuators that have an activation (an integrating servo, a rotor), in `data.act`.
    """

    qpos: NDArray[np.int_]
    qvel: NDArray[np.int_]
    motor_qpos: NDArray[np.int_]
    motor_qvel: NDArray[np.int_]
    ctrl: NDArray[np.int_] | slice
    act: NDArray[np.int_]

    @classmethod
    def of(cls, model: mujoco.MjModel, robot: Robot, prefix: str) -> StateIndices:
        """The indices of the robot under a prefix (`robot/`, `leader/`)."""
        # By name, not by number: attached models are renumbered, and a joint's number is not its place in qpos once a free joint,
        # which takes seven places, comes before it.
        joints = [model.joint(prefix + name) for name in robot.joints]
        actuators = np.array([model.actuator(prefix + name).id for name in robot.actuators], dtype=int)
        activations = model.actuator_actadr[actuators]
        qpos, qvel = (np.array(at, dtype=int) for at in ([j.qposadr[0] for j in joints], [j.dofadr[0] for j in joints]))
        motor_qpos, motor_qvel = _motors(model, robot, prefix) if _elastic(robot) else (qpos, qvel)
        return cls(
            qpos=qpos,
            qvel=qvel,
            motor_qpos=motor_qpos,
            motor_qvel=motor_qvel,
            ctrl=_slice_of(model.actuator_ctrladr[actuators]),
            act=activations[activations >= 0],  # MuJoCo's -1: an actuator without one
        )


def _elastic(robot: Robot) -> bool:
    return robot.mechanics is not None and bool(robot.mechanics.stiffness.any())


def _motors(model: mujoco.MjModel, robot: Robot, prefix: str) -> tuple[NDArray[np.int_], NDArray[np.int_]]:
    """Indices in qpos and qvel (n,) each of the rotors of elastic joints, and of the joints that are rigid."""
    assert robot.mechanics is not None
    names = [f"{ROTOR}{name}" if k else name for name, k in zip(robot.joints, robot.mechanics.stiffness.tolist(), strict=True)]
    motors = [model.joint(prefix + name) for name in names]
    return np.array([j.qposadr[0] for j in motors], dtype=int), np.array([j.dofadr[0] for j in motors], dtype=int)


def _slice_of(indices: NDArray[np.int_]) -> NDArray[np.int_] | slice:
    """The slice of indices that follow each other, else the indices themselves."""
    if len(indices) and (np.diff(indices) == 1).all():
        return slice(int(indices[0]), int(indices[-1]) + 1)
    return indices
