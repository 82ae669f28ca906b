"""pinv(A) b: least squares for one problem and for many, used by all laws to turn feature errors
into motion; `Solve`, its parameters.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import sys
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le, Lt
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec

PINV_RCOND = 1e-6
"""Cut-off of the pseudo-inverse: singular values under about this share of the largest count as
zero, so that the camera does not move in directions that the features do not observe.
"""


def units_of(goal: Any, basis: Array | None) -> Array | float:
    """Units (n,) of velocities along a basis (6, n), by default the camera's six: 1 for turns,
    `goal.unit_m` for what turns nothing.
    """
    if goal.unit_m == 1.0:
        return 1.0
    return np.where((np.eye(6) if basis is None else basis)[3:].any(axis=0), 1.0, goal.unit_m)


def least_squares(A: Array, b: Array) -> Array:
    """The x (..., n) of least norm that minimises |A x - b|, for A (..., m, n) and b (..., m).

    One problem is solved by LAPACK's complete orthogonal factorisation (gelsy), which takes a third
    of the time of a singular value decomposition; the rank follows from the estimated condition of
    the factors. Many problems are solved by their normal equations, and many b of one A (m, n) by
    its pseudo-inverse. (Among many, where the rank of A is under both m and n, x solves the problem
    with the dependent columns left out, and is not the one of least norm.)

    Reference: Golub & Van Loan 2013, Matrix Computations, sections 5.5, 5.6 and 4.2.5 (Cholesky).
    """
    if A.ndim == 2 and b.ndim > 1:
        return b @ np.linalg.pinv(A, PINV_RCOND).T
    if A.ndim > 2:
        x = _many(A.reshape(-1, *A.shape[-2:]), b.reshape(-1, b.shape[-1]))
        return x.reshape(*A.shape[:-2], A.shape[-1])
    m, n = A.shape
    if not (m and n):
        return np.zeros(n)  # LAPACK refuses empty matrices
    # gelsy takes b of m rows and returns x of n rows in one array
    right = b if m >= n else np.concatenate([b, np.zeros(n - m)])
    workspace = 32 * (n + 1)  # for blocks of 32 columns: ample for the six of a law
    _, x, *_ = load_lapack()(A, right[:, None], np.zeros((n, 1), np.int32), PINV_RCOND, workspace)
    return x[:n, 0]


def _many(A: Array, b: Array) -> Array:
    """Least squares of A (M, m, n) and b (M, m), vectorised over M; the x of least norm for fewer
    equations than unknowns.

    A^T A x = A^T b, or A A^T y = b with x = A^T y, by Cholesky factorisation with loops over the
    few elements and arrays over the problems: LAPACK would be called M times.
    """
    right = np.ascontiguousarray(b.T)
    if A.shape[1] < A.shape[2]:  # fewer equations than unknowns: A^T A would be singular
        rows = np.ascontiguousarray(A.transpose(1, 2, 0))
        y = _cholesky(rows, right.copy(), np.zeros(len(b)))
        return np.asarray(np.einsum("mik,mk->ki", rows, y))
    # the problems last, where numpy's loops run
    columns = np.ascontiguousarray(A.transpose(2, 1, 0))
    x = np.einsum("imk,mk->ik", columns, right)
    # A^T b under this share of |A| |b| is rounding error of zero
    return _cholesky(columns, x, 1e-12**2 * _dot(right, right)).T


def _cholesky(columns: Array, x: Array, still2: Array) -> Array:
    """The solution of C^T C x = b, given b (n, M) as `x`, which is overwritten; `columns` (n, m, M)
    are those of C.

    Right sides whose square is under still2 (M,) times that of C count as zero.
    """
    n = len(columns)
    # Once factorised, G[i][i] holds the reciprocal of the pivot, so that the substitutions
    # multiply; 0 for a dependent column.
    G = [[_dot(columns[i], columns[j]) for j in range(i + 1)] for i in range(n)]
    size2 = np.sum([G[i][i] for i in range(n)], axis=0)
    x[:, _dot(x, x) < still2 * size2] = 0.0
    # A pivot under this share of the mean diagonal marks a column that depends on those before it:
    # normal equations square singular values.
    least = np.maximum(PINV_RCOND**2 / n * size2, np.finfo(float).tiny)
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


LAPACK = "scipy.linalg._flapack"


@cache
def load_lapack() -> Any:
    """LAPACK's gelsy; a law loads it before its first frame, which would take longer else.

    Its compiled module alone is loaded, in 0.02 s: the package `scipy.linalg`, which would give the
    same function, takes 0.15 s, a sixth of the time to a run's first picture. Where SciPy keeps it
    elsewhere, the package is imported.
    """
    import scipy  # sets up the search for libraries

    loaders = importlib.machinery.ExtensionFileLoader, importlib.machinery.EXTENSION_SUFFIXES
    finder = importlib.machinery.FileFinder(str(Path(scipy.__path__[0]) / "linalg"), loaders)
    spec = None if LAPACK in sys.modules else finder.find_spec(LAPACK)
    if spec is None or spec.loader is None:
        from scipy.linalg import get_lapack_funcs

        return get_lapack_funcs("gelsy", dtype=np.float64)
    sys.modules[LAPACK] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.dgelsy  # pyright: ignore[reportAttributeAccessIssue] - compiled


@spec
class Solve:
    """How a law inverts its matrix A, with singular values s_1 >= s_2 >= ... and singular vectors
    u_i, v_i:

    x = sum of v_i (u_i^T b) s_i / (s_i^2 + damping^2)  over all i with s_i > cutoff s_1

    Without damping this is the pseudo-inverse of A, with it the x that minimises |A x - b|^2 +
    damping^2 |x|^2. Directions of motion that the features hardly distinguish have small singular
    values, by whose inverse errors are multiplied. Below the cutoff no motion is made in them: one
    that leaves out directions at the goal, too, lets the law rest beside it (`local_minimum`).
    Damping only slows the motion in them, so that the law converges.

    With `levenberg_marquardt` = mu it is

    x = (H + mu diag(H))^-1 A^T b,  H = A^T A,

    which minimises |A x - b|^2 + mu sum of (a_i x_i)^2 with a_i the lengths of the columns of A:
    between the Gauss-Newton step (mu = 0) and, for a large mu, a step along the gradient A^T b
    scaled by 1 / (mu diag(H)). Its damping is the same in whatever units the motions are. It
    reduces the gain to 1 / (1 + mu) or less, also at the goal, unless mu decreases with the error
    (`fades_below`). The cutoff then refers to A with the rows sqrt(mu) a_i below it.

    Args:
        cutoff: least singular value that counts, as a share of the largest [1]. At 1 m from a
            square of .5 m the smallest is .029 of the largest, for points and for the partitioned
            law.
        damping: damping [unit of the singular values]; for points, with motion in m and rad and
            image coordinates normalised, singular values are .086 to 2.9 at 1 m from that square.
        levenberg_marquardt: mu, damping of each motion relative to the length of its column [1];
            for points .01 is usual.
        fades_below: norm of b (for most laws the features' error) under which mu decreases with it,
            mu |b| / fades_below [unit of b]; 0 keeps mu constant.

    References: Golub & Van Loan 2013, Matrix Computations, section 5.5; damped least squares:
    Nakamura & Hanafusa 1986, doi:10.1115/1.3143764; Wampler 1986, doi:10.1109/TSMC.1986.289285;
    Levenberg-Marquardt in visual servoing: Malis 2004, doi:10.1109/ROBOT.2004.1308092; Collewet &
    Marchand 2011, doi:10.1109/TRO.2011.2112593.
    """

    cutoff: Annotated[float, Ge(0), Lt(1)] = PINV_RCOND
    damping: Annotated[float, Ge(0), Le(1e3)] = 0.0
    levenberg_marquardt: Annotated[float, Ge(0), Le(1e6)] = 0.0
    fades_below: Annotated[float, Ge(0), Le(1e3)] = 0.0

    def least_squares(self, A: Array, b: Array, at_least: float = 0.0) -> Array:
        """The x (..., n) for A (..., m, n) and b (..., m); with the default parameters that of the
        function `least_squares`.

        at_least: the damping where it is larger than `damping`, of a law whose damping changes from
            frame to frame.
        """
        damping = max(self.damping, at_least)
        if self.levenberg_marquardt > 0:
            mu = np.full(b.shape[:-1], self.levenberg_marquardt)
            if self.fades_below > 0:
                mu = mu * np.minimum(np.linalg.norm(b, axis=-1) / self.fades_below, 1.0)
            # With the rows sqrt(mu) a_i x_i = 0 below, the normal equations of A x = b are (H + mu
            # diag(H)) x = A^T b.
            size = np.sqrt(mu)[..., None] * np.linalg.norm(A, axis=-2)
            below = size[..., None] * np.eye(A.shape[-1])
            A = np.broadcast_to(A, (*below.shape[:-2], *A.shape[-2:]))
            A = np.concatenate([A, below], axis=-2)
            b = np.concatenate([b, np.zeros(size.shape)], axis=-1)
        if self.cutoff == PINV_RCOND and damping == 0:
            return least_squares(A, b)
        U, s, Vt = np.linalg.svd(A, full_matrices=False)
        counts = s > self.cutoff * s[..., :1]
        inverse = np.where(counts, s / np.where(counts, s * s + damping**2, 1), 0)
        return np.asarray(((b[..., None, :] @ U * inverse[..., None, :]) @ Vt)[..., 0, :])

    def null_space(self, A: Array) -> Array:
        """Orthonormal basis (n, k), as columns, of the directions of x (n,) in which no motion is
        made, for A (m, n).
        """
        _, s, Vt = np.linalg.svd(A)
        rank = int(np.count_nonzero(s > self.cutoff * s[0])) if len(s) else 0
        return np.asarray(Vt[rank:].T, dtype=float)


# the default: no damping, a cutoff far below what features at a usual distance have
PSEUDO_INVERSE = Solve()
