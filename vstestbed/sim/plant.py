"""The physical plant: a robot with inertia, gears and friction in MuJoCo, and its rendered camera;
an arm's linear model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Picture
from vstestbed.core.errors import ParameterError, UnreachableError
from vstestbed.core.geometry import Array, adjoint, inverse
from vstestbed.core.named_files import model_path
from vstestbed.core.planar import place_of, pose_on_ground, relative
from vstestbed.effects.base import Actor, Effect, RobotBody, StateIndices
from vstestbed.robots import Mount, Robot
from vstestbed.robots.base import Reading
from vstestbed.sim.base import Plant, Truth, Viewpoint
from vstestbed.sim.render.image_sensor import ImageSensor
from vstestbed.sim.scene.attach import add_robot
from vstestbed.sim.scene.joint_chain import force_limits, names_of
from vstestbed.sim.scene.scene import Scene
from vstestbed.targets.motion import Path
from vstestbed.timing.setpoints import SetpointBuffer

__all__ = ["LinearArm", "MujocoPlant", "linear_arm"]


class RobotContacts:
    """Tells the contacts that a robot may have, of feet or wheels on the ground, from collisions.

    model: the scene with the robot under `robot/`. robot: names its feet.
    """

    def __init__(self, model: mujoco.MjModel, robot: Robot):
        self._model = model
        bodies = [name.startswith("robot/") for name in names_of(model, "body")]
        self._feet = np.zeros(model.ngeom, dtype=bool)
        for name in robot.body.feet if robot.body else ():
            self._feet[model.geom(f"robot/{name}").id] = True
        self._body = np.array(bodies)[model.geom_bodyid] & ~self._feet
        geoms = names_of(model, "geom")
        self._floors = [i for i, name in enumerate(geoms) if name.startswith("floor")]
        self._on_wheels = robot.base == "planar"

    def touching(self, data: mujoco.MjData) -> tuple[str, str]:
        """What the robot touches: with anything but its feet, and with its feet;
        `forearm and floor`, "" where nothing.
        """
        if not data.ncon:
            return "", ""
        pairs = data.contact.geom
        feet = self._first(pairs, self._feet)
        # wheels and casters always touch the floor; whatever else of a vehicle does goes unnoticed
        if self._on_wheels:
            pairs = pairs[~np.isin(pairs, self._floors).any(axis=1)]
        # A pair within the robot counts, too: the arm's own links are paired in its file to end a
        # run at the first touch.
        return self._first(pairs, self._body), feet

    def _first(self, pairs: NDArray[np.int32], own: NDArray[np.bool_]) -> str:
        """The first pair of geoms (contacts, 2) one of which is among the robot's `own`, that one
        first; "" if there is none.
        """
        touching = own[pairs]
        found = np.flatnonzero(touching.any(axis=1))
        if not len(found):
            return ""
        first = found[0]
        names = [self._name(geom) for geom in pairs[first].tolist()]
        if not touching[first, 0]:
            names.reverse()
        return " and ".join(names)

    def _name(self, geom: int) -> str:
        """Name of a geom, or of the body it belongs to, without the prefix of its part of the
        scene.
        """
        name = self._model.geom(geom).name or self._model.body(self._model.geom_bodyid[geom]).name
        words = name.removeprefix("robot/").removeprefix("scenery/").strip("/")
        return words.replace("/", " ").replace("_", " ") or "something without a name"


NO_JOINTS = np.zeros(0)


class SensorReader:
    """Reads a robot's joints and MJCF sensors, once for each physics step.

    stage: the scene. rng: generator of the noise. actors: add to what the sensors meet.
    """

    def __init__(self, stage: Scene, rng: np.random.Generator, actors: Sequence[Actor] = ()):
        robot = stage.parts.robot
        self._data = stage.data
        self._values = stage.data.sensordata
        self._at = stage.at
        self._has_encoders = len(stage.at.motor_qpos) > 0
        self._model = robot.instruments(rng)
        self._felt = [actor.felt for actor in actors if type(actor).felt is not Actor.felt]
        self._sensors = []
        for name in robot.body.sensors if robot.body else ():
            sensor = stage.model.sensor(f"robot/{name}")
            self._sensors.append((name, slice(sensor.adr[0], sensor.adr[0] + sensor.dim[0])))
        self.read_at = -1
        self._reading: Any = None

    def read(self, step: int) -> Any:
        """What the sensors read at a physics step (`Robot.instruments`)."""
        # Cached: a second reading of the same instant must not draw other noise, which could be
        # averaged out.
        if step != self.read_at:
            values = self._values.tolist()
            sensors = {name: values[where] for name, where in self._sensors}
            for felt in self._felt:
                sensors = felt(sensors)
            q = qd = NO_JOINTS
            # of a craft without any an empty index would take as long as its filters
            if self._has_encoders:
                # the encoders are on the motors
                q = self._data.qpos[self._at.motor_qpos]
                qd = self._data.qvel[self._at.motor_qvel]
            self._reading = self._model(q, qd, sensors)
            self.read_at = step
        return self._reading


# entries of two poses that differ by less are the same: the arm's own model is exact
EXACT_M = 1e-6
ROUNDS = 3
"""Corrections of the joints: each leaves the product of the geometry's error and the correction
before, under a micrometre at the third.
"""


def shown_at(stage: Scene, T_world_flange: Array, q: Array) -> Array:
    """Joints (n,) at which the true flange, which carries the camera, is at a pose (4, 4); those of
    the arm's own model are q (n,).

    q <- f^-1(T E^-1) with the error E = f(q)^-1 T_true(q) of the arm's own kinematics f. The stage
    is left at the joints before the last.
    Raises UnreachableError: the arm does not get there.
    """
    robot = stage.parts.robot
    if not robot.joints or stage.parts.target.on_gripper:
        return q
    for _ in range(ROUNDS):
        stage.place(stage.data.time, stage.target_pose(), q)
        own = robot.flange_pose(q)
        true = stage.camera_pose() @ stage.mount_inverse
        if np.abs(true - own).max() < EXACT_M:
            return q
        q = robot.configuration_at(T_world_flange @ inverse(true) @ own, q)
    return q


def check_static_load(stage: Scene) -> None:
    """Refuse a start at which the weight of the links and the payload is more than motors and
    friction of a joint hold.

    tau = g(q) of the whole arm, less what springs or counterweights in its file carry. Gravity
    compensation by the drives does not count: its torque is the motors' own. A joint holds |tau| <=
    tau_max + its Coulomb friction; motors without a limit hold all. It takes 0.1 ms at the start of
    a run. Raises UnreachableError: a joint that holds less, with the torques, and the payload that
    it would hold.
    """
    robot = stage.parts.robot
    model = stage.model
    data = stage.data
    if stage.root is not None or not robot.joints:
        return
    drives = robot.body and robot.body.actuation
    weight = data.qfrc_bias  # at rest gravity alone
    if drives is None or not drives.carried:
        weight = weight - data.qfrc_gravcomp
    weight = weight[stage.at.qvel]
    motors = stage.at.motor_qvel
    holds = force_limits(model, model.dof_jntid[motors]) + model.dof_frictionloss[motors]
    if not (over := np.flatnonzero(np.abs(weight) > holds)).size:
        return
    joint = int(over[np.argmax(np.abs(weight[over]) / holds[over])])
    slides = model.joint(f"robot/{robot.joints[joint]}").type[0] == mujoco.mjtJoint.mjJNT_SLIDE
    unit = "N" if slides else "Nm"
    words = (
        f"asks {robot.joints[joint]} for {abs(weight[joint]):.4g} {unit} to hold the arm at its"
        f" start, and its motor and friction have {holds[joint]:.4g} {unit}: it would fall"
    )
    for effect in robot.acting:
        if remedy := effect.remedy(stage.body, weight, holds):
            field, works, value = remedy
            raise UnreachableError(field, f"{words}; works: {works}", value)
    raise UnreachableError("robot.start", f"{words}; works: another start, or stronger motors")


def settle(stage: Scene) -> None:
    """Equilibrium of the actuators: integrating servos start at theta + load / kp, elastic joints'
    rotors at q + torsion, craft at hover.

    The load of a joint is what gravity asks of its motor. A servo whose gravity compensation is
    wrong does not know of it: it starts at theta, and sags. Raises UnreachableError: an arm's
    motors cannot hold it there.
    """
    # At q itself an industrial arm would sag until its servos carry it: joint 2 by 2 mrad.
    model = stage.model
    data = stage.data
    robot = stage.parts.robot
    stage.rest()
    mujoco.mj_forward(model, data)
    check_static_load(stage)
    load = data.qfrc_bias - data.qfrc_gravcomp
    for effect in robot.acting:
        effect.settle(stage.body, load)
    if robot.body and robot.body.actuation and robot.body.actuation.gravity_error is not None:
        load[:] = 0.0
    for i in range(model.nu):
        if (
            model.actuator_dyntype[i] == mujoco.mjtDyn.mjDYN_INTEGRATOR
            and model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
        ):
            joint = model.actuator_trnid[i, 0]
            kp = -model.actuator_biasprm[i, 1]
            data.act[model.actuator_actadr[i]] = (
                data.qpos[model.jnt_qposadr[joint]] + load[model.jnt_dofadr[joint]] / kp
            )
    mujoco.mj_forward(model, data)


PERIOD_S = 0.01  # period of the path following [s], that of a car's onboard servos
CROSS_GAIN = 1.5
HEADING_GAIN = 2.5
"""Gains of lateral offset [1/m^2] and heading error [1/m], overdamped: poles -1 and -1.5 [1/m]. The
offset decays within some 1.6 m.
"""


class LeadVehicle:
    """Drives the target's vehicle: w = v (curvature - CROSS_GAIN offset - HEADING_GAIN (heading -
    route's)).

    That is linear feedback along the path: offset'' + HEADING_GAIN offset' + CROSS_GAIN offset = 0
    by arc length.

    stage: the scene with the vehicle under `leader/`.

    Reference: Samson 1995, path following in arc length, doi:10.1109/9.362899.
    """

    def __init__(self, stage: Scene):
        motion = stage.parts.target.carrier
        if motion is None or stage.leader is None or stage.parts.leader is None:
            raise TypeError("no vehicle carries the target")
        self._stage = stage
        self._motion = motion
        self._root = stage.leader
        self._robot = stage.parts.leader
        self._mount = Mount.of(np.eye(4))
        names = self._robot.body.actuators if self._robot.body else ()
        self._at = StateIndices.of(stage.model, self._robot.joints, names, "leader/")
        self._memory: Any = self._robot.onboard.begin() if self._robot.onboard else None
        self._s = motion.from_m
        self.steps = max(1, round(PERIOD_S / stage.parts.step))

    def drive(self, dt: float) -> None:
        """One period dt [s] of the path following."""
        place = place_of(self._root.pose(self._stage.data))
        route = self._motion.route
        # Near its last arc length, since the route may cross itself: .5 m is far more than it
        # drives in a period.
        self._s, _ = route.nearest(place[:2], around=self._s, reach=0.5)
        x, y, heading, curvature = route.at(self._s)
        _, offset, turn = relative(np.array([x, y, heading]), place)
        v = self._motion.speed_mps
        # curvature / (1 - curvature offset) is that of the parallel on which it drives; bounded
        # near the centre of the bend.
        w = v * (
            curvature / max(1 - curvature * offset, 0.1)
            - CROSS_GAIN * offset
            - HEADING_GAIN * math.sin(turn)
        )
        twist = np.array([v, 0.0, 0.0, 0.0, 0.0, w])
        data = self._stage.data
        reading = Reading(data.qpos[self._at.qpos], data.qvel[self._at.qvel])
        ctrl: Any = self._robot.allocate(twist, reading, self._mount, dt).setpoint
        if onboard := self._robot.onboard:
            self._memory, ctrl = onboard.actuate(self._memory, ctrl, reading, dt)
        data.ctrl[self._at.ctrl] = ctrl


AWAY = np.eye(4)
AWAY[2, 3] = 1000.0  # displacement of a craft while a vehicle settles: 1 km up [m]
# How long vehicles settle on their springs before the start [s]; a car's body comes to rest in half
# of it
SETTLE_S = 1.0


LONGEST_PUSH_S = 10.0


class Actors:
    """What acts on a robot while a run lasts, for its effects and for the wind, by when it acts."""

    def __init__(self, effects: Sequence[Effect], body: RobotBody, rng: np.random.Generator):
        self.all: list[Actor] = []
        self.rows: list[tuple[Effect, Actor]] = []  # what fills the effects' columns
        self.forces: list[Array] = []
        self.each_step: list[Callable[[float, float], None]] = []
        self.each_period: list[Callable[[float, float], None]] = []
        self.driven: list[Callable[[Sequence[float], float], Sequence[float]]] = []
        for effect in effects:
            # Each has a stream of its own: turbulence, drawn at the control rate, must not shift
            # the noise that the sensors draw.
            actor = effect.actor(body, rng.spawn(1)[0])
            if effect.columns:
                self.rows.append((effect, actor or Actor()))
            if actor is not None:
                self._add(actor, body)

    def _add(self, actor: Actor, body: RobotBody) -> None:
        self.all.append(actor)
        if actor.force is not None:
            self.forces.append(actor.force)
            if actor.of_motors:
                body.motor_forces.append(actor.force)
        if type(actor).act is not Actor.act:
            (self.each_period if actor.with_controller else self.each_step).append(actor.act)
        if type(actor).driven is not Actor.driven:
            self.driven.append(actor.driven)


class MujocoPlant(Plant):
    """Steps a scene; setpoints go to the actuators, through the robot's onboard controller where it
    has one.

    The robot starts at rest and in equilibrium: integrating servos carry the gravity load from the
    start, as they do when brakes are released; vehicles have settled on their springs. see_hidden:
    compute the truth's `hidden` by casting rays. rng: of the sensors' noise.
    """

    _stage: Scene  # pyright: ignore[reportIncompatibleVariableOverride] - always there

    def __init__(
        self,
        stage: Scene,
        eye: ImageSensor | None,
        see_hidden: bool,
        rng: np.random.Generator,
        path: Path | None = None,
        setpoints: SetpointBuffer | None = None,
    ):
        robot = stage.parts.robot
        world = stage.parts.world
        super().__init__(stage.parts, stage, eye, path, setpoints or stage.parts.setpoints())
        self._robot = robot
        self._scenery = bool(world.movers) or stage.hand_plate is not None
        self._see_hidden = see_hidden
        self._visible = np.zeros(len(self._target.points), dtype=bool)
        self._contacts = RobotContacts(stage.model, robot)
        self._of_robot = stage.body
        self._actors = Actors((world.wind, *robot.acting), self._of_robot, rng)
        self._forces = self._actors.forces
        self._sensors = SensorReader(stage, rng, self._actors.all)
        self._ctrl = stage.data.ctrl
        self._leader = LeadVehicle(stage) if stage.leader else None
        self._velocity = np.zeros(6)
        # whether a push acts, and the physics step at which it ends
        self._pushes = False
        self._push_ends = 0
        self._onboard = robot.onboard
        self._memory: Any = None
        self._control_steps = 0  # none
        if self._onboard:
            self._memory = self._onboard.begin()
            self._control_steps = max(1, round(self._onboard.control_period_s / self.step_s))
        self._start()
        self._loops = [(every, act, every * self.step_s) for every, act in self._acting()]

    def _acting(self) -> Iterator[tuple[int, Callable[[float], None]]]:
        """What acts at fixed multiples of the physics step, in its order: every how many steps, and
        what.
        """
        if self._leader:
            yield self._leader.steps, self._leader.drive
        if self._control_steps:
            yield self._control_steps, self._control
        for act in self._actors.each_step:
            yield 1, lambda dt, act=act: act(self._t, dt)

    def _start(self) -> None:
        parts = self._stage.parts
        T_target = parts.T_world_target if self._path is None else self._path(0.0)
        self._stage.place(0.0, T_target, *parts.start)
        settle(self._stage)
        for actor in self._actors.all:
            actor.start()
        if self._robot.base == "planar" or self._leader:
            self._stand()

    def _stand(self) -> None:
        """Let vehicles settle on their springs, then move them back to their start, at rest, at
        time 0.
        """
        stage = self._stage
        data = stage.data
        T_robot = stage.parts.start[1] @ stage.mount_inverse
        T_leader = self._target.T_world_start @ stage.target_inverse
        # Out of the way: it is not controlled yet, and would fall on the vehicle.
        if self._robot.base == "floating" and stage.root is not None:
            stage.root.put(data.qpos, AWAY @ T_robot)
        if not self._stepped(round(SETTLE_S / self.step_s)):
            raise ParameterError(
                "physics.step_s", "is too long for the vehicle's springs and contacts", self.step_s
            )
        planar = self._robot.base == "planar"
        for root, T, on_wheels in ((stage.root, T_robot, planar), (stage.leader, T_leader, True)):
            if root is None:
                continue
            # What settled is the height; x, y and heading are the scenario's, whatever the
            # settling did to them.
            settled = root.pose(data)
            if on_wheels:
                T[2, 3] = settled[2, 3]
            if root is stage.root and any(effect.uneven for effect in self._robot.acting):
                tilt = inverse(pose_on_ground(place_of(settled))) @ settled
                T[:3, :3] = T[:3, :3] @ tilt[:3, :3]
            root.put(data.qpos, T)
        data.qvel[:] = 0.0
        data.time = 0.0
        stage.rest()
        mujoco.mj_forward(stage.model, data)
        self._sensors.read_at = -1

    def _stepped(self, steps: int) -> bool:
        """Advance without controllers, with what acts at each step; False when MuJoCo reports an
        instability.
        """
        if not self._actors.each_step:
            return self._stage.step(steps)
        for _ in range(steps):
            for act in self._actors.each_step:
                act(0.0, self.step_s)
            self._apply()
            if not self._stage.step(1):
                return False
        return True

    def _apply(self) -> None:
        if self._forces:
            np.sum(self._forces, axis=0, out=self._stage.data.qfrc_applied)

    def _show(self) -> None:
        """Move plates, decoys, a lamp and a target with a path
        of its own to their present poses.
        """
        stage = self._stage
        t = self._t
        if self._scenery or self._path is not None:
            stage.place_plates(t)
            if self._path is not None:
                stage.place_target(self._path(t))
            mujoco.mj_kinematics(stage.model, stage.data)

    def truth(self) -> Truth:
        # dm_control's step ends with `mj_step1`: poses and velocities are those of the present
        # time. After MuJoCo's own `mj_step` they would be one step old, .5 mm for a fast arm.
        stage = self._stage
        self._show()
        T = stage.camera_pose()
        T_target = stage.target_pose()
        p_camera = self._target.seen_from(inverse(T_target) @ T)
        twist = self._twist(stage.eye)
        # relative to the target in the gripper; the camera itself is at rest
        if stage.parts.target.on_gripper:
            twist = -adjoint(inverse(T) @ T_target) @ self._twist(stage.held_site)
        hidden = stage.hidden(T, p_camera) if self._see_hidden else self._visible
        q = stage.data.qpos[stage.at.qpos]
        qd = stage.data.qvel[stage.at.qvel]
        ctrl = self._ctrl[stage.at.ctrl].copy()
        contact, feet = self._contacts.touching(stage.data)
        act = stage.data.act[stage.at.act]
        effects: list[float] = []
        for effect, actor in self._actors.rows:
            effects += _row(effect, actor)
        wind = stage.model.opt.wind.copy()
        tau = self._of_robot.motor_torque()
        return Truth(
            T,
            T_target,
            twist,
            q,
            qd,
            ctrl,
            p_camera,
            hidden,
            contact,
            feet,
            act,
            wind,
            tuple(effects),
            tau,
        )

    def picture_from(self, T_world_flange: Array, q: Array | None = None) -> Picture:
        """A whole picture without noise with the flange at another pose (4, 4), an arm in its
        configuration q there.
        """
        stage = self._stage
        assert self._eye is not None
        with stage.kept():
            if q is None:
                joints = stage.data.qpos[stage.at.qpos]
            else:
                joints = shown_at(stage, T_world_flange, q)
            T_world_camera = T_world_flange @ stage.parts.camera.mount.T
            stage.place(stage.data.time, stage.target_pose(), joints, T_world_camera)
            return self._eye.clean(self._t)

    def pose_of(self, viewpoint: Viewpoint) -> Array:
        """Pose (4, 4) of a further camera, now."""
        return self._stage.camera_pose(viewpoint.name)

    def _twist(self, site: int) -> Array:
        """True twist (v, w) (6,) of a site in its own frame; MuJoCo has the angular part first."""
        mujoco.mj_objectVelocity(
            self._stage.model, self._stage.data, mujoco.mjtObj.mjOBJ_SITE, site, self._velocity, 1
        )
        return np.concatenate([self._velocity[3:], self._velocity[:3]])

    def reading(self) -> Reading:
        """The reading of the robot's sensors with the onboard estimates; the same until time
        passes.
        """
        reading = self._sensors.read(self._steps)
        return self._onboard.reported(self._memory, reading) if self._onboard else reading

    def _actuate(self) -> None:
        setpoint = None if self._control_steps else self._setpoints.at(self._steps)
        if setpoint is not None:
            self._ctrl[self._stage.at.ctrl] = setpoint

    def advance(self, steps: int) -> bool:
        """Advance by physics steps; False when MuJoCo reports an instability.

        Onboard controllers act at fixed multiples of the physics step, however the calls divide the
        time.
        """
        end = self._steps + steps
        while self._steps < end:
            ahead = end - self._steps
            if self._pushes:
                self._pushes = self._steps < self._push_ends
                if self._pushes:
                    ahead = min(ahead, self._push_ends - self._steps)
                else:
                    self._stage.data.xfrc_applied[self._stage.flange_body, :3] = 0.0
            for every, act, dt in self._loops:
                late = self._steps % every
                if not late:
                    act(dt)
                if every - late < ahead:
                    ahead = every - late
            if not self._control_steps:
                self._actuate()
                ahead = self._setpoints.unchanged(self._steps, ahead)
            if self._forces:
                self._apply()
            if not self._stage.step(ahead):
                return False
            self._steps += ahead
        return True

    def _control(self, dt: float) -> None:
        step = self._steps
        stage = self._stage
        for act in self._actors.each_period:
            act(step * self.step_s, dt)
        setpoint = self._setpoints.at(step)
        if setpoint is not None and self._onboard is not None:
            reading = self._sensors.read(step)
            self._memory, orders = self._onboard.actuate(self._memory, setpoint, reading, dt)
            for driven in self._actors.driven:
                orders = driven(orders, dt)  # pyright: ignore[reportArgumentType] - plain floats, of a craft
            self._ctrl[stage.at.ctrl] = orders

    @property
    def weight_n(self) -> float:
        """Weight of all bodies of the robot [N]."""
        model = self._stage.model
        root = model.body_rootid[self._stage.flange_body]
        return float(model.body_subtreemass[root] * np.linalg.norm(model.opt.gravity))

    def push(self, force: Array, duration_s: float) -> None:
        """Push the body that carries the camera (eye to hand, the gripper) with a force (3,) along
        world axes [N], from now on.

        It replaces one that still acts. Raises ParameterError: a force that is not three finite
        numbers, a duration not in (0, 10] s.
        """
        given = np.asarray(force, dtype=float)
        if given.shape != (3,) or not np.isfinite(given).all():
            raise ParameterError.count("force", "three", "finite numbers [N]", force)
        if not 0 < duration_s <= LONGEST_PUSH_S:
            raise ParameterError.bound(
                "duration_s", "more than", f"0 and at most {LONGEST_PUSH_S:g} s", duration_s
            )
        self._stage.data.xfrc_applied[self._stage.flange_body, :3] = given
        self._pushes = True
        self._push_ends = self._steps + max(1, round(duration_s / self.step_s))

    def close(self) -> None:
        # methods of this object: a cycle, which would keep the model until the garbage collector
        # runs
        self._loops = []
        super().close()


def _row(effect: Effect, actor: Actor) -> Sequence[float]:
    """The values of an effect's columns; ParameterError where they are not as many."""
    row = actor.row()
    if len(row) != len(effect.columns):
        names = ", ".join(effect.columns)
        raise ParameterError(
            "robot.effects",
            (
                f"{type(effect).__name__} has the columns {names};"
                " `row` of its actor must return as many"
            ),
            list(row),
        )
    return row


