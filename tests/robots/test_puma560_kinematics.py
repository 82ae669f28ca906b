"""The numpy kinematics of the Puma 560 against differences, the book's pose, and the singularities
they must survive.
"""

import numpy as np
import pytest

from tests.robots.denavit_hartenberg import frames
from tests.shortcuts import forward, jacobian
from vstestbed.core.geometry import exp, inverse
from vstestbed.robots import Allocation, Mount, Puma560, Reading
from vstestbed.robots.arm import resolved_rate
from vstestbed.robots.puma560 import CHAIN, JOINT_LIMITS, SPEED_LIMITS, UPPER_ARM

Q0 = np.radians([0, 45, -180, 0, 45, -45])
SCALE = np.array([1 / UPPER_ARM] * 3 + [1.0] * 3)


def random_q(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(JOINT_LIMITS[:, 0], JOINT_LIMITS[:, 1])


def weakest(J: np.ndarray) -> float:
    """Smallest singular value with lengths in UPPER_ARM, as `resolved_rate` judges it."""
    return float(np.linalg.svd(J * SCALE[:, None])[1][-1])


def test_start_pose_looks_along_x():
    T, J = CHAIN.kinematics(Q0)
    # .5 mm: the pose is given to the millimetre.
    np.testing.assert_allclose(T[:3, 3], [0.596, -0.150, 0.657], atol=5.5e-4)
    # Rounding of six products of unit matrices.
    np.testing.assert_allclose(T[:3, 2], [1, 0, 0], atol=1e-15)
    # Published as 7.9: half of its last digit.
    assert np.linalg.cond(J) == pytest.approx(7.9, abs=0.05)


def test_zero_pose_is_the_sum_of_the_lengths():
    # At q = 0 the arm lies along x and the forearm stands up: (a2 + a3, -d3, d1 + d4), axes
    # parallel to the base's.
    np.testing.assert_allclose(
        forward(np.zeros(6)),
        [[1, 0, 0, 0.4521], [0, 1, 0, -0.15005], [0, 0, 1, 1.10363], [0, 0, 0, 1]],
        atol=1e-15,
    )


def test_the_chain_is_the_denavit_hartenberg_table():
    """Pose by the product of the table's frames; Jacobian column by column from the axis and the
    origin of the frame before each joint.
    """
    rng = np.random.default_rng(4)
    for q in (np.zeros(6), Q0, *(random_q(rng) for _ in range(50))):
        T, J = CHAIN.kinematics(q)
        by_table = frames(q)
        R, o = by_table[6, :3, :3], by_table[6, :3, 3]
        twists = [
            np.concatenate([R.T @ np.cross(A[:3, 2], o - A[:3, 3]), R.T @ A[:3, 2]])
            for A in by_table[:6]
        ]
        # Rounding of products of six matrices with entries of about 1.
        np.testing.assert_allclose(T, by_table[6], atol=1e-14)
        np.testing.assert_allclose(J, np.array(twists).T, atol=1e-14)


def test_start_is_within_the_limits():
    assert np.all(JOINT_LIMITS[:, 0] < Q0) and np.all(JOINT_LIMITS[:, 1] > Q0)


def test_parts_agree_with_the_whole():
    T, J = CHAIN.kinematics(Q0)
    np.testing.assert_array_equal(forward(Q0), T)
    np.testing.assert_array_equal(jacobian(Q0), J)


def test_jacobian_is_the_derivative_of_forward():
    rng, h = np.random.default_rng(1), 1e-6
    for _ in range(50):
        q = random_q(rng)
        J, differences = jacobian(q), np.empty((6, 6))
        for i in range(6):
            step = h * np.eye(6)[i]
            D = inverse(forward(q)) @ (forward(q + step) - forward(q - step))
            differences[:, i] = np.array([*D[:3, 3], D[2, 1], D[0, 2], D[1, 0]]) / (2 * h)
        # Central differences: h^2 = 1e-12 of truncation, 1e-16 / h = 1e-10 of rounding, with a
        # margin of 10.
        np.testing.assert_allclose(differences, J, atol=1e-9)


def test_a_small_resolved_step_makes_the_twist():
    twist, dt = np.array([0.05, -0.02, 0.03, 0.1, 0.05, -0.1]), 1e-4
    reached = forward(Q0 + dt * resolved_rate(jacobian(Q0), twist, UPPER_ARM))
    # The chain bends by |dq dt|^2, about 1e-9 per step; the wish is that small against the motion
    # (5e-6 and more).
    np.testing.assert_allclose(reached, forward(Q0) @ exp(twist * dt), atol=5e-9)


def test_resolved_rate_is_exact_away_from_singularities():
    rng = np.random.default_rng(2)
    checked = 0
    for _ in range(200):
        J, twist = jacobian(random_q(rng)), rng.normal(size=6)
        if weakest(J) < 0.05:
            continue
        dq = resolved_rate(J, twist, UPPER_ARM)
        # Rounding times the condition number, at most about 1e2 here.
        np.testing.assert_allclose(J @ dq, twist, atol=1e-12)
        checked += 1
    assert checked > 100


def test_resolved_rate_is_bounded_at_and_around_singularities():
    for name, q_deg in (
        ("wrist: axes 4 and 6 aligned", [10, 45, -180, 20, 0, 30]),
        # The forearm's offset turns the stretched arm by atan(a3 / d4).
        ("elbow stretched", [10, 45, -90 + np.degrees(np.arctan2(0.0203, 0.4318)), 20, 40, 30]),
    ):
        rng, q = np.random.default_rng(3), np.radians(q_deg)
        # Singular to rounding.
        assert weakest(jacobian(q)) < 1e-12, name
        for size in (0.0, 1e-9, 1e-6, 1e-4, 1e-2, 3e-2, 1e-1):
            for _ in range(20):
                twist = rng.normal(size=6)
                dq = resolved_rate(jacobian(q + size * rng.normal(size=6)), twist, UPPER_ARM)
                # |dq| <= |scaled twist| / threshold everywhere, as the docstring proves; 1e-9 for
                # rounding.
                assert np.linalg.norm(dq) <= np.linalg.norm(twist * SCALE) / 0.05 * (1 + 1e-9)


def test_damping_sets_in_without_a_step():
    twist = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.1])
    angles = np.radians(np.linspace(-20, 20, 4001))
    rates = np.array(
        [resolved_rate(jacobian(np.array([*Q0[:4], a, Q0[5]])), twist, UPPER_ARM) for a in angles]
    )
    smallest = np.array([weakest(jacobian(np.array([*Q0[:4], a, Q0[5]]))) for a in angles])
    assert smallest.min() < 0.05 < smallest.max()
    # Neighbours are 1.7e-4 rad apart and the gain's slope is at most 1 / threshold^2 = 400 per unit
    # of s_min (which moves as the angle, at most 1 : 1), twice with the turning of U and V, times
    # |ts| = .44: .06 rad/s, where a step would be rads.
    assert np.abs(np.diff(rates, axis=0)).max() < 0.06


def allocated(twist: np.ndarray) -> Allocation:
    return Puma560().allocate(twist, Reading(Q0, np.zeros(6)), Mount.of(np.eye(4)), 0.04)


def test_speed_limits_keep_the_direction():
    twist = np.array([2.0, 1.0, -3.0, 1.0, 0.0, 2.0])
    free, limited = resolved_rate(jacobian(Q0), twist, UPPER_ARM), allocated(twist)
    # Division's rounding.
    assert (
        np.max(np.abs(limited.setpoint) / SPEED_LIMITS) == pytest.approx(1.0, abs=1e-12)
        and limited.limit == "speed"
    )
    np.testing.assert_allclose(limited.setpoint, free * (limited.setpoint[0] / free[0]), rtol=1e-12)


def test_slow_twists_are_not_scaled():
    twist = np.full(6, 1e-3)
    np.testing.assert_array_equal(
        allocated(twist).setpoint, resolved_rate(jacobian(Q0), twist, UPPER_ARM)
    )
