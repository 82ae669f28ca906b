"""The point feature: golden matrices, differences over real motions, shapes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import exp, inverse, transform
from vstestbed.features import Point

GOLDEN = json.loads(
    (Path(__file__).parents[1] / "golden" / "interaction_matrices.json").read_text()
)["point"]["cases"]


@pytest.mark.parametrize("case", GOLDEN)
def test_golden_matrices(case):
    x, y, depth = case["in"]
    L = Point().interaction(np.array([[x, y]]), np.array([depth]))
    # The golden file's own tolerance, 15 digits printed.
    np.testing.assert_allclose(L, case["L"], rtol=1e-10, atol=1e-10)
    np.testing.assert_array_equal(Point().measure(np.array([[x, y]])), case["s"])


def test_matrix_is_the_derivative_over_motions_of_the_camera():
    rng, h = np.random.default_rng(0), 1e-6

    def seen_after(xi: np.ndarray, p: np.ndarray) -> np.ndarray:
        q = transform(inverse(exp(xi)), p)  # the camera moves by exp(xi), the points stand still
        return Point().measure(q[:, :2] / q[:, 2:])

    for _ in range(20):
        p = np.column_stack([rng.uniform(-0.5, 0.5, (4, 2)), rng.uniform(0.5, 3, 4)])
        L = Point().interaction(p[:, :2] / p[:, 2:], p[:, 2])
        steps = h * np.eye(6)
        differences = np.column_stack(
            [(seen_after(d, p) - seen_after(-d, p)) / (2 * h) for d in steps]
        )
        # Central differences: truncation h^2 = 1e-12 times third derivatives of up to 1e2, rounding
        # 1e-16 / h = 1e-10.
        np.testing.assert_allclose(differences, L, atol=2e-9)


def test_batches_are_single_ones_stacked():
    rng = np.random.default_rng(1)
    xy, depth = rng.normal(size=(2, 3, 4, 2)), rng.uniform(0.5, 2, (2, 3, 4))
    L, s = Point().interaction(xy, depth), Point().measure(xy)
    assert (L.shape, s.shape) == ((2, 3, 8, 6), (2, 3, 8))
    for i in np.ndindex(2, 3):
        np.testing.assert_array_equal(L[i], Point().interaction(xy[i], depth[i]))
        np.testing.assert_array_equal(s[i], xy[i].ravel())


def test_error_is_now_minus_wanted():
    np.testing.assert_array_equal(Point().error(np.array([1.0, 2]), np.array([0.5, 3])), [0.5, -1])


def test_shapes_that_do_not_belong_together():
    for xy, depth in (
        ((4, 3), (4,)),  # not two coordinates
        ((4, 2), (3,)),  # not one depth for each point
        ((4, 2), ()),  # one depth for all must be written out
        ((2, 4, 2), (4,)),  # a batch of points with one set of depths
    ):
        with pytest.raises(ParameterError, match=r"\(\.\.\., N\)"):
            Point().interaction(np.zeros(xy), np.ones(depth))
