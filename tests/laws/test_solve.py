"""Least squares of one problem, of many, and of many right sides, against the pseudo-inverse."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import linalg

from vstestbed.core.errors import ParameterError
from vstestbed.features import Point
from vstestbed.laws.solve import PINV_RCOND, Solve, least_squares


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


class TestParameters:
    """Cutoff and damping, against scipy."""

    @pytest.mark.parametrize("columns", [4, 6, 8])
    @pytest.mark.parametrize("cutoff", [0.0, 1e-9, 0.03, 0.2, 0.5])
    def test_a_cutoff_is_that_of_scipy(self, cutoff: float, columns: int):
        A, b = (x[:, :columns] for x in problems(100))
        x = Solve(cutoff=cutoff).least_squares(A, b)
        # gelsd: singular values under cond times the largest count as zero.
        expected, ranks = zip(*(linalg.lstsq(a, e, cond=cutoff)[::2] for a, e in zip(A, b, strict=True)), strict=True)
        assert cutoff < 0.03 or len(set(ranks)) > 1
        np.testing.assert_allclose(x, expected, rtol=1e-9, atol=1e-9 * np.abs(x).max())

    @pytest.mark.parametrize("damping", [1e-3, 0.1, 3.0])
    def test_damping_adds_its_share_of_the_motion_to_what_is_minimised(self, damping: float):
        A, b = problems(50)
        x = Solve(damping=damping).least_squares(A, b)
        for a, e, found in zip(A, b, x, strict=True):
            # |A x - b|^2 + damping^2 |x|^2 as one least-squares problem with six more rows.
            expected = linalg.lstsq(np.vstack([a, damping * np.eye(6)]), np.concatenate([e, np.zeros(6)]))[0]
            np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10 * np.abs(x).max())

    def test_both_together_by_hand(self):
        # Singular values 10, 1 and .1: the last is left out by .05, the others have s/(s^2 + .25).
        A, b = np.diag([10.0, 1.0, 0.1]), np.array([3.0, 3.0, 3.0])
        x = Solve(cutoff=0.05, damping=0.5).least_squares(A, b)
        np.testing.assert_allclose(x, [3 * 10 / 100.25, 3 / 1.25, 0], rtol=1e-14)

    @pytest.mark.parametrize("solve", [Solve(cutoff=0.1), Solve(damping=0.1), Solve(cutoff=0.05, damping=0.2), Solve(cutoff=0.0)], ids=repr)
    def test_many_are_exactly_as_each_alone(self, solve: Solve):
        A, b = problems(40)
        np.testing.assert_array_equal(solve.least_squares(A, b), [solve.least_squares(a, e) for a, e in zip(A, b, strict=True)])
        # One matrix with many right sides, and leading axes.
        np.testing.assert_array_equal(solve.least_squares(A[0], b), [solve.least_squares(A[0], e) for e in b])
        assert solve.least_squares(A.reshape(2, 20, 8, 6), b.reshape(2, 20, 8)).shape == (2, 20, 6)
        assert solve.least_squares(A[:0], b[:0]).shape == (0, 6)

    def test_the_default_is_the_plain_solution_bit_for_bit(self):
        A, b = problems(10)
        assert Solve() == Solve(cutoff=PINV_RCOND, damping=0)
        np.testing.assert_array_equal(Solve().least_squares(A, b), least_squares(A, b))
        np.testing.assert_array_equal(Solve().least_squares(A[0], b[0]), least_squares(A[0], b[0]))
        assert not np.array_equal(Solve(cutoff=2e-6).least_squares(A, b), least_squares(A, b))  # another way of the same

    def test_without_any_equation_nothing_moves(self):
        assert not Solve(cutoff=0.1).least_squares(np.zeros((4, 6)), np.ones(4)).any()
        assert not Solve(cutoff=0.0, damping=0.1).least_squares(np.zeros((4, 6)), np.ones(4)).any()

    @pytest.mark.parametrize(("cutoff", "free"), [(0.0, 1), (1e-6, 1), (1e-3, 2), (0.5, 3)])
    def test_the_null_space_is_what_the_cutoff_leaves_out(self, cutoff: float, free: int):
        A = np.diag([1.0, 0.3, 1e-4, 0.0])
        N = Solve(cutoff=cutoff).null_space(A)
        assert N.shape == (4, free)
        np.testing.assert_allclose(np.abs(N.T), np.eye(4)[::-1][:free][::-1], atol=1e-15)
        assert Solve().null_space(np.zeros((0, 4))).shape == (4, 4)

    @pytest.mark.parametrize("wrong", [{"cutoff": -0.1}, {"cutoff": 1.0}, {"damping": -1e-3}], ids=str)
    def test_what_makes_no_sense_is_refused(self, wrong: dict[str, float]):
        with pytest.raises(ParameterError, match=next(iter(wrong))):
            Solve(**wrong)
