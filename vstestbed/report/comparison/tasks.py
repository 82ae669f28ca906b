"""Report of a comparison with tasks: laws by tasks with every failure, figures over the amounts (what varies in a task: `20 deg`)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import polars as pl

from vstestbed.core.files import make_folder, write_whole
from vstestbed.core.geometry import Array
from vstestbed.core.shares import Call, at_once, result_of
from vstestbed.report.comparison import baseline, tables
from vstestbed.report.comparison.page import failures_section
from vstestbed.report.comparison.results import TASK, ComparisonResults, ControllerResults, Metric, interquartiles, pairs, write_records
from vstestbed.report.comparison.statistics import spread, success_rate
from vstestbed.report.html.canvas import LINE_COLORS, LOST, new_figure, save, style, to_svg
from vstestbed.report.html.template import SCRIPT, figure, made_by, page, plain_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AMOUNT: Final = "amount"
TIME: Final = "time_to_converge_s"
DRAWN: Final = (TIME, "max_retreat_m")  # Metrics that are drawn where a comparison names none
MOST_ROWS: Final = 3  # Metrics that are drawn: the first ones; all have tables
MOST_AMOUNTS: Final = 20  # Most failed runs of a cell that are named
ROUNDING: Final = 1e-6  # Values below this are rounding errors in the unit of any metric
MARKERS: Final = "os^DvX*P<h>pd"  # One marker a law, which tells them apart where colours do not: in grey, and with more laws than colours
DPI: Final = 200


@dataclass(frozen=True)
class Cell:
    """The runs of one law in one task: a cell of the table."""

    law: str
    task: str
    controller: ControllerResults

    @property
    def amounts(self) -> list[str]:
        """The amount of each run."""
        return [str(a) for a in self.controller.runs[AMOUNT].to_list()]

    @property
    def failed(self) -> dict[str, list[str]]:
        """Amounts of the failed runs by outcome."""
        by_outcome: dict[str, list[str]] = defaultdict(list)
        for amount, outcome, good in zip(self.amounts, self.controller.runs["outcome"].to_list(), self.controller.success, strict=True):
            if not good:
                by_outcome[str(outcome)].append(amount)
        return dict(by_outcome)

    @property
    def time_s(self) -> float:
        """Median time to converge [s], NaN if no run converged."""
        return spread(self.controller.counted(Metric.of(TIME))).median

    def spread(self, metric: Metric) -> str:
        """Median and largest value of a metric over the runs that count (`Metric.every_run`), as text; empty if none has it."""
        counted = self.controller.counted(metric)
        counted = counted[np.isfinite(counted)]
        return f"{_digits(float(np.median(counted)))}, {_digits(float(counted.max()))}" if len(counted) else ""

    def summary_lines(self) -> list[str]:
        """Successes with their median time, then one line for each outcome of failed runs with their amounts."""
        good, n = int(self.controller.success.sum()), len(self.controller.success)
        first = f"{good} of {n}" + (f", {self.time_s:.1f} s" if good else "")
        return [first] + [f"{_numbers(amounts)}: {outcome.replace('_', ' ')}" for outcome, amounts in self.failed.items()]


def _digits(value: float) -> str:
    """A value with three digits, 0 if it is a rounding error."""
    return "0" if abs(value) < ROUNDING else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def _numbers(amounts: Sequence[str]) -> str:
    """A list of amounts with their unit once: `160, 180 deg`; `no. 3, 7` for bare numbers."""
    numbers, units = zip(*(a.partition(" ")[::2] for a in amounts), strict=True)
    if (more := len(numbers) - MOST_AMOUNTS) > 0:
        numbers = (*numbers[:MOST_AMOUNTS], f"and {more:,} more")
    return f"{', '.join(numbers)} {units[0]}" if units[0] else f"no. {', '.join(numbers)}"


def cells(table: pl.DataFrame, axes: Sequence[str]) -> list[Cell]:
    """Every law in every task, in order of first appearance; the laws are the combinations of all axes but the task."""
    return [
        Cell(law.label, task, ControllerResults(law.label, law.runs.filter(pl.col(TASK) == task)))
        for law in over_all_tasks(table, axes).controllers
        for task in dict.fromkeys(table[TASK].to_list())
        if task in law.tasks
    ]


def over_all_tasks(table: pl.DataFrame, axes: Sequence[str], metrics: Sequence[str] = ()) -> ComparisonResults:
    """Each law with its runs in all tasks, which are the strata of statistics over all of them."""
    return ComparisonResults(table, tuple(axis for axis in axes if axis != TASK), tuple(metrics) or DRAWN, bare=True)


def markdown(found: Sequence[Cell], metrics: Sequence[str] = ()) -> str:
    """Markdown tables, laws by tasks: successes and failures; then median and largest value of each metric but the time."""

    def lines(text: Callable[[Cell], str]) -> str:
        heads, rows = _grid(found, text)
        top = ["| | " + " | ".join(heads) + " |", "|---" * (len(heads) + 1) + "|"]
        return "\n".join([*top, *(f"| `{law}` | {' | '.join(cells)} |" for law, cells in rows)]) + "\n"

    first = lines(lambda cell: "; ".join(cell.summary_lines()))
    return "\n".join([first, *(f"{title}\n\n{lines(text)}" for title, text in _spreads(metrics))])


def _html(found: Sequence[Cell], text: Callable[[Cell], str]) -> str:
    heads, rows = _grid(found, text)
    return plain_table(["", *heads], [[escape(law), *cells] for law, cells in rows])


def _spreads(metrics: Sequence[str]) -> list[tuple[str, Callable[[Cell], str]]]:
    """Title and cells of a table for each metric but the time, which stands in the first table already."""
    shown = [Metric.of(name) for name in metrics if name != TIME]
    return [(f"{m.label}: median and largest of {m.over}", lambda cell, m=m: cell.spread(m)) for m in shown]


def _grid(found: Sequence[Cell], text: Callable[[Cell], str]) -> tuple[list[str], list[tuple[str, list[str]]]]:
    """The tasks, and each law with a text for each task, empty where it has no runs."""
    tasks, laws = _tasks_and_laws(found)
    of = {(c.law, c.task): text(c) for c in found}
    return tasks, [(law, [of.get((law, task), "") for task in tasks]) for law in laws]


def _tasks_and_laws(found: Sequence[Cell]) -> tuple[list[str], list[str]]:
    """Columns and rows of the table, in order of first appearance."""
    return list(dict.fromkeys(c.task for c in found)), list(dict.fromkeys(c.law for c in found))


def _summary_cell(cell: Cell) -> str:
    first, *failures = map(escape, cell.summary_lines())
    rate = success_rate(int(cell.controller.success.sum()), len(cell.controller.success))
    interval = f"[{100 * rate.low:.0f}, {100 * rate.high:.0f}] %"
    return first + "".join(map(tables.below, (interval, *failures)))


def draw(found: Sequence[Cell], metrics: Sequence[str], width_in: float) -> Figure:
    """One column per task, one row per metric: each law's values over the amounts; red crosses at the top: failed runs."""
    tasks, laws = _tasks_and_laws(found)
    by_task = [[c for c in found if c.task == task] for task in tasks]
    shown = [Metric.of(name) for name in (metrics or DRAWN)[:MOST_ROWS]]
    drawn = new_figure(1.3 + 0.19 * width_in * len(shown), width_in)
    grid = drawn.subplots(len(shown), len(tasks), sharey="row", sharex="col", squeeze=False)
    for row, metric in zip(grid, shown, strict=True):
        for axes, here in zip(row, by_task, strict=True):
            _draw_panel(axes, here, laws, metric)
        row[0].set_ylabel(metric.label)
    for column, task, here in zip(grid.T, tasks, by_task, strict=True):
        column[0].set_title(task)
        column[-1].set_xlabel(_unit(here) or "each law in turn")
    handles = grid[0, 0].get_legend_handles_labels()
    drawn.legend(*handles, loc="outside lower center", ncols=min(len(laws), 6))
    return drawn


