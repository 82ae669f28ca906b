"""The data of a comparison's report: controllers with their runs, and metrics."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.report.comparison import statistics as stats
from vstestbed.report.comparison.verdict import MARGIN
from vstestbed.tasks.metrics import EVERY_RUN, SOME_FIGURES, Metric, own_metrics

__all__ = [
    "CENSORED",
    "RESTRICTED",
    "TASK",
    "TIME",
    "ComparisonResults",
    "ControllerResults",
    "Means",
    "interquartiles",
    "shown_by_default",
    "value_text",
]

TASK = "task"  # Column of the task of each run, which only a comparison with tasks has
_TIMES = ("time_to_converge_s", "sim_time_s")
LIMIT = Metric.named("limit_s")
RESTRICTED = Metric.named("time_to_goal_s")
TIME = Metric.named("time_to_converge_s")
CENSORED = 0.1  # Share of the runs counted at their limit above which a page warns
DEFAULT_METRICS = tuple(metric.name for metric in EVERY_RUN if metric.compared)


def shown_by_default(table: pl.DataFrame) -> tuple[str, ...]:
    """Names of the numbers shown of a comparison that names none: the usual ones, those of some
    runs, the scenarios' own.
    """
    # all laws work on grey levels, so that no run measured markers
    both = {"final_error_grey", "final_error_px"} <= set(table.columns)
    grey = both and table["final_error_px"].is_null().all()
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
        if TASK not in self.runs.columns:
            return [""] * len(self.runs)
        return [str(task) for task in self.runs[TASK].to_list()]

    @property
    def starts(self) -> list[tuple[str, int]]:
        """Task and seed of each run, by which the runs of two controllers are paired."""
        return list(zip(self.tasks, self.seeds, strict=True))

    def values(self, metric: Metric) -> Array:
        """The metric of every run in its display unit, shape (runs,), read-only; NaN where a run
        has none.
        """
        if metric not in self._known:
            column = self._column(metric.name)
            if metric == RESTRICTED:
                column = self._times_to_goal(column)
            self._known[metric] = np.where(np.isfinite(column), column, np.nan) * metric.scale
            self._known[metric].setflags(write=False)
        return self._known[metric]

    def _times_to_goal(self, stored: Array) -> Array:
        """The column of times, filled where it has none: of a run that reached its goal with the
        time that it took, of a crashed one with its limit. The tables of earlier versions do not
        have it: their limit is that of the others, or the longest run.
        """
        known = {name: self._column(name) for name in _TIMES if name in self.runs.columns}
        for name in _TIMES if self.success.any() else ():
            stored = np.where(self.success & np.isnan(stored), known.get(name, np.nan), stored)
        longest = np.nanmax(np.append(known.get("sim_time_s", np.nan), -math.inf))
        limits = np.where(np.isnan(self.limits), longest, self.limits)
        return np.where(~self.success & np.isnan(stored), limits, stored)

    def _column(self, name: str) -> Array:
        """A column as numbers, NaN where it has none: a crashed run has null, and a number may be
        stored as text.
        """
        if name not in self.runs.columns:
            return np.full(len(self.runs), np.nan)
        return self.runs[name].cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()

    @cached_property
    def limits(self) -> Array:
        """The limit of time of each run [s], shape (runs,): the price of a failure. NaN where the
        table does not tell.

        Of a crashed run, and in the tables of earlier versions, it is that of the controller's
        other runs, there of those that failed.
        """
        limits = self._column(LIMIT.name)
        if not np.isfinite(limits).any():
            limits = np.where(self.success, np.nan, self._column(RESTRICTED.name))
        known = limits[np.isfinite(limits)]
        return np.where(np.isfinite(limits), limits, known.max() if len(known) else np.nan)

    @property
    def period_s(self) -> float:
        """The usual time from one picture to the next [s]; 0 where it is not known."""
        pictures = self._column("frames") - 1
        periods = self._column("sim_time_s")[pictures > 0] / pictures[pictures > 0]
        periods = periods[np.isfinite(periods)]
        return float(np.median(periods)) if len(periods) else 0.0

    @property
    def censored(self) -> float:
        """The share of the runs that did not reach the goal, whose times are counted at their
        limit.
        """
        return 1 - float(self.success.mean()) if len(self.success) else 0.0

    def counted(self, metric: Metric) -> Array:
        """As `values`, but NaN for the runs that are excluded from the metric's median (see
        `Metric.every_run`).
        """
        values = self.values(metric)
        return values if metric.every_run else np.where(self.success, values, np.nan)

    def quartiles(self, metric: Metric) -> tuple[float, float, float, int]:
        """First quartile, median, third quartile and number of the `counted` values."""
        return stats.quartiles(self.counted(metric))

    @property
    def rate(self) -> stats.IntervalEstimate:
        """The share of the runs that reached the goal."""
        return stats.success_rate(int(self.success.sum()), len(self.success))

    def ranked(self, metric: Metric) -> Array:
        """As `values`, but less is better, and a run that failed is worse than any that did not:
        infinity.

        With `every_pair` a failed run has its own value, and infinity only without one (it
        crashed). NaN: reached the goal, value unknown.
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
    # the metric that decides after success; "": the time to the goal, a failure counted at its
    # limit
    primary: str = ""
    # label of the controller with which each other one is compared; "": all pairs
    reference: str = ""
    # share of the starts by which a better one may reach the goal less often
    margin: float = MARGIN
    # why this ranks settings and no laws, in sentences, which come first; "": it ranks laws
    settings: str = ""

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
        labels = _labels(list(rows), short_names(self.axes))
        return tuple(
            ControllerResults(label, self.table[index].sort("seed"))
            for label, index in zip(labels, rows.values(), strict=True)
        )

    @property
    def labels(self) -> list[str]:
        """The controllers' names on the page."""
        return [c.label for c in self.controllers]

    @cached_property
    def primary_metric(self) -> Metric:
        """The metric that decides a pair whose success does not."""
        return Metric.named(self.primary) if self.primary else RESTRICTED

    @property
    def exploratory(self) -> list[Metric]:
        """The shown metrics that decide nothing."""
        return [metric for metric in self.shown if metric != self.primary_metric]

    @property
    def reference_index(self) -> int:
        """The controller with which each other one is compared where not all pairs are: the first
        without a `reference`.
        """
        if not self.reference:
            return 0
        if self.reference not in self.labels:
            raise ParameterError.choice("reference", self.labels, self.reference)
        return self.labels.index(self.reference)

    def first(self, n: int) -> ComparisonResults:
        """The first n controllers alone."""
        return replace(self, table=pl.concat([c.runs for c in self.controllers[:n]]))


