"""The data of a comparison's report: controllers with their runs, metrics, and pairs of controllers on their common seeds."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, combinations
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.core.files import write_table
from vstestbed.core.geometry import Array
from vstestbed.report.comparison import statistics as stats
from vstestbed.tasks.metrics import EVERY_RUN, SOME_FIGURES, Metric, own_metrics

TASK: Final = "task"  # Column of the task of each run, which only a comparison with tasks has
DEFAULT_METRICS: Final = tuple(metric.name for metric in EVERY_RUN if metric.compared)


def shown_by_default(table: pl.DataFrame) -> tuple[str, ...]:
    """Names of the numbers shown of a comparison that names none: the usual ones, those of some runs, the scenarios' own."""
    # all laws work on grey levels, so that no run measured markers
    grey = {"final_error_grey", "final_error_px"} <= set(table.columns) and table["final_error_px"].is_null().all()
    usual = [name for name in DEFAULT_METRICS if name != "final_error_px" or not grey]
    return (*usual, *(name for name in (*SOME_FIGURES, *own_metrics()) if name in table.columns))


@dataclass(frozen=True)
class ControllerResults:
    """The runs of one controller: a scenario with one combination of the varied values."""

    label: str  # its name on the page
    runs: pl.DataFrame  # its rows of the comparison's table, sorted by seed
    _known: dict[Metric, Array] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Values by metric: each figure and each test asks for them again."""

    @cached_property
    def success(self) -> NDArray[np.bool_]:
        """Whether each run reached its goal, shape (runs,)."""
        return self.runs["success"].cast(pl.Boolean, strict=False).fill_null(False).to_numpy()

    @cached_property
    def seeds(self) -> list[int]:
        """The seed of each run."""
        return self.runs["seed"].to_list()

    @cached_property
    def tasks(self) -> list[str]:
        """The task of each run, all the same where a comparison has none."""
        return [str(task) for task in self.runs[TASK].to_list()] if TASK in self.runs.columns else [""] * len(self.runs)

    @property
    def starts(self) -> list[tuple[str, int]]:
        """Task and seed of each run, by which the runs of two controllers are paired."""
        return list(zip(self.tasks, self.seeds, strict=True))

    def values(self, metric: Metric) -> Array:
        """The metric of every run in its display unit, shape (runs,), read-only; NaN where a run has none."""
        if metric not in self._known:
            stored = self.runs[metric.name] if metric.name in self.runs.columns else pl.Series([None] * len(self.runs))
            # not strict: a crashed run has null, and a number may be stored as text
            column = stored.cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
            self._known[metric] = np.where(np.isfinite(column), column, np.nan) * metric.scale
            self._known[metric].setflags(write=False)
        return self._known[metric]

    def counted(self, metric: Metric) -> Array:
        """As `values`, but NaN for the runs that are excluded from the metric's median (see `Metric.every_run`)."""
        return self.values(metric) if metric.every_run else np.where(self.success, self.values(metric), np.nan)

    def quartiles(self, metric: Metric) -> tuple[float, float, float, int]:
        """First quartile, median, third quartile and number of the `counted` values."""
        return stats.quartiles(self.counted(metric))

    @property
    def rate(self) -> stats.IntervalEstimate:
        """The share of the runs that reached the goal."""
        return stats.success_rate(int(self.success.sum()), len(self.success))

    def ranked(self, metric: Metric) -> Array:
        """As `values`, but less is better, and a run that failed is worse than any that did not: infinity.

        With `every_pair` a failed run has its own value, and infinity only without one (it crashed). NaN: reached the goal, value unknown.
        """
        values = self.values(metric) * (-1.0 if metric.better > 0 else 1.0)
        failed = ~self.success & (np.isnan(values) if metric.every_pair else True)
        return np.where(failed, np.inf, values)


