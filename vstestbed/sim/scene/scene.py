"""A compiled scene and its state, for the plant,
for replays and for the renderers in `sim/render`.
"""

from __future__ import annotations

import contextlib
import logging
import warnings
from collections.abc import Iterator

import mujoco
import numpy as np
from dm_control.mujoco import wrapper
from numpy.typing import NDArray

from vstestbed.core.geometry import FLIP, Array, inverse, quaternion_wxyz
from vstestbed.core.planar import place_of
from vstestbed.effects.base import RobotBody, StateIndices
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.gl_context import Physics
from vstestbed.sim.scene.compose import compose
from vstestbed.sim.scene.joint_chain import before, names_of, placed
from vstestbed.sim.scene.meshes import HAND_PLATE, LENS_GROUP, RANGE_GROUP

__all__ = ["Scene"]

PLANAR = ("root_x", "root_y", "root_yaw")


class Root:
    """The movable base of the robot under a prefix. model: the compiled scene. prefix: the robot's
    (`robot/`).
    """

    def __init__(self, model: mujoco.MjModel, prefix: str):
        self.body = model.body(f"{prefix}base").id
        self.free = f"{prefix}root" in names_of(model, "jnt")
        if self.free:
            begin = model.joint(f"{prefix}root").qposadr[0]
            self._qpos = np.arange(begin, begin + 7)
        else:
            self._qpos = np.array([model.joint(prefix + name).qposadr[0] for name in PLANAR])

    def put(self, qpos: NDArray[np.float64], T_world_base: Array) -> None:
        """Write a pose (4, 4) into the state `qpos`; of a planar base x, y and yaw alone."""
        T = T_world_base
        if self.free:
            qpos[self._qpos] = np.concatenate([T[:3, 3], quaternion_wxyz(T[:3, :3])])
        else:
            qpos[self._qpos] = place_of(T)

    def pose(self, data: mujoco.MjData) -> Array:
        """T_world_base (4, 4) now."""
        return placed(data.xpos[self.body], data.xmat[self.body])


CONFLICT = "Attach conflict"
"""So MuJoCo begins to tell, twice, that options of a robot's file differ from the scene's: of those
that matter `check_options` does.
"""
logging.getLogger("absl").addFilter(lambda record: not record.getMessage().startswith(CONFLICT))


