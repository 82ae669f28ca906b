"""Theta u: exact at both ends, in batches, and the law that follows from its matrix."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.geometry import exp
from vstestbed.features import ThetaU
from vstestbed.features.pose import rotation_interaction, theta_u


def rotations(tu: np.ndarray) -> np.ndarray:
    return exp(np.concatenate([np.zeros_like(tu), tu], axis=-1))[..., :3, :3]


@pytest.mark.parametrize(
    "angle", [0.0, 1e-200, 1e-12, 1e-8, 1e-4, 1.0, 3.0, np.pi - 1e-4, np.pi - 1e-8, np.pi - 1e-12]
)
def test_exact_from_nothing_to_a_half_turn(angle):
    u = np.random.default_rng(0).normal(size=(20, 3))
    tu = angle * u / np.linalg.norm(u, axis=-1, keepdims=True)
    # Relative to the angle: small ones keep their digits. The matrix itself has 1e-16 beside 1.
    np.testing.assert_allclose(
        theta_u(rotations(tu)), tu, rtol=0, atol=4e-15 * max(angle, 0) + 1e-300
    )


def test_half_turns():
    R = np.stack(
        [np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1]), np.eye(3)]
    )
    np.testing.assert_array_equal(theta_u(R), np.vstack([np.pi * np.eye(3), np.zeros(3)]))


@pytest.mark.parametrize("angle", [1e-9, 1e-5, 0.0999, 0.1001, 2.0, np.pi])
def test_matrix_leaves_the_axis_alone(angle):
    # About its own axis a rotation grows as the camera turns: L_w u = u, whatever the angle; and
    # the inverse of L_w is the mean of the rotation on the way (I - b S + c S^2, Lynch & Park 2017,
    # eq. 3.88), to 1e-12 by the series' next term.
    u = np.array([2.0, -1, 2]) / 3
    L = rotation_interaction(angle * u)
    np.testing.assert_allclose(L @ u, u, atol=1e-15)
    way = np.linspace(0, 1, 2001)
    R = rotations(-way[:, None] * angle * u)
    simpson = np.ones(2001)
    simpson[1:-1:2], simpson[2:-1:2] = 4, 2
    np.testing.assert_allclose(
        np.linalg.inv(L), np.einsum("i,ijk->jk", simpson / 6000, R), atol=2e-12
    )


@pytest.mark.parametrize("rotation", ["cdRc", "cRcd"])
def test_turning_home(rotation):
    # w = -gain pinv(L) theta u turns about the fixed axis: each step takes a tenth off the angle.
    feature = ThetaU(rotation=rotation)
    R_goal_camera = rotations(np.array([1.0, -2.0, 2.0]))
    for k in range(30):
        R = R_goal_camera if rotation == "cdRc" else R_goal_camera.T
        e = feature.measure(R)
        assert np.linalg.norm(e) == pytest.approx(3 * 0.9**k, rel=1e-9)
        w = -0.1 * np.linalg.pinv(feature.interaction(R)[:, 3:]) @ e
        R_goal_camera = R_goal_camera @ rotations(w)


def test_batches_are_single_ones_stacked():
    rng = np.random.default_rng(1)
    R = rotations(rng.uniform(-1.5, 1.5, (2, 3, 3)))
    for i in np.ndindex(2, 3):
        np.testing.assert_array_equal(ThetaU().measure(R)[i], ThetaU().measure(R[i]))
        np.testing.assert_array_equal(ThetaU().interaction(R)[i], ThetaU().interaction(R[i]))