def _unit(here: Sequence[Cell]) -> str:
    return here[0].amounts[0].partition(" ")[2]


def _draw_panel(axes: Axes, here: Sequence[Cell], laws: Sequence[str], metric: Metric) -> None:
    """One metric of one task: a curve over the amounts; where they are bare numbers, random starts, a strip of points per law."""
    commanded = bool(_unit(here))
    for cell in here:
        i = laws.index(cell.law)
        look: dict[str, Any] = {"color": LINE_COLORS[i % len(LINE_COLORS)], "marker": MARKERS[i % len(MARKERS)], "label": cell.law}
        value, good = cell.controller.values(metric), cell.controller.success
        amount = np.array([float(a.partition(" ")[0]) for a in cell.amounts])
        if commanded:
            axes.plot(amount, np.where(good, value, np.nan), linewidth=0.7, markersize=4.5, fillstyle="none", **look)
            _crosses(axes, amount[~good], i, len(laws))
        else:
            place = i + 0.6 * (amount / max(amount.max(), 1.0) - 0.5)  # strips of width 0.6, one unit apart
            axes.plot(place[good], value[good], linestyle="none", markersize=3, fillstyle="none", markeredgewidth=0.7, **look)
            _crosses(axes, place[~good], i, len(laws))
    if not commanded:
        axes.set_xticks([])


