"""Statistics over many runs: success rates, medians with quartiles, paired differences, each with a confidence interval or p-value.

Two controllers that ran from the same seeds are compared pair by pair: the difficulty of a start is common to both and cancels.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array

FEWEST: Final = 5
"""Fewest pairs for the bootstrap: with 4, one resample in 64 is 4 times the same pair and has no spread."""

MOST: Final = 2000
"""Most pairs for the bootstrap: of more, Student's t has the same interval to a hundredth of its width, at no cost."""

CHUNK: Final = 1_000_000
"""Values resampled at a time: bounds the memory (about 8 MB an array) whatever the number of pairs."""

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
class Difference:
    """Mean of a - b over `n` pairs and its interval, in the unit of the values; `real`: the interval excludes zero."""

    mean: float
    low: float
    high: float
    n: int
    real: bool


@dataclass(frozen=True, slots=True)
class SuccessDifference:
    """Numbers of seeds on which only a, only b, both, neither succeeded; `p`: two-sided p-value of McNemar's exact test."""

    only_a: int
    only_b: int
    both: int
    neither: int
    p: float


def success_rate(successes: int, n: int, confidence: float = 0.95) -> Rate:
    """Successes among n runs, with the Wilson score interval, which keeps its coverage at 0 and at n of n, too.

    Args:
        successes: runs that succeeded. n: runs. confidence: of the interval, in 0..1.

    Raises:
        ParameterError: successes not in 0..n, or confidence not between 0 and 1.

    Reference: Wilson 1927, doi:10.1080/01621459.1927.10502953; Newcombe 1998, method 3,
        doi:10.1002/(SICI)1097-0258(19980430)17:8<857::AID-SIM777>3.0.CO;2-E.
    """
    _check_confidence(confidence)
    if not 0 <= successes <= n:
        raise ParameterError("successes", f"must be in 0..{n}", successes)
    if n == 0:
        return Rate(math.nan, 0.0, 1.0, 0, 0)  # no run excludes no rate
    from scipy.stats import binomtest  # imported here: it costs half a second that other commands need not pay

    interval = binomtest(int(successes), int(n)).proportion_ci(confidence, method="wilson")
    return Rate(successes / n, float(interval.low), float(interval.high), int(successes), int(n))


def spread(values: Iterable[float | None]) -> Spread:
    """Median and quartiles (linear between neighbours) of the finite values; NaN, infinity and None are left out."""
    known = np.array(list(values), dtype=float)
    known = known[np.isfinite(known)]
    if not len(known):
        return Spread(math.nan, math.nan, math.nan, 0)
    q1, median, q3 = (float(q) for q in np.quantile(known, (0.25, 0.5, 0.75)))
    return Spread(median, q1, q3, len(known))


def paired_difference(a: ArrayLike, b: ArrayLike, confidence: float = 0.95, seed: int = 0, resamples: int = 9999) -> Difference:
    """Mean of d = a - b over the pairs that have both values, with a symmetric studentised bootstrap interval.

        mean(d) -+ q s / sqrt(n),   q: quantile over resamples d* of |mean(d*) - mean(d)| / (s* / sqrt(n))

    False positives of the nominal 5 % test at n = 20 pairs, from 4000 synthetic comparisons each (BCa bootstrap in brackets):
    normal differences 5 % (8 %); symmetric with heavy tails, as two equal controllers have, 1-3 % (10-18 %); exponential
    6 % (9 %); lognormal, which is as skewed as times to converge get, 9 % (13 %).
    Under 5 pairs the interval is Student's t, which is exact for normal differences only, and wide. From 5 to 10 pairs the
    bootstrap is up to twice as wide as Student's t: it rather misses a real difference than reports a false one. Over MOST pairs the
    interval is Student's t, which by the central limit theorem no longer differs.
    If nearly all differences are equal, resamples without spread occur: Student's t again. If all are equal up to
    rounding, as in deterministic runs, then low = high = mean. The order of the pairs does not matter, and exchanging
    a and b changes the sign and nothing else.

    Args:
        a, b: one value a seed, shape (N,), in the same order of seeds; NaN or None where a run has none.
        confidence: of the interval, in 0..1. seed: of the resampling. resamples: how many.

    Returns:
        The difference; low and high are NaN with fewer than two pairs.

    Raises:
        ParameterError: a and b differ in shape, or confidence is not between 0 and 1.

    Reference: Efron & Tibshirani 1993, ch. 12.5, doi:10.1201/9780429246593; Hall 1988 (symmetric intervals),
        doi:10.1111/j.2517-6161.1988.tb01707.x; Hesterberg 2015, doi:10.1080/00031305.2015.1089789.
    """
    _check_confidence(confidence)
    d = _differences(a, b)
    n = len(d)
    if n == 0:
        return Difference(math.nan, math.nan, math.nan, 0, False)
    if n == 1:
        return Difference(float(d[0]), math.nan, math.nan, 1, False)
    if d[0] == d[-1]:  # sorted: all differences are equal, and their standard deviation of 0 is no divisor
        mean, half = float(d[0]), 0.0
    else:
        mean, half = float(d.mean()), float(d.std(ddof=1)) / math.sqrt(n) * _quantile(d, confidence, seed, resamples)
    low, high = mean - half, mean + half
    return Difference(mean, low, high, n, low > 0 or high < 0)


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
    _check_pairs(a, b)
    only_a, only_b = int((a & ~b).sum()), int((~a & b).sum())
    p = 1.0
    if only_a + only_b:
        from scipy.stats import binomtest

        p = float(binomtest(only_a, only_a + only_b).pvalue)
    return SuccessDifference(only_a, only_b, int((a & b).sum()), int((~a & ~b).sum()), p)


