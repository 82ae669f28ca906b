"""Statistics over many runs: success rates, paired tests and differences, interquartile means, Holm's correction.

Two controllers that ran from the same seeds are compared pair by pair: the difficulty of a start is common to both and cancels.
The tests and the bootstrap are scipy's, which is imported where it is used: commands that compare nothing start faster.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Sequence
from statistics import NormalDist
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vstestbed.core.geometry import Array

CONFIDENCE: Final = 0.95  # of all intervals
RESAMPLES: Final = 9999
FEWEST: Final = 5  # Fewest pairs, or runs, for a bootstrap interval
MOST: Final = 1000  # Most values that are resampled RESAMPLES times with BCa; of more, fewer times, and percentiles (see `_bootstrap`)
ROUNDING: Final = 1e-9
"""Relative difference under which two values count as equal: the same number reached by another order of operations, of which a closed
loop has made the 1e-16 of one frame larger."""
LEAST: Final = 1e-12  # The same of values near 0, in the unit in which they are shown (mm, px, s): less than any number of a report tells
_FAR: Final = 1e30  # stands for infinity in means, since inf - inf is NaN


class IntervalEstimate(NamedTuple):
    """A mean over `n` runs or pairs with its confidence interval, in the unit of the values; NaN where it is unknown."""

    mean: float
    low: float = math.nan
    high: float = math.nan
    n: int = 0
    p: float = math.nan  # two-sided p-value of no difference, of a test of two controllers

    @property
    def excludes_zero(self) -> bool:
        """Whether zero is outside the interval."""
        return self.low > 0 or self.high < 0

    def turned(self, whole: float = 0.0) -> IntervalEstimate:
        """The opposite: the difference b - a of a - b; with `whole` = 1 the probability of the contrary."""
        return self._replace(mean=whole - self.mean, low=whole - self.high, high=whole - self.low)


NOTHING: Final = IntervalEstimate(math.nan)


class PairedSuccess(NamedTuple):
    """Numbers of seeds on which only a, only b, both, neither succeeded; `p`: two-sided p-value of McNemar's exact test."""

    only_a: int
    only_b: int
    both: int
    neither: int
    p: float


def success_rate(successes: int, n: int) -> IntervalEstimate:
    """Successes among n runs with the Wilson interval, which keeps its coverage at 0 and at n of n, too; of no run: any rate."""
    return share_of(successes / n, n) if n else IntervalEstimate(math.nan, 0.0, 1.0)


def share_of(share: float, n: int, p: float = math.nan) -> IntervalEstimate:
    """A share of n with its Wilson interval."""
    low, high = wilson(share, n)
    return IntervalEstimate(share, float(low), float(high), n, p)


def wilson(share: ArrayLike, n: ArrayLike) -> tuple[Array, Array]:
    """Both ends of the 95 % Wilson score interval of shares p among n, each broadcast; p may also be the mean of any n values in 0..1.

        (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

    Values between 0 and 1, such as ties that count one half, vary less than p (1 - p), so that the interval is then too wide. (scipy has
    the interval of a count only, one at a time.)

    Reference: Wilson 1927, doi:10.1080/01621459.1927.10502953; Newcombe 1998, method 3,
        doi:10.1002/(SICI)1097-0258(19980430)17:8<857::AID-SIM777>3.0.CO;2-E.
    """
    z = NormalDist().inv_cdf((1 + CONFIDENCE) / 2)
    p, n = np.asarray(share, dtype=float), np.asarray(n, dtype=float)
    middle, half = p + z * z / (2 * n), z * np.sqrt(p * (1 - p) / n + (z / (2 * n)) ** 2)
    # at 0 and at n of n the end is exact, which rounding must not move
    low = np.where(p <= 0, 0.0, (middle - half) / (1 + z * z / n))
    return low, np.where(p >= 1, 1.0, (middle + half) / (1 + z * z / n))


def quartiles(values: Iterable[float | None]) -> tuple[float, float, float, int]:
    """First quartile, median, third quartile (linear between neighbours) and number of the finite values; NaN where there are none."""
    known = np.array(list(values), dtype=float)
    known = known[np.isfinite(known)]
    if not len(known):
        return math.nan, math.nan, math.nan, 0
    q1, median, q3 = np.quantile(known, (0.25, 0.5, 0.75)).tolist()
    return q1, median, q3, len(known)


