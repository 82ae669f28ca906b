"""Pairwise comparison of controllers on their common seeds: differences of the metrics, and successes (paired design)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import polars as pl

from vstestbed.core.files import write_table
from vstestbed.report.comparison.columns import ComparisonResults, ControllerResults, Metric
from vstestbed.report.comparison.statistics import (
    Difference,
    Improvement,
    Interquartile,
    SuccessDifference,
    holm,
    improvement,
    paired_difference,
    paired_success,
    spread,
    success_rate,
    wilson,
)

MOST_CONTROLLERS = 6
"""Up to this many controllers every pair is compared (15 pairs); with more, each controller with the first."""
CHANCE = 0.05
"""Significance level of all tests together."""
SUCCESS = "success"
"""Key of the test on successes among those of a pair."""
Of = Literal["difference", "improvement"]
Test = tuple[str, Of]
"""A test of a pair: of which metric (or of success), and of what."""
TIME = Metric.of("time_to_converge_s")


@dataclass(frozen=True)
class Pair:
    """Controller b against controller a (indices into the comparison's controllers).

    Attributes:
        success: on how many seeds only a, only b, both, neither reached the goal.
        differences: b minus a by metric, in its display unit, over the seeds on which both reached the goal (all seeds for `every_pair`).
        means: mean of a by metric over the same seeds, the reference of relative differences.
        improvements: probability by metric that b is better than a on the same seed, over all common seeds (`ControllerResults.ranked`).
        adjusted: `tests` after Holm's correction over all tests of all pairs.
    """

    a: int
    b: int
    success: SuccessDifference
    differences: dict[str, Difference]
    means: dict[str, float]
    improvements: dict[str, Improvement]
    adjusted: dict[Test, float] = field(default_factory=dict)

    @property
    def tests(self) -> dict[Test, float]:
        """P-values, each by itself: of the differences of success and of each metric, and of improvements; NaN where there is no test."""
        found: dict[Test, float] = {(SUCCESS, "difference"): self.success.p if self.seeds else math.nan}
        for name, difference in self.differences.items():
            found[name, "difference"] = difference.p
            found[name, "improvement"] = self.improvements[name].p
        return found

    def is_real(self, name: str, of: Of = "difference") -> bool:
        """Whether the difference of a metric or of success, or the improvement of a metric, is significant after Holm's correction."""
        return self.adjusted[name, of] <= CHANCE

    @property
    def seeds(self) -> int:
        """Number of common seeds."""
        s = self.success
        return s.only_a + s.only_b + s.both + s.neither

    @property
    def better(self) -> int | None:
        """The controller that is significantly better in success or in time and not worse in the other; None if there is none.

        Success and time to converge vote; where they vote for different controllers (more often, but later) neither is better.
        """
        votes = set()  # one vote each of success and time
        if self.is_real(SUCCESS):
            votes.add(self.b if self.success.only_b > self.success.only_a else self.a)
        time = self.differences[TIME.name]
        if self.is_real(TIME.name):
            votes.add(self.b if time.mean < 0 else self.a)
        return votes.pop() if len(votes) == 1 else None

    def turned(self) -> Pair:
        """The same pair with a and b exchanged."""
        s = self.success
        success = replace(s, only_a=s.only_b, only_b=s.only_a)
        differences = {k: d.turned() for k, d in self.differences.items()}
        # the mean of b over the common seeds is the mean of a plus the mean difference
        means = {k: m + self.differences[k].mean for k, m in self.means.items()}
        improvements = {k: replace(i, share=1 - i.share, low=1 - i.high, high=1 - i.low) for k, i in self.improvements.items()}
        return Pair(self.b, self.a, success, differences, means, improvements, self.adjusted)


def pairs(comparison: ComparisonResults) -> list[Pair]:
    """Every pair of controllers, the later against the earlier; with more than six controllers each one against the first.

    The p-values of all of them are corrected together (Holm).
    """
    n = len(comparison.controllers)
    chosen = combinations(range(n), 2) if n <= MOST_CONTROLLERS else ((0, b) for b in range(1, n))
    found = [_pair(comparison, a, b) for a, b in chosen]
    adjusted = iter(holm([p for pair in found for p in pair.tests.values()]))
    return [replace(pair, adjusted={test: next(adjusted) for test in pair.tests}) for pair in found]


def tests(all_pairs: list[Pair]) -> int:
    """Number of tests over which the p-values are corrected."""
    return sum(not math.isnan(p) for pair in all_pairs for p in pair.tests.values())


def against(all_pairs: list[Pair], reference: int) -> list[Pair]:
    """The pairs that contain the controller `reference`, exchanged where needed so that it is a."""
    return [p if p.a == reference else p.turned() for p in all_pairs if reference in (p.a, p.b)]


def _pair(comparison: ComparisonResults, a: int, b: int) -> Pair:
    first, second = comparison.controllers[a], comparison.controllers[b]
    rows_a, rows_b = _same_seeds(first, second)
    both = first.success[rows_a] & second.success[rows_b]
    differences, means, improvements = {}, {}, {}
    # time to converge decides which controller is better, so that it is needed even where the page does not show it
    for metric in {m.name: m for m in (*comparison.shown, TIME)}.values():
        x, y = first.values(metric)[rows_a], second.values(metric)[rows_b]
        # the same seeds for both, or the difference would not be paired
        used = (both | metric.every_pair) & np.isfinite(x) & np.isfinite(y)
        differences[metric.name] = paired_difference(y[used], x[used])
        means[metric.name] = float(x[used].mean()) if used.any() else np.nan
        improvements[metric.name] = improvement(first.ranked(metric)[rows_a], second.ranked(metric)[rows_b])
    return Pair(a, b, paired_success(first.success[rows_a], second.success[rows_b]), differences, means, improvements)


def _same_seeds(one: ControllerResults, other: ControllerResults) -> tuple[list[int], list[int]]:
    """Row indices of the common starts in both controllers' runs, in the same order."""
    where = {start: i for i, start in enumerate(other.starts)}
    shared = [(i, where[start]) for i, start in enumerate(one.starts) if start in where]
    return [i for i, _ in shared], [k for _, k in shared]


# The statistics of a comparison as two tables for other programs: of each controller, and of each pair, with one row per metric.
CONTROLLERS: Final = "controllers"
PAIRS: Final = "pairs"
"""File names without suffix; each table is written as Parquet and as CSV."""
_NUMBER, _TEXT, _COUNT = pl.Float64(), pl.String(), pl.Int64()
_OF_CONTROLLER: Final[dict[str, Any]] = (
    dict.fromkeys(("controller", "metric", "title", "unit", "better"), _TEXT)
    | dict.fromkeys(("runs", "succeeded"), _COUNT)
    | dict.fromkeys(("success", "success_low", "success_high", "median", "q1", "q3"), _NUMBER)
    | {"median_runs": _COUNT}
    | dict.fromkeys(("iqm", "iqm_low", "iqm_high"), _NUMBER)
    | {"iqm_runs": _COUNT}
)
_OF_PAIR: Final[dict[str, Any]] = (
    dict.fromkeys(("controller", "against", "metric", "title", "unit", "better"), _TEXT)
    | dict.fromkeys(("difference", "low", "high"), _NUMBER)
    | {"pairs": _COUNT, "skewness": _NUMBER, "p": _NUMBER, "p_holm": _NUMBER, "significant": pl.Boolean()}
    | dict.fromkeys(("improvement", "improvement_low", "improvement_high"), _NUMBER)
    | {"improvement_pairs": _COUNT, "improvement_p": _NUMBER, "improvement_p_holm": _NUMBER, "improvement_significant": pl.Boolean()}
)


def write_records(
    folder: Path, comparison: ComparisonResults, means: Sequence[Mapping[str, Interquartile]], all_pairs: Sequence[Pair]
) -> None:
    """Write `controllers` and `pairs`, each as `.parquet` and `.csv`, into a comparison's folder.

    Args:
        folder: the comparison's. comparison: the runs. means: `interquartiles` of them. all_pairs: their pairs.

    Raises:
        OutputError: a file cannot be written.
    """
    for name, table in ((CONTROLLERS, controller_records(comparison, means)), (PAIRS, pair_records(comparison, all_pairs))):
        write_table(folder / name, table)


def controller_records(comparison: ComparisonResults, means: Sequence[Mapping[str, Interquartile]]) -> pl.DataFrame:
    """A row for each controller and metric: successes with their interval, median and quartiles, interquartile mean; display units.

    An infinite `iqm`, or end of its interval: more than a quarter of the runs failed, or could have.
    """
    rows: list[dict[str, Any]] = []
    for controller, found in zip(comparison.controllers, means, strict=True):
        rate = success_rate(int(controller.success.sum()), len(controller.success))
        for metric in comparison.shown:
            middle, mean = spread(controller.counted(metric)), found[metric.name]
            rows.append(
                {"controller": controller.label, **_named(metric), "runs": rate.n, "succeeded": rate.successes}
                | {"success": rate.rate, "success_low": rate.low, "success_high": rate.high}
                | {"median": middle.median, "q1": middle.q1, "q3": middle.q3, "median_runs": middle.n}
                | {"iqm": mean.mean, "iqm_low": mean.low, "iqm_high": mean.high, "iqm_runs": mean.n}
            )
    return pl.DataFrame(rows, schema=_OF_CONTROLLER).with_columns(pl.col(pl.Float64).fill_nan(None))


def pair_records(comparison: ComparisonResults, all_pairs: Sequence[Pair]) -> pl.DataFrame:
    """A row for each pair and metric, success first: the difference `controller` minus `against` with its interval and p-values.

    `improvement` is the probability that `controller` is better than `against`. The difference of successes is that of the rates over the
    common seeds, and has no interval.
    """
    labels = [c.label for c in comparison.controllers]
    rows: list[dict[str, Any]] = []
    for pair in all_pairs:
        names: dict[str, Any] = {"controller": labels[pair.b], "against": labels[pair.a]}
        rows.append(names | _success_of(pair))
        for metric in comparison.shown:
            d = pair.differences[metric.name]
            rows.append(
                names
                | _named(metric)
                | {"difference": d.mean, "low": d.low, "high": d.high, "pairs": d.n, "skewness": d.skewness}
                | _tested(pair, metric.name)
                | _improved(pair.improvements[metric.name])
                | {"improvement_p_holm": pair.adjusted[metric.name, "improvement"]}
                | {"improvement_significant": pair.is_real(metric.name, "improvement")}
            )
    return pl.DataFrame(rows, schema=_OF_PAIR).with_columns(pl.col(pl.Float64).fill_nan(None))


def _named(metric: Metric) -> dict[str, Any]:
    return {"metric": metric.name, "title": metric.title, "unit": metric.unit, "better": "higher" if metric.higher else "lower"}


def _tested(pair: Pair, name: str) -> dict[str, Any]:
    test = (name, "difference")
    return {"p": pair.tests[test], "p_holm": pair.adjusted[test], "significant": pair.is_real(name)}


def _improved(found: Improvement) -> dict[str, Any]:
    names = ("improvement", "improvement_low", "improvement_high", "improvement_pairs", "improvement_p")
    return dict(zip(names, (found.share, found.low, found.high, found.n, found.p), strict=True))


def _success_of(pair: Pair) -> dict[str, Any]:
    s, n = pair.success, pair.seeds
    named = {"metric": SUCCESS, "title": "Reached the goal", "unit": "", "better": "higher", "pairs": n}
    if not n:
        return named | _tested(pair, SUCCESS) | {"improvement_pairs": 0}
    share = (s.only_b + (s.both + s.neither) / 2) / n
    low, high = wilson(share, n)
    return (
        named
        | {"difference": (s.only_b - s.only_a) / n}
        | _tested(pair, SUCCESS)
        | _improved(Improvement(share, float(low), float(high), n))
    )
