"""The distributions of a comparison's numbers: a strip of points a controller, median and quartiles on it, failures beside."""

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
"""Single runs drawn in a panel at most, shared among its controllers."""
WIDE = 30.0
"""Largest over smallest value from which on a panel is logarithmic."""


def distributions(data: Data, width_in: float) -> Figure:
    """A panel a metric, a line a controller; failed runs as red crosses below the line, beyond the frame as arrows at its edge."""
    names = [wrapped(label) for label in data.labels]
    height = 0.27 * sum(name.count("\n") + 1 for name in names) + 0.15 * len(names) + 0.95
    grid, figure = metric_panels(data, width_in, height, 5, names)
    for axes, metric in zip(grid, data.comparison.shown, strict=False):
        limits = _frame(axes, data, metric)
        for i, controller in enumerate(data.comparison.controllers):
            _draw_strip(axes, i, controller, metric, limits, POINTS // len(names))
    return figure


def _frame(axes: Axes, data: Data, metric: Metric) -> tuple[float, float]:
    """Set the scale, and limits by the runs that reached the goal (of all where few did); failures may lie far outside."""
    values = [c.values(metric) for c in data.comparison.controllers]
    reached = np.concatenate([v[c.success] for v, c in zip(values, data.comparison.controllers, strict=True)])
    known = np.concatenate(values)
    known, reached = known[np.isfinite(known)], reached[np.isfinite(reached)]
    used = reached if len(reached) >= max(5, len(known) // 3) else known
    if not len(used):
        axes.set_xlim(0, 1)
        axes.set_xticks([])
        return 0.0, 1.0
    if used.min() > 0 and used.max() > WIDE * used.min():
        axes.set_xscale("log")
        axes.xaxis.set_minor_formatter("")
        reach = (used.max() / used.min()) ** 0.06
        low, high = used.min() / reach, used.max() * (reach**6 if known.max() > used.max() else reach)
    else:
        span = float(np.ptp(used)) or abs(float(used[0])) or 1.0
        low, high = used.min() - 0.06 * span, used.max() + (0.4 if known.max() > used.max() else 0.06) * span
        low = min(low, used.min() - 0.4 * span) if known.min() < used.min() else low
    axes.set_xlim(low, high)
    return float(low), float(high)


def _draw_strip(axes: Axes, line: int, controller: ControllerResults, metric: Metric, limits: tuple[float, float], most: int) -> None:
    """The points of a controller on its line, its quartiles as a bar, and right of the frame how many runs have no value."""
    values = controller.values(metric)
    known = np.isfinite(values)
    shown = known & (np.cumsum(known) <= most)
    sway = np.random.default_rng(line).uniform(-0.16, 0.16, len(values))
    color = look(line)["color"]
    reached = shown & controller.success
    axes.plot(values[reached], line - 0.08 + sway[reached], ".", color=color, markersize=3.5, alpha=0.6, markeredgewidth=0)
    _draw_failures(axes, values[shown & ~controller.success], line + 0.27, limits)
    made = spread(controller.counted(metric))
    if made.n:
        axes.plot([made.q1, made.q3], [line - 0.08] * 2, color=color, linewidth=5, alpha=0.35, solid_capstyle="butt")
        axes.plot(made.median, line - 0.08, "|", color=INK, markersize=11, markeredgewidth=1.5)
    missing = int((~known).sum())
    if missing:
        axes.text(1.01, line + 0.27, f"{missing} n/a", transform=axes.get_yaxis_transform(), va="center", color=LOST, fontsize=6.5)


def _draw_failures(axes: Axes, values: Array, y: float, limits: tuple[float, float]) -> None:
    low, high = limits
    edge = 0.03
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