def _differences(a: ArrayLike, b: ArrayLike) -> Array:
    """Sorted a - b of the pairs with two finite values; differences that are equal up to rounding are set equal."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    _check_pairs(a, b)
    known = np.isfinite(a) & np.isfinite(b)
    a, b = a[known], b[known]
    d = np.sort(a - b)
    rounding = max(ROUNDING * float(np.abs([a, b]).max(initial=0.0)), LEAST)
    d[np.abs(d) <= rounding] = 0.0
    # Differences that are equal but for rounding get one value: in a resample of them alone the spread would be rounding, as a divisor.
    groups = np.cumsum(np.diff(d, prepend=d[:1]) > rounding)
    first, last = np.searchsorted(groups, np.unique(groups), "left"), np.searchsorted(groups, np.unique(groups), "right") - 1
    return np.repeat((d[first] + d[last]) / 2, last - first + 1)


def _quantile(d: Array, confidence: float, seed: int, resamples: int) -> float:
    """Half-width of the interval in standard errors; d: differences, shape (N,), not all equal."""
    n = len(d)
    if FEWEST <= n <= MOST:
        reach = float(np.quantile(_studentised(d, seed, resamples), confidence, method="higher"))
        if math.isfinite(reach):  # else at least a share 1 - confidence of the resamples had no spread
            return reach
    from scipy.special import stdtrit

    return float(stdtrit(n - 1, (1 + confidence) / 2))


def _studentised(d: Array, seed: int, resamples: int) -> Array:
    """|mean(d*) - mean(d)| in standard errors of the resample d*, shape (resamples,); inf where d* has no spread but is off the mean."""
    rng = np.random.default_rng(seed)
    n = len(d)
    centred = d - d.mean()
    # sorted, and with a sign of its own: neither the order of the pairs nor exchanging a and b may change the resamples
    centred = np.sort(centred if _heavier_above(centred) else -centred)
    out = np.empty(resamples)
    # rows of resamples at a time
    step = max(1, CHUNK // n)
    for start in range(0, resamples, step):
        part = out[start : start + step]
        sample = centred[rng.integers(0, n, (len(part), n), dtype=np.int32)]
        mean = np.abs(sample.mean(axis=1))
        flat = sample.min(axis=1) == sample.max(axis=1)
        error = sample.std(axis=1, ddof=1) / math.sqrt(n)
        part[:] = np.where(flat, np.where(mean > 0, np.inf, 0.0), mean / np.where(flat, 1.0, error))
    return out


def _heavier_above(d: Array) -> bool:
    """Whether d rather than -d is resampled: a rule that picks the same of the two for either sign."""
    up, down = np.sort(d), np.sort(-d)
    first = np.flatnonzero(up != down)
    return not len(first) or bool(up[first[0]] > down[first[0]])


def _check_pairs(a: NDArray[np.generic], b: NDArray[np.generic]) -> None:
    if a.ndim != 1 or a.shape != b.shape:
        raise ParameterError("a, b", "must be one-dimensional and of the same length", (a.shape, b.shape))


def _check_confidence(confidence: float) -> None:
    if not 0 < confidence < 1:
        raise ParameterError("confidence", "must be between 0 and 1", confidence)