def paired_success(a: ArrayLike, b: ArrayLike) -> PairedSuccess:
    """Successes (N,) of two controllers on the same seeds, with McNemar's exact test: the sign test on the seeds where they disagree.

    Reference: McNemar 1947, doi:10.1007/BF02295996.
    """
    a, b = np.asarray(a, dtype=bool), np.asarray(b, dtype=bool)
    only_a, only_b = int((a & ~b).sum()), int((~a & b).sum())
    return PairedSuccess(only_a, only_b, int((a & b).sum()), int((~a & ~b).sum()), sign_test(only_a, only_b))


def sign_test(one: int, other: int, alternative: str = "two-sided") -> float:
    """P-value of the exact sign test that both counts have the same expectation; `greater`: against one > other."""
    from scipy.stats import binomtest

    return float(binomtest(one, one + other, alternative=alternative).pvalue) if one + other else 1.0


def improvement(a: ArrayLike, b: ArrayLike) -> IntervalEstimate:
    """Probability that b is better (less) than a, both (N,), on the same seed; ties count one half, NaN leaves a pair out.

        P(b < a) + P(b = a) / 2

    with the exact sign test of the seeds without a tie, and Wilson's interval, which ties make wider than needed. Infinity is a run that
    is worse than any with a number, so that two of them are a tie.

    Reference: Agarwal et al. 2021, Deep reinforcement learning at the edge of the statistical precipice, NeurIPS, arXiv:2108.13264
        (of unpaired runs there).
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    known = ~np.isnan(a) & ~np.isnan(b)
    a, b = a[known], b[known]
    if not len(a):
        return NOTHING
    finite = np.isfinite(a) & np.isfinite(b)
    tied = a == b
    tied[finite] |= np.abs(a[finite] - b[finite]) <= _rounding(a[finite], b[finite])
    better, worse = int((~tied & (b < a)).sum()), int((~tied & (b > a)).sum())
    return share_of((better + tied.sum() / 2) / len(a), len(a), sign_test(better, worse))


def holm(p: Sequence[float]) -> list[float]:
    """P-values adjusted for their number m: whoever calls those under 5 % real is wrong in any of them in 5 % of all cases at most.

        adjusted p_(k) = max over j <= k of min((m + 1 - j) p_(j), 1),        p_(1) <= p_(2) <= ... <= p_(m)

    NaN is no test: it does not count, and stays. Reference: Holm 1979, A simple sequentially rejective multiple test procedure, Scand. J.
    Statist. 6, 65-70.
    """
    values = np.asarray(p, dtype=float)
    order = np.argsort(values, kind="stable")[: int((~np.isnan(values)).sum())]  # NaN is sorted last
    factors = np.arange(len(order), 0, -1)
    adjusted = np.full(len(values), np.nan)
    adjusted[order] = np.maximum.accumulate(np.minimum(factors * values[order], 1.0))
    return adjusted.tolist()


def paired_difference(a: ArrayLike, b: ArrayLike) -> IntervalEstimate:
    """Mean of d = a - b over the pairs that have both values, with its BCa bootstrap interval and the p-value of the sign-flip test.

    The test asks how often random signs of the differences give a mean as far from zero (all 2^n of them up to n = 13, else RESAMPLES
    random ones, so that the least p is 1e-4). It is exact where the two controllers are exchangeable: their differences are then
    symmetric, however heavy their tails. Where the mean is zero but the differences are skewed it is not, and neither is the
    interval; a difference is called real where the test and the interval agree. docs/results/conclusions.md has how often both are
    wrong for eight distributions and three numbers of pairs.

    Differences that are equal up to rounding are set equal. If all are, as in deterministic runs, low = high = mean, and p is 0 or 1.
    There is no interval of fewer than FEWEST pairs, and no test of one.

    `a`, `b`: one value a seed, shape (N,), in the same order of seeds; NaN or None where a run has none.
    Reference: Efron 1987 (BCa), doi:10.1080/01621459.1987.10478410; Fisher 1935, The design of experiments, sec. 21 (test).
    """
    d = _differences(a, b)
    n = len(d)
    if n < 2:
        return IntervalEstimate(float(d[0]), n=1) if n else NOTHING
    mean = float(d.mean())
    if d[0] == d[-1]:  # sorted: all differences are equal
        return IntervalEstimate(mean, mean, mean, n, float(mean == 0))
    from scipy.stats import permutation_test

    drawn = {"n_resamples": _resamples(n), "rng": np.random.default_rng(0), "vectorized": True, "batch": _at_once(n)}
    p = permutation_test((d,), np.mean, permutation_type="samples", **drawn).pvalue
    return IntervalEstimate(mean, *_bootstrap((d,), np.mean), n, float(p))


def _rounding(a: Array, b: Array) -> float:
    return max(ROUNDING * float(np.abs([a, b]).max(initial=0.0)), LEAST)


def _differences(a: ArrayLike, b: ArrayLike) -> Array:
    """Sorted a - b of the pairs with two finite values; differences that are equal up to rounding get their middle."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    known = np.isfinite(a) & np.isfinite(b)
    d, rounding = np.sort(a[known] - b[known]), _rounding(a[known], b[known])
    d[np.abs(d) <= rounding] = 0.0
    groups = np.cumsum(np.diff(d, prepend=d[:1]) > rounding)
    first, last = np.searchsorted(groups, groups, "left"), np.searchsorted(groups, groups, "right") - 1
    return (d[first] + d[last]) / 2


