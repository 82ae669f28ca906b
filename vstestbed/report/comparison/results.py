"""The data of a comparison's report: controllers with their runs, metrics, and pairs of controllers on their common seeds."""

from __future__ import annotations

import json
import math
import re
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

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import write_table
from vstestbed.core.geometry import Array
from vstestbed.report.comparison import statistics as stats
from vstestbed.tasks.metrics import EVERY_RUN, SOME_FIGURES, Metric, own_metrics

TASK: Final = "task"  # Column of the task of each run, which only a comparison with tasks has
_TIMES: Final = ("time_to_converge_s", "sim_time_s")
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
            if metric == RESTRICTED:
                column = self._times_to_goal(column)
            self._known[metric] = np.where(np.isfinite(column), column, np.nan) * metric.scale
            self._known[metric].setflags(write=False)
        return self._known[metric]

    def _times_to_goal(self, stored: Array) -> Array:
        """The column of times, filled where it has none: of a run that reached its goal with the time that it took, of a crashed one
        with the limit of the others. The tables of earlier versions do not have it: their limit is the longest run.
        """
        known = {name: self.runs[name].cast(pl.Float64, strict=False).to_numpy() for name in _TIMES if name in self.runs.columns}
        for name in _TIMES if self.success.any() else ():
            stored = np.where(self.success & np.isnan(stored), known.get(name, np.nan), stored)
        limits = stored[~self.success & np.isfinite(stored)]
        limit = limits.max() if len(limits) else np.nanmax(np.append(known.get("sim_time_s", np.nan), -math.inf))
        return np.where(~self.success & np.isnan(stored), limit, stored)

    @property
    def censored(self) -> float:
        """The share of the runs that did not reach the goal, whose times are counted at their limit."""
        return 1 - float(self.success.mean()) if len(self.success) else 0.0

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
    primary: str = ""  # the metric that decides after success; "": the time to the goal, a failure counted at its limit
    reference: str = ""  # label of the controller with which each other one is compared; "": all pairs
    settings: str = ""  # why this ranks settings and no laws, in sentences, which come first; "": it ranks laws

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
        scenarios, *values = zip(*rows, strict=True) if rows else ((),)
        columns = [_words_of(name, each) for name, each in zip(short_names(self.axes), values, strict=True)]
        several = len(set(scenarios)) > 1  # the scenario is part of a label only where there are several, or nothing else is
        parts = zip([str(name) if several else "" for name in scenarios], *columns, strict=True)
        labels = [", ".join(filter(None, each)) or str(name) for each, name in zip(parts, scenarios, strict=True)]
        if len(set(labels)) < len(labels):  # two values differ only beyond the 6 digits of `:g`, or two axes have the same words
            names = ("", *(f"{name}=" for name in short_names(self.axes)))
            labels = [", ".join(f"{name}{value}" for name, value in zip(names, key, strict=True)) for key in rows]
        return tuple(ControllerResults(label, self.table[index].sort("seed")) for label, index in zip(labels, rows.values(), strict=True))

    @cached_property
    def primary_metric(self) -> Metric:
        """The metric that decides a pair whose success does not."""
        return Metric.named(self.primary) if self.primary else RESTRICTED

    @property
    def reference_index(self) -> int:
        """The controller with which each other one is compared where not all pairs are: the first without a `reference`."""
        labels = [c.label for c in self.controllers]
        if self.reference and self.reference not in labels:
            raise ParameterError.choice("reference", labels, self.reference)
        return labels.index(self.reference) if self.reference else 0

    def first(self, n: int) -> ComparisonResults:
        """The first n controllers alone."""
        return replace(self, table=pl.concat([c.runs for c in self.controllers[:n]]))


def _words_of(name: str, values: Sequence[object]) -> list[str]:
    """What a varied field adds to the label of each controller: nothing where it is the same in all of them.

    A word says by itself what is varied, and a number does not: `ideal`, `gain=0.5`. Of blocks their kind and what differs between them is
    named: `ibvs, interaction=mean`.
    """
    if len(set(values)) < 2:
        return [""] * len(values)
    blocks = [_block(value) for value in values]
    if not any(len(block) > 1 for block in blocks):
        words = all(map(_is_word, values))
        return [value_text(value) if words else f"{name}={value_text(value)}" for value in values]
    keys = [key for key in dict.fromkeys(chain.from_iterable(blocks)) if len({str(block.get(key)) for block in blocks}) > 1]
    named = [{key: block[key] for key in keys if key in block} or block for block in blocks]
    return [", ".join(_plain(v) if k == "kind" else f"{k}={_plain(v)}" for k, v in block.items()) for block in named]