# An arm as a linear system about its start: inertia, springs, dampers and servo gains of its model.
@dataclass(frozen=True, eq=False)
class LinearArm:
    """M z'' = -K z - C z' + b u about rest, u = kp (r - theta) + kv (v - theta'), theta = b^T z; n
    joints and m elastic ones, N = n + m.

    Attributes:
        mass, spring, damper: M, K, C (N, N) of z = (q, theta of the elastic joints); friction of
            the bearings is viscous alone.
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
    """The arm about its nominal start, with its imperfections but ripple, drives and play; without
    gravity's own spring.
    """
    scene = mujoco.MjSpec.from_file(str(model_path("world.xml")))
    scene.compiler.degree = False
    add_robot(scene, robot, "robot/", None)
    model = scene.compile()
    names = robot.body.actuators if robot.body else ()
    data = mujoco.MjData(model)
    at = StateIndices.of(model, robot.joints, names, "robot/")
    data.qpos[at.qpos] = data.qpos[at.motor_qpos] = robot.configuration()
    mujoco.mj_forward(model, data)
    soft = at.motor_qvel != at.qvel
    z = np.concatenate([at.qvel, at.motor_qvel[soft]])
    n = len(at.qvel)
    N = len(z)
    M = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, M)
    spring = np.zeros((N, N))
    damper = np.diag(model.dof_damping[z])
    load = (data.qfrc_bias - data.qfrc_gravcomp)[at.qvel]
    for k, c in filter(None, (effect.springs(load) for effect in robot.acting)):
        for i, joint in enumerate(np.flatnonzero(soft)):
            pair = np.zeros(N)
            pair[joint] = -1.0
            pair[n + i] = 1.0
            spring += k[joint] * np.outer(pair, pair)
            damper += c[joint] * np.outer(pair, pair)
    motors = (z[:, None] == at.motor_qvel[None, :]).astype(float)
    actuators = [model.actuator(f"robot/{name}").id for name in names]
    kp = -model.actuator_biasprm[actuators, 1]
    kv = -model.actuator_biasprm[actuators, 2]
    integrates = model.actuator_dyntype[actuators] == mujoco.mjtDyn.mjDYN_INTEGRATOR
    return LinearArm(M[np.ix_(z, z)], spring, damper, motors, kp, kv, integrates)
