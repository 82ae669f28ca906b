"""Statistics over many runs: success rates, medians with quartiles, paired successes, probability of improvement, Holm's correction.

Two controllers that ran from the same seeds are compared pair by pair: the difficulty of a start is common to both and cancels.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array

ROUNDING: Final = 1e-9
"""Relative difference under which two values count as equal: the same number reached by another order of operations, of which a closed
loop has made the 1e-16 of one frame larger."""
LEAST: Final = 1e-12
"""The same of values near 0, in the unit in which they are shown (mm, px, s): less than any number of a report tells."""


@dataclass(frozen=True, slots=True)
class Rate:
    """A success rate with its confidence interval, all in 0..1; `rate` is NaN for zero runs."""

    rate: float
    low: float
    high: float
    successes: int
    n: int


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and quartiles of `n` known values, in the unit of the values; NaN where there are none."""

    median: float
    q1: float
    q3: float
    n: int


@dataclass(frozen=True, slots=True)
class SuccessDifference:
    """Numbers of seeds on which only a, only b, both, neither succeeded; `p`: two-sided p-value of McNemar's exact test."""

    only_a: int
    only_b: int
    both: int
    neither: int
    p: float


@dataclass(frozen=True, slots=True)
class Improvement:
    """Probability in 0..1 that one controller is better than another on the same of `n` seeds, with its interval; NaN for none.

    `p`: two-sided p-value of the exact sign test, of the hypothesis that either is better equally often.
    """

    share: float
    low: float
    high: float
    n: int
    p: float = math.nan


def success_rate(successes: int, n: int, confidence: float = 0.95) -> Rate:
    """Successes among n runs, with the Wilson score interval, which keeps its coverage at 0 and at n of n, too.

    Args:
        successes: runs that succeeded. n: runs. confidence: of the interval, in 0..1.

    Raises:
        ParameterError: successes not in 0..n, or confidence not between 0 and 1.

    Reference: Wilson 1927, doi:10.1080/01621459.1927.10502953; Newcombe 1998, method 3,
        doi:10.1002/(SICI)1097-0258(19980430)17:8<857::AID-SIM777>3.0.CO;2-E.
    """
    check_confidence(confidence)
    if not 0 <= successes <= n:
        raise ParameterError("successes", f"must be in 0..{n}", successes)
    if n == 0:
        return Rate(math.nan, 0.0, 1.0, 0, 0)  # no run excludes no rate
    low, high = wilson(successes / n, n, confidence)
    return Rate(successes / n, float(low), float(high), int(successes), int(n))


def wilson(share: ArrayLike, n: ArrayLike, confidence: float = 0.95) -> tuple[Array, Array]:
    """Both ends of the Wilson score interval of shares p among n, each broadcast; p may also be the mean of any n values in 0..1.

        (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

    Values between 0 and 1, such as ties that count one half, vary less than p (1 - p), so that the interval is then too wide.
    """
    z = NormalDist().inv_cdf((1 + confidence) / 2)
    p, n = np.asarray(share, dtype=float), np.asarray(n, dtype=float)
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + (z / (2 * n)) ** 2)
    # at 0 and at n of n the end is exact, which rounding must not move
    low = np.where(p <= 0, 0.0, (middle - half) / (1 + z * z / n))
    return low, np.where(p >= 1, 1.0, (middle + half) / (1 + z * z / n))


def spread(values: Iterable[float | None]) -> Spread:
    """Median and quartiles (linear between neighbours) of the finite values; NaN, infinity and None are left out."""
    known = np.array(list(values), dtype=float)
    known = known[np.isfinite(known)]
    if not len(known):
        return Spread(math.nan, math.nan, math.nan, 0)
    q1, median, q3 = (float(q) for q in np.quantile(known, (0.25, 0.5, 0.75)))
    return Spread(median, q1, q3, len(known))


