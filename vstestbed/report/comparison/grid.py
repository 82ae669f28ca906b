"""A comparison over two axes as a grid: what each value of the first, an effect say, does to each
of the second, a law say.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from vstestbed.report.canvas import new_figure, wrapped
from vstestbed.report.comparison.figures import Data
from vstestbed.report.comparison.results import (
    TIME,
    ComparisonResults,
    ControllerResults,
    value_text,
)
from vstestbed.report.comparison.statistics import FEWEST, IntervalEstimate, holm, paired_difference
from vstestbed.report.comparison.verdict import ALPHA
from vstestbed.report.marks import GOAL, LINE_COLORS, LOST
from vstestbed.tasks.metrics import Metric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ERROR = Metric.named("final_position_error_m")
LEAST = 3  # Fewest values of the first axis of which a grid is drawn
STRONGEST = 0.55  # Opacity of the strongest colour: the numbers are read through it
LEAST_SHOWN_S = 0.005  # Changes and errors below this are shown as 0 [s, mm]
ALL = "all"  # Heading of the mean over all columns
Place = TypeVar("Place", bound=Hashable)
Start = tuple[str, int]  # Task and seed


class Look(NamedTuple):
    """How a cell is drawn."""

    words: str
    color: str
    strength: float  # of the colour, from 0 to 1
    bold: bool = False


Looks = dict[tuple[int, int], Look]  # by row and column


@dataclass(frozen=True)
class Grid:
    """The controllers of a comparison by the values of its two axes."""

    rows: tuple[str, ...]  # rows, columns: values of the first and of the second axis, as words
    columns: tuple[str, ...]
    cells: dict[tuple[int, int], ControllerResults]  # the controllers by row and column

    @classmethod
    def of(cls, comparison: ComparisonResults) -> Grid | None:
        """The grid; None of other than two axes, of few values, or of several scenarios."""
        axes = comparison.axes
        if len(axes) != 2 or comparison.table["scenario"].n_unique() > 1:
            return None
        rows, columns = ([*map(value_text, comparison.table[axis].to_list())] for axis in axes)
        found = cls(tuple(dict.fromkeys(rows)), tuple(dict.fromkeys(columns)), {})
        if len(found.rows) < LEAST:
            return None
        for c in comparison.controllers:
            row, column = (value_text(c.runs[axis][0]) for axis in axes)
            found.cells[found.rows.index(row), found.columns.index(column)] = c
        return found

    def changes(self, metric: Metric) -> dict[tuple[int, int], IntervalEstimate]:
        """Paired differences of each row to the first by cell, over the starts from which both
        reached the goal.
        """
        return {at: _mean([found]) for at, found in self._by_start(metric).items()}

    def overall(self, metric: Metric) -> dict[int, IntervalEstimate]:
        """Paired differences of each row to the first: of each start the mean over the columns in
        which both reached the goal from it.
        """
        columns: dict[int, list[dict[Start, float]]] = {}
        for (row, _), cell in self._by_start(metric).items():
            columns.setdefault(row, []).append(cell)
        return {row: _mean(cells) for row, cells in columns.items()}

    def _by_start(self, metric: Metric) -> dict[tuple[int, int], dict[Start, float]]:
        """By cell the change against the first row from each start from which both reached the
        goal.
        """
        return {
            (i, j): _changes(self.cells[0, j], cell, metric)
            for (i, j), cell in self.cells.items()
            if i > 0 and (0, j) in self.cells
        }


def real(changes: Mapping[Place, IntervalEstimate]) -> set[Place]:
    """Which changes have p <= ALPHA after Holm's correction over all of them, from FEWEST starts or
    more.

    Of two or three starts all changes may be equal, since times are whole frames: no spread, but
    nothing is known.
    """
    adjusted = holm([d.p if d.n >= FEWEST else np.nan for d in changes.values()])
    return {at for (at, d), p in zip(changes.items(), adjusted, strict=True) if p <= ALPHA}


def _changes(
    before: ControllerResults, now: ControllerResults, metric: Metric
) -> dict[Start, float]:
    first = _counted(before, metric)
    second = _counted(now, metric)
    return {start: second[start] - first[start] for start in first if start in second}


def _counted(controller: ControllerResults, metric: Metric) -> dict[Start, float]:
    """The metric by start, of the runs that count in a pair."""
    values = controller.values(metric).tolist()
    runs = zip(controller.starts, values, controller.success, strict=True)
    return {start: value for start, value, reached in runs if reached or metric.every_pair}


def _mean(columns: list[dict[Start, float]]) -> IntervalEstimate:
    """Of the changes from each start the mean over the columns, and of these the mean over the
    starts with its test.
    """
    known: dict[Start, list[float]] = {}
    for column in columns:
        for start, change in column.items():
            if np.isfinite(change):
                known.setdefault(start, []).append(change)
    means = [np.mean(those) for those in known.values()]
    return paired_difference(means, np.zeros(len(means)))


def grid(data: Data, width_in: float) -> Figure | None:
    """Three panels: runs that reached the goal, change of the time to converge against the first
    row, final error; None without a grid.
    """
    found = Grid.of(data.comparison)
    if found is None:
        return None
    figure = new_figure(0.24 * len(found.rows) + 1.4, width_in)
    n = len(found.columns)
    # wider cells for a sign and two digits
    panels = figure.subplots(1, 3, sharey=True, width_ratios=(n, 1.3 * (n + (n > 1)), n))
    _reached(panels[0], found)
    _times(panels[1], found)
    _errors(panels[2], found)
    with_all = (*found.columns, ALL) if n > 1 else found.columns
    for axes, names in zip(panels, (found.columns, with_all, found.columns), strict=True):
        axes.set_xlim(-0.5, len(names) - 0.5)
        axes.set_ylim(len(found.rows) - 0.5, -0.5)
        axes.set_xticks(range(len(names)), names, rotation=60, ha="right", rotation_mode="anchor")
        axes.grid(visible=False)
        axes.tick_params(length=0)
        for side in axes.spines.values():
            side.set_visible(False)
    panels[0].set_yticks(range(len(found.rows)), [wrapped(name, 26) for name in found.rows])
    return figure


def _reached(axes: Axes, found: Grid) -> None:
    most = max(len(c.success) for c in found.cells.values())
    axes.set_title(f"reached the goal, of {most}")
    looks: Looks = {}
    for at, c in found.cells.items():
        good = int(c.success.sum())
        n = len(c.success)
        words = str(good) if n == most else f"{good}/{n}"
        looks[at] = Look(words, GOAL, 0.25) if good == n else Look(words, LOST, 1 - 0.7 * good / n)
    _draw(axes, found, looks)


def _times(axes: Axes, found: Grid) -> None:
    """Median time in the first row; below it the mean change with its sign, bold where it is beyond
    chance; last their mean.
    """
    axes.set_title(f"{TIME.title.lower()}, change [s]")
    changes = found.changes(TIME)
    overall = found.overall(TIME)
    marked: set[Any] = real(changes) | real(overall)
    sizes = [abs(d.mean) for d in changes.values() if np.isfinite(d.mean)]
    largest = max(sizes, default=0.0) or 1.0
    looks: Looks = {}
    for at, c in found.cells.items():
        looks[at] = Look(_short(c.quartiles(TIME)[1]), LINE_COLORS[7], 0.15)
    for at, d in changes.items():
        looks[at] = _change(d, largest, at in marked)
    if len(found.columns) > 1:
        for i, d in overall.items():
            looks[i, len(found.columns)] = _change(d, largest, i in marked)
    _draw(axes, found, looks)


def _change(d: IntervalEstimate, largest: float, bold: bool) -> Look:
    """A change with its sign, the stronger the larger."""
    later = d.mean > 0
    size = abs(d.mean)
    words = _short(size)
    if size >= LEAST_SHOWN_S:
        words = ("+" if later else "\N{MINUS SIGN}") + words
    strength = (size / largest) ** 0.5 if np.isfinite(size) else 0.0
    return Look(words, LINE_COLORS[1 if later else 0], strength, bold)


def _errors(axes: Axes, found: Grid) -> None:
    axes.set_title("final error, median [mm]")
    values = {at: c.quartiles(ERROR)[1] for at, c in found.cells.items()}
    sizes = {at: np.log(v) for at, v in values.items() if np.isfinite(v) and v > 0}
    low = min(sizes.values(), default=0.0)
    span = max(sizes.values(), default=0.0) - low or 1.0
    looks: Looks = {}
    for at, value in values.items():
        strength = float(sizes[at] - low) / span if at in sizes else 0.0
        looks[at] = Look(_short(value), LINE_COLORS[1], strength)
    _draw(axes, found, looks)


def _draw(axes: Axes, found: Grid, looks: Looks) -> None:
    from matplotlib.patches import Rectangle

    # a number has its full size in up to nine columns
    size = 6.5 * min(1.0, 9 / len(found.columns))
    for (i, j), (words, color, strength, bold) in looks.items():
        alpha = STRONGEST * strength
        place = (j - 0.47, i - 0.45)
        axes.add_patch(Rectangle(place, 0.94, 0.9, color=color, alpha=alpha, linewidth=0))
        weight = "bold" if bold else "normal"
        axes.text(j, i, words, ha="center", va="center", fontsize=size, fontweight=weight)


def _short(value: float) -> str:
    """Two digits or so, without the zero before the point: the cells are narrow; a dash where there
    is none.
    """
    if not np.isfinite(value):
        return "\N{EN DASH}"
    if value < 1:
        return f"{value:.2f}".lstrip("0") if value >= LEAST_SHOWN_S else "0"
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"
