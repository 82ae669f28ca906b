"""Figures of a comparison over all runs: error over time, single runs, paired differences.

Each function takes the data and the width of the figure [in], since the page and a paper need different sizes.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.report.comparison.columns import ComparisonResults
from vstestbed.report.comparison.pairs import Pair
from vstestbed.report.comparison.series import Series
from vstestbed.report.html.canvas import INK, LINE_COLORS, LOST, RULE, new_figure, printable
from vstestbed.report.run.tracks import MeasuredError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

THRESHOLD: dict[str, Any] = {"color": INK, "linestyle": (0, (2, 2)), "linewidth": 0.8, "alpha": 0.7}
DASHES: tuple[Any, ...] = ("-", (0, (5, 2)), (0, (1, 1.2)), (0, (5, 1.5, 1, 1.5)))
BANDS = 4
"""Most controllers whose quartile bands are drawn in one panel: more bands hide each other."""
PANELS = 24
"""Most controllers with a line, a row or a panel of their own: lines of more cannot be told apart."""
LINES, EACH_LEAST, EACH_MOST = 200, 5, 30
"""Single runs drawn in all panels of `each_run` together, and fewest and most in one panel."""
LEAST_DIFFERENCE = 1e-9
"""Differences below this, in any display unit, are rounding."""


@dataclass(frozen=True)
class Data:
    """Everything the figures draw."""

    comparison: ComparisonResults
    series: Series
    pairs: list[Pair]

    @property
    def labels(self) -> list[str]:
        """The controllers' labels, escaped for matplotlib."""
        return [_plain(c.label) for c in self.comparison.controllers]


def _plain(name: str) -> str:
    """A name escaped for matplotlib: no control characters, no mathtext, and no leading underscore, which the legend would hide."""
    return printable(name).replace("$", r"\$").lstrip("_") or "(unnamed)"


