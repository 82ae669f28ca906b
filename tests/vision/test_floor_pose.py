"""The place of a vehicle from landmarks: its limits, one by one."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.geometry import Array, Pose, inverse, transform
from vstestbed.core.planar import pose_on_ground
from vstestbed.vision import floor_pose
from vstestbed.vision.floor_pose import solve_place

AT_THE_MIDDLE = Pose(xyz=(0, 0, 0.5)).T
FORWARD = Pose(xyz=(0.2, 0.1, 0.5), rpy_deg=(-90, 0, -90)).T
LANDMARKS = np.array([[3, -0.5, 0.5], [3, 0.5, 0.7], [4, 0, 1.0]])


def rays(place: Array, points: Array, mount: Array) -> Array:
    p = transform(inverse(pose_on_ground(place) @ mount), points)
    return p / np.linalg.norm(p, axis=1, keepdims=True)


@pytest.mark.parametrize(
    "mount",
    [AT_THE_MIDDLE, FORWARD, Pose(xyz=(0, 0, 0.5), rpy_deg=(180, 0, 0)).T],
    ids=["up", "forward", "down"],
)
@pytest.mark.parametrize("place", [(0, 0, 0), (1, 0, 0), (-5, 0, 0), (0, 0, np.pi / 2)], ids=str)
def test_landmarks_straight_ahead(mount: Array, place: tuple[float, float, float]) -> None:
    """Frontal and centred, from any previous place or none; two of the three are higher than the
    lens.
    """
    at = np.array(place, dtype=float)
    for previous in (None, at, at + [0, 0, np.radians(5)], at + [0.1, 0.1, 0]):
        found = solve_place(rays(at, LANDMARKS, mount), LANDMARKS, mount, previous)
        assert found == pytest.approx(at, abs=1e-9)


def test_a_previous_place_with_a_landmark_at_the_lens() -> None:
    at = np.zeros(3)
    found = solve_place(
        rays(at, LANDMARKS, AT_THE_MIDDLE), LANDMARKS, AT_THE_MIDDLE, np.array([3, -0.5, 0.0])
    )
    assert found == pytest.approx(at, abs=1e-9)


@pytest.mark.parametrize(("elevation", "found"), [(1.5, False), (2.0, True)])
def test_a_landmark_at_the_height_of_the_lens_gives_no_distance(
    elevation: float, found: bool
) -> None:
    high = 0.5 + 3 * np.tan(np.radians(elevation))
    points = np.array([[3, 0, high], [0, 3, high]])
    place = solve_place(rays(np.zeros(3), points, AT_THE_MIDDLE), points, AT_THE_MIDDLE)
    assert (place is not None) is found


def test_a_landmark_seen_on_the_wrong_side_of_the_horizon_gives_no_distance() -> None:
    points = np.array([[3, 0, 1.0]])
    seen = rays(np.zeros(3), points, AT_THE_MIDDLE)
    assert solve_place(seen * [1, 1, -1], points, AT_THE_MIDDLE) is None


@pytest.mark.parametrize(("error", "found"), [(0.08, True), (0.13, False)])
def test_angles_that_fit_to_a_tenth_of_a_radian(error: float, found: bool) -> None:
    """All rays raised by the same angle, alternately: no place on the floor explains it."""
    points = np.array([[3, 0, 0.6], [-3, 0, 0.6], [0, 3, 0.6], [0, -3, 0.6]])
    seen = rays(np.zeros(3), points, AT_THE_MIDDLE)
    up = np.arctan2(seen[:, 2], np.hypot(seen[:, 0], seen[:, 1])) + error * np.array([1, 1, -1, -1])
    round_ = np.arctan2(seen[:, 1], seen[:, 0])
    bent = np.stack([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)], axis=1)
    assert (solve_place(bent, points, AT_THE_MIDDLE, np.zeros(3)) is not None) is found


def test_two_on_one_vertical_leave_the_heading_as_it_was() -> None:
    mast = np.array([[3.0, 0, 0.3], [3, 0, 0.9]])
    previous = np.array([0.05, -0.1, 0.2])
    found = solve_place(rays(np.zeros(3), mast, AT_THE_MIDDLE), mast, AT_THE_MIDDLE, previous)
    assert found is not None
    # Turning about the mast is open: the least step leaves it, and the place is on the circle of 3
    # m round the mast.
    assert np.hypot(*(found[:2] - [3, 0])) == pytest.approx(3, abs=1e-6)
    assert abs(found[2] - previous[2]) < 0.15


def test_the_jacobian_is_the_derivative_of_the_errors() -> None:
    at, h = np.array([0.3, -0.2, 0.4]), 1e-6
    d = rays(np.zeros(3), LANDMARKS, FORWARD) @ FORWARD[:3, :3].T
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    J = floor_pose._errors(d, across, LANDMARKS, FORWARD[:3, 3], at)[1]
    for k, step in enumerate(np.eye(3) * h):
        plus, minus = (
            floor_pose._errors(d, across, LANDMARKS, FORWARD[:3, 3], at + s * step)[0]
            for s in (1, -1)
        )
        np.testing.assert_allclose(J[:, k], (plus - minus) / (2 * h), atol=1e-8)


def test_two_landmarks_tell_the_heading_also_where_one_is_as_high_as_the_lens() -> None:
    """It has no distance by its height, so that the first guess is of one landmark, with the
    heading open.
    """
    at, points = np.array([0.3, -0.2, 0.3]), np.array([[3, -0.5, 0.5], [3, 0.8, 1.2]])
    for previous in (None, at + [0.02, -0.03, 0.1]):
        assert solve_place(rays(at, points, FORWARD), points, FORWARD, previous) == pytest.approx(
            at, abs=1e-8
        )