def _resamples(n: int) -> int:
    return max(199, min(RESAMPLES, RESAMPLES * MOST // n))


def _at_once(n: int) -> int:
    """Resamples of n values that are in memory together: 80 MB. Of up to 50,000 values they are all of them."""
    return max(1, RESAMPLES * MOST // n)


def _bootstrap(samples: tuple[Array, ...], statistic: Any) -> tuple[float, float]:
    """Both ends of scipy's BCa interval of a statistic of one or several samples, each resampled by itself; NaN of fewer than FEWEST.

    Of more than MOST values the ends are percentiles: the jackknife of BCa takes n statistics of n values (40 s of 30,000), and what it
    corrects is of order 1/n, where the interval's width is of order 1/sqrt(n) (Efron 1987).
    """
    n = sum(map(len, samples))
    if n < FEWEST or min(map(len, samples)) < 2:
        return math.nan, math.nan
    from scipy.stats import bootstrap

    low = high = math.nan
    with warnings.catch_warnings(action="ignore"):  # where hardly any resample differs BCa is undefined, and the percentiles are taken
        for method in ("BCa", "percentile") if n <= MOST else ("percentile",):
            drawn: dict[str, Any] = {"n_resamples": _resamples(n), "rng": np.random.default_rng(0), "batch": _at_once(n)}
            low, high = bootstrap(
                samples, statistic, confidence_level=CONFIDENCE, method=method, vectorized=True, **drawn
            ).confidence_interval
            if np.isfinite([low, high]).all():
                break
    return float(low), float(high)


def interquartile_mean(values: ArrayLike, strata: ArrayLike | None = None) -> IntervalEstimate:
    """Mean of the middle half of all values, with a stratified bootstrap interval (BCa).

        IQM = mean of x_(k+1), ..., x_(n-k),        x_(1) <= ... <= x_(n),   k = floor(n / 4)

    Each resample draws as many values as there are from each stratum, so that its share of the runs stays. Infinity (of one sign) is a
    run that is worse than any with a number: of up to k of them the mean is finite, and an end of the interval is infinite where the
    resamples beyond it have more. NaN is left out. low and high are NaN with fewer than FEWEST runs, or where a stratum has one run.
    `strata`: of each value, any numbers, shape (N,); None: all in one.

    Reference: Agarwal et al. 2021, Deep reinforcement learning at the edge of the statistical precipice, NeurIPS, arXiv:2108.13264.
    """
    from scipy.stats import trim_mean

    x = np.asarray(values, dtype=float)
    stratum = np.zeros(len(x), dtype=int) if strata is None else np.unique(np.asarray(strata), return_inverse=True)[1]
    known = ~np.isnan(x)
    x, stratum = np.nan_to_num(x[known], posinf=_FAR, neginf=-_FAR), stratum[known]
    if not len(x):
        return NOTHING

    def middle(*samples: Array, axis: int = -1) -> Array:
        return trim_mean(np.concatenate(samples, axis=axis), 0.25, axis=axis)

    samples = tuple(np.sort(x[stratum == number]) for number in np.unique(stratum))  # the order of the runs does not matter
    found = (float(middle(*samples)), *_bootstrap(samples, middle))
    mean, low, high = (math.copysign(math.inf, v) if abs(v) > 1e-9 * _FAR else v for v in found)
    return IntervalEstimate(mean, low, high, len(x))
