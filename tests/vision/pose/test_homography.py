"""Two views of a plane: rotation and scaled depth out of pixels, exact without noise, near the goal and at half turns too."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.geometry import Array, Pose, exp, rotation_angle, transform
from vstestbed.targets.points import Square
from vstestbed.vision.pose.homography import relative_view

POINTS = Square(side=0.5, pose=Pose()).points
GOAL = Pose(xyz=(0.05, 0.02, 1), rpy_deg=(5, -10, 3)).T
RNG = np.random.default_rng(7)


def project(T: Array) -> Array:
    p = transform(T, POINTS)
    return p[:, :2] / p[:, 2:]


def compare(T: Array, xy: Array | None = None) -> tuple[float, float]:
    """Errors of the rotation [rad] and of the four points' scaled coordinates."""
    found = relative_view(project(GOAL), project(T) if xy is None else xy, GOAL[:3, 2])
    assert found is not None
    R = T[:3, :3] @ GOAL[:3, :3].T
    goal, now = transform(GOAL, POINTS), transform(T, POINTS)
    m = (goal / goal[:, 2:]) @ found.H.T
    return float(rotation_angle(found.R_camera_goal @ R.T)), float(np.abs(m - now / goal[:, 2:]).max())


def some_pose() -> Array:
    T = exp(np.r_[0, 0, 0, RNG.normal(0, 0.35, 2), RNG.uniform(-np.pi, np.pi)])
    T[:3, 3] = [*RNG.uniform(-0.2, 0.2, 2), RNG.uniform(0.6, 3)]
    return T


@pytest.mark.parametrize("kind", ["anywhere", "near the goal", "at the goal", "a half turn about the axis"])
def test_exact_to_single_precision_without_noise(kind: str):
    for _ in range(50):
        match kind:
            case "anywhere":
                T = some_pose()
            case "near the goal":
                T = exp(RNG.normal(0, 1e-6, 6)) @ GOAL
            case "at the goal":
                T = GOAL
            case _:
                T = np.diag([-1.0, -1, 1, 1]) @ GOAL
                T[2, 3] *= RNG.uniform(1, 4)
        angle, coordinates = compare(T)
        assert angle < 5e-7 and coordinates < 5e-7


def test_noise_of_a_tenth_of_a_pixel_costs_tenths_of_a_degree():
    errors = []
    for _ in range(200):
        T = some_pose()
        errors.append(compare(T, project(T) + RNG.normal(0, 0.1 / 800, (4, 2)))[0])
    assert np.degrees(np.median(errors)) < 0.3


def test_three_points_make_no_homography():
    xy = project(GOAL)
    xy[0] = np.nan
    assert relative_view(project(GOAL), xy, GOAL[:3, 2]) is None


@pytest.mark.parametrize("noise", [0, 0.3 / 800])
def test_all_points_but_one_on_a_line_make_no_homography(noise: float):
    points = np.array([[-0.25, 0, 0], [0, 0, 0], [0.25, 0, 0], [0, 0.25, 0]])
    views = [transform(T, points) for T in (GOAL, *(some_pose() for _ in range(50)))]
    goal, *others = (p[:, :2] / p[:, 2:] for p in views)
    assert all(relative_view(goal, xy + RNG.normal(0, noise, (4, 2)), GOAL[:3, 2]) is None for xy in others)
