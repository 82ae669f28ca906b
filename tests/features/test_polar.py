"""The polar feature: its numbers, the wrapped error, the principal point."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.features import Polar
from vstestbed.features.base import CENTRE


def test_measure():
    xy = np.array([[0.3, 0.4], [0, -0.2], [-0.1, 0]])
    np.testing.assert_allclose(
        Polar().measure(xy), [0.5, np.arctan2(4, 3), 0.2, -np.pi / 2, 0.1, np.pi], rtol=1e-15
    )


def test_only_the_angles_are_wrapped():
    s, s_star = np.array([4.0, 3, 0.5, -3]), np.array([0.5, -3, 0.5, 3])
    e = Polar().error(s, s_star)
    # 3 - (-3) = 6 is 6 - 2 pi; a difference of 3.5 in r is no angle.
    np.testing.assert_allclose(e, [3.5, 6 - 2 * np.pi, 0, 2 * np.pi - 6], atol=1e-15)
    np.testing.assert_array_equal(s, [4.0, 3, 0.5, -3])


def test_half_turn_gives_every_point_the_same_error():
    xy = np.array([[0.2, 0.1], [-0.1, 0.2], [-0.2, -0.1], [0.1, -0.2]])
    rng = np.random.default_rng(0)
    turned = -xy + 1e-9 * rng.normal(size=(50, 4, 2))  # the last bits decide what sign each pi has
    alone = Polar().measure(turned)[:, 1::2] - Polar().measure(xy)[1::2]
    wrapped = (alone + np.pi) % (2 * np.pi) - np.pi
    assert (np.abs(wrapped.sum(axis=-1)) < 3 * np.pi).any()  # wrapped alone, signs are mixed
    e = Polar().error(Polar().measure(turned), Polar().measure(xy))
    np.testing.assert_allclose(np.abs(e[:, 1::2].sum(axis=-1)), 4 * np.pi, rtol=1e-7)
    np.testing.assert_allclose(e[:, 0::2], 0, atol=1e-8)


def test_bounded_at_the_principal_point():
    xy = np.array([[0.0, 0], [1e-12, 0], [0, -1e-5], [CENTRE, 0]])
    L = Polar().interaction(xy, np.full(4, 0.5)).reshape(4, 2, 6)
    np.testing.assert_array_equal(L[0, 1], np.zeros(6))
    # w^2/(r Z) is at most 1/(0.01 * 0.5) = 200.
    assert np.isfinite(L).all() and np.abs(L).max() <= 200 * (1 + 1e-12)
    np.testing.assert_allclose(L[3, 1], [0, -200, 0, 100, 0, -1], atol=1e-9)
    assert np.isfinite(Polar().measure(xy)).all()


def test_next_to_the_principal_point_the_error_is_as_small_as_the_way_to_go():
    near = np.array([[0.3, 0.2], [1e-5, 0]])
    e = Polar().error(Polar().measure(near), Polar().measure(near * [[1], [-1]]))
    assert abs(e[3]) == pytest.approx(np.pi * 1e-6)  # half a turn round a goal 1e-5 away
    away = Polar().measure(np.array([[0.3, 0.2], [0.01, 0]]))
    np.testing.assert_allclose(
        Polar().error(away, Polar().measure(np.array([[0.2, 0.3], [0, -0.01]])))[3], np.pi / 2
    )


def test_a_marker_at_the_principal_point_has_no_say_in_the_half_turn():
    xy = np.array([[0.2, 0.1], [-0.1, 0.2], [1e-9, 0]])
    turned = np.array([[-0.2, -0.1 + 1e-6], [0.1 - 1e-6, -0.2], [1e-9, 1e-9]])
    e = Polar().error(Polar().measure(turned), Polar().measure(xy))
    assert abs(e[1] + e[3]) == pytest.approx(2 * np.pi, abs=1e-4)


def test_batches_are_single_ones_stacked():
    rng = np.random.default_rng(1)
    xy, depth = rng.normal(size=(2, 3, 4, 2)), rng.uniform(0.5, 2, (2, 3, 4))
    L, s = Polar().interaction(xy, depth), Polar().measure(xy)
    e = Polar().error(s, s[0, 0])
    assert (L.shape, s.shape, e.shape) == ((2, 3, 8, 6), (2, 3, 8), (2, 3, 8))
    for i in np.ndindex(2, 3):
        np.testing.assert_array_equal(L[i], Polar().interaction(xy[i], depth[i]))
        np.testing.assert_array_equal(e[i], Polar().error(s[i], s[0, 0]))


def test_depth_behind_the_camera():
    with pytest.raises(ParameterError, match="no image"):
        Polar().interaction(np.zeros((2, 2)), np.array([1.0, -1]))


class TestAsPrinted:
    """Without the weight at the centre the law is that of print up to the centre, where the angle
    ends.
    """

    PRINTED, WEIGHTED = Polar(centre_weight=False), Polar()
    NEAR = np.array([[0.003, 0.004], [-0.004, 0.003], [0.2, 0.1]])

    def test_the_row_of_the_angle_grows_as_one_over_the_radius(self):
        # phi_dot of eq. 16.9 at r = .005, c = .6, s = .8, Z = .5.
        L = self.PRINTED.interaction(self.NEAR, np.full(3, 0.5)).reshape(3, 2, 6)
        np.testing.assert_allclose(
            L[0, 1], [0.8 / 0.0025, -0.6 / 0.0025, 0, 0.6 / 0.005, 0.8 / 0.005, -1], rtol=1e-12
        )
        # The weight of r = .005 is a half, and its square multiplies that row alone.
        weighted = self.WEIGHTED.interaction(self.NEAR, np.full(3, 0.5)).reshape(3, 2, 6)
        np.testing.assert_allclose(weighted[:, 1], L[:, 1] * [[0.25], [0.25], [1]], rtol=1e-12)
        np.testing.assert_array_equal(weighted[:, 0], L[:, 0])

    def test_it_is_the_derivative_there(self):
        def polar(x: float, y: float) -> np.ndarray:
            return self.PRINTED.measure(np.array([[x, y]]))

        # Along vx at Z = 1 the point moves by x_dot = -1.
        x, y, h = 0.001, -0.002, 1e-8
        difference = (polar(x - h, y) - polar(x + h, y)) / (2 * h)
        np.testing.assert_allclose(
            self.PRINTED.interaction(np.array([[x, y]]), np.ones(1))[:, 0], difference, rtol=1e-8
        )

    def test_its_error_is_the_whole_angle(self):
        s, s_star = (
            self.PRINTED.measure(self.NEAR),
            self.PRINTED.measure(self.NEAR * [[1], [-1], [1]]),
        )
        assert abs(self.PRINTED.error(s, s_star)[3]) == pytest.approx(np.pi)
        assert abs(self.WEIGHTED.error(s, s_star)[3]) == pytest.approx(np.pi / 4)

    def test_the_arc_tangent_of_a_ratio_has_half_the_circle(self):
        # Eq. 16.6: opposite points have one angle, and one of them is a half turn off.
        xy = np.array([[0.1, 0.2], [-0.1, -0.2]])
        phi = self.PRINTED.measure(xy)[1::2]
        printed = np.arctan(xy[:, 1] / xy[:, 0])
        assert printed[0] == printed[1] and abs(phi[0] - phi[1]) == pytest.approx(np.pi)
        np.testing.assert_allclose(
            np.hypot(*xy.T)[:, None] * np.column_stack([np.cos(phi), np.sin(phi)]), xy, rtol=1e-12
        )

    def test_the_radius_over_the_picture_s_diagonal_has_another_derivative(self):
        # r = hypot(u, v)/sqrt(W^2 + H^2) [px/px] of the book's camera: 800 px of focal length, 1000
        # x 1000 px.
        x, y, h = 0.1, 0.2, 1e-6
        share = 800 / np.hypot(1000, 1000)
        # along vx at Z = 1
        difference = share * (np.hypot(x - h, y) - np.hypot(x + h, y)) / (2 * h)
        row = self.PRINTED.interaction(np.array([[x, y]]), np.ones(1))[0, 0]
        assert difference / row == pytest.approx(share) and share < 0.6

    def test_at_the_centre_itself_there_is_no_angle(self):
        at = np.array([[0.0, 0.0], [0.1, 0.2]])
        assert not self.PRINTED.interaction(at, np.ones(2))[1].any()
        s = self.PRINTED.measure(at)
        assert self.PRINTED.error(s + [0, 0.5, 0, 0], s)[1] == 0
