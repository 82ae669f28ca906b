"""The feature of a pair of cameras, and depths by triangulation:
against the pair's own pictures.
"""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.geometry import Pose, adjoint, exp, inverse, lengths, transform
from vstestbed.features import Point, StereoPoint
from vstestbed.features.depth import triangulated

B = 0.12
P = np.array([[0.2, -0.1, 1.3], [-0.3, 0.2, 0.9], [0.05, 0.1, 1.6]])
T_RIGHT_LEFT = Pose(xyz=(-B, 0, 0)).T  # the right camera stands b beside the left one along x


def xyw(p: np.ndarray) -> np.ndarray:
    return np.column_stack([p[:, :2] / p[:, 2:], 1 / p[:, 2]])


def test_the_pair_is_what_both_pictures_show() -> None:
    right = transform(T_RIGHT_LEFT, P)
    s = StereoPoint(form="pair", baseline_m=B).measure(xyw(P)).reshape(-1, 3)
    assert s[:, 0] == pytest.approx(P[:, 0] / P[:, 2])
    assert s[:, 1] == pytest.approx(right[:, 0] / right[:, 2])
    assert s[:, 2] == pytest.approx(right[:, 1] / right[:, 2])
    d = StereoPoint(baseline_m=B).measure(xyw(P)).reshape(-1, 3)[:, 2]
    assert d == pytest.approx(s[:, 0] - s[:, 1])


def test_the_matrix_of_the_pair_is_that_of_points_in_both_cameras() -> None:
    # Rows of x_l and y in the left camera; that of x_r in the right one's frame, with the twist
    # Ad(T_right_left) v.
    L = StereoPoint(form="pair", baseline_m=B).interaction(xyw(P), P[:, 2]).reshape(-1, 3, 6)
    right = transform(T_RIGHT_LEFT, P)
    left_rows = Point().interaction(P[:, :2] / P[:, 2:], P[:, 2]).reshape(-1, 2, 6)
    right_rows = Point().interaction(right[:, :2] / right[:, 2:], right[:, 2]).reshape(
        -1, 2, 6
    ) @ adjoint(T_RIGHT_LEFT)
    assert L[:, 0] == pytest.approx(left_rows[:, 0])
    assert L[:, 1] == pytest.approx(right_rows[:, 0])
    assert L[:, 2] == pytest.approx(left_rows[:, 1])
    assert right_rows[:, 1] == pytest.approx(left_rows[:, 1])  # both see the same y


@pytest.mark.parametrize("form", ["disparity", "pair"])
def test_the_matrix_is_the_derivative(form: str) -> None:
    feature, h = StereoPoint(form=form, baseline_m=B), 1e-6  # type: ignore[arg-type] - one of both words
    L = feature.interaction(xyw(P), P[:, 2])
    for axis, v in enumerate(np.eye(6)):
        ahead, behind = (feature.measure(xyw(transform(exp(-way * h * v), P))) for way in (1, -1))
        assert (ahead - behind) / (2 * h) == pytest.approx(L[:, axis], abs=1e-7)


class TestTriangulated:
    @pytest.mark.parametrize(
        "T",
        [inverse(T_RIGHT_LEFT), Pose(xyz=(0.3, -0.1, 0.05), rpy_deg=(4, -20, 8)).T],
        ids=["parallel", "turned"],
    )
    def test_it_is_the_point_where_exact_rays_meet(self, T: np.ndarray) -> None:
        other = transform(inverse(T), P)
        found = triangulated(P / lengths(P), other / lengths(other), T)
        assert found == pytest.approx(P, abs=1e-12)

    def test_of_a_parallel_pair_the_depth_is_b_over_d(self) -> None:
        right = transform(T_RIGHT_LEFT, P)
        ray = right / lengths(right)
        ray[:, 0] += 1e-4  # a wrong disparity, alike in both formulas
        ray /= lengths(ray)
        d = P[:, 0] / P[:, 2] - ray[:, 0] / ray[:, 2]
        found = triangulated(P / lengths(P), ray, inverse(T_RIGHT_LEFT))
        assert found[:, 2] == pytest.approx(B / d, rel=2e-4)

    def test_nothing_where_rays_are_parallel_meet_behind_or_are_missing(self) -> None:
        ray = np.array([[0, 0, 1.0], [0.1, 0, 1.0], [np.nan] * 3])
        other = np.array([[0, 0, 1.0], [0.3, 0, 1.0], [0, 0, 1.0]])
        found = triangulated(ray / lengths(ray), other / lengths(other), inverse(T_RIGHT_LEFT))
        assert np.isnan(found).all()
