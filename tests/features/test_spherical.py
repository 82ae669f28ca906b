"""The spherical feature: all directions, the poles, and what is wrong in print."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import exp, inverse
from vstestbed.features import Spherical


def rays(theta: np.ndarray, phi: np.ndarray) -> np.ndarray:
    return np.stack(
        [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1
    )


def test_measure_in_front_and_behind():
    theta, phi = np.deg2rad([30, 90, 150, 179]), np.deg2rad([0, -120, 45, 180])
    s = Spherical().measure(rays(theta, phi))
    np.testing.assert_allclose(s[0::2], theta, rtol=1e-14)
    np.testing.assert_allclose(s[1::2], phi, rtol=1e-14)


def test_an_arc_sine_folds_what_is_behind_the_equator():
    ray = rays(np.deg2rad([60.0, 120]), np.zeros(2))
    np.testing.assert_allclose(np.arcsin(ray[:, 0]), np.deg2rad([60, 60]))
    np.testing.assert_allclose(Spherical().measure(ray)[0::2], np.deg2rad([60, 120]))


def test_colatitude_is_not_wrapped_and_longitude_is():
    s, s_star = np.array([3.1, 3.0, 0.1, -3.0]), np.array([0.1, -3.0, 3.1, -3.0])
    np.testing.assert_allclose(
        Spherical().error(s, s_star), [3.0, 6 - 2 * np.pi, -3.0, 0], atol=1e-15
    )
    # Near a half turn all longitudes have the majority's sign, colatitudes stay.
    e = Spherical().error(np.array([1, 3.1, 1, -3.1, 1, 3.1]), np.array([2, 0.0, 0.5, 0, 1, 0]))
    np.testing.assert_allclose(e, [-1, 3.1, 0.5, 2 * np.pi - 3.1, 0, 3.1], atol=1e-15)


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_bounded_at_the_poles(z):
    L = (
        Spherical()
        .interaction(np.array([[0, 0, z], [1e-12, 0, z], [0, 1e-3, z]]), np.ones(3))
        .reshape(3, 2, 6)
    )
    np.testing.assert_allclose(L[0, 1], np.zeros(6), atol=1e-9)
    assert np.isfinite(L).all() and np.abs(L).max() <= 100 * (1 + 1e-12)
    e = Spherical().error(
        Spherical().measure(np.array([[1e-5, 0, z]])),
        Spherical().measure(np.array([[-1e-5, 0, z]])),
    )
    assert abs(e[1]) < np.pi * 1e-5  # half a turn of something that is 1e-5 away


def test_printed_derotation_matrix_is_not_the_derivative():
    # Corke 2017, section 16.4.3, prints the columns of w_x and w_y with the rows swapped and
    # without 1/sin theta.
    theta, phi, h = 0.7, 2.1, 1e-6
    printed = np.array(
        [[np.cos(phi) * np.cos(theta), np.sin(phi) * np.cos(theta)], [np.sin(phi), -np.cos(phi)]]
    )
    corrected = np.array(
        [[np.sin(phi), -np.cos(phi)], np.array([np.cos(phi), np.sin(phi)]) / np.tan(theta)]
    )
    ray = rays(np.array([theta]), np.array([phi]))

    def turned(axis: int, angle: float) -> np.ndarray:
        return Spherical().measure(ray @ inverse(exp(angle * np.eye(6)[axis]))[:3, :3].T)

    differences = np.column_stack(
        [(turned(axis, h) - turned(axis, -h)) / (2 * h) for axis in (3, 4)]
    )
    np.testing.assert_allclose(corrected, differences, atol=1e-9)  # rounding 1e-16 / h
    np.testing.assert_allclose(
        Spherical().interaction(ray, np.ones(1))[:, 3:5], differences, atol=1e-9
    )
    assert np.abs(printed - differences).max() > 0.5


def test_range_is_not_depth():
    ray = rays(np.array([1.2]), np.array([0.4]))
    near, far = (
        Spherical().interaction(ray, np.ones(1)),
        Spherical().interaction(ray, np.full(1, 2.0)),
    )
    np.testing.assert_allclose(near[:, :3], 2 * far[:, :3])
    np.testing.assert_array_equal(near[:, 3:], far[:, 3:])


@pytest.mark.parametrize(("ray", "range_"), [((4, 2), (4,)), ((4, 3), (3,)), ((3,), ())])
def test_shapes_that_do_not_belong_together(ray, range_):
    with pytest.raises(ParameterError, match="shape"):
        Spherical().interaction(np.ones(ray), np.ones(range_))


def test_range_must_be_positive():
    with pytest.raises(ParameterError, match="> 0 m"):
        Spherical().interaction(np.ones((2, 3)), np.array([1.0, 0]))


@pytest.mark.parametrize("z", [1.0, -1.0])
def test_without_the_weight_the_angle_is_that_of_print_next_to_the_axis(z: float):
    printed, weighted = Spherical(centre_weight=False), Spherical()
    sine = 0.004
    ray = np.array([[0, sine, z * np.sqrt(1 - sine**2)], [0, 0, z]])
    L = printed.interaction(ray, np.full(2, 2.0)).reshape(2, 2, 6)
    # phi_dot of eq. 16.15 with c = 0, s = 1, R = 2.
    np.testing.assert_allclose(
        L[0, 1], [1 / (2 * sine), 0, 0, 0, z * np.sqrt(1 - sine**2) / sine, -1], atol=1e-9
    )
    np.testing.assert_allclose(
        weighted.interaction(ray, np.full(2, 2.0))[1], L[0, 1] * 0.4**2, atol=1e-9
    )
    # on the axis there is no angle, though pi has a sine of 1.2e-16
    np.testing.assert_array_equal(L[1, 1], np.zeros(6))
    s = printed.measure(ray)
    turned = s + [0, 0.5, 0, 0.5]
    np.testing.assert_allclose(printed.error(turned, s)[1::2], [0.5, 0], atol=1e-15)
    np.testing.assert_allclose(weighted.error(turned, s)[1::2], [0.5 * 0.4**2, 0], atol=1e-12)
