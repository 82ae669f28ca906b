"""The ideal bicycle: exact arcs, limits, and the closed loop of a law."""

import numpy as np
import pytest

from vstestbed.robots.car import BicycleLimits, drive, rolled, steering_of, within_limits, yaw_rate

L = 1.0
FREE = BicycleLimits(speed_mps=np.inf, steering_rad=1.5)


def test_steering_and_yaw_rate_are_inverse():
    rng = np.random.default_rng(0)
    v, steering = rng.uniform(0.1, 2, 200) * rng.choice([-1, 1], 200), rng.uniform(-1.4, 1.4, 200)
    np.testing.assert_allclose(steering_of(v, yaw_rate(v, steering, L), L), steering, atol=1e-12)


def test_a_full_circle_comes_back():
    radius = L / np.tan(0.25)
    round_trip = 2 * np.pi * radius / 0.5
    middle = rolled(np.array([1.0, 2.0, 0.3]), np.array(0.5), np.array(0.25), L, round_trip / 2)
    np.testing.assert_allclose(np.linalg.norm(middle[:2] - [1, 2]), 2 * radius)
    end = rolled(middle, np.array(0.5), np.array(0.25), L, round_trip / 2)
    np.testing.assert_allclose(end, [1, 2, 0.3 + 2 * np.pi], atol=1e-12)


def test_an_arc_is_the_differential_equations():
    place, v, steering = np.array([0.4, -1.0, 2.0]), -0.7, 0.6
    end, n = place.copy(), 20000
    for _ in range(n):  # midpoint rule, error of second order: 1e-9
        dt = 2.0 / n
        half = end[2] + v * np.tan(steering) / L * dt / 2
        end = end + dt * np.array([v * np.cos(half), v * np.sin(half), v * np.tan(steering) / L])
    np.testing.assert_allclose(
        rolled(place, np.array(v), np.array(steering), L, 2.0), end, atol=1e-8
    )


def test_limits_keep_the_arc_or_its_side():
    v, w = np.array([3.0, -3.0, 0.2, -0.2, 0.0]), np.array([1.5, 1.5, -2.0, -2.0, 1.0])
    speed, steering = within_limits(v, w, np.full(5, 0.7), L, BicycleLimits())
    np.testing.assert_allclose(speed, [1, -1, 0.2, -0.2, 0])
    np.testing.assert_allclose(steering, [np.arctan(0.5), -np.arctan(0.5), -1, 1, 0.7])


def test_a_drive_is_made_of_arcs():
    course = drive(
        lambda p: (np.full(p.shape[:-1], 0.5), np.full(p.shape[:-1], 0.2)),
        np.array([[0, 0, 0], [1.0, 2, 3]]),
        L,
        FREE,
        3.0,
    )
    assert course.place.shape == (301, 2, 3) and course.t[-1] == pytest.approx(3.0)
    np.testing.assert_allclose(course.steering, np.arctan(0.4))
    # 300 arcs are one: rounding.
    np.testing.assert_allclose(
        course.place[-1, 1],
        rolled(np.array([1.0, 2, 3]), np.array(0.5), np.arctan(0.4), L, 3.0),
        atol=1e-10,
    )


def test_rates_are_limited_from_rest():
    limits = BicycleLimits(1.0, 1.0, acceleration_mps2=2.0, steering_rate_radps=0.5)
    course = drive(lambda p: (np.array(5.0), np.array(50.0)), np.zeros(3), L, limits, 3.0)
    assert (
        np.diff(course.v, prepend=0).max() <= 0.02 + 1e-12
        and np.diff(course.steering, prepend=0).max() <= 0.005 + 1e-12
    )
    assert (course.v[-1], course.steering[-1]) == (pytest.approx(1.0), pytest.approx(1.0))
    assert course.t[np.argmax(course.v > 1 - 1e-9)] == pytest.approx(0.5, abs=0.011)
    assert course.t[np.argmax(course.steering > 1 - 1e-9)] == pytest.approx(2.0, abs=0.011)


def test_wheels_stay_where_they_are_at_a_stand():
    course = drive(
        lambda p: (np.where(p[..., 0] < 0.5, 0.5, 0.0), np.where(p[..., 0] < 0.5, 0.1, 0.3)),
        np.zeros(3),
        L,
        FREE,
        4.0,
    )
    assert course.v[-1] == 0
    np.testing.assert_allclose(course.steering, np.arctan(0.2))
