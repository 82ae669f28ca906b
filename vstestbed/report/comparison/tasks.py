"""Report of a comparison with tasks: laws by tasks with every failure, figures over the amounts
(what varies in a task: `20 deg`).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl

from vstestbed.core.files import write_whole
from vstestbed.core.shares import result_of
from vstestbed.report.canvas import new_figure, publish, style
from vstestbed.report.comparison import baseline, tables
from vstestbed.report.comparison.page import AT_ONCE, Drawing, by_one_metric, failures, write_tables
from vstestbed.report.comparison.pairs import pairs
from vstestbed.report.comparison.records import write_records
from vstestbed.report.comparison.results import (
    TASK,
    TIME,
    ComparisonResults,
    ControllerResults,
    interquartiles,
)
from vstestbed.report.comparison.sentences import findings
from vstestbed.report.marks import FAILED, MARKERS, Look, line_color
from vstestbed.report.pages import write_page
from vstestbed.tasks.metrics import Metric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AMOUNT = "amount"
DRAWN = (TIME.name, "max_retreat_m")  # Metrics that are drawn where a comparison names none
MOST_ROWS = 3  # Metrics that are drawn: the first ones; all have tables
MOST_AMOUNTS = 20  # Most failed runs of a cell that are named
ROUNDING = 1e-6  # Values below this are rounding errors in the unit of any metric

Cell = tuple[str, str, ControllerResults]  # A cell of the table: a law, a task, and its runs in it


def amounts(runs: ControllerResults) -> list[str]:
    """The amount of each run."""
    return [str(a) for a in runs.runs[AMOUNT].to_list()]


def summary_lines(runs: ControllerResults) -> list[str]:
    """Successes with their median time, then one line for each outcome of failed runs with their
    amounts.
    """
    by_outcome: dict[str, list[str]] = defaultdict(list)
    for amount, outcome, reached in zip(
        amounts(runs), runs.runs["outcome"].to_list(), runs.success, strict=True
    ):
        if not reached:
            by_outcome[str(outcome)].append(amount)
    good, n = int(runs.success.sum()), len(runs.success)
    first = f"{good} of {n}" + (f", {runs.quartiles(TIME)[1]:.1f} s" if good else "")
    return [first] + [
        f"{_numbers(those)}: {outcome.replace('_', ' ')}" for outcome, those in by_outcome.items()
    ]


def _spread(runs: ControllerResults, metric: Metric) -> str:
    """Median and largest value of a metric over the runs that count (`ControllerResults.counted`);
    empty if none has it.
    """
    counted = runs.counted(metric)
    counted = counted[np.isfinite(counted)]
    return (
        f"{_digits(float(np.median(counted)))}, {_digits(float(counted.max()))}"
        if len(counted)
        else ""
    )


def _digits(value: float) -> str:
    """A value with three digits, 0 if it is a rounding error."""
    return "0" if abs(value) < ROUNDING else f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def _numbers(amounts: Sequence[str]) -> str:
    """A list of amounts with their unit once: `160, 180 deg`; `no. 3, 7` for bare numbers."""
    numbers, units = zip(*(a.partition(" ")[::2] for a in amounts), strict=True)
    if (more := len(numbers) - MOST_AMOUNTS) > 0:
        numbers = (*numbers[:MOST_AMOUNTS], f"and {more:,} more")
    return f"{', '.join(numbers)} {units[0]}" if units[0] else f"no. {', '.join(numbers)}"


def cells(laws: ComparisonResults) -> list[Cell]:
    """Every law in every task, in order of first appearance; laws: `over_all_tasks`."""
    return [
        (law.label, task, ControllerResults(law.label, law.runs.filter(pl.col(TASK) == task)))
        for law in laws.controllers
        for task in dict.fromkeys(laws.table[TASK].to_list())
        if task in law.tasks
    ]


def over_all_tasks(comparison: ComparisonResults) -> ComparisonResults:
    """Each law, a combination of all axes but the task, with its runs in all tasks: the strata of
    statistics over all of them.
    """
    return replace(
        comparison,
        axes=tuple(axis for axis in comparison.axes if axis != TASK),
        metrics=comparison.metrics or DRAWN,
    )


def markdown(found: Sequence[Cell], metrics: Sequence[str] = ()) -> str:
    """Markdown tables, laws by tasks: successes and failures; then median and largest value of each
    metric but the time.
    """

    def lines(text: Callable[[ControllerResults], str]) -> str:
        heads, rows = _grid(found, text)
        top = [f"| {' | '.join(heads)} |".replace("|  |", "| |"), "|---" * len(heads) + "|"]
        return (
            "\n".join([*top, *(f"| `{law}` | {' | '.join(cells)} |" for law, *cells in rows)])
            + "\n"
        )

    first = lines(lambda runs: "; ".join(summary_lines(runs)))
    return "\n".join([first, *(f"{title}\n\n{lines(text)}" for title, text in _spreads(metrics))])


def _spreads(metrics: Sequence[str]) -> list[tuple[str, Callable[[ControllerResults], str]]]:
    """Title and cells of a table for each metric but the time, which stands in the first table
    already.
    """
    shown = [Metric.named(name) for name in metrics if name != TIME.name]
    return [
        (f"{m.label}: median and largest of {m.over}", lambda runs, m=m: _spread(runs, m))
        for m in shown
    ]


def _grid(
    found: Sequence[Cell], text: Callable[[ControllerResults], Any]
) -> tuple[list[str], list[list[Any]]]:
    """Heads and lines of a table: the tasks, and each law with a text for each task, empty where it
    has no runs.
    """
    tasks, laws = _tasks_and_laws(found)
    of = {(law, task): text(runs) for law, task, runs in found}
    return ["", *tasks], [[law, *(of.get((law, task), "") for task in tasks)] for law in laws]


def _tasks_and_laws(found: Sequence[Cell]) -> tuple[list[str], list[str]]:
    """Columns and rows of the table, in order of first appearance."""
    return list(dict.fromkeys(task for _, task, _ in found)), list(
        dict.fromkeys(law for law, _, _ in found)
    )


def _summary_cell(runs: ControllerResults) -> list[str]:
    """Successes with their median time; below, the interval of the rate and the failures."""
    first, *failures = summary_lines(runs)
    rate = runs.rate
    return [first, f"[{100 * rate.low:.0f}, {100 * rate.high:.0f}] %", *failures]


def draw(found: Sequence[Cell], metrics: Sequence[str], width_in: float) -> Figure:
    """One column per task, one row per metric: each law's values over the amounts; red crosses at
    the top: failed runs.
    """
    tasks, laws = _tasks_and_laws(found)
    by_task = [[cell for cell in found if cell[1] == task] for task in tasks]
    shown = [Metric.named(name) for name in (metrics or DRAWN)[:MOST_ROWS]]
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
    return amounts(here[0][2])[0].partition(" ")[2]


def _draw_panel(axes: Axes, here: Sequence[Cell], laws: Sequence[str], metric: Metric) -> None:
    """One metric of one task: a curve over the amounts; where they are bare numbers, random starts,
    a strip of points per law.
    """
    commanded = bool(_unit(here))
    for law, _, runs in here:
        i = laws.index(law)
        # a marker a law, which tells them apart where colours do not: in grey, and with more laws
        # than colours
        look: Look = {"color": line_color(i), "marker": MARKERS[i % len(MARKERS)], "label": law}
        value, good = runs.values(metric), runs.success
        at = np.array([float(a.partition(" ")[0]) for a in amounts(runs)])
        if commanded:
            axes.plot(
                at,
                np.where(good, value, np.nan),
                linewidth=0.7,
                markersize=4.5,
                fillstyle="none",
                **look,
            )
        else:
            at = i + 0.6 * (at / max(at.max(), 1.0) - 0.5)  # strips of width 0.6, one unit apart
            axes.plot(
                at[good],
                value[good],
                linestyle="none",
                markersize=3,
                fillstyle="none",
                markeredgewidth=0.7,
                **look,
            )
        # failed runs as crosses just below the top of the panel, each law at its own height
        if not good.all():
            height = np.full(int((~good).sum()), 0.99 - 0.1 * i / len(laws))
            axes.plot(at[~good], height, transform=axes.get_xaxis_transform(), **FAILED)
    if not commanded:
        axes.set_xticks([])


def write_task_report(
    folder: Path,
    comparison: ComparisonResults,
    command: str,
    drawing: Drawing = AT_ONCE,
) -> Path:
    """Write `report.html`, `tasks.md`, `tables.*`, `controllers.*` and `pairs.*` into a
    comparison's folder.

    As `page.write_comparison_report`; the table has the columns `task` and `amount`, and the first
    three metrics are drawn.
    """
    table = comparison.table
    metrics = comparison.metrics
    laws = over_all_tasks(comparison)
    found = cells(laws)
    drawn = drawing.call(_drawn, found, metrics, drawing.place(folder))
    write_whole(folder / "tasks.md", markdown(found, metrics))
    all_pairs = pairs(laws)
    means = interquartiles(laws)
    words = findings(laws, all_pairs)
    write_records(folder, laws, means, all_pairs, words)
    sections = tables.sections(laws, means, all_pairs, every=False)
    write_tables(folder, words, sections["sections"])
    heading = " and ".join(dict.fromkeys(map(str, table["scenario"].to_list()))) + by_one_metric(
        comparison
    )
    return write_page(
        folder,
        "tasks.html",
        f"{heading}: tasks",
        title=heading,
        description=comparison.description,
        found=words,
        reached=(
            int(table["success"].cast(pl.Boolean, strict=False).fill_null(False).sum()),
            len(table),
        ),
        overview=_grid(found, _summary_cell),
        baseline=baseline.section(folder),
        figure=result_of(drawn),
        numbers=[(title, *_grid(found, text)) for title, text in _spreads(metrics)],
        **sections,
        failures=failures(folder, comparison),
        command=command,
    )


def _drawn(found: Sequence[Cell], metrics: Sequence[str], place: Path | None) -> str:
    with style():
        return publish(
            draw(found, metrics, 8.2), "tasks", "Each law over the amounts of each task", place
        )
