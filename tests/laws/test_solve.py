"""Least squares of one problem, of many, and of many right sides, against the pseudo-inverse."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.features import Point
from vstestbed.laws.solve import PINV_RCOND, least_squares


def problems(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Interaction matrices of four points in views of all kinds, and errors."""
    rng = np.random.default_rng(seed)
    L = Point().interaction(rng.uniform(-1, 1, (n, 4, 2)), rng.uniform(0.3, 5, (n, 4)))
    return L, rng.normal(size=(n, 8))


def test_many_are_as_each_alone():
    A, b = problems(300)
    expected = np.array([np.linalg.pinv(a, PINV_RCOND) @ e for a, e in zip(A, b, strict=True)])
    # Normal equations square the condition, here up to 1e3 or so: six digits of sixteen.
    np.testing.assert_allclose(least_squares(A, b), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose([least_squares(a, e) for a, e in zip(A, b, strict=True)], expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("rows", [2, 4, 5])
def test_with_fewer_equations_than_unknowns_many_get_the_shortest(rows: int):
    A, b = problems(100)
    A, b = A[:, :rows], b[:, :rows]
    expected = np.array([np.linalg.pinv(a, PINV_RCOND) @ e for a, e in zip(A, b, strict=True)])
    # Normal equations square the condition, as above.
    np.testing.assert_allclose(least_squares(A, b), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    A[:50, 1], b[:50, 1] = A[:50, 0], b[:50, 0]  # one marker that says the same twice
    expected = np.array([np.linalg.pinv(a, PINV_RCOND) @ e for a, e in zip(A, b, strict=True)])
    np.testing.assert_allclose(least_squares(A, b), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


def test_one_matrix_with_many_right_sides():
    A, b = problems(50)
    np.testing.assert_allclose(least_squares(A[0], b), b @ np.linalg.pinv(A[0]).T, rtol=1e-9, atol=1e-12)


def test_leading_axes_are_kept():
    A, b = problems(12)
    assert least_squares(A.reshape(3, 4, 8, 6), b.reshape(3, 4, 8)).shape == (3, 4, 6)


def test_a_direction_that_nothing_tells_is_not_moved_in():
    A, b = problems(20)
    A[:, :, 5] = 0.0
    A[10:, :, 5] = 1e-9 * A[10:, :, 4]  # far below the cut-off
    x = least_squares(A, b)
    assert (x[:, 5] == 0).all()
    np.testing.assert_allclose(x[:, :5], least_squares(A[..., :5], b), rtol=1e-6, atol=1e-9)


def test_rounding_alone_orders_nothing():
    A, b = problems(20)
    b -= np.einsum("mij,mj->mi", A, least_squares(A, b))  # what no motion would mend
    b -= np.einsum("mij,mj->mi", A, least_squares(A, b))
    x = least_squares(A, b)
    size = np.linalg.norm(A, axis=(1, 2)) * np.linalg.norm(b, axis=1)
    gradient = np.linalg.norm(np.einsum("mij,mi->mj", A, b), axis=1)
    assert (x[gradient < 1e-12 * size] == 0).all() and (gradient < 1e-12 * size).any()


@pytest.mark.parametrize("shape", [(0, 8, 6)])
def test_no_problem_has_no_answer(shape: tuple[int, ...]):
    assert least_squares(np.zeros(shape), np.zeros(shape[:2])).shape == (0, 6)
