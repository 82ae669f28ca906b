"""The ellipse of a disc and of a ball: its fit, a ball's motion, and goals that tell fewer motions
than the rows say.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.features.test_derivatives import differences, moved, seen, worst
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, transform
from vstestbed.features import Ellipse, Moments
from vstestbed.features.moments import fitted_ellipse

BALL = ("xn", "yn", "an")


def ball(centre: Array, radius: float, n: int = 9) -> Array:
    """The outline (..., n, 3) of a ball at centre (..., 3): where the cone of its tangents touches
    it.
    """
    share = 1 - radius**2 / np.sum(centre**2, axis=-1, keepdims=True)
    one = np.cross(centre, [1.0, 0.2, 0])
    two = np.cross(centre, one)
    t = 2 * np.pi * np.arange(n) / n
    one, two = (a / np.linalg.norm(a, axis=-1, keepdims=True) for a in (one, two))
    around = np.cos(t)[:, None] * one[..., None, :] + np.sin(t)[:, None] * two[..., None, :]
    return (share * centre)[..., None, :] + radius * np.sqrt(share)[..., None] * around


def disc(T_camera_target: Array, radius: float = 0.1, n: int = 24) -> Array:
    t = 2 * np.pi * np.arange(n) / n
    return transform(T_camera_target, radius * np.column_stack([np.cos(t), np.sin(t), np.zeros(n)]))


@pytest.mark.parametrize("rows", [Ellipse().rows, BALL])
def test_a_ball_has_the_matrix_of_its_outline(rows):
    # The outline is of other points of the ball in each view; the matrix is that of a plane all the
    # same.
    rng, feature = np.random.default_rng(0), Ellipse(rows=rows)
    centre = np.column_stack([rng.uniform(-0.5, 0.5, (200, 2)), np.ones(200)]) * rng.uniform(
        0.5, 2, (200, 1)
    )
    L = feature.interaction(*seen(ball(centre, 0.12), feature.inputs))
    after = transform(moved(np.broadcast_to(np.eye(4), (200, 4, 4))), centre[:, None])[..., 0, :]
    measured = differences(
        feature.measure(seen(ball(after, 0.12), feature.inputs)[0]),
        feature.measure(seen(ball(centre, 0.12), feature.inputs)[0]),
        np.subtract,
    )
    assert worst(measured, L) < 1e-6
    assert (np.linalg.matrix_rank(L, rtol=1e-9) == 3).all()


def test_the_fit_of_an_exact_ellipse_wherever_its_points_are():
    t = np.array([0.0, 0.2, 0.9, 1.5, 2.0])  # five on a third of it
    cos, sin, (a, b, phi) = np.cos(t), np.sin(t), (0.3, 0.05, 0.7)
    xy = np.stack(
        [
            0.1 + a * cos * np.cos(phi) - b * sin * np.sin(phi),
            -0.2 + a * cos * np.sin(phi) + b * sin * np.cos(phi),
        ],
        axis=-1,
    )
    n = (
        0.25
        * np.array([[np.cos(phi), -np.sin(phi)], [np.sin(phi), np.cos(phi)]])
        @ np.diag([a * a, b * b])
    )
    n = n @ np.array([[np.cos(phi), np.sin(phi)], [-np.sin(phi), np.cos(phi)]])
    np.testing.assert_allclose(
        fitted_ellipse(xy), [0.1, -0.2, n[0, 0], n[0, 1], n[1, 1]], rtol=1e-9
    )
    noisy = ball(np.array([0.1, 0.0, 1.0]), 0.1, 48)
    xy = seen(noisy, ("xy", "depth"))[0] + 1e-4 * np.random.default_rng(0).normal(size=(48, 2))
    np.testing.assert_allclose(
        fitted_ellipse(xy), fitted_ellipse(seen(noisy, ("xy", "depth"))[0]), atol=5e-5
    )


def test_no_ellipse():
    u = np.array([-1.5, -0.5, 0.3, 0.8, 1.4])
    # x^2 - 4 y^2 = 1
    hyperbola = np.column_stack([[-1, 1, 1, -1, 1] * np.cosh(u), 0.5 * np.sinh(u)])
    assert np.isnan(fitted_ellipse(hyperbola)[2:]).all()
    with pytest.raises(ParameterError, match="must have its markers on the outline of an ellipse"):
        Ellipse().check_goal(hyperbola, np.ones(5))
    with pytest.raises(ParameterError, match="at least five markers"):
        Ellipse().measure(hyperbola[:4])


def test_goals_that_tell_fewer_motions_than_rows():
    for p in (ball(np.array([0.2, 0.1, 1.0]), 0.1), disc(Pose(xyz=(0, 0, 1)).T)):
        Ellipse(rows=BALL).check_goal(*seen(p, ("xy", "depth")))
        with pytest.raises(
            ParameterError,
            match=r"a ball, and a disc seen face on, tell three motions; use \[xn, yn, an\]",
        ):
            Ellipse().check_goal(*seen(p, ("xy", "depth")))
    Ellipse().check_goal(*seen(disc(Pose(xyz=(0, 0, 1), rpy_deg=(25, 0, 0)).T), ("xy", "depth")))


def test_rows_of_place_are_those_of_the_region_within():
    xy, depth = seen(disc(Pose(xyz=(0.1, 0.2, 1), rpy_deg=(30, 10, 0)).T, n=400), ("xy", "depth"))
    polygon = Moments(of="region", rows=("xg", "yg", *BALL))
    inner = Ellipse(rows=("xg", "yg", *BALL))
    # 400 corners: 4e-5 of the area are missing
    np.testing.assert_allclose(inner.measure(xy), polygon.measure(xy), rtol=1e-4)
    np.testing.assert_allclose(
        inner.interaction(xy, depth), polygon.interaction(xy, depth), rtol=1e-3, atol=1e-3
    )
