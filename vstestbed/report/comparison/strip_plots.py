"""Strip plots of a comparison's metrics: the runs of each controller as points, with median and quartiles, failures below."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.report.comparison.columns import ControllerResults, Metric
from vstestbed.report.comparison.figures import Data, look, metric_panels, wrapped
from vstestbed.report.comparison.statistics import spread
from vstestbed.report.html.canvas import INK, LOST

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

POINTS = 1500
"""Most runs drawn in one panel, shared among its controllers: every point is an element of the page's SVG."""
LOG_RATIO = 30.0
"""Ratio of the largest to the smallest value above which a panel is logarithmic."""


def distributions(data: Data, width_in: float) -> Figure:
    """One panel per metric, one row per controller; failed runs as red crosses below the row, arrows at the edge if outside the limits."""
    names = [wrapped(label) for label in data.labels]
    height = 0.27 * sum(name.count("\n") + 1 for name in names) + 0.15 * len(names) + 0.95
    grid, figure = metric_panels(data, width_in, height, 5, names)
    for axes, metric in zip(grid, data.comparison.shown, strict=False):
        limits = _set_limits(axes, data, metric)
        for i, controller in enumerate(data.comparison.controllers):
            _draw_strip(axes, i, controller, metric, limits, POINTS // len(names))
    return figure


def _set_limits(axes: Axes, data: Data, metric: Metric) -> tuple[float, float]:
    """Set scale and limits from the runs that reached the goal (from all where few did): failures may lie far outside."""
    known, used = _values_for_limits(data, metric)
    if not len(used):
        axes.set_xlim(0, 1)
        axes.set_xticks([])
        return 0.0, 1.0
    if used.min() > 0 and used.max() > LOG_RATIO * used.min():
        axes.set_xscale("log")
        # no labels at minor ticks: the panels are narrow
        axes.xaxis.set_minor_formatter("")
        low, high = _log_limits(used, known)
    else:
        low, high = _linear_limits(used, known)
    axes.set_xlim(low, high)
    return float(low), float(high)


def _values_for_limits(data: Data, metric: Metric) -> tuple[Array, Array]:
    """All finite values of a metric, and those of them that set the limits."""
    values = [c.values(metric) for c in data.comparison.controllers]
    reached = np.concatenate([v[c.success] for v, c in zip(values, data.comparison.controllers, strict=True)])
    known = np.concatenate(values)
    known, reached = known[np.isfinite(known)], reached[np.isfinite(reached)]
    return known, reached if len(reached) >= max(5, len(known) // 3) else known


def _log_limits(used: Array, known: Array) -> tuple[float, float]:
    """Limits with a margin of 6 % of the decades that `used` spans; 36 % above where larger values need room for their arrows."""
    margin = (used.max() / used.min()) ** 0.06
    return used.min() / margin, used.max() * (margin**6 if known.max() > used.max() else margin)


def _linear_limits(used: Array, known: Array) -> tuple[float, float]:
    """Limits with a margin of 6 % of the span of `used`; 40 % on a side where values outside need room for their arrows."""
    span = float(np.ptp(used)) or abs(float(used[0])) or 1.0  # all equal: the value itself is the scale
    low, high = used.min() - 0.06 * span, used.max() + (0.4 if known.max() > used.max() else 0.06) * span
    return min(low, used.min() - 0.4 * span) if known.min() < used.min() else low, high


def _draw_strip(axes: Axes, row: int, controller: ControllerResults, metric: Metric, limits: tuple[float, float], most: int) -> None:
    """The runs of a controller as points in its row, the quartiles as a bar, and right of the panel the number of runs without a value."""
    values = controller.values(metric)
    known = np.isfinite(values)
    # the first runs, not a random choice: the same page from the same table
    shown = known & (np.cumsum(known) <= most)
    # vertical jitter separates equal values; seeded, so that the page is reproducible
    jitter = np.random.default_rng(row).uniform(-0.16, 0.16, len(values))
    color = look(row)["color"]
    reached = shown & controller.success
    axes.plot(values[reached], row - 0.08 + jitter[reached], ".", color=color, markersize=3.5, alpha=0.6, markeredgewidth=0)
    _draw_failures(axes, values[shown & ~controller.success], row + 0.27, limits)
    summary = spread(controller.counted(metric))
    if summary.n:
        axes.plot([summary.q1, summary.q3], [row - 0.08] * 2, color=color, linewidth=5, alpha=0.35, solid_capstyle="butt")
        axes.plot(summary.median, row - 0.08, "|", color=INK, markersize=11, markeredgewidth=1.5)
    missing = int((~known).sum())
    if missing:
        axes.text(1.01, row + 0.27, f"{missing} n/a", transform=axes.get_yaxis_transform(), va="center", color=LOST, fontsize=6.5)


def _draw_failures(axes: Axes, values: Array, y: float, limits: tuple[float, float]) -> None:
    """Failed runs in red: a cross where the value is inside the limits, else one arrow at the edge beyond which it lies."""
    low, high = limits
    edge = 0.03  # of the panel's width
    places: tuple[tuple[NDArray[np.bool_], str, float | None], ...] = (
        ((values >= low) & (values <= high), "x", None),
        (values > high, ">", 1 - edge),
        (values < low, "<", edge),
    )
    for which, mark, at in places:
        if at is None:
            axes.plot(values[which], [y] * which.sum(), mark, color=LOST, markersize=3.5, markeredgewidth=0.9)
        elif which.any():
            axes.plot(at, y, mark, color=LOST, markersize=3.5, transform=axes.get_yaxis_transform())
