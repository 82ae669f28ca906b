"""The polygon: its numbers, the sign of its angle, no jump where another segment becomes the
longest.
"""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import exp, inverse, transform
from vstestbed.features import Polygon
from vstestbed.features.polygon import angle_error, segments, size, size_error

SQUARE = 0.25 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
GOAL = np.eye(4)
GOAL[2, 3] = 1.0
"""T_camera_target: the square faces the camera at 1 m."""


def picture(T_camera_target: np.ndarray, points: np.ndarray = SQUARE) -> np.ndarray:
    p = transform(T_camera_target, points)
    return p[..., :2] / p[..., 2:]


def error(T_camera_target: np.ndarray, points: np.ndarray = SQUARE) -> np.ndarray:
    """e (..., 2) of a view against the goal view."""
    polygon = Polygon()
    return polygon.error(
        polygon.measure(picture(T_camera_target, points)), polygon.measure(picture(GOAL, points))
    )


def rolled(*angles: float) -> np.ndarray:
    """Camera turned from the goal about its optical axis (n, 4, 4)."""
    return inverse(exp(np.outer(angles, np.eye(6)[5]))) @ GOAL


def swayed(n: int) -> np.ndarray:
    """n views on a smooth way: the target 0.2 m aside, tilted by 50 degrees about an axis that
    turns from one diagonal to the other.
    """
    t = np.linspace(np.pi / 4, 3 * np.pi / 4, n)
    tilt = np.deg2rad(50) * np.stack([np.cos(t), np.sin(t), 0 * t], axis=-1)
    T = exp(np.hstack([np.zeros((n, 3)), tilt]))
    T[:, :3, 3] = [0.2, 0.1, 1]
    return T


def test_size_is_the_root_of_the_area():
    assert size(np.array([[0, 0], [0.3, 0], [0.3, 0.2], [0, 0.2]])) == pytest.approx(np.sqrt(0.06))
    # either way round
    assert size(np.array([[0, 0], [0, 0.2], [0.3, 0]])) == pytest.approx(np.sqrt(0.03))
    assert size(np.array([[0.1, 0.1], [0.3, -0.2]])) == 0


def test_size_errors_are_positive_where_the_camera_is_too_close():
    sigma, wanted = np.array([0.6, 0.3]), np.array([0.3, 0.6])
    np.testing.assert_allclose(size_error(sigma, wanted), [0.3, -0.3])
    np.testing.assert_allclose(size_error(sigma, wanted, "ratio"), [1, -0.5])
    np.testing.assert_allclose(size_error(sigma, wanted, "log"), [np.log(2), -np.log(2)])
    near = GOAL.copy()
    near[2, 3] = 0.5
    assert size_error(size(picture(near)), size(picture(GOAL)), "log") == pytest.approx(np.log(2))
    with pytest.raises(ParameterError, match="span an area"):
        size_error(np.array([0.3]), np.array([0.0]), "log")


def test_edge_angle_goes_against_the_turn_of_the_camera():
    # The printed rule w_z = gain (theta* - theta) has this sign wrong: as the camera turns, the
    # picture turns back.
    np.testing.assert_allclose(
        error(rolled(0.1, -0.3, 2.0, -3.0))[:, 1], [-0.1, 0.3, -2.0, 3.0], rtol=1e-12
    )
    L = Polygon().interaction(picture(GOAL), np.ones(4))
    assert L[1, 5] == pytest.approx(-1)
    w_z, printed = -0.5 * error(rolled(0.3))[0, 1] / L[1, 5], -0.5 * error(rolled(0.3))[0, 1]
    assert w_z < 0 < printed  # turned by +0.3, the camera has to turn back


def test_a_half_turn_is_no_error_for_an_angle_of_0_to_pi():
    # Section 16.1 prints theta in [0, pi) for a segment that has a direction.
    view, goal = picture(rolled(np.pi)[0]), picture(GOAL)
    d, d_star = view[2] - view[0], goal[2] - goal[0]  # a diagonal of the square
    printed = [np.arctan2(one[1], one[0]) % np.pi for one in (d, d_star)]
    assert printed[0] == pytest.approx(printed[1])
    assert abs(error(rolled(np.pi)[0])[1]) == pytest.approx(np.pi)


