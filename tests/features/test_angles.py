"""Wrapping one angle, wrapping many with one sign near a half turn, and the bounded inverse."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.features.base import FLOOR, bounded_inverse, wrap, wrap_together

PI = np.pi


def deg(*angles: float) -> np.ndarray:
    return np.deg2rad(angles)


def test_wrap():
    for angle, wrapped in (
        (0.3, 0.3),
        (-3.0, -3.0),
        (PI, PI),
        (-PI, PI),
        (3 * PI, PI),
        (-3 * PI, PI),
        (PI + 0.1, 0.1 - PI),
        (-PI - 0.1, PI - 0.1),
        (7.0, 7 - 2 * PI),
    ):
        assert wrap(np.array(angle)) == pytest.approx(wrapped, abs=1e-15)


def test_wrap_leaves_what_is_in_range_and_never_leaves_the_range():
    inside = np.array([1e-17, -1e-300, 0.1, np.nextafter(-PI, 0), PI])
    np.testing.assert_array_equal(wrap(inside), inside)
    near = np.array(
        [k * PI + s * 10.0**-n for k in range(-9, 10) for n in range(12, 17) for s in (-1, 1)]
    )
    assert ((wrap(near) > -PI) & (wrap(near) <= PI)).all()


def test_signs_agree_only_where_all_are_far():
    for errors, expected in (
        # all far: the one of the other sign joins the majority
        (deg(179, -179, 179, 179), deg(179, 181, 179, 179)),
        (deg(-179, -179, 179, -100), deg(-179, -179, -181, -100)),
        (deg(179, -179, -179, 179), deg(179, 181, 181, 179)),  # as many of each: positive
        (deg(-179, 181), deg(-179, -179)),  # both are -179 degrees
        (deg(179, -179, 179, 89), deg(179, -179, 179, 89)),  # one is not far: each stays as it is
        # a common sign for small errors would turn the camera for nothing
        (deg(10, -10, 10, 10), deg(10, -10, 10, 10)),
        (deg(350, 370), deg(-10, 10)),
    ):
        np.testing.assert_allclose(wrap_together(errors), expected, atol=1e-14)


def test_each_case_of_a_batch_has_its_own_sign():
    errors = np.stack([deg(179, -179, 179), deg(-179, 179, -179), deg(20, -20, 170)])
    together = wrap_together(errors)
    np.testing.assert_allclose(
        together,
        np.stack([deg(179, 181, 179), deg(-179, -181, -179), deg(20, -20, 170)]),
        atol=1e-14,
    )
    np.testing.assert_array_equal(wrap_together(errors.reshape(3, 1, 3)), together.reshape(3, 1, 3))


def test_what_is_not_seen_has_no_vote():
    together = wrap_together(np.array([*deg(179, -179, 178), np.nan]))
    np.testing.assert_allclose(together[:3], deg(179, 181, 178), atol=1e-14)
    assert np.isnan(together[3])


def test_an_angle_without_a_vote_follows_the_others_where_it_is_far_and_stays_where_it_is_near():
    votes = np.array([True, True, False])
    np.testing.assert_allclose(
        wrap_together(deg(179, 178, -179), votes), deg(179, 178, 181), atol=1e-14
    )
    np.testing.assert_allclose(
        wrap_together(deg(179, 178, -10), votes), deg(179, 178, -10), atol=1e-14
    )
    np.testing.assert_allclose(
        wrap_together(deg(179, -178, -10), votes), deg(179, 182, -10), atol=1e-14
    )


def test_bounded_inverse():
    x = np.array([2.0, 1.001 * FLOOR, FLOOR, 0.5 * FLOOR, 0.0])
    np.testing.assert_allclose(
        bounded_inverse(x), [0.5, 1 / (1.001 * FLOOR), 1 / FLOOR, 0.5 / FLOOR, 0], rtol=1e-12
    )
    assert bounded_inverse(np.linspace(0, 1, 100_001)).max() <= (1 + 1e-12) / FLOOR
