"""Statistics over many runs: success rates, paired tests and differences, interquartile means,
Holm's correction.

Two controllers that ran from the same seeds are compared pair by pair: the difficulty of a start is
common to both and cancels. All is in closed form, without random numbers. The distributions are
scipy's, which is imported where it is used: commands that compare nothing start faster.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vstestbed.core.geometry import Array

__all__ = [
    "CONFIDENCE",
    "FEWEST",
    "LEAST",
    "NOTHING",
    "IntervalEstimate",
    "MeanEstimate",
    "holm",
    "improvement",
    "interquartile_mean",
    "paired_difference",
    "quartiles",
    "rounding",
    "share_of",
    "sign_test",
    "success_rate",
    "wilson",
]

CONFIDENCE = 0.95  # of all intervals
# Fewest runs for the interval of an interquartile mean: of fewer, a single value would be left, or
# all of them
FEWEST = 5
ROUNDING = 1e-9
"""Relative difference under which two values count as equal: the same number reached by another
order of operations, of which a closed loop has made the 1e-16 of one frame larger.
"""
# The same of values near 0, in the unit in which they are shown (mm, px, s): less than any number
# of a report tells
LEAST = 1e-12


class IntervalEstimate(NamedTuple):
    """A mean over `n` runs or pairs with its confidence interval, in the unit of the values; NaN
    where it is unknown.
    """

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
        """The opposite: the difference b - a of a - b; with `whole` = 1 the probability of the
        contrary.
        """
        return self._replace(mean=whole - self.mean, low=whole - self.high, high=whole - self.low)


NOTHING = IntervalEstimate(math.nan)


class MeanEstimate(NamedTuple):
    """A mean with its standard error and degrees of freedom, of which Student's t gives p-values
    and intervals.
    """

    mean: float
    error: float
    free: float

    def t(self, bound: float) -> float:
        """Student's t against a mean of `bound`. Where all values are equal the error is 0, and
        nothing is left to chance.
        """
        distance = self.mean - bound
        return (
            distance / self.error
            if self.error > 0
            else math.copysign(math.inf, distance)
            if distance
            else 0.0
        )

    def p_over(self, bound: float) -> float:
        """One-sided p-value against a mean of at most `bound`."""
        from scipy.special import stdtr

        return float(stdtr(self.free, -self.t(bound)))

    def interval(self) -> tuple[float, float]:
        """Both ends of the two-sided interval."""
        from scipy.special import stdtrit

        half = float(stdtrit(self.free, (1 + CONFIDENCE) / 2)) * self.error
        return self.mean - half, self.mean + half


def success_rate(successes: int, n: int) -> IntervalEstimate:
    """Successes among n runs with the Wilson interval, which keeps its coverage at 0 and at n of n,
    too; of no run: any rate.
    """
    return share_of(successes / n, n) if n else IntervalEstimate(math.nan, 0.0, 1.0)


def share_of(share: float, n: int, p: float = math.nan) -> IntervalEstimate:
    """A share of n with its Wilson interval."""
    low, high = wilson(share, n)
    return IntervalEstimate(share, float(low), float(high), n, p)


def wilson(share: ArrayLike, n: ArrayLike) -> tuple[Array, Array]:
    """Both ends of the 95 % Wilson score interval of shares p among n, each broadcast; p may also
    be the mean of any n values in 0..1.

        (p + z^2 / 2n -+ z sqrt(p (1 - p) / n + z^2 / 4n^2)) / (1 + z^2 / n)

    Values between 0 and 1, such as ties that count one half, vary less than p (1 - p), so that the
    interval is then too wide. (scipy has the interval of a count only, one at a time.)

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
    """First quartile, median, third quartile (linear between neighbours) and number of the finite
    values; NaN where there are none.
    """
    known = np.array(list(values), dtype=float)
    known = known[np.isfinite(known)]
    if not len(known):
        return math.nan, math.nan, math.nan, 0
    q1, median, q3 = np.quantile(known, (0.25, 0.5, 0.75)).tolist()
    return q1, median, q3, len(known)


def sign_test(one: int, other: int, alternative: str = "two-sided") -> float:
    """P-value of the exact sign test that both counts have the same expectation; `greater`: against
    one > other.

    Twice the smaller tail of Bin(one + other, 1/2), at most 1; or the tail of counts of `one` or
    more. Of the starts from which one of two controllers alone reached the goal it is McNemar's
    test (1947, doi:10.1007/BF02295996).
    """
    from scipy.special import bdtr

    if one + other == 0:
        return 1.0
    if alternative == "greater":
        return float(bdtr(other, one + other, 0.5))
    return min(1.0, 2 * float(bdtr(min(one, other), one + other, 0.5)))


