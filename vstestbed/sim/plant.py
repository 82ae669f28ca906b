"""The physical plant: a robot with inertia, gears and friction in MuJoCo, and its rendered camera."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import mujoco
import numpy as np

from vstestbed.camera import Look, Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, adjoint, inverse
from vstestbed.core.planar import place_of, pose_on_ground
from vstestbed.robots.orders import Orders, Stop
from vstestbed.robots.reading import Reading
from vstestbed.robots.setpoints import Interpolation
from vstestbed.sim.base import Truth
from vstestbed.sim.contacts import RobotContacts
from vstestbed.sim.equilibrium import settle
from vstestbed.sim.hands import Push, hold_plate, moved_path
from vstestbed.sim.motor_torques import motor_loops
from vstestbed.sim.process_end import may_end_here
from vstestbed.sim.render.image_sensor import ImageSensor
from vstestbed.sim.row_weights import Contribution
from vstestbed.sim.scene.disturbed import Disturbed
from vstestbed.sim.scene.lead_vehicle import LeadVehicle
from vstestbed.sim.scene.stage import Stage
from vstestbed.sim.scene.tyre_forces import TyreForces
from vstestbed.sim.scene.wind import WindField
from vstestbed.sim.sensor_reader import SensorReader
from vstestbed.sim.taught import shown_at
from vstestbed.targets.motion import Path

AWAY = np.eye(4)
AWAY[2, 3] = 1000.0
"""Displacement of a craft while a vehicle settles: 1 km up [m]."""
SETTLE_S = 1.0
"""How long vehicles settle on their springs before the start [s]; a car's body comes to rest in half of it."""


