"""Figures of a comparison over all runs; each takes the data and its width [in], since the page and
a paper need different sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.loop.log_file import open_log
from vstestbed.report.canvas import new_figure, panels, plain, wrapped
from vstestbed.report.comparison.pairs import Pair
from vstestbed.report.comparison.results import (
    RESTRICTED,
    TIME,
    ComparisonResults,
    ControllerResults,
)
from vstestbed.report.comparison.statistics import FEWEST, LEAST, NOTHING, wilson
from vstestbed.report.marks import (
    FAILED,
    GOAL,
    INK,
    LINE_COLORS,
    LOST,
    RULE,
    THRESHOLD,
    Look,
    look,
    signed,
)
from vstestbed.report.marks import TIME as TIME_LABEL
from vstestbed.report.run.tracks import MeasuredError
from vstestbed.tasks.metrics import Metric

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The error in the image of many runs over time, resampled to one time grid.
#
# Logs are read one at a time and only INSTANTS values of each are kept, so that memory does not
# grow with the length of the logs.
INSTANTS = 240  # Points of the time grid: more than can be resolved in one panel of a figure
SAMPLED, LEAST_SAMPLED = 2000, 20
"""Logs that are read in all, shared among the controllers, and fewest of each: to read one takes a
millisecond.
"""
# Error that stands for a lost target: larger than any real one, but finite, since quantiles
# interpolate (inf - inf is NaN)
_FAR = 1e30


@dataclass(frozen=True)
class Data:
    """Everything the figures draw: the results, and the RMS image error of every run over time."""

    comparison: ComparisonResults
    pairs: Sequence[Pair] = ()
    t: Array = field(default_factory=lambda: np.zeros(1))  # the common time grid, shape (G,) [s]
    # of each controller, shape (runs, G) [unit of `measured`]; NaN while the target is lost and for
    # runs without a log
    errors: tuple[NDArray[np.float32], ...] = ()
    # the errors are of so many first runs of each controller; None: of all
    sampled: int | None = None
    # which error it is of each controller, with the threshold
    measured: tuple[MeasuredError, ...] = ()

    @cached_property
    def labels(self) -> list[str]:
        """The controllers' labels, as matplotlib takes them."""
        return [plain(c.label) for c in self.comparison.controllers]

    @cached_property
    def shown(self) -> tuple[Metric, ...]:
        """The metrics that any run has: a panel without values says nothing."""
        metrics, controllers = self.comparison.shown, self.comparison.controllers
        return (
            tuple(m for m in metrics if any(np.isfinite(c.values(m)).any() for c in controllers))
            or metrics[:1]
        )

    def units(self) -> dict[MeasuredError, list[int]]:
        """The controllers that are measured in the same, by number."""
        found: dict[MeasuredError, list[int]] = {}
        for i, error in enumerate(self.measured):
            found.setdefault(error, []).append(i)
        return found

    def quartiles(self, controller: int) -> Array:
        """First quartile, median and third quartile over the runs, shape (3, G); inf where so many
        runs have lost the target.

        A run without target ranks behind every run that sees it: else a controller that loses its
        worst runs would look better.
        """
        errors = self.errors[controller].astype(float)
        if not len(errors):
            return np.full((3, len(self.t)), np.inf)
        quartiles = np.quantile(
            np.where(np.isfinite(errors), errors, _FAR), [0.25, 0.5, 0.75], axis=0
        )
        # also where _FAR was only a part of the interpolation
        return np.where(quartiles < 1e-3 * _FAR, quartiles, np.inf)


