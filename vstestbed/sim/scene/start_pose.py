"""Poses of camera and target at the start: the robot carries the camera or, eye to hand, the target."""

from __future__ import annotations

from vstestbed.camera import Camera
from vstestbed.core.geometry import Array, inverse
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


def flange_for(camera: Camera, target: Target, T_camera_target: Array) -> Array:
    """Pose of the flange (4, 4) with which the camera sees the target, where it is at the start, at T_camera_target (4, 4)."""
    if target.on_gripper:
        return camera.mount.T @ T_camera_target @ inverse(target.pose.T)
    return target.T_world_start @ inverse(camera.mount.T @ T_camera_target)
