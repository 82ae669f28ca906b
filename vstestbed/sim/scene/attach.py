"""Attaches robots to a scene: their MJCF under a prefix, with the chosen servos and the floor's
friction.
"""

from __future__ import annotations

import functools
from pathlib import Path

import mujoco
import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.named_files import model_path
from vstestbed.effects.base import RobotModel
from vstestbed.effects.body import Change, reshape
from vstestbed.robots import Robot
from vstestbed.robots.allocation import Actuation, Servo
from vstestbed.sim.scene.joint_chain import flange_body, flange_in
from vstestbed.sim.scene.meshes import OF_FILES
from vstestbed.sim.scene.model_files import carry_files, read_model

UNBOUNDED = 1e6  # range of the integrated position of a joint that turns without end [rad]


def choose_servos(model: mujoco.MjSpec, chosen: Actuation | None) -> None:
    """Keep the actuators of the chosen profile, or add the servos, and apply gravity compensation
    and friction.
    """
    if chosen is None:
        return
    if chosen.prefix is not None:
        _keep(model, chosen.prefix)
    for servo in chosen.servos:
        _add(model, servo)
    if carried := chosen.carried:
        for body in model.bodies:
            body.gravcomp = carried
    if not chosen.friction:
        for joint in model.joints:
            joint.frictionloss = 0.0
            joint.damping = np.zeros(3)


def _keep(model: mujoco.MjSpec, prefix: str) -> None:
    for actuator in list(model.actuators):
        profile, _, name = actuator.name.partition("_")
        if profile == prefix:
            actuator.name = name
        else:
            model.delete(actuator)


def _drivers(model: mujoco.MjSpec, joint: str) -> list[mujoco.MjsActuator]:
    on_joint = mujoco.mjtTrn.mjTRN_JOINT
    return [a for a in model.actuators if a.target == joint and a.trntype == on_joint]


def _add(model: mujoco.MjSpec, servo: Servo) -> None:
    there = _drivers(model, servo.joint)
    if servo.torque is None:
        _feed(there[0], servo)
        return
    for actuator in there:
        model.delete(actuator)
    made = model.add_actuator(
        name=servo.joint, target=servo.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
    )
    if servo.kp:
        made.set_to_intvelocity(kp=servo.kp, kv=servo.kv)
        made.actlimited = True
        made.actrange = [-UNBOUNDED, UNBOUNDED]
    elif servo.kv:
        made.set_to_velocity(kv=servo.kv)
    else:
        made.set_to_motor()
        # whatever the file's defaults for actuators are
        made.ctrllimited = made.forcelimited = False
    if servo.kp or servo.kv:
        made.ctrllimited = True
        made.ctrlrange = [-servo.speed, servo.speed]
    if np.isfinite(servo.torque):
        made.forcelimited = True
        made.forcerange = [-servo.torque, servo.torque]


def _feed(own: mujoco.MjsActuator, servo: Servo) -> None:
    """The file's own servo, told speeds: one of position is fed with the integrated speed."""
    own.name = servo.joint
    if own.biasprm[1] != 0 and own.dyntype == mujoco.mjtDyn.mjDYN_NONE:
        own.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
        own.actlimited = True
        limited = own.ctrlrange[0] < own.ctrlrange[1]
        own.actrange = own.ctrlrange if limited else [-UNBOUNDED, UNBOUNDED]
    own.ctrllimited = True
    own.ctrlrange = [-servo.speed, servo.speed]


AUTO = mujoco.mjtJacobian.mjJAC_AUTO


def add_robot(
    scene: mujoco.MjSpec,
    robot: Robot,
    prefix: str,
    friction: float | None,
    assets: dict[str, bytes] | None = None,
) -> tuple[mujoco.MjsBody, Array]:
    """The body that carries the camera, and the pose (4, 4) of the flange in it.

    Args:
        scene: receives the robot, and the solver options of its model.
        robot: to be attached; the ideal camera is a mocap body, which has no mass and is placed by
            the plant.
        prefix: of all its names (`robot/`, `leader/`). friction: of the floor, where the scenario
            sets it.
        assets: receives files in memory, which the scene is given last: MuJoCo warns of models that
            are attached to one with assets.

    Raises ParameterError: the robot's model has no site `flange`.
    """
    body = robot.body
    if body is None:
        return scene.worldbody.add_body(name=f"{prefix}camera", mocap=True), np.eye(4)
    if (found := flange_in(_compiled(body.file), body.flange)) is None:
        words = (
            f"has a model without a site `{body.flange}`, which carries the camera;"
            f" add one to {body.file}"
        )
        raise ParameterError("robot.kind", words)
    model = _spec(body.file, body.changes)
    choose_servos(model, body.actuation)
    _share_options(scene, model, friction)
    edited = RobotModel(
        spec=model,
        scene=scene,
        compiled=functools.partial(_compiled, body.file, body.changes),
        joints=robot.joints,
        actuators=body.actuators,
        flange=flange_body(model, body.flange),
        T_body_flange=found[1].copy(),
        carried=body.actuation.carried if body.actuation else 0.0,
        assets={} if assets is None else assets,
    )
    for effect in robot.acting:
        effect.edit(edited)
    files = carry_files(model, Path(body.file), scene, prefix)
    scene.attach(model, prefix=prefix, frame=scene.worldbody.add_frame())
    # after it: an attached model brings its own assets, under a prefix that nothing refers to
    if files:
        scene.assets = {**scene.assets, **files}
    return flange_body(scene, f"{prefix}{body.flange}"), edited.T_body_flange


def _share_options(scene: mujoco.MjSpec, model: mujoco.MjSpec, friction: float | None) -> None:
    """Groups, solver options and the floor's friction of a model
    that will be attached to a scene.
    """
    for geom in model.geoms:
        geom.group = OF_FILES.get(geom.group, geom.group)
    # `attach` leaves the child's options behind: what its contacts and air were tuned with must be
    # copied. Of two robots the larger value serves both.
    model.option.timestep = scene.option.timestep
    for name in ("cone", "impratio", "density", "viscosity"):
        setattr(scene.option, name, max(getattr(scene.option, name), getattr(model.option, name)))
    if model.option.jacobian != AUTO:
        scene.option.jacobian = model.option.jacobian
    # Both geoms of a contact: MuJoCo takes the larger friction of the two, or that of the geom with
    # priority (a car's wheel), so a slippery floor alone would change nothing.
    if friction is not None:
        for geom in [*model.geoms, scene.geom("floor")]:
            geom.friction[0] = min(geom.friction[0], friction)


def _spec(model: str, changes: tuple[Change, ...]) -> mujoco.MjSpec:
    spec = read_model(model_path(model))
    reshape(spec, changes)
    return spec


@functools.lru_cache(maxsize=32)
def _compiled(model: str, changes: tuple[Change, ...] = ()) -> mujoco.MjModel:
    return _spec(model, changes).compile()


def extent_of(robot: Robot) -> float:
    """Size of a robot with a body, by MuJoCo's own measure [m]."""
    assert robot.body is not None
    return float(_compiled(robot.body.file, robot.body.changes).stat.extent)