def read_series(
    folder: Path,
    comparison: ComparisonResults,
    pairs: Sequence[Pair] = (),
    measured: Sequence[MeasuredError] = (),
) -> Data:
    """The data of the figures; of very many runs the errors of the first of each controller; after
    its end a run holds its last value.

    `measured`: which error of each controller, by default that of markers. RunFolderError: a log is
    damaged.
    """
    # the duration of the longest run; 1 s if no run has any, so that the grid is not empty
    longest = (
        comparison.table["sim_time_s"].cast(pl.Float64, strict=False).max()
        if "sim_time_s" in comparison.table.columns
        else None
    )
    t = np.linspace(0, longest if isinstance(longest, float) and longest > 0 else 1.0, INSTANTS)
    most = max(SAMPLED // max(len(comparison.controllers), 1), LEAST_SAMPLED)
    measured = tuple(measured) or (MeasuredError(),) * len(comparison.controllers)
    of_controllers = []
    for controller, error in zip(comparison.controllers, measured, strict=True):
        # the first, not a random choice: the same page from the same table
        places = controller.runs["folder"].head(most).to_list()
        # single precision halves the memory of large comparisons
        errors = np.full((len(places), len(t)), np.nan, dtype=np.float32)
        for i, place in enumerate(places):
            errors[i] = _resampled(folder / str(place) / "log.parquet", error.column, t)
        of_controllers.append(errors)
    sampled = most if any(len(c.runs) > most for c in comparison.controllers) else None
    return Data(comparison, pairs, t, tuple(of_controllers), sampled, measured)


def _resampled(path: Path, column: str, t: Array) -> Array:
    """Zero-order hold of a log's error at the times t (G,) [s]; NaN before its first frame, and
    everywhere where there is no log.
    """
    if not path.is_file():  # of a run that crashed
        return np.full(len(t), np.nan)
    times, error = open_log(path.parent, names=("t", column)).table.T
    # 1e-9 s: a grid point that rounding has put just before its frame belongs to that frame
    frame = np.searchsorted(times, t + 1e-9, side="right") - 1
    return (
        np.where(frame >= 0, error[np.maximum(frame, 0)], np.nan)
        if len(error)
        else np.full(len(t), np.nan)
    )


# Most controllers whose quartile bands are drawn in one panel: more bands hide each other
BANDS = 4
# Most controllers with a line, a row or a panel of their own: lines of more cannot be told apart
PANELS = 24
# Single runs drawn in all panels of `each_run` together, and fewest and most in one panel
LINES, EACH_LEAST, EACH_MOST = 200, 5, 30


def medians(data: Data, width_in: float) -> Figure:
    """Median error of each controller over time with its quartile band,
    in one panel for each unit.
    """
    units = data.units()
    figure = new_figure(
        (0.58 + 0.4 * (len(units) - 1)) * width_in + legend_height_in(data), width_in
    )
    grid = panels(figure, len(units), 1, sharex=True)
    for axes, (error, those) in zip(grid, units.items(), strict=True):
        quartiles = [data.quartiles(i) for i in those]
        for i, quartile in zip(those, quartiles, strict=True):
            _draw_quartiles(axes, data.t, quartile, look(i), band=len(data.labels) <= BANDS)
        _error_axes([axes], data.t[-1], error, [*quartiles, *(data.errors[i] for i in those)])
        axes.set_ylabel(wrapped(error.label, 16))
        if error.threshold and axes.get_yscale() == "log":
            # on the left, where no curve is at its goal yet
            words, at = f"{error.threshold:g} {error.unit}", (0.01, error.threshold)
            axes.annotate(words, at, xycoords=axes.get_yaxis_transform(), va="bottom", ha="left")
    grid[-1].set_xlabel(TIME_LABEL)
    legend(figure, data)
    return figure


def each_run(data: Data, width_in: float) -> Figure:
    """One panel per controller: its runs, its median and quartile band, and in grey the medians of
    the others in the same unit.
    """
    n, units = len(data.labels), data.units()
    # at most 4, and rows of equal length: 5 panels are 3 + 2, not 4 + 1
    columns = -(-n // -(-n // 4))
    figure = new_figure(width_in / max(columns, 3) * 0.8 * -(-n // columns) + 0.3, width_in)
    grid = panels(figure, n, columns, sharex=True, sharey=len(units) == 1)
    for i, axes in enumerate(grid):
        axes.set_title(wrapped(data.labels[i], 28))
        axes.xaxis.set_tick_params(labelbottom=i + columns >= n)
    for error, those in units.items():
        _draw_alike({i: grid[i] for i in those}, data, error)
        if len(units) > 1:
            for i in those:
                grid[i].set_ylabel(wrapped(error.label, 16))
    size = grid[0].xaxis.label.get_size()
    figure.supxlabel(TIME_LABEL, fontsize=size)
    if len(units) == 1:
        figure.supylabel(next(iter(units)).label, fontsize=size)
    return figure


def _draw_alike(grid: Mapping[int, Axes], data: Data, error: MeasuredError) -> None:
    """The controllers that are measured in the same, by number, each with the others' medians."""
    quartiles = {i: data.quartiles(i) for i in grid}
    for i, axes in grid.items():
        for k, (_, median, _) in quartiles.items():
            if k != i:
                axes.plot(data.t, _shown(median), color=RULE, linewidth=0.8)
        _draw_runs(axes, data, i)
        _draw_quartiles(axes, data.t, quartiles[i], look(i) | {"linestyle": "-"}, band=True)
    shown = [*quartiles.values(), *(data.errors[i] for i in grid)]
    _error_axes([*grid.values()], data.t[-1], error, shown)


def _draw_runs(axes: Axes, data: Data, i: int) -> None:
    """The first runs of a controller; failed ones in red, with a cross where the target was last
    seen.
    """
    most = min(max(LINES // len(data.labels), EACH_LEAST), EACH_MOST)
    success = data.comparison.controllers[i].success
    for error, reached in zip(data.errors[i][:most], success, strict=False):
        line = _shown(error.astype(float))
        # failures on top: they are few
        color, alpha, order = (look(i)["color"], 0.45, 2) if reached else (LOST, 0.9, 4)
        axes.plot(data.t, line, color=color, linewidth=0.5, alpha=alpha, zorder=order)
        seen = np.flatnonzero(np.isfinite(line))
        if not reached and len(seen):
            axes.plot(data.t[seen[-1]], line[seen[-1]], **FAILED)


def _draw_quartiles(axes: Axes, t: Array, quartile: Array, style: Look, band: bool) -> None:
    """Median (line) and band between the quartiles (3, G) over the times t (G,)."""
    low, middle, high = quartile
    if band:
        seen = np.isfinite(low) & (low > 0)
        # a quarter of the runs is lost: the band is open above
        top = np.where(np.isfinite(high), high, 1e9)
        axes.fill_between(
            t,
            np.where(seen, low, 1),
            top,
            where=seen.tolist(),
            color=style["color"],
            alpha=0.2,
            linewidth=0,
        )
    axes.plot(t, _shown(middle), **style)


def _shown(error: Array) -> Array:
    """The error with NaN (a gap) where a logarithmic axis cannot show it."""
    return np.where(np.isfinite(error) & (error > 0), error, np.nan)


def _error_axes(
    panels: Sequence[Axes],
    end_s: float,
    error: MeasuredError,
    shown: Sequence[Array | NDArray[np.float32]],
) -> None:
    """Logarithmic axis of errors, the same in each panel, over the runs, their quartiles and the
    threshold, whose words need room.
    """
    values = np.concatenate([e[np.isfinite(e) & (e > 0)].astype(float) for e in shown])
    if not len(values):
        panels[0].set_yticks([])
        panels[0].text(
            0.5,
            0.5,
            "no run with a log",
            transform=panels[0].transAxes,
            ha="center",
            va="center",
            alpha=0.7,
        )
        return
    # a single outlier may not squeeze all other curves
    low, high = np.quantile(values, [0.001, 0.999])
    for panel in panels:
        panel.set_yscale("log")
        panel.set_ylim(
            0.7 * min(low, error.threshold or low), 1.5 * max(high, error.threshold or high)
        )
        panel.set_xlim(0, end_s)
        if error.threshold:
            panel.axhline(error.threshold, **THRESHOLD)


def differences(data: Data, width_in: float) -> Figure | None:
    """Forest plot: mean paired difference of each metric with its interval, significant ones in
    colour; None without any interval.
    """
    rows = data.pairs
    if len(data.labels) > BANDS:  # each controller against the first
        rows = [pair for pair in rows if pair.a == 0]
    shown = [m for m in data.shown if _has_interval(m, rows)]
    # else a single controller, or so few seeds on which both reached the goal that intervals would
    # hide all else
    return _forest(data, rows, shown, width_in) if shown else None


def _forest(data: Data, rows: Sequence[Pair], shown: Sequence[Metric], width_in: float) -> Figure:
    """A row for each pair, a panel for each metric."""
    names = [wrapped(f"{data.labels[p.b]} \N{MINUS SIGN} {data.labels[p.a]}", 30) for p in rows]
    lines = "".join(names).count("\n") + len(names)
    grid, figure = metric_panels(shown, width_in, 0.22 * lines + 0.06 * len(rows) + 1.0, 5, names)
    for axes, metric in zip(grid, shown, strict=True):
        axes.axvline(0, color=INK, linewidth=0.8)
        largest = [_draw_difference(axes, row, pair, metric.name) for row, pair in enumerate(rows)]
        if max(largest) <= 1e-9:  # rounding errors, in any display unit, would fill the width
            axes.set_xlim(-1, 1)
    return figure


def _has_interval(metric: Metric, rows: Sequence[Pair]) -> bool:
    found = [pair.differences.get(metric.name, NOTHING) for pair in rows]
    return max((d.n for d in found), default=0) >= FEWEST


def _draw_difference(axes: Axes, row: int, pair: Pair, metric: str) -> float:
    """A pair's mean difference and its interval in a row; the largest of the numbers."""
    d = pair.differences.get(metric, NOTHING)
    real = metric in pair.differences and pair.is_real(metric)
    # filled if the difference is real, in colour also if only the improvement is
    more_often = metric in pair.improvements and pair.is_real(metric, "improvement")
    color = LINE_COLORS[1] if real or more_often else LINE_COLORS[7]
    if np.isfinite(d.low):
        axes.plot([d.low, d.high], [row, row], color=color, linewidth=1.8)
    axes.plot(
        d.mean,
        row,
        "o" if real else "D",
        color=color,
        markersize=4,
        markerfacecolor=color if real else "none",
    )
    return float(np.abs(np.nan_to_num([d.mean, d.low, d.high])).max())


def matrix(data: Data, width_in: float) -> Figure | None:
    """Who is better than whom, a row against a column, with the difference of the primary metric;
    None of fewer than three controllers.
    """
    n = len(data.labels)
    if n < 3 or len(data.pairs) < n * (n - 1) / 2:
        return None
    figure = new_figure(0.3 * n + 1.2, width_in)
    axes = figure.add_subplot()
    metric = data.pairs[0].primary
    size = min(7.0, 50 / n)
    for pair in data.pairs:
        for p in (pair, pair.turned()):  # a is the column, b the row
            _draw_mark(axes, p, size)
            d = p.differences[metric.name].mean
            words = signed(d) if np.isfinite(d) else "\N{EN DASH}"
            axes.text(p.a, p.b + 0.4, words, ha="center", va="bottom", fontsize=0.8 * size)
    names = [wrapped(name, 22) for name in data.labels]
    axes.set_xticks(range(n), names, rotation=45, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(n), names)
    axes.set_ylim(n - 0.5, -0.5)
    axes.set_xlim(-0.5, n - 0.5)
    axes.set_title(wrapped(f"{metric.label}, row minus column", 44), fontsize=8)
    axes.grid(visible=False)
    axes.tick_params(length=0)
    return figure


def _draw_mark(axes: Axes, pair: Pair, size: float) -> None:
    """Full dot: the row b is better than the column a; ring: it is sooner, which is no verdict; T:
    a trade.
    """
    place = (pair.a, pair.b - 0.12)
    if pair.better == pair.b:
        axes.plot(*place, "o", color=GOAL, markersize=size)
    elif pair.verdict.decision == "trade":
        axes.text(*place, "T", ha="center", va="center", fontsize=size, fontweight="bold")
    elif pair.better is None and pair.sooner == pair.b:
        axes.plot(*place, "o", color=GOAL, markersize=size, markerfacecolor="none")


def metric_panels(
    metrics: Sequence[Metric], width_in: float, panel_in: float, columns: int, names: Sequence[str]
) -> tuple[list[Any], Figure]:
    """One panel per metric in a grid, with the same named rows in each panel, the first on top."""
    n = len(metrics)
    columns = min(n, columns)
    figure = new_figure(panel_in * -(-n // columns), width_in)
    grid = panels(figure, n, columns, sharey=True)
    grid[0].set_yticks(range(len(names)), names)
    grid[0].set_ylim(len(names) - 0.4, -0.6)  # reversed: the first row on top
    for axes, metric in zip(grid, metrics, strict=True):
        axes.set_xlabel(wrapped(metric.label, 18))
        axes.grid(axis="y", visible=False)
        axes.tick_params(axis="y", length=0)
        axes.locator_params(axis="x", nbins=2)
        # 0, not 0.0000: numbers of many digits would overlap
        axes.xaxis.set_major_formatter("{x:g}")
    return grid, figure


def legend_height_in(data: Data) -> float:
    """Height of the legend [in]."""
    return 0.2 * -(-len(data.labels) // _legend_columns(data))


def _legend_columns(data: Data) -> int:
    """As many columns as the longest label leaves room for, all of equal length."""
    n, longest = len(data.labels), max(map(len, data.labels))  # [characters]
    most = next(
        (columns for columns, letters in ((4, 8), (3, 14), (2, 26)) if longest <= letters), 1
    )
    return -(-n // -(-n // most))


def legend(figure: Figure, data: Data) -> None:
    """The controllers' lines below the panels."""
    from matplotlib.lines import Line2D

    keys = [Line2D([], [], label=label, **look(i)) for i, label in enumerate(data.labels)]
    figure.legend(handles=keys, loc="outside lower center", ncols=_legend_columns(data))


# Strip plots of a comparison's metrics: the runs of each controller as points, with median and
# quartiles, failures below.

# Most runs drawn in one panel, shared among its controllers: every point is an element of the
# page's SVG
POINTS = 1500


def distributions(data: Data, width_in: float) -> Figure:
    """One panel per metric, one row per controller; failed runs as red crosses below the row,
    arrows at the edge if outside the limits.
    """
    names = [wrapped(label) for label in data.labels]
    height = 0.27 * sum(name.count("\n") + 1 for name in names) + 0.15 * len(names) + 0.95
    grid, figure = metric_panels(data.shown, width_in, height, 5, names)
    for axes, metric in zip(grid, data.shown, strict=True):
        limits = _set_limits(axes, data, metric)
        for i, controller in enumerate(data.comparison.controllers):
            _draw_strip(axes, i, controller, metric, limits, POINTS // len(names))
    return figure


def _set_limits(axes: Axes, data: Data, metric: Metric) -> tuple[float, float]:
    """Set scale and limits from the runs that reached the goal (from all where few did): failures
    may lie far outside.

    The margin is 6 % of the span, or of its decades; more on a side where values outside need room
    for their arrows.
    """
    controllers = data.comparison.controllers
    known, reached = (
        np.concatenate([c.values(metric)[c.success | every] for c in controllers])
        for every in (True, False)
    )
    known, reached = known[np.isfinite(known)], reached[np.isfinite(reached)]
    used = reached if len(reached) >= max(5, len(known) // 3) else known
    if not len(used):
        axes.set_xlim(0, 1)
        axes.set_xticks([])
        return 0.0, 1.0
    low, high = float(used.min()), float(used.max())
    below, above = (0.4 if beyond else 0.06 for beyond in (known.min() < low, known.max() > high))
    low, high = _with_margins(axes, low, high, low > 0 and high > 30 * low, below, above)
    axes.set_xlim(low, high)
    return low, high


def _with_margins(
    axes: Axes, low: float, high: float, decades: bool, below: float, above: float
) -> tuple[float, float]:
    """Limits with margins as shares of the span, or of its decades on an axis that is then
    logarithmic.
    """
    if not decades:
        span = high - low or abs(high) or 1.0  # all equal: the value itself is the scale
        return low - below * span, high + above * span
    axes.set_xscale("log")
    axes.xaxis.set_minor_formatter("")  # no labels at minor ticks: the panels are narrow
    return low / (high / low) ** below, high * (high / low) ** above


def _draw_strip(
    axes: Axes,
    row: int,
    controller: ControllerResults,
    metric: Metric,
    limits: tuple[float, float],
    most: int,
) -> None:
    """The runs of a controller as points in its row, the quartiles as a bar, and right of the panel
    the number of runs without a value.
    """
    values = controller.values(metric)
    known = np.isfinite(values)
    # the first runs, not a random choice: the same page from the same table
    shown = known & (np.cumsum(known) <= most)
    # vertical jitter separates equal values; seeded, so that the page is reproducible
    jitter = np.random.default_rng(row).uniform(-0.16, 0.16, len(values))
    color = look(row)["color"]
    reached = shown & controller.success
    axes.plot(
        values[reached],
        row - 0.08 + jitter[reached],
        ".",
        color=color,
        markersize=3.5,
        alpha=0.6,
        markeredgewidth=0,
    )
    # failures in red: a cross where the value is inside the limits, else one arrow at the edge
    # beyond which it lies
    low, high = limits
    failed, y = values[shown & ~controller.success], row + 0.27
    inside = failed[(failed >= low) & (failed <= high)]
    axes.plot(inside, [y] * len(inside), **FAILED)
    # [1] of the panel's width
    for beyond, mark, at in ((failed > high, ">", 0.97), (failed < low, "<", 0.03)):
        if beyond.any():
            arrow: Look = FAILED | {"marker": mark}
            axes.plot(at, y, transform=axes.get_yaxis_transform(), **arrow)
    q1, median, q3, n = controller.quartiles(metric)
    if n:
        axes.plot(
            [q1, q3], [row - 0.08] * 2, color=color, linewidth=5, alpha=0.35, solid_capstyle="butt"
        )
        axes.plot(median, row - 0.08, "|", color=INK, markersize=11, markeredgewidth=1.5)
    missing = int((~known).sum())
    if missing:
        axes.text(
            1.01,
            y,
            f"{missing} n/a",
            transform=axes.get_yaxis_transform(),
            va="center",
            color=LOST,
            fontsize=6.5,
        )


# Performance profiles of a comparison: which share of the runs is as good as a value or better,
# over all values of a metric.

# Most steps of a drawn curve: more cannot be told apart, and each is a part of the page's SVG
STEPS = 300
COLUMNS = 5  # Most panels side by side


def profile(controller: ControllerResults, metric: Metric) -> tuple[Array, Array, int]:
    """Values tau in ascending order of badness, the share of runs that are as good or better, both
    shape (M,), and the number of runs.

        share(tau) = #{runs with x <= tau} / n     (x >= tau for a metric of which more is better)

    Failed runs never are (`ControllerResults.ranked`). Of many values STEPS are kept.
    Reference: Dolan & Moré 2002, doi:10.1007/s101070100263 (of ratios to the best there); Agarwal
    et al. 2021, arXiv:2108.13264.
    """
    ranked = controller.ranked(metric)
    ranked = ranked[~np.isnan(ranked)]
    n = len(ranked)
    ordered = np.sort(ranked[np.isfinite(ranked)])
    # of equal values the last: its share is that of all of them
    last = np.flatnonzero(np.diff(ordered, append=np.inf) > 0)
    kept = (
        last
        if len(last) <= STEPS
        else last[np.linspace(0, len(last) - 1, STEPS).round().astype(int)]
    )
    return (-ordered if metric.better > 0 else ordered)[kept], (kept + 1) / max(n, 1), n


def success(data: Data, width_in: float) -> Figure:
    """Performance profile of the time to converge: the share of runs that have converged, over
    time, with its band.
    """
    figure = new_figure(0.58 * width_in + legend_height_in(data), width_in)
    axes = figure.add_subplot()
    end = float(data.t[-1])
    _draw(axes, data, TIME, (0.0, end))
    axes.set_xlabel(TIME_LABEL)
    axes.set_ylabel("converged [%]")
    legend(figure, data)
    return figure


def profiles(data: Data, width_in: float) -> Figure | None:
    """Performance profile of each other metric that any run has, one panel each; None without one,
    or where its values are all equal.
    """
    shown = [
        m for m in data.shown if m.name not in (TIME.name, RESTRICTED.name) and _differs(data, m)
    ]
    if not shown:
        return None
    rows = -(-len(shown) // COLUMNS)
    columns = -(-len(shown) // rows)  # rows of equal length: 6 panels are 3 + 3, not 5 + 1
    figure = new_figure(
        (0.9 * width_in / max(columns, 3) + 0.25) * rows + legend_height_in(data) + 0.1, width_in
    )
    grid = panels(figure, len(shown), columns, sharey=True)
    for axes, metric in zip(grid, shown, strict=True):
        _draw(axes, data, metric, _limits(axes, data, metric))
        axes.set_xlabel(wrapped(metric.label, 18))
        if axes.get_xscale() == "linear":
            axes.locator_params(axis="x", nbins=3)
            axes.xaxis.set_major_formatter("{x:g}")
    figure.supylabel("runs [%]", fontsize=grid[0].xaxis.label.get_size())
    legend(figure, data)
    return figure


def _differs(data: Data, metric: Metric) -> bool:
    """Whether the runs have different values of a metric: one value alone says no more than the
    success rate.
    """
    found = np.concatenate([profile(c, metric)[0] for c in data.comparison.controllers])
    return len(found) > 0 and bool(np.ptp(found) > LEAST)


def _limits(axes: Axes, data: Data, metric: Metric) -> tuple[float, float]:
    """Ends of the axis from the best to the worst value, in that order; logarithmic where the
    values span decades.
    """
    found = np.concatenate([profile(c, metric)[0] for c in data.comparison.controllers])
    common, rare = np.quantile(found, [0.02, 0.98])
    low, high = float(found.min()), float(found.max())
    low, high = _with_margins(axes, low, high, low > 0 and rare > 30 * common, 0.04, 0.04)
    return (high, low) if metric.better > 0 else (low, high)


def _draw(axes: Axes, data: Data, metric: Metric, ends: tuple[float, float]) -> None:
    """Each controller's profile as steps between the ends of the axis, for up to BANDS of them with
    the pointwise 95 % band (Wilson).

    The bootstrap of a share is the binomial distribution; its band is nearly the same, but has no
    width where all runs are as good.
    """
    controllers = data.comparison.controllers
    for i, controller in enumerate(controllers):
        tau, share, n = profile(controller, metric)
        if not n:
            continue
        x, y = (
            np.concatenate([ends[:1], tau, ends[1:]]),
            np.concatenate([[0.0], share, share[-1:] if len(share) else [0.0]]),
        )
        if len(tau) and len(controllers) <= BANDS:
            low, high = wilson(y[1:], n)
            axes.fill_between(
                x[1:],
                100 * low,
                100 * high,
                step="post",
                color=look(i)["color"],
                alpha=0.15,
                linewidth=0,
            )
        axes.step(x, 100 * y, where="post", **look(i))
    axes.set_xlim(*ends)
    axes.set_ylim(0, 104)