class MujocoPlant:
    """Steps a scene; setpoints go to the actuators, through the robot's onboard controller where it has one.

    The robot starts at rest and in equilibrium: integrating servos carry the gravity load from the start, as they do when brakes are
    released; vehicles have settled on their springs.

    Args:
        stage: the scene. steps_per_frame: physics steps between pictures.
        eye: takes the pictures; None where no detector needs them. see_hidden: compute the truth's `hidden` by casting rays.
        rng: generator of the robot's sensor noise. path: the pose of a target that moves by itself as a function of time, else None.
        order_s: how long a setpoint lasts before the robot stops [s]. led: how it goes from one setpoint to the next; None: at once.
    """

    def __init__(
        self,
        stage: Stage,
        steps_per_frame: int,
        eye: ImageSensor | None,
        see_hidden: bool,
        rng: np.random.Generator,
        path: Path | None = None,
        order_s: float = math.inf,
        led: Interpolation | None = None,
    ):
        robot, world = stage.parts.robot, stage.parts.world
        self._stage, self._robot, self._target = stage, robot, stage.parts.target
        self.step_s, self.steps_per_frame, self._steps = stage.parts.step, steps_per_frame, 0
        self._path, self._scenery = path, bool(world.movers or path)
        self._eye = eye
        self._see_hidden, self._visible = see_hidden, np.zeros(len(self._target.points), dtype=bool)
        self._contacts = RobotContacts(stage.model, robot)
        # A stream of its own: turbulence, drawn at the control rate, must not shift the noise that the sensors draw.
        wind = WindField(world.wind, stage.model, rng.spawn(1)[0]) if robot.base == "floating" else None
        self._wind_field = None if world.wind.still else wind
        disturbance = robot.disturbance(rng.spawn(1)[0])
        self._disturbed = None if disturbance is None else Disturbed(stage, disturbance)
        self._sensors, self._ctrl = SensorReader(stage, rng, self._disturbed), stage.data.ctrl
        self._leader = LeadVehicle(stage) if stage.leader else None
        self._velocity, self._push = np.zeros(6), Push(stage)
        self._memory: Any = robot.begin()
        self._orders = Orders(robot.stopping, robot.hold_setpoint(), order_s / self.step_s, self.step_s, led)
        self._control_steps = _whole_steps(robot.control_period_s, self.step_s)
        self._tyres = TyreForces(stage, robot.tyres) if robot.tyres else None
        self._start()
        self._loops = [(every, act, every * self.step_s) for every, act in self._acting()]

    def _acting(self) -> Iterator[tuple[int, Callable[[float], None]]]:
        """What acts at fixed multiples of the physics step, in its order: every how many steps, and what."""
        if self._leader:
            yield self._leader.steps, self._leader.drive
        if self._control_steps:
            yield self._control_steps, self._control
        if self._tyres:
            yield 1, self._tyres.act
        yield from motor_loops(self._stage)

    def _start(self) -> None:
        """Place everything at its start, in equilibrium."""
        q, T = self._stage.parts.start
        self._stage.place(0.0, self._stage.parts.T_world_target if self._path is None else self._path(0.0), q, T)
        settle(self._stage)
        if self._disturbed is not None:
            self._disturbed.start()
        if self._robot.base == "planar" or self._leader:
            self._stand()

    def _stand(self) -> None:
        """Let vehicles settle on their springs, then move them back to their start, at rest, at time 0."""
        stage, data = self._stage, self._stage.data
        T_robot, T_leader = stage.parts.start[1] @ stage.mount_inverse, self._target.T_world_start @ stage.target_inverse
        if (
            self._robot.base == "floating" and stage.root is not None
        ):  # out of the way: it is not controlled yet, and would fall on the vehicle
            stage.root.put(data.qpos, AWAY @ T_robot)
        if not self._stepped(round(SETTLE_S / self.step_s)):
            raise ParameterError("physics.step_s", "is too long for the vehicle's springs and contacts", self.step_s)
        for root, T_start, stands in ((stage.root, T_robot, self._robot.base == "planar"), (stage.leader, T_leader, True)):
            if root is not None:
                # What settled is the height; x, y and heading are the scenario's, whatever the settling did to them.
                T, settled = T_start.copy(), root.pose(data)
                T[2, 3] = settled[2, 3] if stands else T[2, 3]
                if root is stage.root and self._robot.uneven_floor is not None:
                    T[:3, :3] = T_start[:3, :3] @ (inverse(pose_on_ground(place_of(settled))) @ settled)[:3, :3]  # with its tilt there
                root.put(data.qpos, T)
        data.qvel[:] = 0.0
        data.time = 0.0
        stage.rest()
        mujoco.mj_forward(stage.model, data)
        self._sensors.restart()

    def _stepped(self, steps: int) -> bool:
        """Advance without controllers, on tyres where the robot has such; False when MuJoCo reports an instability."""
        if self._tyres is None:
            return self._stage.step(steps)
        for _ in range(steps):
            self._tyres.act(self.step_s)
            if not self._stage.step(1):
                return False
        return True

    @property
    def render_s(self) -> float:
        """Wall time spent on pictures so far [s]."""
        return self._eye.spent_s if self._eye else 0.0

    def capture(self, look: Look | None = None) -> tuple[Picture | None, Truth]:
        """The picture, where a detector needs one, and the truth, now."""
        truth = self.truth()
        return self._eye.capture(self._steps * self.step_s, look) if self._eye else None, truth

    def _move_scenery(self) -> None:
        """Move plates, decoys, a lamp and a target with a path of its own to their present poses."""
        stage, t = self._stage, self._steps * self.step_s
        if self._scenery:
            stage.place_plates(t)
            if self._path is not None:
                stage.place_target(self._path(t))
            mujoco.mj_kinematics(stage.model, stage.data)

    def truth(self) -> Truth:
        """The truth, now."""
        # dm_control's step ends with `mj_step1`: poses and velocities are those of the present time. After MuJoCo's own `mj_step` they
        # would be one step old, .5 mm for a fast arm.
        stage = self._stage
        self._move_scenery()
        T, T_target = stage.camera_pose(), stage.target_pose()
        p_camera = self._target.seen_from(inverse(T_target) @ T)
        twist = self._twist(stage.eye)
        if stage.parts.target.on_gripper:  # relative to the target in the gripper; the camera itself is at rest
            twist = -adjoint(inverse(T) @ T_target) @ self._twist(stage.held_site)
        hidden = stage.hidden(T, p_camera) if self._see_hidden else self._visible
        q, qd, ctrl = *self._sensors.joints(), self._ctrl[stage.at.ctrl].copy()
        contact, feet = self._contacts.touching(stage.data)
        act = stage.data.act[stage.at.act]
        return Truth(T, T_target, twist, q, qd, ctrl, p_camera, hidden, contact, feet, act, stage.model.opt.wind.copy())

    def names_before(self, T_world_camera: Array, p_camera: Array) -> tuple[str, ...]:
        """What stands now before each of points (N, 3)."""
        return self._stage.names_before(T_world_camera, p_camera)

    def with_own(self, picture: Picture) -> Picture:
        """A picture just taken with the camera's own image, where it has none."""
        return self._eye.with_own(picture) if self._eye else picture

    def picture_from(self, T_world_flange: Array, q: Array | None = None) -> Picture:
        """A whole picture without noise with the flange at another pose (4, 4), an arm in its configuration q there."""
        stage = self._stage
        assert self._eye is not None
        with stage.kept():
            joints = stage.data.qpos[stage.at.qpos] if q is None else shown_at(stage, T_world_flange, q)
            stage.place(stage.data.time, stage.target_pose(), joints, T_world_flange @ stage.parts.camera.mount.T)
            return self._eye.clean(self._steps * self.step_s)

    def exposure_s(self) -> float | None:
        """Exposure time of the next picture [s], as the camera will have it; None where no detector needs pictures."""
        self._move_scenery()
        return self._eye.exposure_s(self._steps * self.step_s) if self._eye else None

    def expose(self, weight: float | Contribution, look: Look | None = None, middle: bool = False) -> None:
        """Add an image of the exposure, where a detector needs pictures."""
        self._move_scenery()
        if self._eye is not None:
            self._eye.expose(weight, look, middle)

    def developed(self, t: float) -> Picture | None:
        """The picture of all images added since the last one."""
        return self._eye.developed(t) if self._eye else None

    def _twist(self, site: int) -> Array:
        """True twist (v, w) (6,) of a site in its own frame; MuJoCo has the angular part first."""
        mujoco.mj_objectVelocity(self._stage.model, self._stage.data, mujoco.mjtObj.mjOBJ_SITE, site, self._velocity, 1)
        return np.concatenate([self._velocity[3:], self._velocity[:3]])

    def reading(self) -> Reading:
        """The reading of the robot's sensors with the onboard estimates; the same until time passes."""
        return self._robot.reported(self._memory, self._sensors.read(self._steps))

    def apply(self, setpoint: Array, stop: Stop = "") -> None:
        """Set the setpoint, or a stop in its place; without an onboard controller these are the actuators' controls (n,)."""
        self._orders.give(self._steps, setpoint, stop)
        self._actuate()

    def _actuate(self) -> None:
        """The setpoint in force becomes the controls of a robot without an onboard controller."""
        setpoint = None if self._control_steps else self._orders.at(self._steps)
        if setpoint is not None:
            self._ctrl[self._stage.at.ctrl] = setpoint

    def advance(self, steps: int) -> bool:
        """Advance by physics steps; False when MuJoCo reports an instability.

        Onboard controllers act at fixed multiples of the physics step, however the calls divide the time.
        """
        may_end_here()
        end = self._steps + steps
        while self._steps < end:
            ahead = end - self._steps
            if self._push.acts:
                ahead = self._push.ahead(self._steps, ahead)
            for every, act, dt in self._loops:
                late = self._steps % every
                if not late:
                    act(dt)
                if every - late < ahead:
                    ahead = every - late
            if not self._control_steps:
                self._actuate()
                ahead = self._orders.unchanged(self._steps, ahead)
            if not self._stage.step(ahead):
                return False
            self._steps += ahead
        return True

    def _control(self, dt: float) -> None:
        """One period of the robot's onboard controller, and of the wind that acts on it."""
        step, stage = self._steps, self._stage
        if self._wind_field is not None:
            self._wind_field.blow(step * self.step_s, dt)
        setpoint = self._orders.at(step)
        if setpoint is not None:
            reading = self._sensors.read(step)
            self._memory, orders = self._robot.actuate(self._memory, setpoint, reading, dt)
            self._ctrl[stage.at.ctrl] = orders if self._disturbed is None else self._disturbed.act(orders, dt)

    @property
    def weight_n(self) -> float:
        """Weight of all bodies of the robot [N]."""
        model = self._stage.model
        root = model.body_rootid[self._stage.flange_body]
        return float(model.body_subtreemass[root] * np.linalg.norm(model.opt.gravity))

    def push(self, force: Array, duration_s: float) -> None:
        """Push the body that carries the camera (eye to hand, the gripper) with a force (3,) along world axes [N]."""
        self._push.begin(force, self._steps, duration_s, self.step_s)

    def move_target(self, T_world_target: Array) -> None:
        """Put the target at a pose (4, 4); one that moves goes on from there."""
        self._path = moved_path(self._path, self._stage.parts, self._steps * self.step_s, T_world_target)
        self._scenery = True

    def hold_plate(self, T_world_plate: Array | None) -> None:
        """Put the plate in reserve at a pose (4, 4), or away."""
        hold_plate(self._stage, T_world_plate)
        self._scenery = True

    def close(self) -> None:
        """Free pictures and physics."""
        self._loops = []  # methods of this object: a cycle, which would keep the model until the garbage collector runs
        self._stage.close()


def _whole_steps(period_s: float | None, step_s: float) -> int:
    """A controller's period as whole physics steps, one at least; 0 for a robot without an onboard controller."""
    return max(1, round(period_s / step_s)) if period_s else 0