def look(i: int) -> dict[str, Any]:
    """Line style of controller i: the eight colours with solid lines first, then the same colours dashed."""
    return {"color": LINE_COLORS[i % len(LINE_COLORS)], "linestyle": DASHES[i // len(LINE_COLORS) % len(DASHES)]}


def wrapped(label: str, width: int = 20) -> str:
    """A long label broken into several lines."""
    return textwrap.fill(label, width)


def medians(data: Data, width_in: float) -> Figure:
    """Median error of each controller over time with its quartile band, in one panel for each unit."""
    units = data.series.units()
    figure = new_figure((0.58 + 0.4 * (len(units) - 1)) * width_in + legend_height_in(data), width_in)
    panels = np.ravel(figure.subplots(len(units), 1, sharex=True, squeeze=False))
    for axes, (error, those) in zip(panels, units.items(), strict=True):
        quartiles = [data.series.quartiles(i) for i in those]
        for i, quartile in zip(those, quartiles, strict=True):
            _draw_quartiles(axes, data.series.t, quartile, look(i), band=len(data.labels) <= BANDS)
        _error_axes([axes], data.series.t[-1], error, [*quartiles, *(data.series.errors[i] for i in those)])
        axes.set_ylabel(wrapped(error.label, 16))
        if error.threshold and axes.get_yscale() == "log":
            words, at = f"{error.threshold:g} {error.unit}", (1, error.threshold)
            axes.annotate(words, at, xycoords=axes.get_yaxis_transform(), va="bottom", ha="right")
    panels[-1].set_xlabel("time [s]")
    legend(figure, data)
    return figure


def each_run(data: Data, width_in: float) -> Figure:
    """One panel per controller: single runs as thin lines, median and quartile band over them, the other controllers' medians in grey.

    Panels of the same unit have the same axis of errors, and each the medians of its own unit.
    """
    n, units = len(data.labels), data.series.units()
    columns = -(-n // -(-n // 4))  # at most 4, and rows of equal length: 5 panels are 3 + 2, not 4 + 1
    figure = new_figure(width_in / max(columns, 3) * 0.8 * -(-n // columns) + 0.3, width_in)
    panels = np.ravel(figure.subplots(-(-n // columns), columns, sharex=True, sharey=len(units) == 1, squeeze=False))
    for axes in panels[n:]:
        axes.set_visible(False)
    for i, axes in enumerate(panels[:n]):
        axes.set_title(wrapped(data.labels[i], 28))
        axes.xaxis.set_tick_params(labelbottom=i + columns >= n)
    for error, those in units.items():
        _draw_each({i: panels[i] for i in those}, data, error)
    figure.supxlabel("time [s]", fontsize=_size())
    if len(units) == 1:
        figure.supylabel(next(iter(units)).label, fontsize=_size())
        return figure
    for error, those in units.items():
        for i in those:
            panels[i].set_ylabel(wrapped(error.label, 16))
    return figure


def _draw_each(panels: Mapping[int, Axes], data: Data, error: MeasuredError) -> None:
    """The controllers of one unit, each in its panel, by number."""
    quartiles = {i: data.series.quartiles(i) for i in panels}
    for i, axes in panels.items():
        for k in panels:
            if k != i:
                axes.plot(data.series.t, _shown(quartiles[k][1]), color=RULE, linewidth=0.8)
        _draw_runs(axes, data, i)
        _draw_quartiles(axes, data.series.t, quartiles[i], look(i) | {"linestyle": "-"}, band=True)
    _error_axes([*panels.values()], data.series.t[-1], error, [*quartiles.values(), *(data.series.errors[i] for i in panels)])


def _draw_runs(axes: Axes, data: Data, i: int) -> None:
    """The first runs of a controller; failed ones in red, with a cross where the target was last seen."""
    most = min(max(LINES // len(data.labels), EACH_LEAST), EACH_MOST)
    success = data.comparison.controllers[i].success
    for error, reached in zip(data.series.errors[i][:most], success, strict=False):
        line = _shown(error.astype(float))
        color, alpha, order = (look(i)["color"], 0.45, 2) if reached else (LOST, 0.9, 4)  # failures on top: they are few
        axes.plot(data.series.t, line, color=color, linewidth=0.5, alpha=alpha, zorder=order)
        seen = np.flatnonzero(np.isfinite(line))
        if not reached and len(seen):
            axes.plot(data.series.t[seen[-1]], line[seen[-1]], "x", color=LOST, markersize=4)


def _draw_quartiles(axes: Axes, t: Array, quartile: Array, style: dict[str, Any], band: bool) -> None:
    """Median (line) and band between the quartiles (3, G) over the times t (G,)."""
    low, middle, high = quartile
    if band:
        seen = np.isfinite(low) & (low > 0)
        top = np.where(np.isfinite(high), high, 1e9)  # a quarter of the runs is lost: the band is open above
        axes.fill_between(t, np.where(seen, low, 1), top, where=seen.tolist(), color=style["color"], alpha=0.2, linewidth=0)
    axes.plot(t, _shown(middle), **style)


def _shown(error: Array) -> Array:
    """The error with NaN (a gap) where a logarithmic axis cannot show it."""
    return np.where(np.isfinite(error) & (error > 0), error, np.nan)


def _error_axes(panels: Sequence[Axes], end_s: float, error: MeasuredError, shown: Sequence[Array | NDArray[np.float32]]) -> None:
    """Logarithmic error axis over what is shown, the runs and their quartiles, and the threshold; the same in each panel.

    The threshold is always inside: its words outside of the axes would leave them no room.
    """
    values = np.concatenate([e[np.isfinite(e) & (e > 0)].astype(float) for e in shown])
    if not len(values):
        panels[0].set_yticks([])
        panels[0].text(0.5, 0.5, "no run with a log", transform=panels[0].transAxes, ha="center", va="center", alpha=0.7)
        return
    low, high = np.quantile(values, [0.001, 0.999])  # a single outlier may not squeeze all other curves
    for panel in panels:
        panel.set_yscale("log")
        panel.set_ylim(0.7 * min(low, error.threshold or low), 1.5 * max(high, error.threshold or high))
        panel.set_xlim(0, end_s)
        if error.threshold:
            panel.axhline(error.threshold, **THRESHOLD)


def differences(data: Data, width_in: float) -> Figure | None:
    """Forest plot: mean paired difference of each metric with its interval, significant ones in colour; None without any interval."""
    rows = _forest_rows(data)
    if not any(np.isfinite(p.differences[m.name].low) for p in rows for m in data.comparison.shown):
        return None  # a single controller, or no two seeds on which both reached the goal
    names = [wrapped(f"{data.labels[p.b]} \N{MINUS SIGN} {data.labels[p.a]}", 30) for p in rows]
    height = 0.22 * sum(name.count("\n") + 1 for name in names) + 0.06 * len(rows) + 1.0
    grid, figure = metric_panels(data, width_in, height, 5, names)
    for axes, metric in zip(grid, data.comparison.shown, strict=False):
        axes.axvline(0, color=INK, linewidth=0.8)
        reach = [_draw_interval(axes, row, pair, metric.name) for row, pair in enumerate(rows)]
        if max(reach, default=0.0) <= LEAST_DIFFERENCE:  # otherwise rounding errors would fill the width
            axes.set_xlim(-1, 1)
    return figure


def _forest_rows(data: Data) -> list[Pair]:
    """All pairs of up to four controllers; of more, each controller against the first."""
    return data.pairs if len(data.labels) <= BANDS else [p for p in data.pairs if p.a == 0]


def _draw_interval(axes: Axes, row: int, pair: Pair, name: str) -> float:
    """One row of a forest plot: the mean on its interval; gives the largest value drawn.

    It is filled if the difference is real, and in colour also if only the improvement is.
    """
    d, real = pair.differences[name], pair.is_real(name)
    color = LINE_COLORS[1] if real or pair.is_real(name, "improvement") else LINE_COLORS[7]
    if np.isfinite(d.low):
        axes.plot([d.low, d.high], [row, row], color=color, linewidth=1.8)
    axes.plot(d.mean, row, "o" if real else "D", color=color, markersize=4, markerfacecolor=color if real else "none")
    return float(np.abs(np.nan_to_num([d.mean, d.low, d.high])).max())


def metric_panels(data: Data, width_in: float, panel_in: float, columns: int, names: Sequence[str]) -> tuple[list[Any], Figure]:
    """One panel per metric in a grid, with the same named rows in each panel, the first on top."""
    n = len(data.comparison.shown)
    columns = min(n, columns)
    figure = new_figure(panel_in * -(-n // columns), width_in)
    grid = list(np.ravel(figure.subplots(-(-n // columns), columns, sharey=True, squeeze=False)))
    for axes in grid[n:]:
        axes.set_visible(False)
    grid[0].set_yticks(range(len(names)), names)
    grid[0].set_ylim(len(names) - 0.4, -0.6)  # reversed: the first row on top
    for axes, metric in zip(grid, data.comparison.shown, strict=False):
        axes.set_xlabel(wrapped(metric.label, 18))
        axes.grid(axis="y", visible=False)
        axes.tick_params(axis="y", length=0)
        axes.locator_params(axis="x", nbins=2)
        axes.xaxis.set_major_formatter("{x:g}")  # 0, not 0.0000: numbers of many digits would overlap
    return grid, figure


def legend_height_in(data: Data) -> float:
    """Height of the legend [in]."""
    return 0.2 * -(-len(data.labels) // _legend_columns(data))


def _legend_columns(data: Data) -> int:
    """As many columns as the longest label leaves room for, all of equal length."""
    n, longest = len(data.labels), max(map(len, data.labels))  # [characters]
    most = next((columns for columns, letters in ((4, 8), (3, 14), (2, 26)) if longest <= letters), 1)
    return -(-n // -(-n // most))


def legend(figure: Figure, data: Data) -> None:
    """The controllers' lines below the panels."""
    from matplotlib.lines import Line2D

    keys = [Line2D([], [], label=label, **look(i)) for i, label in enumerate(data.labels)]
    figure.legend(handles=keys, loc="outside lower center", ncols=_legend_columns(data))


def _size() -> float:
    import matplotlib

    return float(matplotlib.rcParams["axes.labelsize"])
