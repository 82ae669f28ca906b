"""Frames: the error in the image, and where what carries the camera is."""

from dataclasses import replace

import numpy as np
import pytest

from tests.tasks.frames import GOAL, frame, observed
from vstestbed.core.geometry import Pose, inverse
from vstestbed.tasks.frame import ImageError

SEEN = observed(GOAL.T_camera_target)


def without(*markers: int):
    """The goal's own view, 3 px to the right and 4 px down, some markers out of sight."""
    uv = GOAL.uv + [3.0, 4.0]
    uv[list(markers)] = np.nan
    return replace(SEEN, uv=uv)


class TestImageError:
    def test_rms_over_the_coordinates_seen(self):
        for seen in (without(), without(2), without(0, 1, 3)):
            assert ImageError.of(seen, GOAL, "").rms_px == pytest.approx(5.0 / np.sqrt(2))

    def test_all_that_counts_is_seen(self):
        assert ImageError.of(without(), GOAL, "").all_seen
        assert not ImageError.of(without(3), GOAL, "").all_seen
        inner = replace(GOAL, counted=np.array([True, True, True, False]))
        assert ImageError.of(without(3).only(inner.counted), inner, "").all_seen
        assert not ImageError.of(without(0).only(inner.counted), inner, "").all_seen

    @pytest.mark.parametrize(
        ("seen", "why"),
        [
            (without(0, 1, 2, 3), ""),
            (without(), "the depth of the markers in sight cannot be told"),
        ],
    )
    def test_lost_is_who_has_nothing_to_go_by(self, seen, why):
        error = ImageError.of(seen, GOAL, why)
        assert error.lost and np.isnan(error.rms_px)

    def test_who_sees_one_marker_is_not_lost_by_that(self):
        assert not ImageError.of(without(0, 1, 2), GOAL, "").lost


def test_what_carries_the_camera_is_at_its_mount():
    base, mount = (
        Pose(xyz=(1, 2, 3), rpy_deg=(10, 20, 30)).T,
        Pose(xyz=(0.1, 0, 0.2), rpy_deg=(-90, 0, -90)).T,
    )
    np.testing.assert_allclose(
        frame(T_world_camera=base @ mount).T_world_base(inverse(mount)), base, atol=1e-12
    )