def improvement(a: ArrayLike, b: ArrayLike) -> IntervalEstimate:
    """Probability that b is better (less) than a, both (N,), on the same seed; ties count one half,
    NaN leaves a pair out.

        P(b < a) + P(b = a) / 2

    with the exact sign test of the seeds without a tie, and Wilson's interval, which ties make
    wider than needed. Infinity is a run that is worse than any with a number, so that two of them
    are a tie.

    Reference: Agarwal et al. 2021, Deep reinforcement learning at the edge of the statistical
        precipice, NeurIPS, arXiv:2108.13264 (of unpaired runs there).
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    known = ~np.isnan(a) & ~np.isnan(b)
    a, b = a[known], b[known]
    if not len(a):
        return NOTHING
    finite = np.isfinite(a) & np.isfinite(b)
    tied = a == b
    tied[finite] |= np.abs(a[finite] - b[finite]) <= rounding(a[finite], b[finite])
    better, worse = int((~tied & (b < a)).sum()), int((~tied & (b > a)).sum())
    return share_of((better + tied.sum() / 2) / len(a), len(a), sign_test(better, worse))


def holm(p: Sequence[float]) -> list[float]:
    """P-values adjusted for their number m: whoever calls those under 5 % real is wrong in any of
    them in 5 % of all cases at most.

        adjusted p_(k) = max over j <= k of min((m + 1 - j) p_(j), 1),
        p_(1) <= p_(2) <= ... <= p_(m)

    NaN is no test: it does not count, and stays. Reference: Holm 1979, A simple sequentially
    rejective multiple test procedure, Scand. J. Statist. 6, 65-70.
    """
    values = np.asarray(p, dtype=float)
    # NaN is sorted last
    order = np.argsort(values, kind="stable")[: int((~np.isnan(values)).sum())]
    factors = np.arange(len(order), 0, -1)
    adjusted = np.full(len(values), np.nan)
    adjusted[order] = np.maximum.accumulate(np.minimum(factors * values[order], 1.0))
    return adjusted.tolist()


def paired_difference(a: ArrayLike, b: ArrayLike) -> IntervalEstimate:
    """Mean of d = a - b over the pairs that have both values, with Student's interval and the
    p-value of his test of no difference.

        mean(d) -+ t_{n-1}(0.975) sd(d) / sqrt(n)

    Differences of two controllers on the same starts are near enough to symmetric for it; where one
    of them fails rarely and a failure is dear they are not, and the interval is then one of what
    was flown (docs/results/verdicts.md has its coverage). Differences under rounding count as 0. If
    all are equal up to rounding, as in deterministic runs, low = high = mean, and p is 0 or 1.
    There is no interval and no test of one pair.

    `a`, `b`: one value a seed, shape (N,), in the same order of seeds; NaN or None where a run has
    none.
    Reference: Student 1908, doi:10.1093/biomet/6.1.1.
    """
    d, least = _differences(a, b)
    n = len(d)
    if n < 2:
        return IntervalEstimate(float(d[0]), n=1) if n else NOTHING
    mean = float(d.mean())
    if np.ptp(d) <= least:
        return IntervalEstimate(mean, mean, mean, n, float(mean == 0))
    found = MeanEstimate(mean, float(d.std(ddof=1)) / math.sqrt(n), n - 1)
    return IntervalEstimate(
        mean, *found.interval(), n, 2 * found._replace(mean=abs(mean)).p_over(0.0)
    )


def rounding(a: Array, b: Array) -> float:
    """The difference up to which values of a and b are equal."""
    return max(ROUNDING * float(np.abs([a, b]).max(initial=0.0)), LEAST)


def _differences(a: ArrayLike, b: ArrayLike) -> tuple[Array, float]:
    """Sorted a - b of the pairs with two finite values, 0 for those that are equal up to rounding;
    and what rounding is.
    """
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    known = np.isfinite(a) & np.isfinite(b)
    least = rounding(a[known], b[known])
    d = np.sort(a[known] - b[known])  # sorted: the order of the seeds changes no digit of the mean
    d[np.abs(d) <= least] = 0.0
    return d, least


def interquartile_mean(values: ArrayLike) -> IntervalEstimate:
    """Mean of the middle half of all values, with the interval of a trimmed mean.

        IQM = mean of x_(k+1), ..., x_(n-k),
              x_(1) <= ... <= x_(n),   k = floor(n / 4),   h = n - 2 k
        IQM -+ t_{h-1}(0.975) sqrt(SSD / (h (h - 1)))

    SSD: sum of squared deviations of the Winsorised values, in which x_(1), ..., x_(k) are set to
    x_(k+1), and the k greatest to x_(n-k). Infinity (of one sign) is a run that is worse than any
    with a number: of up to k of them all is finite; of more the mean is infinite, and has no
    interval. NaN is left out. There is no interval of fewer than FEWEST runs.

    Reference: Agarwal et al. 2021, Deep reinforcement learning at the edge of the statistical
        precipice, NeurIPS, arXiv:2108.13264; Tukey & McLaughlin 1963, Sankhya A 25, 331-352
        (interval).
    """
    x = np.asarray(values, dtype=float)
    x = np.sort(x[~np.isnan(x)])  # the order of the runs does not matter
    n = len(x)
    if not n:
        return NOTHING
    k = n // 4
    middle = x[k : n - k]
    mean = float(middle.mean())
    if n < FEWEST or not math.isfinite(mean):
        return IntervalEstimate(mean, n=n)
    winsorised = np.clip(x, middle[0], middle[-1])
    deviations = float(((winsorised - winsorised.mean()) ** 2).sum())
    h = len(middle)
    if deviations == 0:
        return IntervalEstimate(mean, mean, mean, n)
    return IntervalEstimate(
        mean, *MeanEstimate(mean, math.sqrt(deviations / (h * (h - 1))), h - 1).interval(), n
    )
