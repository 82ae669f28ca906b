"""Puts a robot's actuators into its model: a profile of its file, or servos made for it."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.robots import Robot
from vstestbed.robots.allocation import Servo
from vstestbed.sim.scene.gears import add_rotors

UNBOUNDED = 1e6
"""Range of the integrated position of a joint that turns without end [rad]."""


def choose_servos(model: mujoco.MjSpec, robot: Robot) -> None:
    """Keep the actuators of the chosen profile, or add the servos, and apply gravity compensation and friction."""
    chosen = robot.actuator_set
    if chosen is None:
        return
    if chosen.prefix is not None:
        _keep(model, chosen.prefix)
    for servo in chosen.servos:
        _add(model, servo)
    if carried := compensated(robot):
        for body in model.bodies:
            body.gravcomp = carried
    for joint in model.joints:
        if not chosen.friction:
            joint.frictionloss, joint.damping = 0.0, np.zeros(3)
    if robot.mechanics is not None:
        if robot.mechanics.drives is not None:
            idle(model, robot)
        add_rotors(model, robot.mechanics)


def compensated(robot: Robot) -> float:
    """The share of a body's weight that the drives' gravity compensation carries; 0 for drives without one."""
    chosen, mechanics = robot.actuator_set, robot.mechanics
    if mechanics is not None and mechanics.gravity is not None:
        return mechanics.gravity
    return 1.0 if chosen is not None and chosen.gravity_compensated else 0.0


def idle(model: mujoco.MjSpec, robot: Robot) -> None:
    """Leave a robot's servos without force, for `sim/motor_torques.py`; integrals of commands and gains stay where they are."""
    for actuator in model.actuators:
        if actuator.name in robot.actuators:
            actuator.biastype = mujoco.mjtBias.mjBIAS_NONE
            actuator.gainprm[0] = 0.0


def _keep(model: mujoco.MjSpec, prefix: str) -> None:
    """Keep the actuators `<prefix>_<joint>`, each named as its joint."""
    for actuator in list(model.actuators):
        profile, _, name = actuator.name.partition("_")
        if profile == prefix:
            actuator.name = name
        else:
            model.delete(actuator)


def _add(model: mujoco.MjSpec, servo: Servo) -> None:
    """A servo for a joint, named as the joint."""
    there = [a for a in model.actuators if a.target == servo.joint and a.trntype == mujoco.mjtTrn.mjTRN_JOINT]
    if servo.torque is None:
        _feed(there[0], servo)
        return
    for actuator in there:
        model.delete(actuator)
    made = model.add_actuator(name=servo.joint, target=servo.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    if servo.kp:
        made.set_to_intvelocity(kp=servo.kp, kv=servo.kv)
        made.actlimited, made.actrange = True, [-UNBOUNDED, UNBOUNDED]
    else:
        made.set_to_velocity(kv=servo.kv)
    made.ctrllimited, made.ctrlrange = True, [-servo.speed, servo.speed]
    if np.isfinite(servo.torque):
        made.forcelimited, made.forcerange = True, [-servo.torque, servo.torque]


def _feed(own: mujoco.MjsActuator, servo: Servo) -> None:
    """The file's own servo, told speeds: one of position is fed with the integrated speed."""
    own.name = servo.joint
    if own.biasprm[1] != 0 and own.dyntype == mujoco.mjtDyn.mjDYN_NONE:
        own.dyntype, own.actlimited = mujoco.mjtDyn.mjDYN_INTEGRATOR, True
        own.actrange = own.ctrlrange if own.ctrlrange[0] < own.ctrlrange[1] else [-UNBOUNDED, UNBOUNDED]
    own.ctrllimited, own.ctrlrange = True, [-servo.speed, servo.speed]
