"""A comparison over two axes as a grid: what each value of the first, an effect say, does to each
of the second, a law say.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

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
# Of a cell: words, colour, strength of the colour from 0 to 1, whether in bold
Look = tuple[str, str, float, bool]


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
        rows, columns = (
            tuple(dict.fromkeys(map(value_text, comparison.table[axis].to_list()))) for axis in axes
        )
        if len(rows) < LEAST:
            return None
        at = {
            (
                rows.index(value_text(c.runs[axes[0]][0])),
                columns.index(value_text(c.runs[axes[1]][0])),
            ): c
            for c in comparison.controllers
        }
        return cls(rows, columns, at)

    def changes(self, metric: Metric) -> dict[tuple[int, int], IntervalEstimate]:
        """Paired differences of each row to the first by cell, over the starts from which both
        reached the goal.
        """
        return {at: _mean([found]) for at, found in self._by_start(metric).items()}

    def overall(self, metric: Metric) -> dict[int, IntervalEstimate]:
        """Paired differences of each row to the first: of each start the mean over the columns in
        which both reached the goal from it.
        """
        found = self._by_start(metric)
        return {
            i: _mean([cell for (row, _), cell in found.items() if row == i])
            for i in dict.fromkeys(i for i, _ in found)
        }

    def _by_start(self, metric: Metric) -> dict[tuple[int, int], dict[tuple[str, int], float]]:
        """By cell the change against the first row from each start from which both reached the
        goal.
        """
        cells = self.cells.items()
        return {
            (i, j): _changes(self.cells[0, j], cell, metric)
            for (i, j), cell in cells
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
) -> dict[tuple[str, int], float]:
    first, second = (
        {s: (v, ok) for s, v, ok in zip(c.starts, c.values(metric), c.success, strict=True)}
        for c in (before, now)
    )
    both = [
        s for s in first if s in second and (metric.every_pair or (first[s][1] and second[s][1]))
    ]
    return {s: float(second[s][0] - first[s][0]) for s in both}


def _mean(columns: list[dict[tuple[str, int], float]]) -> IntervalEstimate:
    """Of the changes from each start the mean over the columns, and of these the mean over the
    starts with its test.
    """
    starts = dict.fromkeys(start for column in columns for start in column)
    values = [
        [column[start] for column in columns if np.isfinite(column.get(start, np.nan))]
        for start in starts
    ]
    means = [np.mean(those) for those in values if those]
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
    for axes in panels:
        names = (
            [*found.columns, ALL] if axes is panels[1] and len(found.columns) > 1 else found.columns
        )
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
    looks: dict[tuple[int, int], Look] = {}
    for at, c in found.cells.items():
        good, n = int(c.success.sum()), len(c.success)
        words = str(good) if n == most else f"{good}/{n}"
        looks[at] = (
            (words, GOAL, 0.25, False) if good == n else (words, LOST, 1 - 0.7 * good / n, False)
        )
    _draw(axes, found, looks)


def _times(axes: Axes, found: Grid) -> None:
    """Median time in the first row; below it the mean change with its sign, bold where it is beyond
    chance; last their mean.
    """
    axes.set_title(f"{TIME.title.lower()}, change [s]")
    changes, overall = found.changes(TIME), found.overall(TIME)
    marked: set[Any] = real(changes) | real(overall)
    largest = (
        max((abs(d.mean) for d in changes.values() if np.isfinite(d.mean)), default=0.0) or 1.0
    )

    def change(at: Any, d: IntervalEstimate) -> Look:
        sign = "" if not abs(d.mean) >= LEAST_SHOWN_S else "+" if d.mean > 0 else "\N{MINUS SIGN}"
        size = abs(d.mean) / largest if np.isfinite(d.mean) else 0.0
        return (
            sign + _short(abs(d.mean)),
            LINE_COLORS[1] if d.mean > 0 else LINE_COLORS[0],
            size**0.5,
            at in marked,
        )

    looks: dict[tuple[int, int], Look] = {
        at: (_short(c.quartiles(TIME)[1]), LINE_COLORS[7], 0.15, False)
        for at, c in found.cells.items()
    }
    looks |= {at: change(at, d) for at, d in changes.items()}
    if len(found.columns) > 1:
        looks |= {(i, len(found.columns)): change(i, d) for i, d in overall.items()}
    _draw(axes, found, looks)


def _errors(axes: Axes, found: Grid) -> None:
    axes.set_title("final error, median [mm]")
    values = {at: c.quartiles(ERROR)[1] for at, c in found.cells.items()}
    known = np.log([v for v in values.values() if np.isfinite(v) and v > 0] or [1.0])
    low, span = known.min(), float(np.ptp(known)) or 1.0
    strength = {
        at: float(np.log(v) - low) / span if np.isfinite(v) and v > 0 else 0.0
        for at, v in values.items()
    }
    _draw(
        axes,
        found,
        {at: (_short(value), LINE_COLORS[1], strength[at], False) for at, value in values.items()},
    )


def _draw(axes: Axes, found: Grid, looks: Mapping[tuple[int, int], Look]) -> None:
    from matplotlib.patches import Rectangle

    # a number has its full size in up to nine columns
    size = 6.5 * min(1.0, 9 / len(found.columns))
    for (i, j), (words, color, strength, bold) in looks.items():
        axes.add_patch(
            Rectangle(
                (j - 0.47, i - 0.45),
                0.94,
                0.9,
                color=color,
                alpha=STRONGEST * strength,
                linewidth=0,
            )
        )
        style: dict[str, Any] = {
            "ha": "center",
            "va": "center",
            "fontsize": size,
            "fontweight": "bold" if bold else "normal",
        }
        axes.text(j, i, words, **style)


def _short(value: float) -> str:
    """Two digits or so, without the zero before the point: the cells are narrow; a dash where there
    is none.
    """
    if not np.isfinite(value):
        return "\N{EN DASH}"
    if value < 1:
        return f"{value:.2f}".lstrip("0") if value >= LEAST_SHOWN_S else "0"
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"