def _block(value: object) -> dict[str, object]:
    """A varied value as a block; a bare word is its kind."""
    if isinstance(value, str) and value.startswith("{"):
        return json.loads(value)
    return {"kind": value}


def _plain(value: object) -> str:
    return json.dumps(value).replace('"', "") if isinstance(value, dict | list) else value_text(value)


def _is_word(value: object) -> bool:
    return isinstance(value, str) and not re.fullmatch(r"[-+.\d].*|true|false|null", value)


def short_names(paths: Sequence[str]) -> list[str]:
    """The shortest suffix of each dotted path that is unique among them: `actuation` for `robot.actuation`."""
    suffixes = [[".".join(path.split(".")[-parts:]) for parts in range(1, path.count(".") + 2)] for path in paths]
    common = Counter(chain.from_iterable(suffixes))
    return [next((suffix for suffix in own if common[suffix] == 1), own[-1]) for own in suffixes]


def value_text(value: object) -> str:
    """A varied value as YAML would write it."""
    if value is None or isinstance(value, bool):  # before numbers: bool is an int
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, str) and value.startswith("["):
        return value.strip("[]").replace('"', "") or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


# Pairs of controllers on their common seeds (paired design). One verdict for each pair, from the primary metric that the comparison
# declares; everything else is exploratory.

MOST_CONTROLLERS = 6  # Up to this many controllers every metric of every pair is compared; with more, those of each with the reference
MOST_PAIRED = 24  # Up to this many controllers every pair has a verdict; with more, each controller with the reference
CHANCE = 0.05  # Significance level of all verdicts together, and of all exploratory tests together
CENSORED = 0.1  # Share of the runs counted at their limit above which a page warns
SUCCESS: Final = Metric("success", "Reached the goal", better=1)
TIME = Metric.named("time_to_converge_s")
RESTRICTED = Metric.named("time_to_goal_s")
Of = Literal["difference", "improvement"]
Test = tuple[str, Of]  # An exploratory test of a pair: of which metric, and of what


