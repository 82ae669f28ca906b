"""Lines through markers: their names, their error, views in which they vanish."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.features import LineFeature
from vstestbed.features.line import line_interaction

SQUARE = np.array([[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]])


def test_measure_of_a_square():
    s = LineFeature().measure(SQUARE)
    np.testing.assert_allclose(s[0::2], [-0.2] * 4, rtol=1e-14)  # every normal points inwards
    np.testing.assert_allclose(s[1::2], [np.pi / 2, np.pi, -np.pi / 2, 0], atol=1e-15)


def test_both_markers_are_on_their_line():
    xy = np.random.default_rng(0).uniform(-1, 1, (50, 5, 2))
    s = LineFeature().measure(xy)
    rho, normal = s[:, 0::2], np.stack([np.cos(s[:, 1::2]), np.sin(s[:, 1::2])], axis=-1)
    np.testing.assert_allclose(np.sum(normal * xy, axis=-1), rho, atol=1e-14)
    np.testing.assert_allclose(np.sum(normal * np.roll(xy, -1, axis=1), axis=-1), rho, atol=1e-14)


def test_distance_passes_zero_without_a_jump():
    across = np.linspace(-0.1, 0.1, 11)
    s = LineFeature().measure(
        np.stack(
            [np.stack([0 * across - 0.3, across], -1), np.stack([0 * across + 0.3, across], -1)],
            axis=-2,
        )
    )
    np.testing.assert_allclose(s, np.stack([across, np.full(11, np.pi / 2)], axis=-1), atol=1e-15)


@pytest.mark.parametrize("angle", [0.3, -1.5, 2.0, -3.0])
def test_a_turned_picture_is_an_error_of_angles_alone(angle):
    R = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    e = LineFeature().error(LineFeature().measure(SQUARE @ R.T), LineFeature().measure(SQUARE))
    np.testing.assert_allclose(e, [0, angle] * 4, atol=1e-14)


def test_half_turn_has_one_sign():
    rng = np.random.default_rng(0)
    turned = -SQUARE + 1e-9 * rng.normal(size=(50, 4, 2))
    e = LineFeature().error(LineFeature().measure(turned), LineFeature().measure(SQUARE))
    np.testing.assert_allclose(np.abs(e[:, 1::2].sum(axis=-1)), 4 * np.pi, rtol=1e-7)


def test_both_names_of_a_line_are_one_where_the_way_is_not_known():
    s, other = np.array([0.3, 1.0, -0.2, -2.0]), np.array([-0.3, 1.0 + np.pi, 0.2, -2.0 + np.pi])
    either = LineFeature(directed=False)
    np.testing.assert_allclose(either.error(s, other), 0, atol=1e-15)
    np.testing.assert_allclose(
        either.error(s + [0.01, 0.1, -0.02, 0.2], other), [0.01, 0.1, -0.02, 0.2], atol=1e-15
    )
    # with directions it is the line run backwards
    assert np.abs(LineFeature().error(s, other)).max() == pytest.approx(np.pi)
    e = either.error(np.array([0.3, 1.0]), np.array([0.3, 2.0]))
    np.testing.assert_allclose(e, [0, -1], atol=1e-15)


def test_a_line_through_the_camera():
    # Two markers behind each other are one point in the picture: no line, but finite numbers.
    L = LineFeature().interaction(np.array([[0.1, 0.2], [0.1, 0.2]]), np.array([1.0, 2.0]))
    assert np.isfinite(L).all() and np.abs(L).max() < 2e3


def test_shapes():
    rng = np.random.default_rng(1)
    xy, depth = rng.normal(size=(2, 3, 4, 2)), rng.uniform(0.5, 2, (2, 3, 4))
    L, s = LineFeature().interaction(xy, depth), LineFeature().measure(xy)
    assert (L.shape, s.shape) == ((2, 3, 8, 6), (2, 3, 8))
    for i in np.ndindex(2, 3):
        np.testing.assert_array_equal(L[i], LineFeature().interaction(xy[i], depth[i]))
    assert LineFeature().measure(xy[..., :2, :]).shape == (2, 3, 2)  # two markers have one line


def test_one_marker_has_no_line():
    with pytest.raises(ParameterError, match="two"):
        LineFeature().measure(np.zeros((1, 2)))
    with pytest.raises(ParameterError, match="at least 2"):
        LineFeature().interaction(np.zeros((1, 2)), np.ones(1))


def test_a_plane_through_the_camera():
    with pytest.raises(ParameterError, match="centre"):
        line_interaction(np.array(0.1), np.array(0.2), np.array([1.0, 0, 0, 0]))
