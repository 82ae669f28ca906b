"""Curves that grow with a run: the judged error, the commanded twist, the joints; of bounded length."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from vstestbed.core.geometry import Array
from vstestbed.live.transport import Sample
from vstestbed.report.html.canvas import AXIS_COLORS, LINE_COLORS
from vstestbed.scenario.scenario import Scenario

MOST = 1200
"""Points of a curve: when there are more, every other one is dropped, so that the whole run stays in sight."""
HEIGHT = 150
"""Of a plot [px]."""
THIN: dict[str, Any] = {"font": "11px sans-serif", "ticks": {"size": 4, "width": 1}, "grid": {"width": 1, "stroke": "#e3e6ea"}}
AXES: tuple[Any, ...] = ({"size": 26, **THIN}, {"size": 46, **THIN})


class Curves:
    """Rows of numbers over time, at most `MOST` of them."""

    def __init__(self, columns: int):
        self._rows = np.empty((MOST, columns))
        self._count, self._every, self._skipped = 0, 1, 0

    def add(self, row: Array) -> None:
        """One more row, the first number of which is the time; only every k-th is kept once the run is long."""
        self._skipped += 1
        if self._skipped < self._every:
            return
        self._skipped = 0
        if self._count == MOST:
            self._count = MOST // 2
            self._rows[: self._count] = self._rows[::2].copy()
            self._every *= 2
        self._rows[self._count] = row
        self._count += 1

    def clear(self) -> None:
        """Begin anew."""
        self._count, self._every, self._skipped = 0, 1, 0

    @property
    def columns(self) -> tuple[Array, ...]:
        """The columns, as copies."""
        return tuple(np.ascontiguousarray(column) for column in self._rows[: self._count].T)


class Plots:
    """The plots of a run.

    Args:
        gui: where they are added, in the container that is open. scenario: the experiment. unit: of the judged error.
    """

    def __init__(self, gui: viser.GuiApi, scenario: Scenario, unit: str):
        joints = len(scenario.robot.joints)
        self._joints = joints
        self._curves = Curves(8 + joints)
        self._error = _plot(gui, f"judged error [{unit}]", ["error"], [LINE_COLORS[0]], log=True)
        key = " · ".join(f'<span style="color:{color}">{axis}</span>' for axis, color in zip("xyz", AXIS_COLORS, strict=True))
        self._key = gui.add_html(f'<div style="font-size:12px;text-align:center">commanded twist: {key} of the camera</div>')
        self._v = _plot(gui, "commanded speed [m/s]", ["vx", "vy", "vz"], AXIS_COLORS)
        self._w = _plot(gui, "commanded rate [rad/s]", ["wx", "wy", "wz"], AXIS_COLORS)
        names = list(scenario.robot.joints)
        self._q = _plot(gui, "joints [rad]", names, [LINE_COLORS[i % len(LINE_COLORS)] for i in range(joints)]) if joints else None

    def add(self, sample: Sample) -> None:
        """One more frame."""
        positive = sample.judged if sample.judged > 0 else np.nan  # logarithmic
        self._curves.add(np.array([sample.film.t, positive, *sample.twist, *sample.film.q[: self._joints]]))

    def clear(self) -> None:
        """Begin anew."""
        self._curves.clear()

    def draw(self) -> None:
        """Send the curves, which need not be done with every frame."""
        t, error, *rest = self._curves.columns
        if len(t) < 2:
            return
        self._error.data = t, error
        self._v.data = t, *rest[:3]
        self._w.data = t, *rest[3:6]
        if self._q is not None:
            self._q.data = t, *rest[6:]

    def remove(self) -> None:
        """Take the plots away."""
        for plot in (self._error, self._key, self._v, self._w, self._q):
            if plot is not None:
                plot.remove()


def _plot(gui: viser.GuiApi, title: str, names: list[str], colors: Any, log: bool = False) -> viser.GuiUplotHandle:
    t = np.array([0.0, 1.0])
    series: list[Any] = [{"label": "t [s]"}]
    series += [
        {"label": name, "stroke": color, "width": 1.5, "points": {"show": False}} for name, color in zip(names, colors, strict=False)
    ]
    scales: dict[str, Any] = {"x": {"time": False}, "y": {"distr": 3 if log else 1}}
    blank = np.full(2, np.nan)
    return gui.add_uplot(
        (t, *(blank for _ in names)),
        tuple(series),
        title=title,
        scales=scales,
        axes=AXES,
        legend={"show": False},
        height=HEIGHT,
        padding=(10, 12, 0, 0),
    )
