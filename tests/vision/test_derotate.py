"""Derotation against closed forms: exactly, to first order, and as print has it."""

import numpy as np
import pytest

from vstestbed.camera import Perspective, SphericalCamera
from vstestbed.core.geometry import Pose, exp
from vstestbed.vision.derotate import NO_TRIM, level_from_tilt, level_rays, level_twist, trimmed

DOWN = Pose(xyz=(0.0, 0.0, 0.0), rpy_deg=(180, 0, 0))
ROUND = SphericalCamera(width=640, height=640, mount=DOWN)
FLAT = Perspective(width=640, height=640, fovy_deg=100, mount=DOWN)
POINTS = np.array([[1.0, 1, 3], [-1, 1, 3], [-1, -1, 3], [1, -1, 3], [0.3, 2, 1]])


def seen(tilt: np.ndarray, mount: Pose = DOWN) -> tuple[np.ndarray, np.ndarray]:
    """Unit rays of the points from the level camera, and from one on a craft tilted by rotations
    about x, then y.
    """
    roll, pitch = exp(np.array([0, 0, 0, tilt[0], 0, 0])), exp(np.array([0, 0, 0, 0, tilt[1], 0]))
    R = mount.T[:3, :3].T @ (pitch @ roll)[:3, :3] @ mount.T[:3, :3]
    level = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)
    return level, level @ R


def worst(a: np.ndarray, b: np.ndarray) -> float:
    """Largest angle between rays [rad]."""
    return float(np.arcsin(np.clip(np.linalg.norm(np.cross(a, b), axis=1), 0, 1)).max())


@pytest.mark.parametrize("mount", [DOWN, Pose(xyz=(0.1, 0, 0), rpy_deg=(180, 20, 45))])
def test_exact_is_exact_however_the_camera_sits(mount):
    tilt = np.radians([25.0, -17.0])
    level, tilted = seen(tilt, mount)
    np.testing.assert_allclose(
        level_rays(tilted, tilt, SphericalCamera(mount=mount), "exact"), level, atol=1e-12
    )


@pytest.mark.parametrize("camera", [ROUND, FLAT], ids=["angles", "plane"])
def test_first_order_errs_by_the_square_of_the_tilt(camera):
    errors = []
    for degrees in (0.25, 0.5, 1.0):
        tilt = np.radians([degrees, -0.7 * degrees])
        level, tilted = seen(tilt)
        errors.append(worst(level_rays(tilted, tilt, camera, "first_order"), level))
    # Twice the tilt, four times the error: 3.5 to 4.5 leaves room for the third order.
    assert 3.5 < errors[1] / errors[0] < 4.5 and 3.5 < errors[2] / errors[1] < 4.5
    assert errors[2] < 1.5e-3  # of 21e-3 rad of tilt


def test_as_printed_errs_by_the_tilt_itself():
    tilt = np.radians([1.0, -0.7])
    level, tilted = seen(tilt)
    # Without any derotation the rays are off by the tilt, .021 rad; with print's matrix by as much
    # again.
    assert worst(tilted, level) == pytest.approx(np.hypot(*tilt), rel=0.05)
    assert worst(level_rays(tilted, tilt, ROUND, "as_printed"), level) > 0.8 * np.hypot(*tilt)


def test_none_is_nothing_and_what_is_not_seen_stays_so():
    _, tilted = seen(np.radians([5.0, 5.0]))
    tilted[1] = np.nan
    for how in ("none", "exact", "first_order", "as_printed"):
        out = level_rays(tilted, np.radians([5.0, 5.0]), ROUND, how)
        np.testing.assert_array_equal(np.isnan(out[:, 0]), [False, True, False, False, False])


def test_the_picture_takes_a_bias_off_the_tilt():
    true, bias, rng = np.radians([4.0, -3.0]), np.radians([0.4, -0.2]), np.random.default_rng(0)
    R = level_from_tilt(true, DOWN.T[:3, :3])
    goal, T = Pose(xyz=(0, 0, 3), rpy_deg=(0, 0, 90)).T, np.eye(4)
    yaw = Pose(rpy_deg=(0, 0, 37)).T[:3, :3]
    trim = NO_TRIM
    for _ in range(400):
        noise = exp(np.concatenate([np.zeros(3), rng.normal(0, np.radians(0.5), 3)]))[:3, :3]
        T[:3, :3] = noise @ R.T @ yaw @ goal[:3, :3]
        trim = trimmed(trim, true + bias, T, goal, DOWN.T[:3, :3], 0.01)
    # Noise of .5 deg through k = .01: .5 sqrt(.01 / 2) = .035 deg; three of them.
    np.testing.assert_allclose(np.degrees(trim[0]), np.degrees(-bias), atol=0.11)