@dataclass(frozen=True)
class ComparisonResults:
    """The table of a finished comparison, grouped by controller."""

    table: pl.DataFrame  # one row a run, as in `comparison.parquet`
    axes: tuple[str, ...] = ()  # paths of the varied fields, each a column of the table
    metrics: tuple[str, ...] = DEFAULT_METRICS  # keys of the numbers that are shown
    description: str = ""  # what is compared, in a few words
    bare: bool = False  # label the controllers of one scenario and one axis by the value alone: `points`, not `law=points`

    @cached_property
    def shown(self) -> tuple[Metric, ...]:
        """The metrics with titles and units."""
        return tuple(map(Metric.named, self.metrics))

    @cached_property
    def controllers(self) -> tuple[ControllerResults, ...]:
        """The controllers, in order of first appearance."""
        keys = self.table.select("scenario", *self.axes).rows()
        rows: dict[tuple[Any, ...], list[int]] = {}
        for i, key in enumerate(keys):
            rows.setdefault(key, []).append(i)
        several = len({key[0] for key in rows}) > 1  # the scenario is part of a label only where there are several
        names = short_names(self.axes)
        if self.bare and len(names) == 1 and not several:
            names = [""]
        labels = [_label((str(key[0]), *map(value_text, key[1:])), names, several) for key in rows]
        if len(set(labels)) < len(labels):  # two values differ only beyond the 6 digits of `:g`
            labels = [_label(tuple(map(str, key)), names, several) for key in rows]
        return tuple(ControllerResults(label, self.table[index].sort("seed")) for label, index in zip(labels, rows.values(), strict=True))

    def first(self, n: int) -> ComparisonResults:
        """The first n controllers alone."""
        return replace(self, table=pl.concat([c.runs for c in self.controllers[:n]]))


def _label(key: tuple[str, ...], names: Sequence[str], several: bool) -> str:
    parts = [key[0]] if several or not names else []  # without varied fields the scenario is all there is to name
    return ", ".join(parts + [f"{name}={value}" if name else value for name, value in zip(names, key[1:], strict=True)])


def short_names(paths: Sequence[str]) -> list[str]:
    """The shortest suffix of each dotted path that is unique among them: `actuation` for `robot.actuation`."""
    suffixes = [[".".join(path.split(".")[-parts:]) for parts in range(1, path.count(".") + 2)] for path in paths]
    common = Counter(chain.from_iterable(suffixes))
    return [next((suffix for suffix in own if common[suffix] == 1), own[-1]) for own in suffixes]


def value_text(value: object) -> str:
    """A varied value as YAML would write it."""
    if value is None or isinstance(value, bool):  # before numbers: bool is an int
        return {None: "null", True: "true", False: "false"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)


# Pairs of controllers on their common seeds: differences of the metrics, and successes (paired design).

MOST_CONTROLLERS = 6  # Up to this many controllers every pair is compared (15 pairs); with more, each controller with the first
CHANCE = 0.05  # Significance level of all tests together
SUCCESS = "success"  # Key of the test on successes among those of a pair
Of = Literal["difference", "improvement"]
Test = tuple[str, Of]  # A test of a pair: of which metric (or of success), and of what
TIME = Metric.named("time_to_converge_s")


@dataclass(frozen=True)
class Pair:
    """Controller b against controller a (indices into the comparison's controllers)."""

    a: int
    b: int
    success: stats.SuccessDifference  # on how many seeds only a, only b, both, neither reached the goal
    # b minus a by metric, in its display unit, over the seeds on which both reached the goal (all seeds for `every_pair`)
    differences: dict[str, stats.IntervalEstimate]
    means: dict[str, float]  # mean of a by metric over the same seeds, the reference of relative differences
    # probability by metric that b is better than a on the same seed, over all common seeds (`ControllerResults.ranked`)
    improvements: dict[str, stats.IntervalEstimate]
    adjusted: dict[Test, float] = field(default_factory=dict)  # `tests` after Holm's correction over all tests of all pairs

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
        """The controller that is significantly better in success or in time to converge and not worse in the other; None without one."""
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
        improvements = {k: i.turned(1.0) for k, i in self.improvements.items()}
        return Pair(self.b, self.a, success, differences, means, improvements, self.adjusted)


