"""What a comparison's report is made from: controllers with their runs, the numbers that are shown, and what goes before what."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.report.run import numbers

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

_TITLES: Final = {
    name: (title, unit) for name, title, unit in (*numbers.CONTINUING_TILES, *numbers.TILES, *numbers.ROWS, *numbers.TRACKING_ROWS)
}
_SCALES: Final = {"final_position_error_m": ("mm", 1e3), "saturated_fraction": ("%", 1e2)}
_FINAL: Final = ("final_error_px", "final_position_error_m", "final_rotation_error_deg")
_WHATEVER_ITS_END: Final = ("feature_overshoot", "worst_off_m", *(name for name, _, _ in numbers.TRACKING_ROWS))


@dataclass(frozen=True)
class Metric:
    """A number of a run as it is shown.

    Attributes:
        name: in `summary.json`. title, unit: what is printed; scale: the unit's numbers over those of the summary.
        every_run: of all runs that have it, not only of those that reached the goal.
        every_pair: compared on all seeds, too: it tells as much of a run that failed.
    """

    name: str
    title: str
    unit: str = ""
    scale: float = 1.0
    every_run: bool = False
    every_pair: bool = False

    @classmethod
    def of(cls, name: str) -> Metric:
        """A name of `summary.json`; one that the run's report has no words for shows as it is."""
        title, unit = _TITLES.get(name, (name, ""))
        unit, scale = _SCALES.get(name, (unit, 1.0))
        whole = name in _WHATEVER_ITS_END
        return cls(name, title, unit, scale, whole or name in _FINAL, whole)

    @property
    def label(self) -> str:
        """Title and unit: `Final error [px]`."""
        return f"{self.title} [{self.unit}]" if self.unit else self.title


@dataclass(frozen=True)
class ControllerResults:
    """A scenario with one combination of the varied values, and its runs.

    Attributes:
        label: what it is called on the page. runs: its rows of the comparison's table, by seed.
    """

    label: str
    runs: pl.DataFrame

    @cached_property
    def success(self) -> NDArray[np.bool_]:
        """Whether each run reached its goal, shape (runs,)."""
        return self.runs["success"].cast(pl.Boolean, strict=False).fill_null(False).to_numpy()

    @cached_property
    def seeds(self) -> list[int]:
        """The seed of each run."""
        return self.runs["seed"].to_list()

    def values(self, metric: Metric) -> Array:
        """A number of every run in the metric's unit, shape (runs,); NaN where the run has none."""
        if metric.name not in self.runs.columns:
            return np.full(len(self.runs), np.nan)
        column = self.runs[metric.name].cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
        return np.where(np.isfinite(column), column, np.nan) * metric.scale

    def counted(self, metric: Metric) -> Array:
        """As `values`, but NaN for the runs that the metric's median leaves out."""
        return self.values(metric) if metric.every_run else np.where(self.success, self.values(metric), np.nan)


@dataclass(frozen=True)
class ComparisonResults:
    """A finished comparison.

    Attributes:
        table: one row a run, as in `comparison.parquet`.
        axes: paths of the varied fields, each a column of the table.
        metrics: names of the numbers that are shown. description: in a few words, what is compared.
    """

    table: pl.DataFrame
    axes: tuple[str, ...] = ()
    metrics: tuple[str, ...] = DEFAULT_METRICS
    description: str = ""

    @cached_property
    def shown(self) -> tuple[Metric, ...]:
        """The metrics with their words."""
        return tuple(Metric.of(name) for name in self.metrics)

    @cached_property
    def controllers(self) -> tuple[ControllerResults, ...]:
        """The controllers, in order of first appearance."""
        keys = self.table.select("scenario", *self.axes).rows()
        rows: dict[tuple[Any, ...], list[int]] = {}
        for i, key in enumerate(keys):
            rows.setdefault(key, []).append(i)
        several = len({key[0] for key in rows}) > 1
        names = short_names(self.axes)
        labels = [_label((str(key[0]), *map(value_text, key[1:])), names, several) for key in rows]
        if len(set(labels)) < len(labels):  # values that differ beyond the digits that are usually shown
            labels = [_label(tuple(map(str, key)), names, several) for key in rows]
        return tuple(ControllerResults(label, self.table[index].sort("seed")) for label, index in zip(labels, rows.values(), strict=True))


def _label(key: tuple[str, ...], names: Sequence[str], several: bool) -> str:
    parts = [key[0]] if several or not names else []
    return ", ".join(parts + [f"{name}={value}" for name, value in zip(names, key[1:], strict=True)])


def short_names(paths: Sequence[str]) -> list[str]:
    """The shortest end of each dotted path that no other one shares: `actuation` of `robot.actuation`."""

    def end(path: str, parts: int) -> str:
        return ".".join(path.split(".")[-parts:])

    made = []
    for path in paths:
        lengths = range(1, path.count(".") + 2)
        made.append(next((end(path, n) for n in lengths if sum(end(p, n) == end(path, n) for p in paths) == 1), path))
    return made


def value_text(value: object) -> str:
    """A varied value as YAML would write it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return f"{value:g}" if isinstance(value, float) else str(value)
