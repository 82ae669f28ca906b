"""The position-based law: which way the camera takes, what it does without a pose, finite
differences of its error.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

import vstestbed as vs
from tests.laws.flight import book_camera, fly, pixels
from vstestbed.core.geometry import Pose, exp, inverse, transform
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import PBVS
from vstestbed.laws.points import NO_POSE, TOO_FEW
from vstestbed.targets.base import Square

Way = Literal["cdMc", "cMcd", "cMo"]
CAMERA, POINTS = book_camera(), Square(side=0.5, pose=Pose()).points
GOAL = Goal.from_view(CAMERA, POINTS, Pose(xyz=(0, 0, 1)).T)
START = {"xyz": (0.6, 0.3, -2.0), "rpy_deg": (8.0, -14.0, 100.0)}


def at(T: np.ndarray) -> Goal:
    return Goal.from_view(CAMERA, POINTS, T)


@pytest.mark.parametrize("way", ["cdMc", "cMcd", "cMo"])
def test_the_matrix_is_the_derivative_of_the_error(way: Way):
    law, T, h = PBVS(translation=way), inverse(Pose(**START).T), 1e-6  # pyright: ignore[reportArgumentType]
    L = law.equations(at(T), GOAL)[1]
    for i, twist in enumerate(np.eye(6)):
        ahead, back = (law.equations(at(exp(-s * h * twist) @ T), GOAL)[0] for s in (1, -1))
        assert (ahead - back) / (2 * h) == pytest.approx(L[:, i], abs=1e-8)


def off_line(p: np.ndarray) -> float:
    """How far points (frames, 3) stray from the straight line between the first one and the origin
    [m].
    """
    return float(np.linalg.norm(np.cross(p, p[0] / np.linalg.norm(p[0])), axis=1).max())


def test_the_camera_goes_straight():
    r = fly(PBVS(), **START)  # pyright: ignore[reportArgumentType]
    assert r.outcome is vs.Outcome.converged
    way_there = np.linalg.norm(np.array(START["xyz"]) - (0, 0, -1))
    assert r.summary()["path_length_m"] == pytest.approx(way_there, rel=1e-3)


def test_the_goal_comes_straight_at_the_camera():
    r = fly(PBVS(translation="cMcd"), **START)  # pyright: ignore[reportArgumentType]
    assert r.outcome is vs.Outcome.converged
    goal = Pose(xyz=(0, 0, -1)).T
    assert off_line(np.array([(inverse(T) @ goal)[:3, 3] for T in camera_poses(r)])) < 5e-3


def test_the_targets_origin_goes_straight_in_the_image():
    r = fly(PBVS(translation="cMo"), **START)  # pyright: ignore[reportArgumentType]
    assert r.outcome is vs.Outcome.converged
    T = np.array([inverse(Pose().T @ pose) for pose in camera_poses(r)])
    o = T[:, :3, 3] - (0, 0, 1)
    assert off_line(o) < 5e-3
    assert r.summary()["path_length_m"] > 1.05 * np.linalg.norm(np.array(START["xyz"]) - (0, 0, -1))


def camera_poses(r: vs.Recording) -> list[np.ndarray]:
    from vstestbed.core.geometry import pose_from

    columns = np.column_stack([r[f"cam_{n}"] for n in ("x", "y", "z", "qw", "qx", "qy", "qz")])
    return [pose_from(row[:3], row[3:]) for row in columns]


def test_the_image_is_left_to_itself():
    """Its weakness: markers may leave the picture on the way,
    since nothing in the law knows of it.
    """
    r = fly(PBVS(), (0.9, 0.0, -1.6), rpy_deg=(0, -20, 170))
    assert r.outcome is vs.Outcome.converged
    assert not CAMERA.inside(pixels(r)).all()


class TestRest:
    def step(self, seen: int, T: np.ndarray | None) -> str:
        p = transform(GOAL.T_camera_target, POINTS)
        uv = np.where(np.arange(4)[:, None] < seen, CAMERA.project(p), np.nan)
        o = Observation(t=0, uv=uv, xy=CAMERA.normalise(uv), depth=p[:, 2], T_camera_target=T)
        command = PBVS().step(PBVS().init(GOAL), o, GOAL, np.eye(6))[1]
        assert not command.u.any() or not command.rest_reason
        return command.rest_reason

    def test_too_few_markers_for_a_pose(self):
        assert self.step(2, GOAL.T_camera_target) == TOO_FEW

    def test_no_pose_from_what_is_seen(self):
        assert self.step(4, None) == NO_POSE

    def test_three_are_enough_with_a_pose(self):
        assert self.step(3, GOAL.T_camera_target) == ""
