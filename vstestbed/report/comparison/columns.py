"""The data of a comparison's report: controllers with their runs, and the metrics that are shown, in their order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.report.run import numbers
from vstestbed.tasks.metrics import SOME_FIGURES, own_titles

TASK: Final = "task"
"""Column of the task of each run, which only a comparison with tasks has."""
DEFAULT_METRICS: Final = (
    "time_to_converge_s",
    "final_error_px",
    "final_position_error_m",
    "final_rotation_error_deg",
    "path_ratio",
    "max_retreat_m",
    "max_feature_excursion_px",
    "min_border_margin_px",
    "peak_speed_mps",
    "saturated_fraction",
)

_SOMETIMES: Final = (*numbers.TRACKING_ROWS, *numbers.MODE_ROWS, *numbers.LINK_ROWS, *numbers.SWING_ROWS)
# Titles and units are those of the single-run report, so that a number is called the same on both pages.
_TILES: Final = (*numbers.CONTINUING_TILES, *numbers.TILES, numbers.GREY_TILE)
_TITLES: Final = {name: (title, unit) for name, title, unit in (*_TILES, *numbers.ROWS, *_SOMETIMES)}
_SCALES: Final = {"final_position_error_m": ("mm", 1e3), "saturated_fraction": ("%", 1e2)}
_FINAL: Final = ("final_error_px", "final_error_grey", "final_position_error_m", "final_rotation_error_deg")
_ON_THE_WAY: Final = ("feature_overshoot", "worst_task_error_m", *(name for name, _, _ in _SOMETIMES))
_HIGHER: Final = ("min_border_margin_px",)


def shown_by_default(table: pl.DataFrame) -> tuple[str, ...]:
    """Names of the numbers shown of a comparison that names none: the usual ones, those of some runs, the scenarios' own."""
    usual = [name for name in DEFAULT_METRICS if name != "final_error_px" or not _in_grey_alone(table)]
    return (*usual, *(name for name in (*SOME_FIGURES, *own_titles()) if name in table.columns))


def _in_grey_alone(table: pl.DataFrame) -> bool:
    """Whether no run measured markers, since all of their laws work on grey levels."""
    return "final_error_grey" in table.columns and "final_error_px" in table.columns and table["final_error_px"].is_null().all()


@dataclass(frozen=True)
class Metric:
    """A number of `summary.json` with its title and display unit.

    Attributes:
        name: key in `summary.json`. title, unit: as printed; scale: factor from the summary's unit to the printed one.
        every_run: the median is over all runs that have the number, not only over those that reached the goal.
        every_pair: paired differences are over all common seeds, too: the number means the same for a run that failed.
        higher: a higher value is better; of all other numbers (times, errors, paths, speeds) the lower.
    """

    name: str
    title: str
    unit: str = ""
    scale: float = 1.0
    every_run: bool = False
    every_pair: bool = False
    higher: bool = False

    @classmethod
    def of(cls, name: str) -> Metric:
        """The metric of a key of `summary.json`; a key without a title in the run's report is its own title."""
        own = own_titles()
        title, unit = _TITLES.get(name) or own.get(name, (name, ""))
        unit, scale = _SCALES.get(name, (unit, 1.0))
        on_the_way = name in _ON_THE_WAY or name in own  # measured while the run goes on: meaningful whatever its outcome
        return cls(name, title, unit, scale, on_the_way or name in _FINAL, on_the_way, name in _HIGHER)

    @property
    def label(self) -> str:
        """Title and unit: `Final error [px]`."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title

    @property
    def over(self) -> str:
        """Which runs the median is of."""
        return "all runs" if self.every_run else "the runs that reached the goal"


@dataclass(frozen=True)
class ControllerResults:
    """The runs of one controller: a scenario with one combination of the varied values.

    Attributes:
        label: its name on the page. runs: its rows of the comparison's table, sorted by seed.
    """

    label: str
    runs: pl.DataFrame
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
            self._known[metric] = self._read(metric)
            self._known[metric].setflags(write=False)
        return self._known[metric]

    def _read(self, metric: Metric) -> Array:
        if metric.name not in self.runs.columns:
            return np.full(len(self.runs), np.nan)
        # not strict: a crashed run has null, and a number may be stored as text
        column = self.runs[metric.name].cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
        return np.where(np.isfinite(column), column, np.nan) * metric.scale

    def counted(self, metric: Metric) -> Array:
        """As `values`, but NaN for the runs that are excluded from the metric's median (see `Metric.every_run`)."""
        return self.values(metric) if metric.every_run else np.where(self.success, self.values(metric), np.nan)

    def ranked(self, metric: Metric) -> Array:
        """As `values`, but less is better, and a run that failed is worse than any that did not: infinity.

        A metric of `every_pair` has its own value in a failed run, and infinity only where a failed run has none (it crashed). A run that
        reached the goal without having the number is NaN: unknown, not bad.
        """
        values = self.values(metric) * (-1.0 if metric.higher else 1.0)
        failed = ~self.success & (np.isnan(values) if metric.every_pair else True)
        return np.where(failed, np.inf, values)


@dataclass(frozen=True)
class ComparisonResults:
    """The table of a finished comparison, grouped by controller.

    Attributes:
        table: one row a run, as in `comparison.parquet`.
        axes: paths of the varied fields, each a column of the table.
        metrics: keys of the numbers that are shown. description: what is compared, in a few words.
        bare: label the controllers of one scenario and one axis by the value alone: `points`, not `law=points`.
    """

    table: pl.DataFrame
    axes: tuple[str, ...] = ()
    metrics: tuple[str, ...] = DEFAULT_METRICS
    description: str = ""
    bare: bool = False

    @cached_property
    def shown(self) -> tuple[Metric, ...]:
        """The metrics with titles and units."""
        return tuple(Metric.of(name) for name in self.metrics)

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

    def suffix(path: str, parts: int) -> str:
        return ".".join(path.split(".")[-parts:])

    names = []
    for path in paths:
        lengths = range(1, path.count(".") + 2)
        names.append(next((suffix(path, n) for n in lengths if sum(suffix(p, n) == suffix(path, n) for p in paths) == 1), path))
    return names


def value_text(value: object) -> str:
    """A varied value as YAML would write it."""
    if value is None or isinstance(value, bool):  # before numbers: bool is an int
        return {None: "null", True: "true", False: "false"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)