def pairs(comparison: ComparisonResults) -> list[Pair]:
    """Every pair of controllers, the later against the earlier; of more than six each against the first. Holm corrects all p-values."""
    n = len(comparison.controllers)
    chosen = combinations(range(n), 2) if n <= MOST_CONTROLLERS else ((0, b) for b in range(1, n))
    found = [_pair(comparison, a, b) for a, b in chosen]
    adjusted = iter(stats.holm([p for pair in found for p in pair.tests.values()]))
    return [replace(pair, adjusted={test: next(adjusted) for test in pair.tests}) for pair in found]


def against(all_pairs: list[Pair], reference: int) -> list[Pair]:
    """The pairs that contain the controller `reference`, exchanged where needed so that it is a."""
    return [p if p.a == reference else p.turned() for p in all_pairs if reference in (p.a, p.b)]


def _pair(comparison: ComparisonResults, a: int, b: int) -> Pair:
    first, second = comparison.controllers[a], comparison.controllers[b]
    where = {start: k for k, start in enumerate(second.starts)}
    shared = [(i, where[start]) for i, start in enumerate(first.starts) if start in where]
    rows_a, rows_b = [i for i, _ in shared], [k for _, k in shared]  # of the common starts
    both = first.success[rows_a] & second.success[rows_b]
    differences, means, improvements = {}, {}, {}
    # time to converge decides which controller is better, so that it is needed even where the page does not show it
    for metric in {m.name: m for m in (*comparison.shown, TIME)}.values():
        x, y = first.values(metric)[rows_a], second.values(metric)[rows_b]
        # the same seeds for both, or the difference would not be paired
        used = (both | metric.every_pair) & np.isfinite(x) & np.isfinite(y)
        differences[metric.name] = stats.paired_difference(y[used], x[used])
        means[metric.name] = float(x[used].mean()) if used.any() else np.nan
        improvements[metric.name] = stats.improvement(first.ranked(metric)[rows_a], second.ranked(metric)[rows_b])
    return Pair(a, b, stats.paired_success(first.success[rows_a], second.success[rows_b]), differences, means, improvements)


Means = list[dict[str, stats.IntervalEstimate]]  # of each controller, by metric


def interquartiles(comparison: ComparisonResults) -> Means:
    """Of each controller: the interquartile mean of each shown metric over all its runs, in its display unit; the tasks are the strata.

    Infinite (of the bad sign) where more than a quarter of the runs failed. `n` is 0 where runs reached the goal and none of them has the
    number, and for a metric of `every_pair` where no run has it.
    """

    def of(controller: ControllerResults, metric: Metric) -> stats.IntervalEstimate:
        known, reached = np.isfinite(controller.values(metric)), controller.success
        if (reached.any() and not known[reached].any()) or (metric.every_pair and not known.any()):
            return stats.NOTHING
        found = stats.interquartile_mean(controller.ranked(metric), controller.tasks)
        return found.turned() if metric.better > 0 else found

    return [{metric.name: of(controller, metric) for metric in comparison.shown} for controller in comparison.controllers]


# The statistics of a comparison as two tables for other programs: of each controller, and of each pair, with one row per metric.
CONTROLLERS: Final = "controllers"
PAIRS: Final = "pairs"  # File names without suffix; each table is written as Parquet and as CSV
_OF_CONTROLLER: Final = (
    *("controller", "metric", "title", "unit", "better", "runs", "succeeded", "success", "success_low", "success_high"),
    *("median", "q1", "q3", "median_runs", "iqm", "iqm_low", "iqm_high", "iqm_runs"),
)
_OF_PAIR: Final = (
    *("controller", "against", "metric", "title", "unit", "better", "difference", "low", "high", "pairs", "skewness"),
    *("p", "p_holm", "significant", "improvement", "improvement_low", "improvement_high", "improvement_pairs"),
    *("improvement_p", "improvement_p_holm", "improvement_significant"),
)
_COUNTS: Final = ("runs", "succeeded", "median_runs", "iqm_runs", "pairs", "improvement_pairs")
_WORDS: Final = ("controller", "against", "metric", "title", "unit", "better")


