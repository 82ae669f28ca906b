"""Controllers two by two, on the seeds that both ran: differences of their numbers, and who reached the goal where."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from vstestbed.report.comparison.columns import ComparisonResults, ControllerResults, Metric
from vstestbed.report.comparison.statistics import Difference, SuccessDifference, paired_difference, paired_success

MOST_CONTROLLERS = 6
"""Up to so many controllers, each is compared with each; of more, each with the first."""
CHANCE = 0.05
"""A difference of success rates is real where chance alone would show one as large less often than this."""
TIME = Metric.of("time_to_converge_s")


@dataclass(frozen=True)
class Pair:
    """Controller b against controller a (numbers of the comparison's controllers).

    Attributes:
        success: on how many seeds only a, only b, both, neither reached the goal.
        differences: b minus a of each metric in its unit, over the seeds on which both reached the goal, or all (`every_pair`).
        means: of a, over the same seeds; what a difference is a share of.
    """

    a: int
    b: int
    success: SuccessDifference
    differences: dict[str, Difference]
    means: dict[str, float]

    @property
    def seeds(self) -> int:
        """How many seeds both ran."""
        s = self.success
        return s.only_a + s.only_b + s.both + s.neither

    @property
    def success_is_real(self) -> bool:
        """Whether one reaches the goal more often, beyond chance."""
        return self.success.p < CHANCE

    @property
    def better(self) -> int | None:
        """The controller that reaches the goal more often, or as often as one can tell and sooner; None if neither or both."""
        votes = set()
        if self.success_is_real:
            votes.add(self.b if self.success.only_b > self.success.only_a else self.a)
        time = self.differences[TIME.name]
        if time.real:
            votes.add(self.b if time.mean < 0 else self.a)
        return votes.pop() if len(votes) == 1 else None

    def turned(self) -> Pair:
        """The same two, a against b."""
        s = self.success
        success = replace(s, only_a=s.only_b, only_b=s.only_a)
        differences = {k: replace(d, mean=-d.mean, low=-d.high, high=-d.low) for k, d in self.differences.items()}
        return Pair(self.b, self.a, success, differences, {k: m + self.differences[k].mean for k, m in self.means.items()})


def pairs(comparison: ComparisonResults) -> list[Pair]:
    """Each two controllers, the later against the earlier; of more than six, each against the first."""
    n = len(comparison.controllers)
    chosen = combinations(range(n), 2) if n <= MOST_CONTROLLERS else ((0, b) for b in range(1, n))
    return [_pair(comparison, a, b) for a, b in chosen]


def against(made: list[Pair], reference: int) -> list[Pair]:
    """Every pair that has the reference, turned so that it is the one compared with."""
    return [p if p.a == reference else p.turned() for p in made if reference in (p.a, p.b)]


def _pair(comparison: ComparisonResults, a: int, b: int) -> Pair:
    one, other = comparison.controllers[a], comparison.controllers[b]
    rows_a, rows_b = _same_seeds(one, other)
    both = one.success[rows_a] & other.success[rows_b]
    differences, means = {}, {}
    for metric in {m.name: m for m in (*comparison.shown, TIME)}.values():
        x, y = one.values(metric)[rows_a], other.values(metric)[rows_b]
        used = (both | metric.every_pair) & np.isfinite(x) & np.isfinite(y)
        differences[metric.name] = paired_difference(y[used], x[used])
        means[metric.name] = float(x[used].mean()) if used.any() else np.nan
    return Pair(a, b, paired_success(one.success[rows_a], other.success[rows_b]), differences, means)


def _same_seeds(one: ControllerResults, other: ControllerResults) -> tuple[list[int], list[int]]:
    """The rows of both that have the same seed, in the same order."""
    where = {seed: i for i, seed in enumerate(other.seeds)}
    shared = [(i, where[seed]) for i, seed in enumerate(one.seeds) if seed in where]
    return [i for i, _ in shared], [k for _, k in shared]