@dataclass(frozen=True)
class Pair:
    """Controller b against controller a (indices into the comparison's controllers).

    The verdict: b is better where it succeeds on more of the common seeds beyond chance (McNemar); or, if the test of success tells
    nothing, where its primary metric is better beyond chance and it succeeds on as many seeds or more. So a controller that fails more
    often never wins by time: the margin of non-inferiority is no seed at all.
    """

    a: int
    b: int
    primary: Metric  # the metric that decides where success does not
    success: stats.PairedSuccess  # on how many seeds only a, only b, both, neither reached the goal
    # b minus a by metric, in its display unit, over the seeds on which both reached the goal (all seeds for `every_pair`); of the primary
    # metric always, of the others, which are exploratory, where the pair is explored
    differences: dict[str, stats.IntervalEstimate]
    means: dict[str, float]  # mean of a by metric over the same seeds, the reference of relative differences
    # probability by exploratory metric that b is better than a on the same seed, over all common seeds (`ControllerResults.ranked`)
    improvements: dict[str, stats.IntervalEstimate]
    adjusted: dict[Test, float] = field(default_factory=dict)  # p-values by Holm: of verdicts over all pairs, of all exploratory tests

    @property
    def deciding(self) -> dict[Test, float]:
        """P-values of the two tests of the verdict, each by itself; NaN where there is no test.

        None is one of success on so few seeds with different outcomes that none of its p-values is beyond chance: it can call nothing
        real, so it does not count among the tests for which the others are corrected (Tarone 1990, doi:10.2307/2531456).
        """
        decides = self.success.only_a + self.success.only_b > math.log2(2 / CHANCE)
        success = self.success.p if decides else math.nan
        return {(SUCCESS.name, "difference"): success, (self.primary.name, "difference"): self.differences[self.primary.name].p}

    @property
    def exploratory(self) -> dict[Test, float]:
        """P-values of the exploratory tests, each by itself; NaN where there is no test."""
        found: dict[Test, float] = {(name, "difference"): d.p for name, d in self.differences.items() if name != self.primary.name}
        found.update({(name, "improvement"): i.p for name, i in self.improvements.items()})
        return found

    def is_real(self, name: str, of: Of = "difference") -> bool:
        """Whether a difference or an improvement is beyond chance by its adjusted p; the interval of a difference must agree."""
        agrees = of == "improvement" or name == SUCCESS.name or self.differences[name].excludes_zero
        return agrees and self.adjusted[name, of] <= CHANCE

    @property
    def seeds(self) -> int:
        """Number of common seeds."""
        return sum(self.success[:4])

    @property
    def better(self) -> int | None:
        """The controller that the verdict calls better; None where the runs do not tell."""
        more = self.success.only_b - self.success.only_a
        if self.is_real(SUCCESS.name):
            return self.b if more > 0 else self.a
        return None if self.sooner is None or (more < 0 if self.sooner == self.b else more > 0) else self.sooner

    @property
    def sooner(self) -> int | None:
        """The controller whose primary metric is better beyond chance, however often it succeeds; None without one."""
        if not self.is_real(self.primary.name):
            return None
        return self.b if (self.differences[self.primary.name].mean > 0) == (self.primary.better > 0) else self.a

    def turned(self) -> Pair:
        """The same pair with a and b exchanged."""
        return replace(
            self,
            a=self.b,
            b=self.a,
            success=self.success._replace(only_a=self.success.only_b, only_b=self.success.only_a),
            differences={k: d.turned() for k, d in self.differences.items()},
            # the mean of b over the same seeds is the mean of a plus the mean difference
            means={k: m + self.differences[k].mean for k, m in self.means.items()},
            improvements={k: i.turned(1.0) for k, i in self.improvements.items()},
        )


def pairs(comparison: ComparisonResults) -> list[Pair]:
    """Every pair of controllers, the later against the earlier; with a reference, or of many controllers, each against the reference.

    Two families of tests, each adjusted by Holm: both tests of the verdicts of all pairs, and all exploratory ones.
    """
    n, reference = len(comparison.controllers), comparison.reference_index
    every = n <= MOST_PAIRED and not comparison.reference
    chosen = list(combinations(range(n), 2)) if every else [(reference, b) for b in range(n) if b != reference]
    found = [_pair(comparison, a, b, n <= MOST_CONTROLLERS or reference in (a, b)) for a, b in chosen]
    deciding = iter(stats.holm([p for pair in found for p in pair.deciding.values()]))
    exploratory = iter(stats.holm([p for pair in found for p in pair.exploratory.values()]))
    out = []
    for pair in found:
        adjusted = {
            test: pair.success.p if math.isnan(p) and test[0] == SUCCESS.name and pair.seeds else p
            for test, p in zip(pair.deciding, deciding, strict=False)
        }
        out.append(replace(pair, adjusted=adjusted | dict(zip(pair.exploratory, exploratory, strict=False))))
    return out


def against(all_pairs: list[Pair], reference: int) -> list[Pair]:
    """The pairs that contain the controller `reference`, exchanged where needed so that it is a."""
    return [p if p.a == reference else p.turned() for p in all_pairs if reference in (p.a, p.b)]