def paired_success(a: ArrayLike, b: ArrayLike) -> SuccessDifference:
    """Successes of two controllers on the same seeds, with McNemar's exact test on the seeds where they disagree.

        p = P(|K - n/2| >= |only_a - n/2|),   K ~ Binomial(n = only_a + only_b, 1/2)

    Args:
        a, b: whether each run succeeded, shape (N,), in the same order of seeds.

    Raises:
        ParameterError: a and b differ in shape.

    Reference: McNemar 1947, doi:10.1007/BF02295996.
    """
    a, b = np.asarray(a, dtype=bool), np.asarray(b, dtype=bool)
    check_pairs(a, b)
    only_a, only_b = int((a & ~b).sum()), int((~a & b).sum())
    return SuccessDifference(only_a, only_b, int((a & b).sum()), int((~a & ~b).sum()), _sign_test(only_a, only_b))


def _sign_test(one: int, other: int) -> float:
    """Two-sided p-value of the hypothesis that both counts have the same expectation."""
    if one + other == 0:
        return 1.0
    from scipy.special import bdtr  # imported here: it costs time that other commands need not pay

    return min(1.0, 2 * float(bdtr(min(one, other), one + other, 0.5)))  # both tails are equal


def improvement(a: ArrayLike, b: ArrayLike, confidence: float = 0.95) -> Improvement:
    """Probability that b is better (less) than a on the same seed; ties count one half, and NaN on either side leaves a pair out.

        P(b < a) + P(b = a) / 2,        p = P(|K - m/2| >= |#{b < a} - m/2|),   K ~ Binomial(m, 1/2), m: seeds without a tie

    Infinity is a run that is worse than any with a number, so that two of them are a tie. The test is exact however skewed the numbers
    are. The interval is Wilson's: the bootstrap's is nearly the same, but shrinks to a point where b is better on every seed. Ties make
    it wider than needed.

    Args:
        a, b: one value a seed, shape (N,), in the same order of seeds; the less the better. confidence: of the interval, in 0..1.

    Raises:
        ParameterError: a and b differ in shape, or confidence is not between 0 and 1.

    Reference: Agarwal et al. 2021, Deep reinforcement learning at the edge of the statistical precipice, NeurIPS, arXiv:2108.13264
        (of unpaired runs there).
    """
    check_confidence(confidence)
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    check_pairs(a, b)
    known = ~np.isnan(a) & ~np.isnan(b)
    a, b = a[known], b[known]
    if not len(a):
        return Improvement(math.nan, math.nan, math.nan, 0)
    finite = np.isfinite(a) & np.isfinite(b)
    rounding = max(ROUNDING * float(np.abs([a[finite], b[finite]]).max(initial=0.0)), LEAST)
    tied = a == b
    tied[finite] |= np.abs(a[finite] - b[finite]) <= rounding
    share = float(np.where(tied, 0.5, b < a).mean())
    low, high = wilson(share, len(a), confidence)
    better, worse = int((~tied & (b < a)).sum()), int((~tied & (b > a)).sum())
    return Improvement(share, float(low), float(high), len(a), _sign_test(better, worse))


def holm(p: Sequence[float]) -> list[float]:
    """P-values adjusted for their number m: whoever calls those under 5 % real is wrong in any of them in 5 % of all cases at most.

        adjusted p_(k) = max over j <= k of min((m + 1 - j) p_(j), 1),        p_(1) <= p_(2) <= ... <= p_(m)

    NaN is no test: it does not count, and stays.

    Reference: Holm 1979, A simple sequentially rejective multiple test procedure, Scand. J. Statist. 6, 65-70.
    """
    values = np.asarray(p, dtype=float)
    order = np.argsort(values, kind="stable")[: int((~np.isnan(values)).sum())]  # NaN is sorted last
    factors = np.arange(len(order), 0, -1)
    adjusted = np.full(len(values), np.nan)
    adjusted[order] = np.maximum.accumulate(np.minimum(factors * values[order], 1.0))
    return adjusted.tolist()


def check_pairs(a: NDArray[np.generic], b: NDArray[np.generic]) -> None:
    """Raise a ParameterError where two rows of values cannot be pairs."""
    if a.ndim != 1 or a.shape != b.shape:
        raise ParameterError("a, b", "must be one-dimensional and of the same length", (a.shape, b.shape))


def check_confidence(confidence: float) -> None:
    """Raise a ParameterError where a confidence is not between 0 and 1."""
    if not 0 < confidence < 1:
        raise ParameterError("confidence", "must be between 0 and 1", confidence)
