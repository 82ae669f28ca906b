"""The filter of a vehicle's place: time constants, lever arm, what is not known."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.geometry import Pose
from vstestbed.core.planar import pose_on_ground
from vstestbed.vision.floor_pose import corrections, fused_place

MOUNT = Pose(xyz=(0.4, 0.1, 0.5), rpy_deg=(-90, 0, -90)).T
GAINS = np.array([0.25, 0.5])


def test_the_corrections_settle_with_half_and_a_quarter_of_a_second() -> None:
    assert corrections(0.1) == pytest.approx(
        [1 - np.exp(-0.1 / 0.5), 1 - np.exp(-0.1 / 0.25)], rel=1e-12
    )
    assert corrections(0.0) == pytest.approx([0, 0], abs=0)


def test_nothing_known_stays_unknown() -> None:
    assert fused_place(None, None, MOUNT, 0.3, GAINS) is None


def test_the_first_sight_is_taken_whole_and_the_compass_gives_the_heading() -> None:
    place = np.array([2.0, -1.0, 0.6])
    T = pose_on_ground(place) @ MOUNT
    assert fused_place(None, T, MOUNT, None, GAINS) == pytest.approx(place, abs=1e-12)
    found = fused_place(None, T, MOUNT, 0.7, GAINS)
    assert found is not None
    assert found[2] == 0.7
    # The lens is where the landmarks say; the base follows by the lever arm at the compass's
    # heading.
    assert (pose_on_ground(found) @ MOUNT)[:2, 3] == pytest.approx(T[:2, 3], abs=1e-12)


def test_without_landmarks_the_odometry_goes_on_and_the_compass_corrects_its_heading() -> None:
    predicted = np.array([1.0, 2.0, 3.1])
    assert fused_place(predicted, None, MOUNT, None, GAINS) == pytest.approx(predicted, abs=0)
    # -3.1 is 2 pi - 6.2 = .083 ahead: the short way round.
    assert fused_place(predicted, None, MOUNT, -3.1, GAINS) == pytest.approx(
        [1, 2, 3.1 + 0.25 * (2 * np.pi - 6.2)], abs=1e-12
    )


def test_landmarks_correct_the_position_by_their_gain() -> None:
    predicted, true = np.array([1.0, 2.0, 0.5]), np.array([1.2, 1.6, 0.5])
    found = fused_place(predicted, pose_on_ground(true) @ MOUNT, MOUNT, 0.5, GAINS)
    assert found == pytest.approx([1.1, 1.8, 0.5], abs=1e-12)
    # without a compass the heading is the landmarks'
    turned = fused_place(
        predicted, pose_on_ground(np.array([1.0, 2.0, 0.8])) @ MOUNT, MOUNT, None, GAINS
    )
    assert turned == pytest.approx([1.0, 2.0, 0.8], abs=1e-12)
