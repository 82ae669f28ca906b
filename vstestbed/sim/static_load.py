"""Whether an arm's motors can hold it where it starts: an arm that cannot falls before its law has seen a picture."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import UnreachableError
from vstestbed.core.geometry import Array
from vstestbed.sim.scene.servos import compensated
from vstestbed.sim.scene.stage import Stage


def check_static_load(stage: Stage) -> None:
    """Refuse a start at which the weight of the links and the payload is more than motors and friction of a joint hold.

    tau = g(q) of the whole arm, of which a file's own compensation (springs, counterweights) is taken off, and not that of the drives,
    whose torque is the motors'. A joint holds |tau| <= tau_max + its Coulomb friction; motors without a limit hold all. It takes
    0.1 ms at the start of a run.

    Raises:
        UnreachableError: a joint that holds less, with the torques, and the payload that it would hold.
    """
    robot, model, data = stage.parts.robot, stage.model, stage.data
    if stage.root is not None or not robot.joints:
        return
    # at rest the bias is gravity alone
    weight = (data.qfrc_bias if compensated(robot) else data.qfrc_bias - data.qfrc_gravcomp)[stage.at.qvel]
    holds = _largest_torques(stage) + model.dof_frictionloss[stage.at.motor_qvel]
    if not (over := np.flatnonzero(np.abs(weight) > holds)).size:
        return
    joint = int(over[np.argmax(np.abs(weight[over]) / holds[over])])
    slides = model.joint(f"robot/{robot.joints[joint]}").type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    unit = "N" if slides else "Nm"
    words = (
        f"asks {robot.joints[joint]} for {abs(weight[joint]):.4g} {unit} to hold the arm at its start, and its motor and friction have "
        f"{holds[joint]:.4g} {unit}: it would fall"
    )
    payload = None if robot.mechanics is None else robot.mechanics.payload
    if payload is None:
        raise UnreachableError("robot.start", f"{words}; works: another start, or stronger motors")
    most = _most_kg(weight, weight - payload.mass_kg * _weight_of_a_kilogram(stage), holds, payload.mass_kg)
    remedy = f"at most {_down(most):g} kg here" if most > 0 else "another start, for it falls without a payload, too"
    raise UnreachableError("robot.payload.mass_kg", f"{words}; works: {remedy}", payload.mass_kg)


def _largest_torques(stage: Stage) -> Array:
    """Of the motors of each joint (n,) [Nm, N], by the limits of its actuators and its own; infinite without one."""
    model = stage.model
    motors = np.array([model.actuator(f"robot/{name}").id for name in stage.parts.robot.actuators], dtype=int)
    motors = motors[model.actuator_trntype[motors] == mujoco.mjtTrn.mjTRN_JOINT]
    return np.array([_largest_torque(model, turned, motors) for turned in model.dof_jntid[stage.at.motor_qvel]])


def _largest_torque(model: mujoco.MjModel, joint: int, motors: NDArray[np.int_]) -> float:
    """The same of one joint, by its number; motors: numbers of the actuators that act on joints."""
    own = motors[model.actuator_trnid[motors, 0] == joint]
    limited = len(own) and model.actuator_forcelimited[own].all()
    most = float((np.abs(model.actuator_gear[own, 0]) * model.actuator_forcerange[own, 1]).sum()) if limited else np.inf
    return min(most, float(model.jnt_actfrcrange[joint, 1])) if model.jnt_actfrclimited[joint] else most


def _weight_of_a_kilogram(stage: Stage) -> Array:
    """What a kilogram of the payload asks of each joint (n,) [Nm/kg, N/kg]: -J^T g, with the Jacobian J of its centre."""
    model, data = stage.model, stage.data
    J = np.zeros((3, model.nv))
    mujoco.mj_jacBodyCom(model, data, J, None, model.body("robot/payload").id)
    return -(J.T @ model.opt.gravity)[stage.at.qvel]


def _most_kg(weight: Array, without: Array, holds: Array, mass_kg: float) -> float:
    """The largest payload m for which |without + (weight - without) m / mass_kg| <= holds in every joint; 0 where none is held."""
    if (np.abs(without) > holds).any():
        return 0.0
    each = (weight - without) / mass_kg
    with np.errstate(divide="ignore", invalid="ignore"):
        most = (holds - np.sign(each) * without) / np.abs(each)
    return float(np.nanmin(np.where(each == 0, np.inf, most)))


def _down(value: float) -> float:
    """A number under the value, of three digits: one that was rounded up would be too much."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 2)
    return float(f"{np.floor(value / unit) * unit:.3g}")
