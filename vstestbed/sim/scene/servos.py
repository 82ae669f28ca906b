"""Puts a robot's actuators into its model: a profile of its file, or servos made for it."""

from __future__ import annotations

import mujoco
import numpy as np

from vstestbed.robots import Robot
from vstestbed.robots.allocation import Servo

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
    for body in model.bodies:
        if chosen.gravity_compensated:
            body.gravcomp = 1.0
    for joint in model.joints:
        if not chosen.friction:
            joint.frictionloss, joint.damping = 0.0, np.zeros(3)


def _keep(model: mujoco.MjSpec, prefix: str) -> None:
    """Keep the actuators `<prefix>_<joint>`, each named as its joint."""
    for actuator in list(model.actuators):
        profile, _, name = actuator.name.partition("_")
        if profile == prefix:
            actuator.name = name
        else:
            model.delete(actuator)


def _add(model: mujoco.MjSpec, servo: Servo) -> None:
    """A servo for a joint, named as the joint; of the file's own only the name, the range and what it is told change."""
    there = [a for a in model.actuators if a.target == servo.joint and a.trntype == mujoco.mjtTrn.mjTRN_JOINT]
    if servo.torque is None:
        (own,) = there
        own.name = servo.joint
        if own.biasprm[1] != 0 and own.dyntype == mujoco.mjtDyn.mjDYN_NONE:  # a position servo, fed with the integrated speed
            own.dyntype, own.actlimited = mujoco.mjtDyn.mjDYN_INTEGRATOR, True
            own.actrange = own.ctrlrange if own.ctrlrange[0] < own.ctrlrange[1] else [-UNBOUNDED, UNBOUNDED]
        own.ctrlrange, own.ctrllimited = [-servo.speed, servo.speed], True
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
