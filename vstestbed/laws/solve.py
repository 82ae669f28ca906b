"""pinv(A) b, the one way in which laws turn feature errors into motion."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from vstestbed.geometry import Array

PINV_RCOND = 1e-6
"""Cut-off of the pseudo-inverse: singular values under about this share of the largest count as zero:
a direction that pixels do not tell is not moved in."""
BLOCK = 32
"""Columns that LAPACK treats at a time; what it needs for a handful."""


def least_squares(A: Array, b: Array) -> Array:
    """The shortest x (n,) that minimises |A x - b|, for A (m, n) and b (m,).

    By LAPACK's complete orthogonal factorisation, which takes a third of the time of a singular value decomposition; the
    rank is told from the factors' estimated condition.

    Reference: Golub & Van Loan 2013, Matrix Computations, section 5.5.
    """
    m, n = A.shape
    if not (m and n):
        return np.zeros(n)
    wide = np.zeros((max(m, n), 1))
    wide[:m, 0] = b
    _, x, *_ = _gelsy()(A, wide, np.zeros((n, 1), np.int32), PINV_RCOND, BLOCK * (n + 1))
    return x[:n, 0]


@cache
def _gelsy() -> Any:
    from scipy.linalg import get_lapack_funcs  # .2 s that listing and checking scenarios can do without

    return get_lapack_funcs("gelsy", dtype=np.float64)
