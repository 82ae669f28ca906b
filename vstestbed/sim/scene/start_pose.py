"""Poses of camera and target at the start: the robot carries the camera or, eye to hand, the target."""

from __future__ import annotations

import contextlib

import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.errors import UnreachableError
from vstestbed.core.geometry import Array, inverse
from vstestbed.robots import Robot
from vstestbed.targets.base import Target

POSTURES = 12
"""Most postures from which the goal's is sought: Newton's steps find the Jaco's from every second one."""


def camera_start(robot: Robot, camera: Camera, target: Target) -> Array:
    """Pose of the servo camera at the start (4, 4): on the robot, or in the room (eye to hand)."""
    if target.on_gripper:
        return camera.mount.T
    return robot.flange_pose(robot.configuration()) @ camera.mount.T


def target_start(robot: Robot, target: Target) -> Array:
    """Pose of the target at the start (4, 4)."""
    if target.on_gripper:
        return robot.flange_pose(robot.configuration()) @ target.pose.T
    return target.T_world_start


def flange_for(camera: Camera, target: Target, T_camera_target: Array) -> Array:
    """Pose of the flange (4, 4) with which the camera sees the target, where it is at the start, at T_camera_target (4, 4)."""
    if target.on_gripper:
        return camera.mount.T @ T_camera_target @ inverse(target.pose.T)
    return target.T_world_start @ inverse(camera.mount.T @ T_camera_target)


def posture_at(robot: Robot, T_world_flange: Array) -> Array:
    """The configuration of an arm at a flange pose (4, 4): from the nominal start, else from the first of POSTURES others that gets there.

    Raises:
        UnreachableError: it does not get there.
    """
    rng, nominal = np.random.default_rng(0), robot.configuration()
    for _ in range(POSTURES):
        with contextlib.suppress(UnreachableError):
            return robot.configuration_at(T_world_flange, nominal)
        nominal = robot.configuration() + rng.uniform(-np.pi, np.pi, len(nominal))
    return robot.configuration_at(T_world_flange, nominal)
