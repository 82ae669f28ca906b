"""Performance profiles of a comparison: which share of the runs is as good as a value or better, over all values of a metric."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.report.comparison.columns import ControllerResults, Metric
from vstestbed.report.comparison.figures import BANDS, Data, legend, legend_height_in, look, wrapped
from vstestbed.report.comparison.pairs import TIME
from vstestbed.report.comparison.statistics import LEAST, wilson
from vstestbed.report.html.canvas import new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STEPS: Final = 300
"""Most steps of a drawn curve: more cannot be told apart, and each is a part of the page's SVG."""
COLUMNS: Final = 5
"""Most panels side by side."""
LOG_RATIO: Final = 30.0
"""Ratio of the 98th to the 2nd percentile of the values above which an axis is logarithmic."""


def profile(controller: ControllerResults, metric: Metric) -> tuple[Array, Array, int]:
    """Values tau in ascending order of badness and the share of runs that are as good or better, both shape (M,), and the number of runs.

        share(tau) = #{runs with x <= tau} / n        (x >= tau for a metric of which more is better)

    Failed runs never are (`ControllerResults.ranked`), so that the last share is that of the runs that did not fail. Of many values
    STEPS are kept.

    Reference: Dolan & Moré 2002, doi:10.1007/s101070100263 (of ratios to the best there); Agarwal et al. 2021, arXiv:2108.13264.
    """
    ranked = controller.ranked(metric)
    ranked = ranked[~np.isnan(ranked)]
    n = len(ranked)
    ordered = np.sort(ranked[np.isfinite(ranked)])
    last = np.flatnonzero(np.diff(ordered, append=np.inf) > 0)  # of equal values the last: its share is that of all of them
    kept = last if len(last) <= STEPS else last[np.linspace(0, len(last) - 1, STEPS).round().astype(int)]
    return (-ordered if metric.higher else ordered)[kept], (kept + 1) / max(n, 1), n


def success(data: Data, width_in: float) -> Figure:
    """Performance profile of the time to converge: the share of runs that have converged, over time, with its band."""
    figure = new_figure(0.58 * width_in + legend_height_in(data), width_in)
    axes = figure.add_subplot()
    end = float(data.series.t[-1])
    _draw(axes, data, TIME, (0.0, end))
    axes.set_xlabel("time [s]")
    axes.set_ylabel("converged [%]")
    legend(figure, data)
    return figure


def profiles(data: Data, width_in: float) -> Figure | None:
    """Performance profile of each other metric that any run has, one panel each; None without one, or where its values are all equal."""
    shown = [m for m in data.comparison.shown if m.name != TIME.name and _differs(data, m)]
    if not shown:
        return None
    rows = -(-len(shown) // COLUMNS)
    columns = -(-len(shown) // rows)  # rows of equal length: 6 panels are 3 + 3, not 5 + 1
    figure = new_figure((0.9 * width_in / max(columns, 3) + 0.25) * rows + legend_height_in(data) + 0.1, width_in)
    grid = list(np.ravel(figure.subplots(rows, columns, sharey=True, squeeze=False)))
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    for axes, metric in zip(grid, shown, strict=False):
        _draw(axes, data, metric, _limits(axes, data, metric))
        axes.set_xlabel(wrapped(metric.label, 18))
        if axes.get_xscale() == "linear":
            axes.locator_params(axis="x", nbins=3)
            axes.xaxis.set_major_formatter("{x:g}")
    figure.supylabel("runs [%]", fontsize=grid[0].xaxis.label.get_size())
    legend(figure, data)
    return figure


def _differs(data: Data, metric: Metric) -> bool:
    """Whether the runs have different values of a metric: one value alone says no more than the success rate."""
    found = np.concatenate([profile(c, metric)[0] for c in data.comparison.controllers])
    return len(found) > 0 and bool(np.ptp(found) > LEAST)


def _limits(axes: Axes, data: Data, metric: Metric) -> tuple[float, float]:
    """Ends of the axis from the best to the worst value, in that order; logarithmic where the values span decades."""
    found = np.concatenate([profile(c, metric)[0] for c in data.comparison.controllers])
    low, high = float(found.min()), float(found.max())
    common, rare = np.quantile(found, [0.02, 0.98])
    if low > 0 and rare > LOG_RATIO * common:
        axes.set_xscale("log")
        axes.xaxis.set_minor_formatter("")
        margin = (high / low) ** 0.04
        low, high = low / margin, high * margin
    else:
        margin = 0.04 * (high - low or abs(high) or 1.0)
        low, high = low - margin, high + margin
    return (high, low) if metric.higher else (low, high)


def _draw(axes: Axes, data: Data, metric: Metric, ends: tuple[float, float]) -> None:
    """Each controller's profile as steps between the ends of the axis, with its pointwise 95 % band (Wilson) for up to BANDS of them.

    The band begins at the first value. The bootstrap of a share is the binomial distribution; its band is nearly the same, but has no
    width where all runs are as good.
    """
    controllers = data.comparison.controllers
    for i, controller in enumerate(controllers):
        tau, share, n = profile(controller, metric)
        if not n:
            continue
        x, y = np.concatenate([ends[:1], tau, ends[1:]]), np.concatenate([[0.0], share, share[-1:] if len(share) else [0.0]])
        if len(tau) and len(controllers) <= BANDS:
            low, high = wilson(y[1:], n)
            axes.fill_between(x[1:], 100 * low, 100 * high, step="post", color=look(i)["color"], alpha=0.15, linewidth=0)
        axes.step(x, 100 * y, where="post", **look(i))
    axes.set_xlim(*ends)
    axes.set_ylim(0, 104)
