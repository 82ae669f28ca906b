"""The page of a search for good settings, and its figures: trials over each parameter, the best so far."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from vstestbed.core.files import make_folder, write_whole
from vstestbed.report.comparison.columns import Metric
from vstestbed.report.comparison.tables import SCRIPT, Cell, table
from vstestbed.report.comparison.tables import STYLE as TABLES
from vstestbed.report.html.canvas import GOAL, LINE_COLORS, LOST, WIDTH_IN, new_figure, save, style, to_svg
from vstestbed.report.html.template import PAGE, STYLE, figure
from vstestbed.report.run.numbers import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLUMNS: Final = 3
"""Panels side by side."""
DPI: Final = 200
WIDE: Final = 20.0
"""Ratio of the largest to the smallest number from which an axis is logarithmic."""


@dataclass(frozen=True)
class TrialRow:
    """A trial as the page shows it.

    Attributes:
        number: of the trial. values: of each parameter, a number or a word. reached, runs: how many runs reached the goal, of how many.
        mean: of the metric over those runs, NaN where none has it. note: how the others ended.
    """

    number: int
    values: tuple[float | str, ...]
    reached: int
    runs: int
    mean: float
    note: str = ""

    @property
    def whole(self) -> bool:
        """Whether all runs reached the goal, and the metric is known."""
        return self.reached == self.runs > 0 and math.isfinite(self.mean)


@dataclass(frozen=True)
class ParameterAxis:
    """A parameter: its path, its ends (low, high) or its words, and whether equal factors are equally far apart."""

    path: str
    ends: tuple[float, float] = (0.0, 1.0)
    words: tuple[str, ...] = ()
    log: bool = False

    def place(self, value: float | str) -> float:
        """Where a value is drawn: words at 0, 1, 2, ..."""
        return float(self.words.index(str(value))) if self.words else float(value)


@dataclass(frozen=True)
class TuningPage:
    """What the page of a search shows.

    Attributes:
        title: the scenario. headline, sentences: the result in words. command: that takes it. metric: by which trials are compared.
        higher: whether more is better. sure: whether nothing speaks against the result.
        axes: the parameters. trials: in their order. best: number of the best one; None without any.
        made_by: the command that repeats the search.
    """

    title: str
    headline: str
    sentences: Sequence[str]
    command: str
    metric: Metric
    higher: bool
    sure: bool
    axes: Sequence[ParameterAxis]
    trials: Sequence[TrialRow]
    best: int | None
    made_by: str = ""


def slices(page: TuningPage, width_in: float) -> Figure:
    """The metric of each trial over each parameter; red crosses at the top: trials some of whose runs failed."""
    rows = -(-len(page.axes) // COLUMNS)
    drawn = new_figure(2.5 * rows, width_in)
    grid = np.ravel(drawn.subplots(rows, min(COLUMNS, len(page.axes)), sharey=True, squeeze=False))
    for i, axes in enumerate(grid):
        if i >= len(page.axes):
            axes.set_visible(False)
            continue
        axis = page.axes[i]
        _points(axes, page, [axis.place(trial.values[i]) for trial in page.trials])
        axes.set_xlabel(axis.path)
        if axis.words:
            axes.set_xticks(range(len(axis.words)), [word[:24] for word in axis.words], rotation=20 if max(map(len, axis.words)) > 8 else 0)
            axes.set_xlim(-0.5, len(axis.words) - 0.5)
        elif axis.log:
            axes.set_xscale("log")
    grid[0].set_ylabel(page.metric.label)
    return drawn


def history(page: TuningPage, width_in: float) -> Figure:
    """The metric of each trial in their order, with the best so far."""
    drawn = new_figure(2.5, width_in)
    axes = drawn.add_subplot()
    _points(axes, page, [trial.number for trial in page.trials])
    good = [(trial.number, trial.mean) for trial in page.trials if trial.whole]
    if good:
        numbers, means = (np.array(column, dtype=float) for column in zip(*good, strict=True))
        so_far = (np.maximum if page.higher else np.minimum).accumulate(means)
        axes.step([*numbers, page.trials[-1].number], [*so_far, so_far[-1]], where="post", color=LINE_COLORS[0])
    axes.set_xlabel("trial")
    axes.set_ylabel(page.metric.label)
    return drawn


def _points(axes: Axes, page: TuningPage, places: Sequence[float]) -> None:
    """A point for each trial: later ones darker, the best one ringed, those with failed runs as crosses at the top."""
    for trial, x in zip(page.trials, places, strict=True):
        if trial.whole:
            shade = 0.25 + 0.65 * (trial.number + 1) / len(page.trials)
            axes.plot(x, trial.mean, "o", markersize=4.5, color=LINE_COLORS[0], alpha=shade, markeredgewidth=0)
            if trial.number == page.best:
                axes.plot(x, trial.mean, "o", markersize=10, markerfacecolor="none", markeredgecolor=GOAL, markeredgewidth=1.8)
        else:
            axes.plot(x, 0.97, "x", color=LOST, markersize=5, transform=axes.get_xaxis_transform(), clip_on=False)
    means = [trial.mean for trial in page.trials if trial.whole]
    if means and min(means) > 0 and max(means) / min(means) > WIDE:
        axes.set_yscale("log")
    axes.margins(y=0.12)


PLOTS: Final = (
    (
        "slices",
        "Trials over each parameter",
        slices,
        "A point for each trial whose runs all reached the goal: the mean of the metric, later trials darker, the best one ringed. "
        "Red crosses at the top: trials of which a run failed, which count as worse than all of the others.",
    ),
    ("history", "Trials in their order", history, "The line is the best trial so far."),
)


def write_page(folder: Path, page: TuningPage) -> Path:
    """Write `report.html`, and the figures as PDF and PNG into `figures/`; returns the page's path.

    Raises:
        OutputError: a file cannot be written.
    """
    place, parts = make_folder(folder / "figures"), []
    for key, title, draw, caption in PLOTS:
        with style(paper=True):
            drawn = draw(page, 7.16)
            save(drawn, place / f"{key}.pdf")
            save(drawn, place / f"{key}.png", DPI)
        with style():
            parts.append(f'<div class="broad">{figure(title, to_svg(draw(page, 2 * WIDTH_IN), key, title), caption)}</div>')
    listed = "".join(f"<li>{escape(words)}</li>" for words in page.sentences)
    good = "" if page.best is None else " good" if page.sure else " open"
    body = [
        f'<div class="outcome{good}"><strong>{escape(page.headline)}</strong><ul>{listed}</ul></div>',
        f"<section><h2>To take it</h2><pre>{escape(page.command)}</pre></section>" if page.command else "",
        f"<section><h2>Figures</h2>{''.join(parts)}</section>",
        _trials(page),
        f"<section><h2>How it was made</h2><p>Made again by<br><code>{escape(page.made_by)}</code></p></section>" if page.made_by else "",
        SCRIPT,
    ]
    heading = f"{page.title}: tuning"
    described = f'<p class="soft">{len(page.trials)} trials by {escape(page.metric.title.lower())}</p>'
    html = PAGE.format(
        title=escape(heading), style=STYLE + TABLES, heading=escape(heading), description=described, body="\n".join(filter(None, body))
    )
    return write_whole(folder / "report.html", html)


def _trials(page: TuningPage) -> str:
    """All trials, the best first."""
    heads = ["Trial", *(axis.path for axis in page.axes), "Reached the goal", page.metric.label, "The others ended"]
    sign = -1 if page.higher else 1
    order = sorted(page.trials, key=lambda t: (t.runs - t.reached or not t.runs, sign * t.mean if math.isfinite(t.mean) else math.inf))
    lines: list[list[Cell]] = [
        [
            (trial.number, f"{trial.number}{' (the best)' if trial.number == page.best else ''}"),
            *((value, escape(value) if isinstance(value, str) else f"{value:g}") for value in trial.values),
            (trial.reached, f"{trial.reached} of {trial.runs}"),
            (trial.mean, number(trial.mean)) if math.isfinite(trial.mean) else (None, "–"),
            (trial.note, escape(trial.note)),
        ]
        for trial in order
    ]
    return f'<section><h2>Trials</h2>{table(heads, lines)}<p class="soft">Click on a head to sort.</p></section>'