def _crosses(axes: Axes, at: Array, place: int, of: int) -> None:
    """Failed runs as crosses at the top of the panel, each law at its own height."""
    if len(at):
        # in axes coordinates, just below the top
        height = np.full(len(at), 0.99 - 0.1 * place / max(of, 1))
        axes.plot(at, height, "x", markersize=3.5, markeredgewidth=0.9, color=LOST, transform=axes.get_xaxis_transform())


def write_task_report(
    folder: Path, table: pl.DataFrame, axes: tuple[str, ...], metrics: tuple[str, ...], description: str, command: str, call: Call = at_once
) -> Path:
    """Write `report.html`, `tasks.md`, `figures/tasks.*`, `controllers.*` and `pairs.*` into a comparison's folder; returns the page.

    As `page.write_comparison_report`; the table has the columns `task` and `amount`, and the first three metrics are drawn.
    """
    found = cells(table, axes)
    drawn = call(_on_page, found, metrics), call(_paper, make_folder(folder / "figures"), found, metrics)
    write_whole(folder / "tasks.md", markdown(found, metrics))
    n, good = len(table), int(table["success"].cast(pl.Boolean, strict=False).fill_null(False).sum())
    numbers = "".join(f"<h3>{escape(title)}</h3>{_html(found, lambda c, text=text: escape(text(c)))}" for title, text in _spreads(metrics))
    caption = "Numbers of the runs that reached the goal; red crosses at the top: runs that did not, each law at its own height."
    body = [
        f"<p>{good} of {n} runs reached the goal. Each cell: how many, the median time to converge, the 95 % interval of the rate, "
        "and each failure by its outcome.</p>",
        _html(found, _summary_cell),
        baseline.section(folder),
        f'<section><h2>Figure</h2><div class="broad">{figure("Over the amounts", result_of(drawn[0]), caption)}</div></section>',
        f"<section><h2>In numbers</h2>{numbers}</section>" if numbers else "",
        *_statistics(folder, over_all_tasks(table, axes, metrics)),
        failures_section(folder, ComparisonResults(table, axes, metrics)),
        made_by(command),
    ]
    heading = " and ".join(dict.fromkeys(map(str, table["scenario"].to_list())))
    result_of(drawn[1])
    return write_whole(folder / "report.html", page(f"{heading}: tasks", body, f"<p>{escape(description)}</p>", heading))


def _statistics(folder: Path, laws: ComparisonResults) -> tuple[str, ...]:
    """The laws over all tasks, as HTML and as tables for other programs."""
    all_pairs, means = pairs(laws), interquartiles(laws)
    write_records(folder, laws, means, all_pairs)
    words = (
        "Intervals and p-values are those of starts that are a random sample of each task; where the amounts were chosen, "
        "they say how far other amounts of that kind could change the result."
    )
    return (
        f"<section><h2>Over all tasks</h2><p>{words}</p></section>",
        tables.interquartile_means(laws, means),
        tables.differences(laws, all_pairs),
        tables.improvements(laws, all_pairs),
        SCRIPT,
    )


def _paper(folder: Path, found: Sequence[Cell], metrics: Sequence[str]) -> None:
    with style(paper=True):
        drawn = draw(found, metrics, 8.2)
        save(drawn, folder / "tasks.pdf")
        save(drawn, folder / "tasks.png", DPI)


def _on_page(found: Sequence[Cell], metrics: Sequence[str]) -> str:
    with style():
        return to_svg(draw(found, metrics, 13.0), "tasks", "Each law over the amounts of each task")
