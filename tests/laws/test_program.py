"""Quadratic programs against SciPy and the conditions of optimality; what gives way where
constraints contradict each other.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import lsq_linear, minimize

from vstestbed.laws import constraints
from vstestbed.laws.constraints import Group, minimise

ENDLESS = np.full(6, np.inf)


def problem(seed: int, rows: int = 8) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(rows, 6)), 3 * rng.normal(size=rows)


def test_without_constraints_it_is_least_squares() -> None:
    A, b = problem(0)
    found = minimise(A, b, -ENDLESS, ENDLESS, ())
    assert found.x is not None and not found.bound
    np.testing.assert_allclose(found.x, np.linalg.lstsq(A, b, rcond=None)[0], atol=1e-6)


@pytest.mark.parametrize("seed", range(8))
def test_bounds_as_scipy_has_them(seed: int) -> None:
    A, b = problem(seed)
    low, high = -np.abs(b[:6]) - 0.1, np.abs(b[2:]) / 3 + 0.1
    found = minimise(A, b, low, high, ())
    np.testing.assert_allclose(found.x, lsq_linear(A, b, (low, high), tol=1e-14).x, atol=1e-5)


@pytest.mark.parametrize("seed", range(4))
def test_inequalities_as_scipy_has_them(seed: int) -> None:
    A, b = problem(seed)
    rng = np.random.default_rng(100 + seed)
    C, low = 50 * rng.normal(size=(5, 6)), rng.normal(size=5)
    found = minimise(
        A, b, -ENDLESS, ENDLESS, (Group("border", C[:2], low[:2]), Group("twist", C[2:], low[2:]))
    )
    slsqp = minimize(
        lambda x: ((A @ x - b) ** 2).sum(),
        np.zeros(6),
        jac=lambda x: 2 * A.T @ (A @ x - b),
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda x: C @ x - low, "jac": lambda x: C},
        options={"ftol": 1e-14, "maxiter": 500},
    )
    assert found.x is not None and found.gave_way == ()
    np.testing.assert_allclose(found.x, slsqp.x, atol=1e-4)
    assert (C @ found.x >= low - 1e-4).all()


def test_fewer_rows_than_unknowns_give_the_smallest() -> None:
    A, b = problem(3, rows=3)
    np.testing.assert_allclose(
        minimise(A, b, -ENDLESS, ENDLESS, ()).x, np.linalg.pinv(A) @ b, atol=1e-5
    )


def test_groups_give_way_in_their_order_and_as_little_as_they_must() -> None:
    A, b, one = np.eye(6), np.zeros(6), np.eye(6)[:1]
    # x_0 >= 3 and x_0 <= 1
    soft, firm = Group("border", one, np.array([3.0])), Group("twist", -one, np.array([-1.0]))
    found = minimise(A, b, -ENDLESS, ENDLESS, (soft, firm))
    assert found.gave_way == ("border",) and found.x is not None
    assert found.x[0] == pytest.approx(1.0, abs=1e-4)  # as near to 3 as the other allows
    other = minimise(A, b, -ENDLESS, ENDLESS, (firm, soft))
    assert (
        other.gave_way == ("twist",)
        and other.x is not None
        and other.x[0] == pytest.approx(3.0, abs=1e-4)
    )


def test_bounds_never_give_way() -> None:
    one = np.eye(6)[:1]
    high = np.full(6, 0.5)
    both = Group("border", one, np.array([3.0])), Group("twist", one, np.array([2.0]))
    found = minimise(np.eye(6), np.zeros(6), -high, high, both)
    assert (
        found.gave_way == ("border", "twist")
        and found.x is not None
        and found.x[0] == pytest.approx(0.5)
    )
    assert (
        minimise(np.eye(6), np.zeros(6), high, -high, ()).failure
        == "the quadratic program was not solved: its bounds contradict each other"
    )


def test_a_solver_that_gives_up_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constraints, "ITERATIONS", 1)
    rng = np.random.default_rng(0)
    groups = (Group("border", rng.normal(size=(40, 6)), np.ones(40) * 0.1),)
    found = minimise(*problem(1), -ENDLESS, ENDLESS, groups)
    assert (
        found.x is None
        and found.failure == "the quadratic program was not solved: the solver stopped with code -4"
    )


def test_an_objective_of_zeros_gives_rest() -> None:
    np.testing.assert_array_equal(
        minimise(np.zeros((2, 6)), np.zeros(2), -ENDLESS, ENDLESS, ()).x, np.zeros(6)
    )