@pytest.mark.parametrize("mount", [DOWN, Pose(xyz=(0.1, 0.05, -0.1), rpy_deg=(180, 20, 45))])
def test_a_level_camera_moves_with_the_craft_and_turns_with_its_heading_alone(mount):
    """Against finite differences of a craft that moves, rolls, pitches and yaws at once."""
    rates, speeds, start = (
        np.array([0.7, -0.9, 0.4]),
        np.array([0.6, -0.3, 0.2]),
        np.array([0.3, -0.4, 0.8]),
    )
    h, M = 1e-5, mount.T

    def poses(t: float) -> tuple[np.ndarray, np.ndarray]:
        """T_world_camera and that of the level camera, which is where it is."""
        roll, pitch, yaw = start + rates * t
        T = Pose(xyz=tuple(speeds * t), rpy_deg=tuple(np.degrees([roll, pitch, yaw]))).T @ M
        level = Pose(rpy_deg=(0, 0, float(np.degrees(yaw)))).T @ M
        level[:3, 3] = T[:3, 3]
        return T, level

    def twist(i: int) -> np.ndarray:
        before, now, after = (poses(t)[i] for t in (-h, 0, h))
        turn = before[:3, :3].T @ after[:3, :3]
        w = (
            np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            / 2
        )
        return np.concatenate([now[:3, :3].T @ (after[:3, 3] - before[:3, 3]), w]) / (2 * h)

    # Differences of second order: h^2.
    np.testing.assert_allclose(level_twist(twist(0), start[:2], M[:3, :3]), twist(1), atol=1e-8)


def test_near_a_pitch_of_90_degrees_the_heading_turns_ten_times_as_fast_at_most():
    level = DOWN.T[:3, :3]
    for pitch in np.radians([80.0, 84.0, 86.0, 90.0]):
        rate = (
            level @ level_twist(np.array([0, 0, 0, 1.0, 0, 0]), np.array([0.0, pitch]), level)[3:]
        )
        wx, _, wz = level @ level_from_tilt(np.array([0.0, pitch]), level) @ [1.0, 0, 0]
        assert rate[:2] == pytest.approx(0, abs=1e-12)
        assert rate[2] == pytest.approx(wz + wx * np.sin(pitch) / max(np.cos(pitch), 0.1))


@pytest.mark.parametrize("how", ["none", "exact", "first_order", "as_printed"])
@pytest.mark.parametrize("camera", [ROUND, FLAT], ids=["angles", "plane"])
def test_a_marker_straight_ahead_keeps_a_direction(how, camera):
    rays = np.array([[0, 0, 1.0], [0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, 0.8]])
    for tilt in ((0, 0), (0.1, 0), (0, 0.1), (np.pi / 2, 0), (0, np.pi / 2)):
        out = level_rays(rays, np.array(tilt, dtype=float), camera, how)
        assert np.linalg.norm(out, axis=1) == pytest.approx(1)
        assert tilt != (0, 0) or how == "as_printed" or out == pytest.approx(rays, abs=1e-12)


def test_the_first_pictures_are_averaged_and_later_ones_weighed_by_the_gain():
    tilt, R = np.radians([2.0, -1.0]), DOWN.T[:3, :3]
    goal, T = Pose(xyz=(0, 0, 3)).T, np.eye(4)
    T[:3, :3] = level_from_tilt(tilt, R).T @ goal[:3, :3]
    first = trimmed(NO_TRIM, np.zeros(2), T, goal, R, 0.3)
    assert first[1] == 1 and first[0] == pytest.approx(tilt, abs=1e-12)
    second = trimmed(first, np.zeros(2), goal, goal, R, 0.3)  # level: half of the first is left
    assert second[1] == 2 and second[0] == pytest.approx(tilt / 2, abs=1e-12)
    fifth = trimmed((tilt, 4), np.zeros(2), goal, goal, R, 0.3)
    assert fifth[0] == pytest.approx(0.7 * tilt, abs=1e-12)