def _labels(keys: Sequence[tuple[Any, ...]], axes: Sequence[str]) -> list[str]:
    """The name of each controller by its scenario and the values of its axes."""
    scenarios = [str(key[0]) for key in keys]
    # the scenario is part of a label only where there are several, or nothing else is
    several = len(set(scenarios)) > 1
    columns = [scenarios if several else [""] * len(keys)]
    for i, axis in enumerate(axes, start=1):
        columns.append(_words_of(axis, [key[i] for key in keys]))
    labels = [
        ", ".join(filter(None, words)) or scenario
        for scenario, *words in zip(scenarios, *columns, strict=True)
    ]
    # two values differ only beyond the 6 digits of `:g`, or two axes have the same words
    if len(set(labels)) < len(labels):
        return [_in_full(key, axes) for key in keys]
    return labels


def _in_full(key: Sequence[object], axes: Sequence[str]) -> str:
    scenario, *values = key
    named = (f"{axis}={value}" for axis, value in zip(axes, values, strict=True))
    return ", ".join([str(scenario), *named])


def _words_of(name: str, values: Sequence[object]) -> list[str]:
    """What a varied field adds to the label of each controller: nothing where it is the same in all
    of them.

    A word says by itself what is varied, and a number does not: `ideal`, `gain=0.5`. Of blocks
    their kind and what differs between them is named: `ibvs, interaction=mean`.
    """
    if len(set(values)) < 2:
        return [""] * len(values)
    blocks = [_block(value) for value in values]
    if any(len(block) > 1 for block in blocks):
        return _what_differs(blocks)
    before = "" if all(map(_is_word, values)) else f"{name}="
    return [before + value_text(value) for value in values]


def _what_differs(blocks: list[dict[str, object]]) -> list[str]:
    """Of each block the entries in which it differs from others, its kind without its key."""
    keys = dict.fromkeys(chain.from_iterable(blocks))
    differing = [key for key in keys if len({str(block.get(key)) for block in blocks}) > 1]
    named = [{key: block[key] for key in differing if key in block} or block for block in blocks]
    return [", ".join(_entry(key, value) for key, value in block.items()) for block in named]


def _entry(key: str, value: object) -> str:
    words = value_text(value)
    if isinstance(value, dict | list):
        words = json.dumps(value).replace('"', "")
    return words if key == "kind" else f"{key}={words}"


def _block(value: object) -> dict[str, object]:
    """A varied value as a block; a bare word is its kind."""
    if isinstance(value, str) and value.startswith("{"):
        return json.loads(value)
    return {"kind": value}


def _is_word(value: object) -> bool:
    return isinstance(value, str) and not re.fullmatch(r"[-+.\d].*|true|false|null", value)


def short_names(paths: Sequence[str]) -> list[str]:
    """The shortest suffix of each dotted path that is unique among them: `actuation` for
    `robot.actuation`.
    """
    suffixes = [
        [".".join(path.split(".")[-parts:]) for parts in range(1, path.count(".") + 2)]
        for path in paths
    ]
    common = Counter(chain.from_iterable(suffixes))
    return [next((suffix for suffix in own if common[suffix] == 1), own[-1]) for own in suffixes]


def value_text(value: object) -> str:
    """A varied value as YAML would write it."""
    if value is None or isinstance(value, bool):  # before numbers: bool is an int
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, str) and value.startswith("["):
        return value.strip("[]").replace('"', "") or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


Means = list[dict[str, stats.IntervalEstimate]]  # of each controller, by metric


def interquartiles(comparison: ComparisonResults) -> Means:
    """Of each controller: the interquartile mean of each shown metric over all its runs, in its
    display unit.

    Infinite (of the bad sign) where more than a quarter of the runs failed. `n` is 0 where runs
    reached the goal and none of them has the number, and for a metric of `every_pair` where no run
    has it.
    """

    def of(controller: ControllerResults, metric: Metric) -> stats.IntervalEstimate:
        known, reached = np.isfinite(controller.values(metric)), controller.success
        if (reached.any() and not known[reached].any()) or (metric.every_pair and not known.any()):
            return stats.NOTHING
        found = stats.interquartile_mean(controller.ranked(metric))
        return found.turned() if metric.better > 0 else found

    return [
        {metric.name: of(controller, metric) for metric in comparison.shown}
        for controller in comparison.controllers
    ]
