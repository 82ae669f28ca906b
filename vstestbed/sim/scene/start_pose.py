"""Where camera and target are at the start: the robot carries the one or, eye to hand, the other."""

from __future__ import annotations

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array
from vstestbed.robots import Robot
from vstestbed.targets.base import Target


def camera_start(robot: Robot, camera: Camera, target: Target) -> Array:
    """Where the servo camera is at the start (4, 4): on the robot, or in the room where the hand holds the target."""
    if target.on_gripper:
        return camera.mount.T
    return robot.flange_pose(robot.configuration()) @ camera.mount.T


def target_start(robot: Robot, target: Target) -> Array:
    """Where the target is at the start (4, 4)."""
    if target.on_gripper:
        return robot.flange_pose(robot.configuration()) @ target.pose.T
    return target.T_world_start
