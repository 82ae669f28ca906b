"""Inverse kinematics: the joints that put a flange somewhere, by the kinematics themselves; and
what is out of reach.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from tests.robots.arms import BLOCKS, block
from vstestbed.core.errors import ParameterError, UnreachableError
from vstestbed.core.geometry import Pose, inverse, rigid_error
from vstestbed.robots import ROBOTS, Robot
from vstestbed.robots.arm import NEAR_M


def arm(name: str) -> Robot:
    return ROBOTS.members["mjcf"](**{k: v for k, v in block(name).items() if k != "kind"})


@pytest.mark.parametrize(
    "robot",
    [vs.load("arm_ibvs").robot, vs.load("arm_jaco").robot, *map(arm, BLOCKS)],
    ids=["puma", "jaco", *BLOCKS],
)
def test_the_joints_found_put_the_flange_there(robot: Robot) -> None:
    rng, near = np.random.default_rng(0), robot.configuration()
    for _ in range(10):
        T = robot.flange_pose(near + rng.uniform(-0.08, 0.08, len(near)))
        q = robot.configuration_at(T, near)
        # joints are rounded to 1e-4 deg
        assert max(rigid_error(robot.flange_pose(q), T)) < NEAR_M + 1e-5
        assert robot.started_at(q).configuration() == pytest.approx(q)


def test_what_is_out_of_reach_is_told_with_how_near_it_comes() -> None:
    robot = vs.load("arm_ibvs").robot
    T = robot.flange_pose(robot.configuration()) @ Pose(xyz=(0, 0, 2)).T
    with pytest.raises(
        UnreachableError, match=r"out of its reach: it stays \d+ mm and \d+\.\d deg away"
    ):
        robot.configuration_at(T, robot.configuration())


def test_a_vehicle_has_no_inverse() -> None:
    with pytest.raises(ParameterError, match=r"robot\.kind must be an arm or the free camera"):
        vs.load("car_pbvs").displaced(Pose(xyz=(0, 0, 0.1)), "camera")


@pytest.mark.parametrize("name", ["ibvs_book", "arm_ibvs", "arm_jaco", "arm_eye_to_hand"])
def test_a_displaced_start_is_seen_displaced(name: str) -> None:
    s, by = vs.load(name), Pose(xyz=(0.01, -0.02, 0.03), rpy_deg=(2, -3, 5))
    goal = s.goal_poses[-1]
    for of, wanted in (("camera", inverse(by.T) @ goal), ("target", goal @ by.T)):
        moved = s.displaced(by, of)  # pyright: ignore[reportArgumentType]
        flange = moved.robot.flange_pose(moved.robot.configuration())
        eye_to_hand = moved.target.on_gripper
        camera = moved.camera.mount.T if eye_to_hand else flange @ moved.camera.mount.T
        target = flange @ moved.target.pose.T if eye_to_hand else moved.target.pose.T
        assert max(rigid_error(inverse(camera) @ target, wanted)) < 1e-5
