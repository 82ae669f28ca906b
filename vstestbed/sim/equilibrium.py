"""The equilibrium in which a robot begins: its servos carry its weight, and its gears are wound up by it."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.sim.scene.stage import Stage
from vstestbed.sim.static_load import check_static_load

NO_LOAD = 1e-6
"""Load under which a gear lies in the middle of its play [Nm]: what rounding leaves of the weight on a vertical axis is less."""


def settle(stage: Stage) -> None:
    """Equilibrium of the actuators: integrating servos start at theta + load / kp, elastic joints' rotors at q + torsion, craft at hover.

    The load of a joint is what gravity asks of its motor. A servo whose gravity compensation is wrong does not know of it: it starts at
    theta, and sags.

    Raises:
        UnreachableError: an arm's motors cannot hold it there.
    """
    # At q itself an industrial arm would sag until its servos carry it: joint 2 by 2 mrad.
    model, data, at = stage.model, stage.data, stage.at
    mechanics = stage.parts.robot.mechanics
    stage.rest()
    mujoco.mj_forward(model, data)
    check_static_load(stage)
    load = data.qfrc_bias - data.qfrc_gravcomp
    if mechanics is not None and at.motor_qpos is not at.qpos:
        soft = mechanics.stiffness > 0
        asked = load[at.qvel][soft]
        torsion = mechanics.torsion(load[at.qvel])[soft]
        play = np.where(np.abs(asked) > NO_LOAD, np.sign(asked) * mechanics.play[soft] / 2, 0.0)
        data.qpos[at.motor_qpos[soft]] += torsion + play
        load[at.motor_qvel] = load[at.qvel]
    if mechanics is not None and mechanics.gravity is not None:
        load[:] = 0.0
    for i in range(model.nu):
        if model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_INTEGRATOR and model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT:
            joint = model.actuator_trnid[i, 0]
            kp = -model.actuator_biasprm[i, 1]
            data.act[model.actuator_actadr[i]] = data.qpos[model.jnt_qposadr[joint]] + load[model.jnt_dofadr[joint]] / kp
    mujoco.mj_forward(model, data)
