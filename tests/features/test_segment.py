"""The segment: its direction, many markers, and two at one place."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.features import Segment

PAIR = np.array([[0.1, 0.2], [0.3, -0.1]])


def test_its_numbers():
    length = np.hypot(0.2, 0.3)
    np.testing.assert_allclose(Segment().measure(PAIR), [0.2, 0.05, length, np.arctan2(0.3, -0.2)])
    np.testing.assert_allclose(
        Segment(normalised=True).measure(PAIR),
        [0.2 / length, 0.05 / length, 1 / length, np.arctan2(0.3, -0.2)],
    )


def test_it_is_that_of_the_first_two_markers():
    more, depth = np.vstack([PAIR, [[0.5, 0.5]]]), np.array([1.0, 1.2, 3.0])
    np.testing.assert_array_equal(Segment().measure(more), Segment().measure(PAIR))
    np.testing.assert_array_equal(
        Segment().interaction(more, depth), Segment().interaction(PAIR, depth[:2])
    )
    with pytest.raises(ParameterError, match="a segment has two ends"):
        Segment().measure(PAIR[:1])


def test_its_direction_is_wrapped():
    s, s_star = np.array([0, 0, 1, 3.0]), np.array([0, 0, 1, -3.0])
    np.testing.assert_allclose(Segment().error(s, s_star), [0, 0, 0, 6 - 2 * np.pi])


@pytest.mark.parametrize("normalised", [False, True])
def test_normalised_rows_of_a_facing_segment_do_not_depend_on_its_distance(normalised):
    near, far = (
        Segment(normalised=normalised).interaction(PAIR / z, np.full(2, z))[:, :3]
        for z in (1.0, 3.0)
    )
    assert np.allclose(near[:3], far[:3]) == normalised


@pytest.mark.parametrize("normalised", [False, True])
def test_two_markers_at_one_place(normalised):
    L = Segment(normalised=normalised).interaction(np.full((2, 2), 0.1), np.ones(2))
    assert np.isfinite(L).all() and np.abs(L).max() < 2e3
