"""The physical plant: a robot with masses, gears and friction in MuJoCo, its camera rendered."""

from __future__ import annotations

import mujoco
import numpy as np
from dm_control.rl.control import PhysicsError

from vstestbed.camera import Frame, Look
from vstestbed.geometry import Array, inverse, transform
from vstestbed.observation import Encoders
from vstestbed.sim.base import Eyes, Truth
from vstestbed.sim.scene import Parts
from vstestbed.sim.stage import Stage


class MujocoPlant:
    """Steps a dm_control physics; setpoints are the actuators' controls.

    dm_control's step ends with `mj_step1`, so that poses, the camera and velocities are those of the present time, not
    one step old. The robot starts at rest and in equilibrium: integrating servos carry the gravity load from the start,
    as they do when brakes are released.

    Args:
        stage: the scene. start: joint angles (n,). steps_per_frame: physics steps between pictures.
        eye: makes the pictures; None where no detector needs them. see_hidden: cast rays for the truth's `hidden`.
    """

    def __init__(self, stage: Stage, start: Array, steps_per_frame: int, eye: Eyes | None, see_hidden: bool):
        self._stage, self._eye, self._see_hidden = stage, eye, see_hidden
        parts: Parts = stage.parts
        self.step_s, self.steps_per_frame = parts.step, steps_per_frame
        self._points = parts.target.points
        self._T_world_target = parts.target.pose.T
        ctrl = [stage.model.actuator_ctrladr[stage.model.actuator(f"robot/{name}").id] for name in parts.robot.joints]
        self._ctrl = np.array(ctrl, dtype=int)
        bodies = [stage.model.body(i).name.startswith("robot/") for i in range(stage.model.nbody)]
        self._robot_geoms = np.array(bodies)[stage.model.geom_bodyid]
        self._velocity = np.zeros(6)
        self._visible = np.zeros(len(self._points), dtype=bool)
        self._steps = 0
        stage.place(0.0, self._T_world_target, start)
        self._settle()

    def _settle(self) -> None:
        """Integrating servos start at q + (gravity torque) / kp."""
        model, data = self._stage.model, self._stage.data
        mujoco.mj_forward(model, data)
        for i in range(model.nu):
            if model.actuator_actnum[i] == 1:
                joint = model.actuator_trnid[i, 0]
                load = data.qfrc_bias[model.jnt_dofadr[joint]] - data.qfrc_gravcomp[model.jnt_dofadr[joint]]
                kp = model.actuator_gainprm[i, 0]
                data.act[model.actuator_actadr[i]] = data.qpos[model.jnt_qposadr[joint]] + load / kp
        mujoco.mj_forward(model, data)

    @property
    def render_s(self) -> float:
        """Wall time spent on pictures so far [s]."""
        return self._eye.spent_s if self._eye else 0.0

    def capture(self, look: Look | None = None) -> tuple[Frame | None, Truth]:
        """The picture, where one is wanted, and the truth, now."""
        stage = self._stage
        model, data = stage.model, stage.data
        t = self._steps * self.step_s
        if stage.parts.world.plates:
            stage.place_plates(t)
            mujoco.mj_kinematics(model, data)
        T = stage.camera_pose()
        p_camera = transform(inverse(T) @ self._T_world_target, self._points)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, stage.eye, self._velocity, 1)
        twist = np.concatenate([self._velocity[3:], self._velocity[:3]])
        hidden = stage.hidden(T, p_camera) if self._see_hidden else self._visible
        q, qd, ctrl = data.qpos[stage.qpos], data.qvel[stage.qvel], data.ctrl[self._ctrl]
        truth = Truth(T, self._T_world_target, twist, q, qd, ctrl, p_camera, hidden, self._touches())
        frame = Frame(t, self._eye.glimpse(look), self._eye.whole) if self._eye else None
        return frame, truth

    def _touches(self) -> bool:
        data = self._stage.data
        return bool(data.ncon) and bool(self._robot_geoms[data.contact.geom].any())

    def encoders(self) -> Encoders:
        """Joint angles and speeds [rad, rad/s], noise-free."""
        stage = self._stage
        return Encoders(stage.data.qpos[stage.qpos], stage.data.qvel[stage.qvel])

    def apply(self, setpoint: Array) -> None:
        """Joint velocity setpoints (n,) [rad/s] from now on."""
        self._stage.data.ctrl[self._ctrl] = setpoint

    def advance(self, steps: int) -> bool:
        """Let physics steps pass; False when MuJoCo reports an instability."""
        try:
            self._stage.physics.step(steps)
        except PhysicsError:
            return False
        self._steps += steps
        return True

    def close(self) -> None:
        """Free pictures and physics."""
        self._stage.close()
