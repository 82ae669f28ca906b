"""Pairs of controllers on their common starts (paired design), each with its verdict; all else that
is compared is exploratory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.report.comparison import statistics as stats
from vstestbed.report.comparison.results import RESTRICTED, ComparisonResults, ControllerResults
from vstestbed.report.comparison.verdict import (
    ALPHA,
    PairTest,
    Side,
    Starts,
    Verdict,
    judge,
    test_of,
)
from vstestbed.tasks.metrics import Metric

__all__ = ["SUCCESS", "Of", "Pair", "against", "has_every_pair", "pairs"]

MOST_CONTROLLERS = 6
"""Up to this many controllers every metric of every pair is compared; with more, those of each with
the reference.
"""
# Up to this many controllers every pair has a verdict; with more, each controller with the
# reference
MOST_PAIRED = 24
SUCCESS = Metric("success", "Reached the goal", better=1)
Of = Literal["difference", "improvement"]
Test = tuple[str, Of]  # An exploratory test of a pair: of which metric, and of what


@dataclass(frozen=True)
class Pair:
    """Controller b against controller a (indices into the comparison's controllers)."""

    a: int
    b: int
    primary: Metric  # the metric that decides where success does not
    test: PairTest
    verdict: Verdict
    late: int  # arrivals after the limit of the other one, which count as failures
    # b minus a by metric, in its display unit, as flown: of the primary metric over all common
    # seeds, of the others, which are exploratory, over the seeds on which both reached the goal
    # (all seeds for `every_pair`)
    differences: dict[str, stats.IntervalEstimate]
    # probability by exploratory metric that b is better than a on the same seed, over all common
    # seeds (`ControllerResults.ranked`)
    improvements: dict[str, stats.IntervalEstimate]
    # p-values of all exploratory tests by Holm
    adjusted: dict[Test, float] = field(default_factory=dict)

    @property
    def exploratory(self) -> dict[Test, float]:
        """P-values of the exploratory tests, each by itself; NaN where there is no test."""
        found: dict[Test, float] = {
            (name, "difference"): self.differences[name].p for name in self.improvements
        }
        found.update({(name, "improvement"): i.p for name, i in self.improvements.items()})
        return found

    def is_real(self, name: str, of: Of = "difference") -> bool:
        """Whether a difference or an improvement is beyond chance, by its adjusted p."""
        if name == SUCCESS.name:
            return self.verdict.by_success
        if name == self.primary.name:
            return self.verdict.by_cost
        return self.adjusted[name, of] <= ALPHA

    @property
    def seeds(self) -> int:
        """Number of common seeds."""
        return self.test.n

    @property
    def better(self) -> int | None:
        """The controller that the verdict calls better; None where the runs do not tell."""
        return self.of(self.verdict.better)

    @property
    def sooner(self) -> int | None:
        """The controller that arrives first from more starts, beyond chance; None without one."""
        return self.of(self.verdict.sooner)

    def of(self, side: Side | None) -> int | None:
        """The controller on a side."""
        return {"a": self.a, "b": self.b, None: None}[side]

    @property
    def deciding(self) -> tuple[float, float]:
        """Both ends of the interval of the primary difference b - a with failures not yet seen, in
        its display unit.
        """
        low, high = self.test.unseen
        return (-high, -low) if self.primary.better > 0 else (low, high)

    @property
    def worst(self) -> float:
        """What a failure costs: the limit of time, or the worst value of the primary metric, in its
        display unit.
        """
        return -self.test.worst if self.primary.better > 0 else self.test.worst

    def turned(self) -> Pair:
        """The same pair with a and b exchanged."""
        return replace(
            self,
            a=self.b,
            b=self.a,
            test=self.test.turned(),
            verdict=self.verdict.turned(),
            differences={name: d.turned() for name, d in self.differences.items()},
            improvements={name: i.turned(1.0) for name, i in self.improvements.items()},
        )


def pairs(comparison: ComparisonResults) -> list[Pair]:
    """Every pair of controllers, the later against the earlier; with a reference, or of many
    controllers, each against the reference.

    Three families of tests, each adjusted by Holm: those of the verdicts of all pairs, those of who
    is sooner, and all exploratory ones.
    """
    n = len(comparison.controllers)
    reference = comparison.reference_index
    chosen = [(reference, b) for b in range(n) if b != reference]
    if has_every_pair(n, comparison.reference):
        chosen = list(combinations(range(n), 2))
    common = [_Common(comparison, a, b) for a, b in chosen]
    tests = [test_of(one.starts, comparison.margin) for one in common]
    found = []
    for one, test, verdict in zip(common, tests, judge(tests), strict=True):
        explored = n <= MOST_CONTROLLERS or reference in (one.a, one.b)
        found.append(_pair(one, test, verdict, comparison.exploratory if explored else ()))
    return _adjusted(found)


def _adjusted(found: list[Pair]) -> list[Pair]:
    """The pairs with the p-values of all exploratory tests together."""
    adjusted = iter(stats.holm([p for pair in found for p in pair.exploratory.values()]))
    return [
        replace(pair, adjusted=dict(zip(pair.exploratory, adjusted, strict=False)))
        for pair in found
    ]


def _pair(one: _Common, test: PairTest, verdict: Verdict, metrics: Sequence[Metric]) -> Pair:
    """A pair with its exploratory differences, whose p-values are still to be adjusted."""
    differences = {one.primary.name: _as_flown(test, one.primary)}
    differences |= {metric.name: one.difference(metric) for metric in metrics}
    improvements = {metric.name: one.improvement(metric) for metric in metrics}
    return Pair(one.a, one.b, one.primary, test, verdict, one.late, differences, improvements)


def has_every_pair(controllers: int, reference: str) -> bool:
    """Whether so many controllers are compared all with all, and not each with one of them."""
    return controllers <= MOST_PAIRED and not reference


def _as_flown(test: PairTest, primary: Metric) -> stats.IntervalEstimate:
    """The mean of b - a of the primary metric over all common starts, in its display unit, with
    failures as the rule counts them.
    """
    if not test.n:
        return stats.NOTHING
    found = stats.IntervalEstimate(test.saved.negative().mean, *test.seen, test.n, test.p_either)
    return found.turned() if primary.better > 0 else found


def against(all_pairs: Sequence[Pair], reference: int) -> list[Pair]:
    """The pairs that contain the controller `reference`, exchanged where needed so that it is a."""
    return [p if p.a == reference else p.turned() for p in all_pairs if reference in (p.a, p.b)]


class _Common:
    """Two controllers on their common starts."""

    def __init__(self, comparison: ComparisonResults, a: int, b: int):
        self.a = a
        self.b = b
        self.primary = comparison.primary_metric
        self._comparison = comparison
        self._first = first = comparison.controllers[a]
        self._second = second = comparison.controllers[b]
        where = {start: k for k, start in enumerate(second.starts)}
        shared = [(i, where[start]) for i, start in enumerate(first.starts) if start in where]
        self._rows_a = [i for i, _ in shared]
        self._rows_b = [k for _, k in shared]
        self._times_a = first.values(RESTRICTED)[self._rows_a]
        self._times_b = second.values(RESTRICTED)[self._rows_b]
        limits_a = first.limits[self._rows_a]
        limits_b = second.limits[self._rows_b]
        self._limits = np.fmin(limits_a, limits_b)  # both are judged by the earlier one
        arrived_a = first.success[self._rows_a]
        arrived_b = second.success[self._rows_b]
        late_a = arrived_a & (limits_a > self._limits) & (self._times_a > self._limits)
        late_b = arrived_b & (limits_b > self._limits) & (self._times_b > self._limits)
        self.late = int(late_a.sum() + late_b.sum())
        self.reached_a: NDArray[np.bool_] = arrived_a & ~late_a
        self.reached_b: NDArray[np.bool_] = arrived_b & ~late_b

    @property
    def starts(self) -> Starts:
        """What the rule needs of both."""
        times_a, times_b, limit = self._times()
        cost_a, cost_b, worst = times_a, times_b, limit
        if self.primary != RESTRICTED:
            cost_a, cost_b, worst = self._costs()
        period = max(self._first.period_s, self._second.period_s)
        tasks = [self._first.tasks[i] for i in self._rows_a]
        strata = np.unique(tasks, return_inverse=True)[1]
        return Starts(
            self.reached_a, self.reached_b, cost_a, cost_b, worst, period, strata, times_a, times_b
        )

    def _times(self) -> tuple[Array, Array, float]:
        """Times to the goal, a failure at the earlier of both limits; and the greatest of these
        limits.
        """
        a = self._times_a
        b = self._times_b
        # a table of an earlier version in which nothing failed does not tell its limit: it is the
        # longest time or more
        limits = np.where(np.isnan(self._limits), np.nanmax([*a, *b, 0.0]), self._limits)
        a = np.where(self.reached_a, np.fmin(a, limits), limits)
        b = np.where(self.reached_b, np.fmin(b, limits), limits)
        return a, b, float(limits.max(initial=0.0))

    def _costs(self) -> tuple[Array, Array, float]:
        """The primary metric, less is better; a failure without a number that means something has
        the worst of the whole comparison.
        """
        metric = self.primary
        known = np.concatenate(
            [_less(controller, metric) for controller in self._comparison.controllers]
        )
        known = known[np.isfinite(known)]
        worst = float(known.max()) if len(known) else math.nan  # no run has it
        a = _less(self._first, metric)[self._rows_a]
        b = _less(self._second, metric)[self._rows_b]
        if not metric.every_run:
            a = np.where(self.reached_a, a, worst)
            b = np.where(self.reached_b, b, worst)
        return np.where(np.isfinite(a), a, worst), np.where(np.isfinite(b), b, worst), worst

    def difference(self, metric: Metric) -> stats.IntervalEstimate:
        """The mean of b - a of an exploratory metric."""
        x = self._first.values(metric)[self._rows_a]
        y = self._second.values(metric)[self._rows_b]
        if metric == RESTRICTED:
            x, y, _ = self._times()
        # the same seeds for both, or the difference would not be paired
        used = (
            ((self.reached_a & self.reached_b) | metric.every_pair)
            & np.isfinite(x)
            & np.isfinite(y)
        )
        return stats.paired_difference(y[used], x[used])

    def improvement(self, metric: Metric) -> stats.IntervalEstimate:
        """The probability that b is better than a from the same start."""
        return stats.improvement(
            self._first.ranked(metric)[self._rows_a], self._second.ranked(metric)[self._rows_b]
        )


def _less(controller: ControllerResults, metric: Metric) -> Array:
    """The values of a metric turned so that less is better."""
    return controller.values(metric) * (-1.0 if metric.better > 0 else 1.0)
