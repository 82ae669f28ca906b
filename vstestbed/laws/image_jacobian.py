"""Estimates of an image Jacobian from measured motion: Broyden's correction, and recursive least squares with forgetting."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.core.spec import OneOf, spec


@spec
class Broyden:
    """J + rate (y - J x) x^T / (x^T x): the least change of J that explains a share `rate` of the surprise.

    Args:
        rate: share of the difference between the measured and the expected motion in the picture that is taken over [1].

    References: Broyden 1965, doi:10.1090/S0025-5718-1965-0198670-6; Jagersand, Fuentes & Nelson 1997, doi:10.1109/ROBOT.1997.606723.
    """

    kind: Literal["broyden"] = "broyden"
    rate: Annotated[float, Gt(0), Le(1)] = 0.5

    def corrected(self, J: Array, P: Array, x: Array, y: Array, most: float) -> tuple[Array, Array]:
        """The next J and P of markers whose motion was measured.

        Args:
            J: image Jacobian of each marker (N, 2, m). P: unused, (N, m, m). x: displacement (m,), not 0. y: its motion in the
                picture (N, 2). most: unused.
        """
        return J + self.rate * _surprise(J, x, y)[..., None] * (x / (x @ x)), P


@spec
class RecursiveLeastSquares:
    """The J that minimises the sum of forgetting^(k - i) |y_i - J x_i|^2 over all displacements i up to the present one k.

        gain = P x / (forgetting + x^T P x),  J + (y - J x) gain^T,  P = (P - gain x^T P) / forgetting

    Motion in a few directions only would let P grow without end in the others (wind-up), where the first measurement after that, noise
    included, would replace J. So the eigenvalues of P are kept under a bound, by which a displacement of `step_px` in a direction
    unknown so far corrects J by half of its surprise or, with forgetting, a little more.

    Args:
        forgetting: weight of a displacement against the one after it [1]; 1 forgets nothing.

    References: Piepmeier, McMurray & Lipkin 2004, doi:10.1109/TRA.2003.820923; Haykin 2002, Adaptive Filter Theory, chapter 9.
    """

    kind: Literal["rls"] = "rls"
    forgetting: Annotated[float, Ge(0.1), Le(1)] = 0.8

    def corrected(self, J: Array, P: Array, x: Array, y: Array, most: float) -> tuple[Array, Array]:
        """The next J and P of markers whose motion was measured.

        Args:
            J: image Jacobian of each marker (N, 2, m). P: inverse of the weighted sum of x x^T, (N, m, m). x: displacement (m,).
                y: its motion in the picture (N, 2). most: bound of the eigenvalues of P.
        """
        Px = P @ x
        gain = Px / (self.forgetting + Px @ x)[:, None]
        J = J + _surprise(J, x, y)[..., None] * gain[:, None, :]
        P = (P - gain[..., None] * Px[:, None, :]) / self.forgetting
        return J, P if np.einsum("nii->n", P).max() <= most else _bounded(P, most)


def _surprise(J: Array, x: Array, y: Array) -> Array:
    """Measured less expected motion (N, 2)."""
    return y - J @ x


def _bounded(P: Array, most: float) -> Array:
    """Symmetric matrices (N, m, m) with their eigenvalues in (0, most]."""
    w, V = np.linalg.eigh(P)
    return np.asarray((V * np.minimum(w, most)[:, None, :]) @ V.mT)


ESTIMATORS = OneOf("estimator", Broyden, RecursiveLeastSquares)
Estimator = Annotated[Broyden | RecursiveLeastSquares, ESTIMATORS]


class MotionSums:
    """Sums of displacements and of the motion in the picture that they made, for J by least squares; a value, never changed.

    Attributes:
        xx: sum of x x^T for each marker (N, m, m). yx: sum of y x^T, (N, 2, m). taken: x x^T of all frames, seen or not (m, m).
    """

    __slots__ = ("taken", "xx", "yx")

    def __init__(self, xx: Array, yx: Array, taken: Array):
        self.xx, self.yx, self.taken = xx, yx, taken

    @classmethod
    def none(cls, markers: int, columns: int) -> MotionSums:
        """No samples of N markers and m velocities."""
        return cls(np.zeros((markers, columns, columns)), np.zeros((markers, 2, columns)), np.zeros((columns, columns)))

    def with_one(self, x: Array, y: Array) -> MotionSums:
        """One more displacement x (m,) with its motion in the picture y (N, 2), NaN for markers that are not seen."""
        seen, one = np.isfinite(y[:, 0]), np.outer(x, x)
        y = np.where(seen[:, None], y, 0.0)
        return MotionSums(self.xx + seen[:, None, None] * one, self.yx + y[..., None] * x, self.taken + one)

    def jacobian(self, least_share: float = 0.5) -> Array:
        """J (N, 2, m) that minimises the sum of |y - J x|^2; NaN for markers that were seen in too small a share of some velocity.

        A velocity that never moved anything has a column of zeros.
        """
        moved = np.sqrt(np.diagonal(self.taken))
        unit = np.where(moved > 0, moved, 1.0)  # so that columns of other units weigh the same
        inverse = np.linalg.pinv(self.xx / np.outer(unit, unit), rcond=1e-9, hermitian=True)
        J = (self.yx / unit) @ inverse / unit
        J[~self.known(least_share)] = np.nan
        return J

    def known(self, least_share: float) -> NDArray[np.bool_]:
        """Which markers were seen in at least this share of each velocity's displacements, (N,)."""
        return np.asarray((np.diagonal(self.xx, axis1=1, axis2=2) >= least_share * np.diagonal(self.taken)).all(axis=1))
