"""An arm as a linear system about its start: inertia, springs, dampers and servo gains of its model."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.core.named_files import model_path
from vstestbed.effects.base import StateIndices
from vstestbed.robots import Robot
from vstestbed.sim.scene.attach import add_robot


@dataclass(frozen=True, eq=False)
class LinearArm:
    """M z'' = -K z - C z' + b u about rest, u = kp (r - theta) + kv (v - theta'), theta = b^T z; n joints and m elastic ones, N = n + m.

    Attributes:
        mass, spring, damper: M, K, C (N, N) of z = (q, theta of the elastic joints); friction of the bearings is viscous alone.
        motors: b (N, n), which entry of z each servo turns. kp, kv: gains of the servos (n,).
        integrates: whose command v goes through the integral r' = v alone, not through kv (n,).
    """

    mass: Array
    spring: Array
    damper: Array
    motors: Array
    kp: Array
    kv: Array
    integrates: NDArray[np.bool_]


def linear_arm(robot: Robot) -> LinearArm:
    """The arm about its nominal start, with its imperfections but ripple, drives and play; without gravity's own spring."""
    scene = mujoco.MjSpec.from_file(str(model_path("world.xml")))
    scene.compiler.degree = False
    add_robot(scene, robot, "robot/", None)
    model = scene.compile()
    names = robot.body.actuators if robot.body else ()
    data, at = mujoco.MjData(model), StateIndices.of(model, robot.joints, names, "robot/")
    data.qpos[at.qpos] = data.qpos[at.motor_qpos] = robot.configuration()
    mujoco.mj_forward(model, data)
    soft = at.motor_qvel != at.qvel
    z = np.concatenate([at.qvel, at.motor_qvel[soft]])
    n, N, M = len(at.qvel), len(z), np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    spring, damper = np.zeros((N, N)), np.diag(model.dof_damping[z])
    load = (data.qfrc_bias - data.qfrc_gravcomp)[at.qvel]
    for k, c in filter(None, (effect.springs(load) for effect in robot.acting)):
        for i, joint in enumerate(np.flatnonzero(soft)):
            pair = np.zeros(N)
            pair[joint], pair[n + i] = -1.0, 1.0
            spring += k[joint] * np.outer(pair, pair)
            damper += c[joint] * np.outer(pair, pair)
    motors = (z[:, None] == at.motor_qvel[None, :]).astype(float)
    actuators = [model.actuator(f"robot/{name}").id for name in names]
    kp, kv = -model.actuator_biasprm[actuators, 1], -model.actuator_biasprm[actuators, 2]
    integrates = model.actuator_dyntype[actuators] == mujoco.mjtDyn.mjDYN_INTEGRATOR
    return LinearArm(M[np.ix_(z, z)], spring, damper, motors, kp, kv, integrates)