@pytest.mark.parametrize("sign", [1, -1])
def test_turning_by_the_edge_angle(sign):
    T = inverse(rolled(2.5)[0])
    for _ in range(100):
        e = error(inverse(T))[1]
        # w_z = gain wrap(theta - theta*), as L = -1 has it, or as printed
        T = T @ exp(sign * 0.1 * e * np.eye(6)[5])
    left = abs(error(inverse(T))[1])
    # 2.5 * 0.9^100 = 7e-5; the printed sign settles at the half turn, the farthest there is.
    assert left < 1e-4 if sign > 0 else left > 3


def test_no_jump_where_another_segment_becomes_the_longest():
    views = swayed(2001)
    d, d_star = segments(picture(views)), segments(picture(GOAL))
    lead = np.hypot(d[..., 0], d[..., 1]).argmax(axis=-1)
    assert len(set(lead.tolist())) > 1
    now = np.take_along_axis(d, lead[:, None, None], axis=1)[:, 0]
    bearing = np.arctan2(now[:, 1], now[:, 0])
    # the angle of whichever leads jumps from one diagonal to the other
    assert np.abs(np.diff(bearing)).max() > 1
    own = d_star[lead]
    hard = np.arctan2(own[:, 0] * now[:, 1] - own[:, 1] * now[:, 0], np.sum(own * now, axis=-1))
    # measured from its own goal still by the perspective of both
    assert np.abs(np.diff(hard)).max() > 0.02
    e = error(views)
    # Steps of 1/2000 of the way: the error goes on by as little, and by half at half the step.
    assert np.abs(np.diff(e, axis=0)).max() < 2e-3
    assert np.abs(np.diff(error(swayed(4001)), axis=0)).max() == pytest.approx(
        0.5 * np.abs(np.diff(e, axis=0)).max(), rel=0.02
    )


def test_interaction_has_no_jump_there_either():
    views = swayed(2001)
    depth = transform(views, SQUARE)[..., 2]
    L = Polygon().interaction(picture(views), depth)
    finer = swayed(4001)
    L_finer = Polygon().interaction(picture(finer), transform(finer, SQUARE)[..., 2])
    assert np.abs(np.diff(L_finer, axis=0)).max() == pytest.approx(
        0.5 * np.abs(np.diff(L, axis=0)).max(), rel=0.02
    )


def test_a_segment_that_leads_by_a_fifth_is_alone():
    d_star = np.array([[1.0, 0], [0, 0.79], [0.5, 0.5]])
    d = np.array([[np.cos(0.2), np.sin(0.2)], [0.79, 0], [-0.5, 0.5]])
    assert angle_error(d, d_star) == pytest.approx(0.2, abs=1e-15)


def test_half_turn_and_beyond():
    e = error(rolled(np.pi - 1e-3, np.pi + 1e-3))[:, 1]
    np.testing.assert_allclose(e, [1e-3 - np.pi, np.pi - 1e-3], rtol=1e-10)
    assert abs(error(rolled(np.pi))[0, 1]) == pytest.approx(np.pi, rel=1e-12)


def test_markers_that_span_nothing():
    L = Polygon().interaction(np.zeros((4, 2)), np.ones(4))
    np.testing.assert_array_equal(L, np.zeros((2, 6)))
    np.testing.assert_array_equal(
        Polygon().error(Polygon().measure(np.zeros((4, 2))), Polygon().measure(picture(GOAL))),
        [-0.5, 0],
    )
    # on one line: no area
    row = Polygon().interaction(np.array([[0.1, 0], [0.2, 0], [0.3, 0]]), np.ones(3))
    np.testing.assert_array_equal(row[0], 0)
    with pytest.raises(ParameterError, match="at least 2"):
        Polygon().interaction(np.zeros((1, 2)), np.ones(1))


def test_batches_are_single_ones_stacked():
    rng = np.random.default_rng(1)
    xy, depth = rng.normal(size=(2, 3, 5, 2)), rng.uniform(0.5, 2, (2, 3, 5))
    L, s = Polygon().interaction(xy, depth), Polygon().measure(xy)
    e = Polygon().error(s, s[0, 0])
    assert (L.shape, s.shape, e.shape) == ((2, 3, 2, 6), (2, 3, 21), (2, 3, 2))
    for i in np.ndindex(2, 3):
        # Sums over pairs may be taken in another order.
        np.testing.assert_allclose(
            L[i], Polygon().interaction(xy[i], depth[i]), rtol=1e-12, atol=1e-14
        )
        np.testing.assert_allclose(e[i], Polygon().error(s[i], s[0, 0]), rtol=1e-12, atol=1e-14)
