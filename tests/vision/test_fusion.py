"""The pose of a target by the pictures of several cameras: against scipy's solver, the mean by
covariances, and trials with noise.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, Pose, exp, inverse, log, transform
from vstestbed.vision.observe import CameraPixels, fused_pose, pose_of_all

POINTS = np.array([[-0.25, -0.25, 0], [0.25, -0.25, 0], [0.25, 0.25, 0], [-0.25, 0.25, 0]])
HAND = Perspective(width=640, height=480, fovy_deg=64)
ROOM = Perspective(width=800, height=600, fovy_deg=45)
# of the target in the frame of the camera in the hand
T_HAND = Pose(xyz=(0.1, -0.05, 1.1), rpy_deg=(12, -20, 30)).T
T_ROOM_HAND = Pose(xyz=(0.9, 0.2, 1.1), rpy_deg=(5, -50, 10)).T


def seen(
    T: Array,
    sigma: float = 0.0,
    rng: np.random.Generator | None = None,
    hidden: tuple[list[int], list[int]] = ([], []),
):
    """The pixels of both cameras for the target at T (4, 4) in the hand's camera,
    with noise [px].
    """
    found = []
    for camera, M, lacks in ((HAND, np.eye(4), hidden[0]), (ROOM, T_ROOM_HAND, hidden[1])):
        uv = camera.project(transform(M @ T, POINTS))
        if rng is not None:
            uv = uv + rng.normal(0, sigma, uv.shape)
        uv[lacks] = np.nan
        found.append(CameraPixels(camera, uv, M))
    return found


def by_scipy(T: Array, cameras: list[CameraPixels]) -> Array:
    """The same minimum by another solver, over the exponential coordinates of the pose."""

    def residuals(xi: Array) -> Array:
        parts = []
        for one in cameras:
            known = np.isfinite(one.uv[:, 0])
            uv = one.camera.project(transform(one.T_this_reference @ exp(xi) @ T, POINTS[known]))
            parts.append(np.sqrt(one.weight) * (uv - one.uv[known]).ravel())
        return np.concatenate(parts)

    return exp(least_squares(residuals, np.zeros(6), xtol=1e-14, ftol=1e-14, gtol=1e-14).x) @ T


@pytest.mark.parametrize(
    "hidden", [([], []), ([0, 1, 2], [3]), ([0, 1, 2, 3], []), ([0, 1], [2, 3])]
)
def test_it_is_the_least_squares_pose_of_all_pictures(hidden: tuple[list[int], list[int]]) -> None:
    cameras = seen(T_HAND, 0.5, np.random.default_rng(1), hidden)
    near = exp(np.array([0.03, -0.02, 0.05, 0.04, 0.02, -0.05])) @ T_HAND
    found = fused_pose(near, POINTS, cameras)
    assert found is not None
    assert np.abs(log(found[0] @ inverse(by_scipy(near, cameras)))).max() < 1e-7


def test_weights_count() -> None:
    cameras = seen(T_HAND, 0.5, np.random.default_rng(2))
    cameras[1] = cameras[1]._replace(weight=9.0)
    found = fused_pose(T_HAND, POINTS, cameras)
    assert found is not None
    assert np.abs(log(found[0] @ inverse(by_scipy(T_HAND, cameras)))).max() < 1e-7


def test_it_is_the_mean_of_single_poses_by_the_inverses_of_their_covariances() -> None:
    # To first order in the noise, which is small here: xi = (I_1 + I_2)^-1 (I_1 xi_1 + I_2 xi_2).
    cameras = seen(T_HAND, 0.002, np.random.default_rng(3))
    alone = [fused_pose(T_HAND, POINTS, [one]) for one in cameras]
    both = fused_pose(T_HAND, POINTS, cameras)
    assert both is not None
    steps = [(log(found[0] @ inverse(T_HAND)), found[1]) for found in alone if found is not None]
    mean = np.linalg.solve(sum(info for _, info in steps), sum(info @ xi for xi, info in steps))
    assert log(both[0] @ inverse(T_HAND)) == pytest.approx(mean, rel=0.02, abs=1e-9)
    assert both[1] == pytest.approx(
        sum(info for _, info in steps), rel=1e-3, abs=1e-2 * np.abs(both[1]).max()
    )


def test_its_information_is_the_inverse_of_the_covariance_over_trials() -> None:
    sigma, rng = 0.3, np.random.default_rng(4)
    truth = fused_pose(T_HAND, POINTS, seen(T_HAND))
    assert truth is not None
    wanted = sigma**2 * np.linalg.inv(truth[1])
    trials = [fused_pose(T_HAND, POINTS, seen(T_HAND, sigma, rng)) for _ in range(400)]
    errors = np.array([log(found[0] @ inverse(T_HAND)) for found in trials if found is not None])
    assert len(errors) == 400
    # Whitened errors have variance 1 in each direction; that of 400 trials is within 4 of its own
    # standard deviations, sqrt(2/400).
    white = np.linalg.solve(np.linalg.cholesky(wanted), errors.T)
    assert np.abs(white.var(axis=1) - 1).max() < 4 * np.sqrt(2 / 400)


def test_two_cameras_tell_more_than_each() -> None:
    cameras = seen(T_HAND)
    alone, both = fused_pose(T_HAND, POINTS, cameras[:1]), fused_pose(T_HAND, POINTS, cameras)
    assert alone is not None and both is not None
    before, after = (np.sqrt(np.diag(np.linalg.inv(found[1]))) for found in (alone, both))
    assert (after < before).all()
    assert after[2] < 0.5 * before[2]  # the depth, which one camera tells worst


class TestNothing:
    def test_too_few_markers(self) -> None:
        assert fused_pose(T_HAND, POINTS, seen(T_HAND, hidden=([0, 1, 2], [0, 1, 2]))) is None

    def test_a_pose_that_is_far_off(self) -> None:
        away = Pose(xyz=(0, 0, -1)).T  # behind the camera
        assert fused_pose(away, POINTS, seen(T_HAND)) is None

    def test_no_pose_to_begin_with(self) -> None:
        own, other = seen(T_HAND)
        assert pose_of_all(None, POINTS, own, [other]) is None


def test_it_begins_with_the_camera_that_sees_most() -> None:
    own, other = seen(T_HAND, hidden=([0, 1, 2, 3], []))
    old = Pose(xyz=(0, 0, -1)).T  # of a camera that has seen nothing for long
    found = pose_of_all(old, POINTS, own, [other._replace(T_this_target=T_ROOM_HAND @ T_HAND)])
    assert found == pytest.approx(T_HAND, abs=1e-9)
