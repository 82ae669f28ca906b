"""Poses from markers: exact data, noise, mirror views, three markers, wide rays."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.geometry import Array, exp, inverse, rigid_error, transform
from vstestbed.vision import solve_pose, solve_pose_from_rays

SQUARE = np.array([[-0.25, -0.25, 0], [0.25, -0.25, 0], [0.25, 0.25, 0], [-0.25, 0.25, 0]])
HOUSE = np.vstack([SQUARE, [[0.0, 0.0, 0.2], [0.1, 0.0, 0.3]]])


def _pose(wx: float, wy: float, wz: float, t: tuple[float, float, float]) -> Array:
    T = exp(np.array([0, 0, 0, wx, wy, 0])) @ exp(np.array([0, 0, 0, 0, 0, wz]))
    T[:3, 3] = t
    return T


def _see(T: Array, points: Array) -> Array:
    p = transform(T, points)
    return p[:, :2] / p[:, 2:]


def _random_poses(n: int) -> list[Array]:
    rng = np.random.default_rng(5)
    draws = [rng.uniform([-0.8, -0.8, -3, -0.2, -0.2, 0.7], [0.8, 0.8, 3, 0.2, 0.2, 2]) for _ in range(n)]
    return [_pose(d[0], d[1], d[2], (d[3], d[4], d[5])) for d in draws]


_ROUND = np.linspace(0, 2 * np.pi, 12, endpoint=False)
DOZEN = np.stack([0.3 * np.cos(_ROUND), 0.2 * np.sin(_ROUND), 0 * _ROUND], axis=1)


@pytest.mark.parametrize("depth", [0.6, 1.0, 4.0])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.2, 0.1, 0.97), (0.6, -0.3, 0.2)], ids=str)
@pytest.mark.parametrize("points", [SQUARE, DOZEN, SQUARE[:, [2, 0, 1]] @ exp(np.array([0, 0, 0, 0, 1.5, 0]))[:3, :3].T])
def test_half_and_quarter_turns(points: Array, axis: tuple[float, ...], depth: float) -> None:
    n = np.array(axis) / np.linalg.norm(axis)
    K = np.cross(np.eye(3), -n)
    T = np.eye(4)
    T[:3, 3] = 0.02, 0.01, depth
    for angle in (np.pi, *(np.pi + s * d for s in (-1, 1) for d in (1e-9, 1e-7, 1e-5, 1e-3)), np.pi / 2, 1e-6, 0.0):
        sine = 0.0 if angle == np.pi else np.sin(angle)  # exactly half a turn
        T[:3, :3] = np.eye(3) + sine * K + (1 - np.cos(angle)) * K @ K
        p = transform(T, points)
        if p[:, 2].min() < 0.1 or np.linalg.svd(p / p[:, 2:] - (p / p[:, 2:]).mean(axis=0))[1][1] < 1e-3:
            continue  # behind the camera, or seen edge on
        for previous in (None, T):
            found = solve_pose(_see(T, points), points, previous)
            assert found is not None
            assert rigid_error(found, T) == pytest.approx((0, 0), abs=1e-6), angle


def test_pixels_that_fit_no_pose_give_none() -> None:
    xy = np.array([[-0.2, -0.2], [0.2, 0.2], [0.2, -0.2], [-0.2, 0.2]])  # two corners swapped
    assert solve_pose(xy, SQUARE) is None


@pytest.mark.parametrize("points", [SQUARE, HOUSE, HOUSE[:5], HOUSE[[0, 1, 2, 4]]], ids=["plane 4", "space 6", "space 5", "space 4"])
def test_exact_pixels_give_the_exact_pose(points: Array) -> None:
    for T in _random_poses(50):
        found = solve_pose(_see(T, points), points)
        assert found is not None
        assert rigid_error(found, T) == pytest.approx((0, 0), abs=1e-6)  # single-precision stop of the refinement


THREE_IN_LINE = np.array([[-0.25, 0, 0], [0, 0, 0], [0.25, 0, 0], [0, 0.25, 0]])
FOUR_IN_LINE = np.vstack([THREE_IN_LINE, [[0.1, 0, 0]]])


@pytest.mark.parametrize("points", [THREE_IN_LINE, FOUR_IN_LINE, THREE_IN_LINE @ exp(np.array([0, 0, 0, 0.3, 1, 0.5]))[:3, :3].T])
def test_all_but_one_on_a_line_fix_a_pose_and_no_homography(points: Array) -> None:
    for T in [*_random_poses(50), _pose(0.3, 0.2, 3.14159, (0.1, 0, 1))]:
        found = solve_pose(_see(T, points), points)
        assert found is not None
        assert rigid_error(found, T) == pytest.approx((0, 0), abs=1e-6)


@pytest.mark.parametrize(
    "xy", [[[-0.2, 0.1], [-0.1, 0.1], [0.1, 0.1], [0.2, 0.1]], [[0.1, 0.1]] * 4, [[0, 0], [0.1, 0], [0.2, 0], [0, 0.1]]]
)
def test_pixels_from_which_the_solver_makes_nothing_raise_nothing(xy: list[list[float]]) -> None:
    found = solve_pose(np.array(xy, dtype=float), SQUARE)  # OpenCV then hands out None for its errors
    assert found is None or np.isfinite(found).all()


def test_noise_of_a_third_of_a_pixel() -> None:
    # .2 m square at .8 m, .3 px at f = 540 px: 1.4 mm and .6 degrees are known; the mirror pose would be off by tens of degrees.
    rng = np.random.default_rng(0)
    points, errors = SQUARE * 0.4, []
    for _ in range(200):
        T = _pose(rng.uniform(-0.6, 0.6), rng.uniform(-0.6, 0.6), rng.uniform(-3, 3), (0.05, 0.0, 0.8))
        found = solve_pose(_see(T, points) + rng.normal(0, 0.3 / 540, (4, 2)), points, previous=T)
        assert found is not None
        errors.append(rigid_error(found, T))
    assert np.median(errors, axis=0)[0] < 0.003
    assert np.degrees(np.median(errors, axis=0)[1]) < 1.2


def test_mirror_view_is_resolved_by_continuity() -> None:
    # Far and small (20 px across at f = 400), .2 px noise: both poses fit; the one that follows from the last frame is right.
    rng = np.random.default_rng(3)
    T = _pose(0.35, 0.0, 0.0, (0.0, 0.0, 10.0))
    alone, followed = [], []
    for _ in range(200):
        xy = _see(T, SQUARE) + rng.normal(0, 0.2 / 400, (4, 2))
        nearby = exp(rng.normal(0, 0.02, 6)) @ T
        for found, errors in ((solve_pose(xy, SQUARE), alone), (solve_pose(xy, SQUARE, nearby), followed)):
            assert found is not None
            errors.append(rigid_error(found, T)[1])
    wrong = 0.5  # rad: the mirror is 2 * .35 = .7 away
    assert np.mean(np.array(alone) > wrong) > 0.05  # the case is a hard one
    assert np.mean(np.array(followed) > wrong) < 0.02  # .7 % measured


def test_clear_fit_overrules_a_wrong_previous_pose() -> None:
    T, mirror = _pose(0.6, 0.1, 0.2, (0, 0, 0.9)), _pose(-0.6, -0.1, 0.2, (0, 0, 0.9))
    xy = _see(T, SQUARE) + np.random.default_rng(0).normal(0, 2e-4, (4, 2))
    found = solve_pose(xy, SQUARE, previous=mirror)
    assert found is not None
    assert rigid_error(found, T)[1] < 0.05


def test_three_markers_need_and_follow_a_previous_pose() -> None:
    for T in _random_poses(50):
        xy = _see(T, SQUARE[:3])
        assert solve_pose(xy, SQUARE[:3]) is None
        found = solve_pose(xy, SQUARE[:3], previous=exp(np.array([0.002, -0.001, 0.002, 0.001, 0.001, -0.002])) @ T)
        assert found is not None
        assert rigid_error(found, T) == pytest.approx((0, 0), abs=1e-4)  # single precision near a double root
        assert solve_pose(xy, SQUARE[:3], previous=_pose(2.0, 1.0, 1.0, (0, 0, 9.0))) is None


def test_too_few_or_collinear_markers_give_no_pose() -> None:
    line = np.array([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.3, 0, 0.0]])
    T = _pose(0.1, 0.2, 0.3, (0, 0, 1))
    assert solve_pose(_see(T, SQUARE[:2]), SQUARE[:2], T) is None
    assert solve_pose(_see(T, line), line, T) is None


def test_rays_to_the_side_and_behind() -> None:
    # The target seen by a lens turned away by 100 degrees: every ray points backward.
    T = _pose(0.3, 0.2, 0.5, (0.1, 0.0, 1.0))
    turned = inverse(exp(np.array([0, 0, 0, 0, np.radians(100), 0]))) @ T
    p = transform(turned, SQUARE)
    assert (p[:, 2] < 0).any()
    found = solve_pose_from_rays(p / np.linalg.norm(p, axis=1, keepdims=True), SQUARE, turned)
    assert found is not None
    assert rigid_error(found, turned) == pytest.approx((0, 0), abs=1e-6)


def test_rays_all_round_give_no_pose() -> None:
    rays = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0.0]])
    assert solve_pose_from_rays(rays, SQUARE) is None
