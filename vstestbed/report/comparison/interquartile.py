"""Interquartile mean with its stratified bootstrap interval: as robust as a median against few wild runs, and less noisy."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vstestbed.core.geometry import Array
from vstestbed.report.comparison.columns import ComparisonResults, ControllerResults, Metric
from vstestbed.report.comparison.resampling import draws, remembered
from vstestbed.report.comparison.statistics import check_confidence

FEWEST: Final = 5
"""Fewest runs for an interval: of four, the mean of two has hardly any other values."""

MOST: Final = 200
"""Most runs for the bootstrap: of more, the normal approximation is within a few hundredths of it, at no cost."""

RESAMPLES: Final = 1999


@dataclass(frozen=True, slots=True)
class Interquartile:
    """Interquartile mean of `n` runs with its interval, in the unit of the values; infinite where too many runs have no number."""

    mean: float
    low: float
    high: float
    n: int


NOTHING: Final = Interquartile(math.nan, math.nan, math.nan, 0)


def interquartiles(comparison: ComparisonResults) -> list[dict[str, Interquartile]]:
    """Of each controller: the interquartile mean of each shown metric over all its runs, in its display unit; the tasks are the strata.

    Infinite (minus infinity for a metric of which more is better) where more than a quarter of the runs failed. `n` is 0 where no run that
    reached the goal has the number, although some did, and where none has one that failed runs have, too: there is no such number.
    """
    return [{metric.name: _of(controller, metric) for metric in comparison.shown} for controller in comparison.controllers]


def _of(controller: ControllerResults, metric: Metric) -> Interquartile:
    known, reached = np.isfinite(controller.values(metric)), controller.success
    if (reached.any() and not known[reached].any()) or (metric.every_pair and not known.any()):
        return NOTHING
    found = interquartile_mean(controller.ranked(metric), controller.tasks)
    return replace(found, mean=-found.mean, low=-found.high, high=-found.low) if metric.higher else found


def interquartile_mean(
    values: ArrayLike, strata: ArrayLike | None = None, confidence: float = 0.95, seed: int = 0, resamples: int = RESAMPLES
) -> Interquartile:
    """Mean of the middle half of all values, with a stratified bootstrap interval.

        IQM = mean of x_(k+1), ..., x_(n-k),        x_(1) <= ... <= x_(n),   k = floor(n / 4)

    Each resample draws as many values as there are from each stratum, so that its share of the runs stays. The interval has the ends of
    the percentile interval, expanded for small n: at the level Phi(-sqrt(n / f) t(alpha / 2, f)) with f = n - number of strata. It
    holds the true mean in 95 to 96 % of 3000 samples at n = 20 (normal, exponential, lognormal, Student's t with 2 degrees of freedom,
    two humps), in 97 % at 10, in 88 to 94 % at 5, and in 94 to 96 % at 50 and 200. Strata of two runs make it too short (78 %), those of
    four do not (95 %). Over MOST runs it is normal, with the standard error of the trimmed mean by Winsorised variances within the strata.

    Infinity (of one sign) is a run that is worse than any with a number. Of up to k of them the mean is finite; an end of the interval is
    infinite where the resamples beyond it have more.

    Args:
        values: shape (N,); NaN is left out. strata: of each value, any numbers, shape (N,); None: all in one.
        confidence: of the interval, in 0..1. seed: of the resampling. resamples: how many.

    Returns:
        The mean; low and high are NaN with fewer than FEWEST runs, or where no stratum has two.

    Raises:
        ParameterError: confidence is not between 0 and 1.

    Reference: Agarwal et al. 2021, Deep reinforcement learning at the edge of the statistical precipice, NeurIPS, arXiv:2108.13264;
        Hesterberg 2015 (expanded percentiles), doi:10.1080/00031305.2015.1089789; Tukey & McLaughlin 1963 (standard error),
        Sankhya A 25, 331-352.
    """
    check_confidence(confidence)
    x = np.asarray(values, dtype=float)
    stratum = np.zeros(len(x), dtype=int) if strata is None else np.unique(np.asarray(strata), return_inverse=True)[1]
    known = ~np.isnan(x)
    x, stratum = x[known], stratum[known]
    n = len(x)
    if not n:
        return NOTHING
    order = np.lexsort((x, stratum))  # the order of the runs does not matter
    x, stratum = x[order], stratum[order]
    sizes = tuple(int(size) for size in np.bincount(stratum) if size)
    mean = _mean(np.sort(x), n // 4)
    freedom = n - len(sizes)
    if n < FEWEST or freedom < 1:
        return Interquartile(mean, math.nan, math.nan, n)
    if n > MOST and _far_from_a_quarter(x):
        half = NormalDist().inv_cdf((1 + confidence) / 2) * _error(x, stratum)
        return Interquartile(mean, mean - half, mean + half, n)
    means = _resampled(x, sizes, seed, resamples if n <= MOST else max(199, resamples * MOST // n))
    low, high = np.quantile(means, _levels(n, freedom, confidence), method="inverted_cdf")
    return Interquartile(mean, float(low), float(high), n)


def _mean(ordered: Array, k: int) -> float:
    return float(ordered[k : len(ordered) - k].mean())


def _levels(n: int, freedom: int, confidence: float) -> tuple[float, float]:
    """Both levels of the expanded percentile interval."""
    from scipy.special import stdtrit  # imported here: it costs time that other commands need not pay

    low = NormalDist().cdf(-math.sqrt(n / freedom) * float(stdtrit(freedom, (1 + confidence) / 2)))
    return low, 1 - low


def _resampled(x: Array, sizes: tuple[int, ...], seed: int, resamples: int) -> Array:
    """Interquartile means of resamples, shape (resamples,); x: the values, stratum by stratum, shape (sum of sizes,)."""
    n, k = len(x), len(x) // 4
    order = np.argsort(x, kind="stable")
    drawn = (remembered if n <= MOST else draws)(sizes, resamples, seed)[:, order]
    # how many of the copies of each value, in ascending order, lie in the middle n - 2 k places
    last = np.cumsum(drawn, axis=1)
    middle = np.clip(last, k, n - k) - np.clip(last - drawn, k, n - k)
    ordered = x[order]
    finite = np.isfinite(ordered)
    means = middle[:, finite] @ ordered[finite] / (n - 2 * k)
    if finite.all():
        return means
    return np.where(middle[:, ~finite].any(axis=1), ordered[~finite][0], means)


def _far_from_a_quarter(x: Array) -> bool:
    """Whether the number of infinite values is so far from a quarter that it is on the same side in practically every resample."""
    n, share = len(x), float(np.isinf(x).mean())
    return share == 0 or abs(share - 0.25) > 5 * math.sqrt(share * (1 - share) / n)


def _error(x: Array, stratum: NDArray[np.int_]) -> float:
    """Standard error: that of the mean of Winsorised values, over the share of the middle; 0 where the mean is infinite."""
    n, k = len(x), len(x) // 4
    ordered = np.sort(x)
    low, high = ordered[k], ordered[n - k - 1]
    if not np.isfinite(low + high):
        return 0.0
    winsorised = np.clip(x, low, high)
    size = np.bincount(stratum).astype(float)
    centred = winsorised - (np.bincount(stratum, winsorised) / np.maximum(size, 1))[stratum]
    squares = np.bincount(stratum, centred**2)
    variance = float((squares * size / np.maximum(size - 1, 1)).sum()) / n**2
    return math.sqrt(variance) / (1 - 2 * k / n)
