"""pinv(A) b, the one way in which laws turn feature errors into motion."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array

PINV_RCOND = 1e-6
"""Cut-off of the pseudo-inverse: singular values under about this share of the largest count as zero:
a direction that pixels do not tell is not moved in."""
BLOCK = 32
"""Columns that LAPACK treats at a time; what it needs for a handful."""
DEPENDENT = PINV_RCOND**2
"""Of many problems at once: a column of whose square less than this share of the mean is left beside the columns before it says
nothing new, and its x is 0. That is the cut-off, squared as the normal equations are."""
STILL = 1e-12
"""Of many: A^T b under this share of |A| |b| is zero but for rounding, and so is x."""


def least_squares(A: Array, b: Array) -> Array:
    """The shortest x (..., n) that minimises |A x - b|, for A (..., m, n) and b (..., m).

    One problem by LAPACK's complete orthogonal factorisation, which takes a third of the time of a singular value
    decomposition; the rank is told from the factors' estimated condition. Many by their normal equations, and many b of
    one A (m, n) by its pseudo-inverse. (Of many, an A whose rank is under both m and n gives a least x among those of some columns.)

    Reference: Golub & Van Loan 2013, Matrix Computations, sections 5.5, 5.6 and 4.2.5 (Cholesky).
    """
    if A.ndim == 2 and b.ndim > 1:
        return b @ np.linalg.pinv(A, PINV_RCOND).T
    if A.ndim > 2:
        return _many(A.reshape(-1, *A.shape[-2:]), b.reshape(-1, b.shape[-1])).reshape(*A.shape[:-2], A.shape[-1])
    m, n = A.shape
    if not (m and n):
        return np.zeros(n)
    wide = np.zeros((max(m, n), 1))
    wide[:m, 0] = b
    _, x, *_ = _gelsy()(A, wide, np.zeros((n, 1), np.int32), PINV_RCOND, BLOCK * (n + 1))
    return x[:n, 0]


def _many(A: Array, b: Array) -> Array:
    """Least squares of A (M, m, n) and b (M, m), each operation over all M; with fewer equations than unknowns the shortest x.

    A^T A x = A^T b, or A A^T y = b with x = A^T y, by Cholesky's C C^T, elements in loops and problems in arrays: LAPACK
    would be called M times.
    """
    right = np.ascontiguousarray(b.T)
    if A.shape[1] < A.shape[2]:
        rows = np.ascontiguousarray(A.transpose(1, 2, 0))
        return np.asarray(np.einsum("mik,mk->ki", rows, _cholesky(rows, right.copy(), np.zeros(len(b)))))
    columns = np.ascontiguousarray(A.transpose(2, 1, 0))
    x = np.einsum("imk,mk->ik", columns, right)
    return _cholesky(columns, x, STILL**2 * _dot(right, right)).T


def _cholesky(columns: Array, x: Array, still2: Array) -> Array:
    """What solves C^T C x = the given x (n, M), which it overwrites: the columns (n, m, M) are C's.

    Right sides whose square is under still2 (M,) times that of C count as zero.
    """
    n = len(columns)
    G = [[_dot(columns[i], columns[j]) for j in range(i + 1)] for i in range(n)]
    size2 = np.sum([G[i][i] for i in range(n)], axis=0)
    x[:, _dot(x, x) < still2 * size2] = 0.0
    least = np.maximum(DEPENDENT / n * size2, np.finfo(float).tiny)
    for i in range(n):
        for j in range(i):
            for k in range(j):
                G[i][j] -= G[i][k] * G[j][k]
            G[i][j] *= G[j][j]
            x[i] -= G[i][j] * x[j]
        pivot = G[i][i].copy()
        for k in range(i):
            pivot -= G[i][k] * G[i][k]
        G[i][i] = np.where(pivot > least, 1 / np.sqrt(np.maximum(pivot, least)), 0.0)
        x[i] *= G[i][i]
    for i in reversed(range(n)):
        for k in range(i + 1, n):
            x[i] -= G[k][i] * x[k]
        x[i] *= G[i][i]
    return x


def _dot(a: Array, b: Array) -> NDArray[np.float64]:
    """Products of the columns of a and b (m, M), shape (M,)."""
    return np.einsum("mk,mk->k", a, b)


def null_space(A: Array) -> Array:
    """Orthonormal columns (n, k) that A (m, n) takes to nothing: those that `least_squares` leaves alone."""
    _, s, Vt = np.linalg.svd(A)
    rank = int(np.count_nonzero(s > PINV_RCOND * s[0])) if len(s) else 0
    return np.asarray(Vt[rank:].T, dtype=float)


@cache
def _gelsy() -> Any:
    from scipy.linalg import get_lapack_funcs  # .2 s that listing and checking scenarios can do without

    return get_lapack_funcs("gelsy", dtype=np.float64)