def write_records(folder: Path, comparison: ComparisonResults, means: Means, all_pairs: Sequence[Pair]) -> None:
    """Write `controllers` and `pairs`, each as `.parquet` and `.csv`, into a comparison's folder; means: `interquartiles`."""
    for name, table in ((CONTROLLERS, controller_records(comparison, means)), (PAIRS, pair_records(comparison, all_pairs))):
        write_table(folder / name, table)


def controller_records(comparison: ComparisonResults, means: Means) -> pl.DataFrame:
    """A row for each controller and metric in display units; an infinite `iqm` or end: a quarter of the runs failed, or could have."""
    rows: list[dict[str, Any]] = []
    for controller, found in zip(comparison.controllers, means, strict=True):
        rate = controller.rate
        for metric in comparison.shown:
            q1, median, q3, n = controller.quartiles(metric)
            rows.append(
                {"controller": controller.label, **_named(metric), "runs": rate.n, "succeeded": int(controller.success.sum())}
                | {"success": rate.mean, "success_low": rate.low, "success_high": rate.high}
                | {"median": median, "q1": q1, "q3": q3, "median_runs": n}
                | _estimate(found[metric.name], "iqm", "iqm_low", "iqm_high", "iqm_runs")
            )
    return _records(rows, _OF_CONTROLLER)


def pair_records(comparison: ComparisonResults, all_pairs: Sequence[Pair]) -> pl.DataFrame:
    """A row for each pair and metric, success first: the difference `controller` minus `against` with its interval and p-values.

    `improvement`: probability that `controller` is better. The difference of success rates over the common seeds has no interval.
    """
    labels = [c.label for c in comparison.controllers]
    rows: list[dict[str, Any]] = []
    for pair in all_pairs:
        s, n = pair.success, pair.seeds
        of_success = stats.NOTHING, stats.NOTHING
        if n:
            more, better = (s.only_b - s.only_a) / n, (s.only_b + (s.both + s.neither) / 2) / n
            of_success = stats.IntervalEstimate(more, n=n), stats.share_of(better, n)
        for metric in (_SUCCESS, *comparison.shown):
            d, i = of_success if metric is _SUCCESS else (pair.differences[metric.name], pair.improvements[metric.name])
            rows.append(
                {"controller": labels[pair.b], "against": labels[pair.a], **_named(metric)}
                | _estimate(d, "difference", "low", "high", "pairs")
                | {"skewness": d.skewness if metric is not _SUCCESS else None}
                | _tested(pair, metric.name, "difference")
                | _estimate(i, "improvement", "improvement_low", "improvement_high", "improvement_pairs")
                | _tested(pair, metric.name, "improvement", "improvement_")
            )
    return _records(rows, _OF_PAIR)


_SUCCESS: Final = Metric(SUCCESS, "Reached the goal", better=1)


def _named(metric: Metric) -> dict[str, Any]:
    return {"metric": metric.name, "title": metric.title, "unit": metric.unit, "better": "higher" if metric.better > 0 else "lower"}


def _estimate(found: stats.IntervalEstimate, *names: str) -> dict[str, Any]:
    return dict(zip(names, (found.mean, found.low, found.high, found.n), strict=True))


def _tested(pair: Pair, name: str, of: Of, prefix: str = "") -> dict[str, Any]:
    p, adjusted = (tests.get((name, of)) for tests in (pair.tests, pair.adjusted))
    return {f"{prefix}p": p, f"{prefix}p_holm": adjusted, f"{prefix}significant": None if adjusted is None else adjusted <= CHANCE}


def _records(rows: list[dict[str, Any]], names: Sequence[str]) -> pl.DataFrame:
    """Rows as a table of these columns: words, counts, truths, and numbers, of which NaN is null."""

    def kind(name: str) -> Any:
        return pl.String if name in _WORDS else pl.Int64 if name in _COUNTS else pl.Boolean if "significant" in name else pl.Float64

    return pl.DataFrame(rows, schema={name: kind(name) for name in names}).with_columns(pl.col(pl.Float64).fill_nan(None))