def _pair(comparison: ComparisonResults, a: int, b: int, explore: bool) -> Pair:
    first, second = comparison.controllers[a], comparison.controllers[b]
    where = {start: k for k, start in enumerate(second.starts)}
    shared = [(i, where[start]) for i, start in enumerate(first.starts) if start in where]
    rows_a, rows_b = [i for i, _ in shared], [k for _, k in shared]  # of the common starts
    succeeded = first.success[rows_a], second.success[rows_b]

    def difference(metric: Metric) -> tuple[stats.IntervalEstimate, float]:
        x, y = first.values(metric)[rows_a], second.values(metric)[rows_b]
        if metric == RESTRICTED:  # both up to the earlier of the two limits
            limit = min((*x[~succeeded[0]], *y[~succeeded[1]]), default=math.inf)
            x, y = np.minimum(x, limit), np.minimum(y, limit)
        # the same seeds for both, or the difference would not be paired
        used = ((succeeded[0] & succeeded[1]) | metric.every_pair) & np.isfinite(x) & np.isfinite(y)
        return stats.paired_difference(y[used], x[used]), float(x[used].mean()) if used.any() else math.nan

    primary = comparison.primary_metric
    shown = [metric for metric in comparison.shown if explore and metric != primary]
    found = {metric.name: difference(metric) for metric in (primary, *shown)}
    improvements = {m.name: stats.improvement(first.ranked(m)[rows_a], second.ranked(m)[rows_b]) for m in shown}
    differences, means = {name: d for name, (d, _) in found.items()}, {name: mean for name, (_, mean) in found.items()}
    return Pair(a, b, primary, stats.paired_success(*succeeded), differences, means, improvements)


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
    *("controller", "against", "better_one", "role", "metric", "title", "unit", "better", "difference", "low", "high", "pairs"),
    *("p", "p_holm", "significant", "improvement", "improvement_low", "improvement_high", "improvement_pairs"),
    *("improvement_p", "improvement_p_holm", "improvement_significant"),
)
_COUNTS: Final = ("runs", "succeeded", "median_runs", "iqm_runs", "pairs", "improvement_pairs")
_WORDS: Final = ("controller", "against", "better_one", "role", "metric", "title", "unit", "better")


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
    """A row for each pair and metric: the difference `controller` minus `against` with its interval and p-values.

    role: `primary` of success (which has no interval) and of the primary metric, which make the verdict `better_one` (null: the runs do
    not tell); `exploratory` of the others. `improvement`: probability that `controller` is better.
    """
    labels = [c.label for c in comparison.controllers]
    rows: list[dict[str, Any]] = []
    for pair in all_pairs:
        s, n, better = pair.success, pair.seeds, pair.better
        d = stats.IntervalEstimate((s.only_b - s.only_a) / n, n=n, p=s.p) if n else stats.NOTHING
        i = stats.share_of((s.only_b + (s.both + s.neither) / 2) / n, n) if n else stats.NOTHING
        found = {SUCCESS: (d, i)} | {m: (pair.differences[m.name], pair.improvements.get(m.name, stats.NOTHING)) for m in _ordered(pair)}
        for metric, (d, i) in found.items():
            rows.append(
                {"controller": labels[pair.b], "against": labels[pair.a], "better_one": None if better is None else labels[better]}
                | {"role": "primary" if metric in (SUCCESS, pair.primary) else "exploratory"}
                | _named(metric)
                | {"difference": d.mean, "low": d.low, "high": d.high, "pairs": d.n, "p": d.p}
                | {"p_holm": pair.adjusted[metric.name, "difference"], "significant": pair.is_real(metric.name)}
                | _estimate(i, "improvement", "improvement_low", "improvement_high", "improvement_pairs")
                | {"improvement_p": i.p, "improvement_p_holm": pair.adjusted.get((metric.name, "improvement"))}
                | {"improvement_significant": metric.name in pair.improvements and pair.is_real(metric.name, "improvement")}
            )
    return _records(rows, _OF_PAIR)


def _ordered(pair: Pair) -> list[Metric]:
    return [Metric.named(name) for name in pair.differences]


def _named(metric: Metric) -> dict[str, Any]:
    return {"metric": metric.name, "title": metric.title, "unit": metric.unit, "better": "higher" if metric.better > 0 else "lower"}


def _estimate(found: stats.IntervalEstimate, *names: str) -> dict[str, Any]:
    return dict(zip(names, (found.mean, found.low, found.high, found.n), strict=True))


def _records(rows: list[dict[str, Any]], names: Sequence[str]) -> pl.DataFrame:
    """Rows as a table of these columns: words, counts, truths, and numbers, of which NaN is null."""

    def kind(name: str) -> Any:
        return pl.String if name in _WORDS else pl.Int64 if name in _COUNTS else pl.Boolean if "significant" in name else pl.Float64

    return pl.DataFrame(rows, schema={name: kind(name) for name in names}).with_columns(pl.col(pl.Float64).fill_nan(None))
