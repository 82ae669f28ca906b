"""Quadratic programs of a law: bounds that never give way, groups of inequalities that give way in a stated order, and their solver."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from vstestbed.core.geometry import Array, all_finite

SOLVED = (1, 2)
"""Exit codes of the solver: solved, and solved with soft constraints violated."""
INFEASIBLE = -1
SOFT = 8
"""The solver's mark of a constraint that may be violated, at a cost."""
VIOLATION_COST = 1e6
"""Cost of a squared violation of a soft constraint, in units of the mean curvature of the objective."""
ITERATIONS = 500
"""Most iterations of one program. A count and not a time: the same run gives the same commands on every machine."""
REGULARISATION = 1e-9
"""Added to the diagonal of the objective as a share of its mean: of many solutions the smallest is taken."""


@dataclass(frozen=True, slots=True)
class Group:
    """Inequalities low <= A x that give way together: their word, A (m, n) and low (m,)."""

    word: str
    A: Array
    low: Array


@dataclass(frozen=True, slots=True)
class Solution:
    """What a program gave.

    Attributes:
        x: (n,); None where it could not be solved.
        gave_way: words of the groups that had to, the softest first.
        bound: whether a bound or an inequality is met with equality.
        failure: the solver's exit code in words; "" where it solved.
    """

    x: Array | None
    gave_way: tuple[str, ...] = ()
    bound: bool = False
    failure: str = ""


def minimise(A: Array, b: Array, low: Array, high: Array, groups: tuple[Group, ...]) -> Solution:
    """The x (n,) that minimises |A x - b|^2 with low <= x <= high and the inequalities of the groups.

    Where these contradict each other, groups give way in their order, the first one first: its inequalities are violated as little as the
    others allow. The bounds never do. The dual active-set method starts at the unconstrained minimum; most frames need no step from there.

    Args:
        A, b: objective (m, n) and (m,). low, high: bounds (n,), low <= high.
        groups: the softest first.

    References: Arnström, Bemporad & Axehill 2022, doi:10.1109/TAC.2022.3176430 (the solver, DAQP); for the order in which constraints give
    way Escande, Mansard & Wieber 2014, doi:10.1177/0278364914521306.
    """
    if not _finite(A, b, groups):
        return Solution(None, failure="the quadratic program was not solved: it has numbers that are not finite")
    H = A.T @ A
    mean = float(np.trace(H)) / len(H)
    if mean <= 0:
        return Solution(np.clip(np.zeros(len(H)), low, high))
    H, f = H / mean, -(A.T @ b) / mean
    H[np.diag_indices_from(H)] += REGULARISATION
    groups = _given(groups)
    rows, floor = _normalised(groups, len(H))
    upper, lower = np.concatenate([high, np.full(len(rows), np.inf)]), np.concatenate([low, floor])
    firm = len(low)
    sense, code = np.zeros(len(upper), dtype=np.int32), INFEASIBLE
    for level in range(len(groups) + 1):
        if level:
            sense[firm : firm + len(groups[level - 1].A)] = SOFT
            firm += len(groups[level - 1].A)
        x, _, code, info = _daqp()(H, f, rows, upper, lower, sense, iter_limit=ITERATIONS, rho_soft=1 / VIOLATION_COST)
        if code in SOLVED:
            gave_way = tuple(group.word for group in groups[:level] if _violated(group, x))
            return Solution(np.clip(x, low, high), gave_way, bool(np.any(info["lam"])))
        if code != INFEASIBLE:
            break
    return Solution(None, failure=f"the quadratic program was not solved: {_named(code)}")


def _finite(A: Array, b: Array, groups: tuple[Group, ...]) -> bool:
    return all(all_finite(part) for part in (A, b, *(part for group in groups for part in (group.A, group.low))))


def _given(groups: tuple[Group, ...]) -> tuple[Group, ...]:
    return tuple(group for group in groups if len(group.A))


def _named(code: int) -> str:
    return "its bounds contradict each other" if code == INFEASIBLE else f"the solver stopped with code {code}"


def _normalised(groups: tuple[Group, ...], n: int) -> tuple[Array, Array]:
    """All inequalities (m, n), (m,), each with a row of length 1; a row of zeros stays."""
    rows = np.concatenate([np.zeros((0, n)), *(group.A for group in groups)])
    low = np.concatenate([np.zeros(0), *(group.low for group in groups)])
    size = np.linalg.norm(rows, axis=1)
    size[size < np.finfo(float).tiny] = 1.0
    return rows / size[:, None], low / size


def _violated(group: Group, x: Array) -> bool:
    """Whether x breaks an inequality of the group by more than rounding."""
    slack = group.A @ x - group.low
    return bool((slack < -1e-6 * np.maximum(np.linalg.norm(group.A, axis=1), 1e-12)).any())


def load_solver() -> None:
    """Import the solver now, not in the first frame."""
    _daqp()


@cache
def _daqp() -> Any:
    import daqp  # here: checking and listing scenarios need not pay for it

    return daqp.solve
