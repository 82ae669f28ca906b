"""Poses of camera and target at the start: the robot carries the camera or, eye to hand, the target."""

from __future__ import annotations

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array
from vstestbed.robots import Robot
from vstestbed.targets.base import Target


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
