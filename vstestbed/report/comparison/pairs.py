"""Pairwise comparison of controllers on their common seeds: differences of the metrics, and successes (paired design)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from vstestbed.report.comparison.columns import ComparisonResults, ControllerResults, Metric
from vstestbed.report.comparison.statistics import Difference, SuccessDifference, paired_difference, paired_success

MOST_CONTROLLERS = 6
"""Up to this many controllers every pair is compared (15 pairs); with more, each controller with the first."""
CHANCE = 0.05
"""Significance level of McNemar's test on successes."""
TIME = Metric.of("time_to_converge_s")


@dataclass(frozen=True)
class Pair:
    """Controller b against controller a (indices into the comparison's controllers).

    Attributes:
        success: on how many seeds only a, only b, both, neither reached the goal.
        differences: b minus a by metric, in its display unit, over the seeds on which both reached the goal (all seeds for `every_pair`).
        means: mean of a by metric over the same seeds, the reference of relative differences.
    """

    a: int
    b: int
    success: SuccessDifference
    differences: dict[str, Difference]
    means: dict[str, float]

    @property
    def seeds(self) -> int:
        """Number of common seeds."""
        s = self.success
        return s.only_a + s.only_b + s.both + s.neither

    @property
    def success_is_real(self) -> bool:
        """Whether the success rates differ significantly."""
        return self.success.p < CHANCE

    @property
    def better(self) -> int | None:
        """The controller that is significantly better in success or in time and not worse in the other; None if there is none.

        Success and time to converge vote; where they vote for different controllers (more often, but later) neither is better.
        """
        votes = set()  # one vote each of success and time
        if self.success_is_real:
            votes.add(self.b if self.success.only_b > self.success.only_a else self.a)
        time = self.differences[TIME.name]
        if time.real:
            votes.add(self.b if time.mean < 0 else self.a)
        return votes.pop() if len(votes) == 1 else None

    def turned(self) -> Pair:
        """The same pair with a and b exchanged."""
        s = self.success
        success = replace(s, only_a=s.only_b, only_b=s.only_a)
        differences = {k: replace(d, mean=-d.mean, low=-d.high, high=-d.low) for k, d in self.differences.items()}
        # the mean of b over the common seeds is the mean of a plus the mean difference
        return Pair(self.b, self.a, success, differences, {k: m + self.differences[k].mean for k, m in self.means.items()})


def pairs(comparison: ComparisonResults) -> list[Pair]:
    """Every pair of controllers, the later against the earlier; with more than six controllers each one against the first."""
    n = len(comparison.controllers)
    chosen = combinations(range(n), 2) if n <= MOST_CONTROLLERS else ((0, b) for b in range(1, n))
    return [_pair(comparison, a, b) for a, b in chosen]


def against(all_pairs: list[Pair], reference: int) -> list[Pair]:
    """The pairs that contain the controller `reference`, exchanged where needed so that it is a."""
    return [p if p.a == reference else p.turned() for p in all_pairs if reference in (p.a, p.b)]


def _pair(comparison: ComparisonResults, a: int, b: int) -> Pair:
    first, second = comparison.controllers[a], comparison.controllers[b]
    rows_a, rows_b = _same_seeds(first, second)
    both = first.success[rows_a] & second.success[rows_b]
    differences, means = {}, {}
    # time to converge decides which controller is better, so that it is needed even where the page does not show it
    for metric in {m.name: m for m in (*comparison.shown, TIME)}.values():
        x, y = first.values(metric)[rows_a], second.values(metric)[rows_b]
        # the same seeds for both, or the difference would not be paired
        used = (both | metric.every_pair) & np.isfinite(x) & np.isfinite(y)
        differences[metric.name] = paired_difference(y[used], x[used])
        means[metric.name] = float(x[used].mean()) if used.any() else np.nan
    return Pair(a, b, paired_success(first.success[rows_a], second.success[rows_b]), differences, means)


def _same_seeds(one: ControllerResults, other: ControllerResults) -> tuple[list[int], list[int]]:
    """Row indices of the common seeds in both controllers' runs, in the same order of seeds."""
    where = {seed: i for i, seed in enumerate(other.seeds)}
    shared = [(i, where[seed]) for i, seed in enumerate(one.seeds) if seed in where]
    return [i for i, _ in shared], [k for _, k in shared]