class Scene:
    """A compiled scene with a dm_control physics on it; `place` puts it into a state, the renderers
    of `sim/render` draw it.

    Args:
        parts: what the scene is made of. samples: multisampling of this stage's pictures.

    Attributes:
        at: where the robot's joints and actuators are in `data`. eye: number of the servo camera's
            site, in computer-vision axes.
        root, leader: the free bases of the robot and of the vehicle that carries the target; None
            where there is none.
        flange_body: number of the body that carries the camera, or eye to hand the target.
        hand_plate: number of the mocap body of the plate in reserve; None without one.
        held_site: number of the target's site in the gripper (eye to hand), else -1.
    """

    def __init__(self, parts: SceneDescription, samples: int = 0):
        self.parts = parts
        self.spec = compose(parts)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", CONFLICT)
            model = self.spec.compile()
        model.vis.quality.offsamples = samples
        self.physics = Physics.from_model(wrapper.MjModel(model))
        self.physics.anisotropy = parts.camera.anisotropy
        self.physics.glossy = parts.glossy
        self.model = self.physics.model.ptr
        self.data = self.physics.data.ptr
        self._target = self.model.body("target/frame")
        self._turned = np.zeros((4, 4)), np.zeros(4)
        self.root = Root(self.model, "robot/") if parts.robot.base != "fixed" else None
        self.leader = Root(self.model, "leader/") if parts.leader else None
        self.target_inverse = inverse(parts.target.pose.T)
        movers = parts.world.movers
        self._plate_paths = list(movers.values())
        self._plates = [self._mocap(name) for name in movers]
        self.hand_plate = self._mocap(HAND_PLATE) if parts.plate_m else None
        self.eye = self.model.site("eye").id
        self._eyes = {"eye": self.eye}
        for other in parts.others:
            self._eyes[other.name] = self.model.site(other.name).id
        if parts.target.on_gripper:
            self.flange_body = self.model.body_parentid[self._target.id]
            self.held_site = self.model.site("target/frame").id
        else:
            self.flange_body = self.model.site_bodyid[self.eye]
            self.held_site = -1
        body = parts.robot.body
        self._free = self._mocap("robot/camera") if body is None else None
        self._rest = body and body.rest_ctrl
        self._actuators = body.actuators if body else ()
        self.at = StateIndices.of(self.model, parts.robot.joints, self._actuators, "robot/")
        self._warnings = self.physics.data.warning.number
        self._warned = self._warnings.tobytes()

    def _mocap(self, body: str) -> int:
        return self.model.body(body).mocapid[0]

    @property
    def body(self) -> RobotBody:
        """The robot, for its effects."""
        robot = self.parts.robot
        return RobotBody(
            self.model, self.data, self.at, self.parts.step, robot.joints, self._actuators
        )

    def step(self, steps: int) -> bool:
        """Advance by physics steps and update what depends on positions and velocities; False where
        MuJoCo warns of an instability.
        """
        # The order of dm_control's `Physics.step` (`mj_step1` has been called for this state),
        # whose Python takes longer than MuJoCo's own step of a small craft.
        mujoco.mj_step2(self.model, self.data)
        if steps > 1:
            mujoco.mj_step(self.model, self.data, steps - 1)
        mujoco.mj_step1(self.model, self.data)
        before = self._warned
        self._warned = self._warnings.tobytes()
        return self._warned == before

    def place(
        self, t: float, T_world_target: Array, q: Array, T_world_camera: Array | None = None
    ) -> None:
        """Put the scene into a state and update its kinematics: joints q (n,); T_world_camera (4,
        4) for a movable base.
        """
        self.data.time = t
        self.place_target(T_world_target)
        self.place_plates(t)
        self.data.qpos[self.at.qpos] = q
        self.data.qpos[self.at.motor_qpos] = q  # gears unwound; `sim.plant.settle` winds them up
        if T_world_camera is not None:
            if self._free is not None:
                self.put(self._free, T_world_camera @ self.mount_inverse)
            elif self.root is not None:
                self.root.put(self.data.qpos, T_world_camera @ self.mount_inverse)
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    @contextlib.contextmanager
    def kept(self) -> Iterator[None]:
        """Put the state back as it was, bit by bit, after something else was drawn."""
        present = mujoco.MjData(self.model)
        mujoco.mj_copyData(present, self.model, self.data)
        try:
            yield
        finally:
            mujoco.mj_copyData(self.data, self.model, present)

    def rest(self) -> None:
        """Set the controls and activations of a craft that hovers at its start; nothing for other
        robots.
        """
        if self._rest is not None:
            self.data.ctrl[self.at.ctrl] = self.data.act[self.at.act] = self._rest

    @property
    def mount_inverse(self) -> Array:
        """T_camera_base (4, 4)."""
        return inverse(self.parts.camera.mount.T)

    def place_target(self, T: Array) -> None:
        """Put the target at a pose (4, 4), with the vehicle that carries it; nothing for one in the
        gripper, which the joints place.
        """
        if self.parts.target.on_gripper:
            return
        if self.leader is not None:
            self.leader.put(self.data.qpos, T @ self.target_inverse)
            return
        mocap = self._target.mocapid[0]
        # most targets are at rest, and the quaternion takes .2 ms
        if not np.array_equal(T, self._turned[0]):
            self._turned = T.copy(), quaternion_wxyz(T[:3, :3])
        self.data.mocap_pos[mocap] = T[:3, 3]
        self.data.mocap_quat[mocap] = self._turned[1]

    def place_plates(self, t: float) -> None:
        """Put plates, decoys and a lamp that moves at their poses at a time [s]."""
        for path, mocap in zip(self._plate_paths, self._plates, strict=True):
            self.put(mocap, path(t))

    def put(self, mocap: int, T_world_body: Array) -> None:
        """Put a mocap body, by its number among them, at a pose (4, 4)."""
        self.data.mocap_pos[mocap] = T_world_body[:3, 3]
        self.data.mocap_quat[mocap] = quaternion_wxyz(T_world_body[:3, :3])

    def target_pose(self) -> Array:
        """Pose (4, 4) of the target in the world."""
        return placed(self.data.xpos[self._target.id], self.data.xmat[self._target.id])

    def camera_pose(self, eye: str = "eye") -> Array:
        """Pose (4, 4) of the servo camera, or of a further one by its name, in the world,
        computer-vision axes.
        """
        site = self._eyes[eye]
        return placed(self.data.site_xpos[site], self.data.site_xmat[site])

    def pose_of(self, camera: str) -> Array:
        """Pose (4, 4) of a camera by its name in the world, computer-vision axes."""
        data = self.data.camera(camera)
        return placed(data.xpos, data.xmat.reshape(3, 3) @ FLIP[:3, :3])

    def hidden(self, T_world_camera: Array, p_camera: Array, eye: str = "eye") -> NDArray[np.bool_]:
        """Which marker centres (N, 3) are occluded: a ray from the lens hits something before them.
        Not those that do not exist (NaN).
        """
        return self._before(T_world_camera, p_camera, eye) >= 0

    def names_before(self, T_world_camera: Array, p_camera: Array) -> tuple[str, ...]:
        """What occludes each of marker centres (N, 3), by the name of its body, or the renderer's
        near plane; "" where nothing does.
        """
        geoms = self._before(T_world_camera, p_camera)
        bodies = [
            self.model.body(int(self.model.geom_bodyid[g])).name if g >= 0 else "" for g in geoms
        ]
        near_m = float(self.model.vis.map.znear) * float(self.model.stat.extent)
        # before the face of the camera's cube that shows the point
        depth = np.abs(p_camera).max(axis=1)
        plane = f"the near plane (nothing within {1e3 * near_m:.2g} mm of the lens is drawn)"
        return tuple(plane if z < near_m else body for z, body in zip(depth, bodies, strict=True))

    def _before(
        self, T_world_camera: Array, p_camera: Array, name: str = "eye"
    ) -> NDArray[np.int_]:
        """The geom that a ray from the lens hits before each of marker centres (N, 3);
        -1 for none.
        """
        # the ray hits the marker itself before its centre, by its height
        slack = self.parts.target.marker.clearance_m(p_camera)
        eye = np.ascontiguousarray(T_world_camera[:3, 3])
        # A lens on the flange lies inside the last of these groups; neither is in its picture.
        unseen = (RANGE_GROUP,) if self.parts.stands(name) else (RANGE_GROUP, LENS_GROUP)
        return before(
            self.model, self.data, eye, p_camera @ T_world_camera[:3, :3].T, slack, unseen
        )

    @property
    def body_names(self) -> list[str]:
        """Names of all bodies, by number."""
        return names_of(self.model, "body")

    @property
    def body_poses(self) -> tuple[Array, Array]:
        """Positions (B, 3) [m] and quaternions (B, 4), wxyz, of all bodies in the state; valid
        until the next one.
        """
        return self.data.xpos, self.data.xquat

    def close(self) -> None:
        """Free the OpenGL context."""
        self.physics.free()
