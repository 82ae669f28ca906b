"""Figures over time of a ground vehicle: wheels, slip, localisation error, error of the task."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.planar import wrapped
from vstestbed.report.html.canvas import GOAL, LINE_COLORS, RULE, new_figure
from vstestbed.report.run.figures import BAND, least_span, line_keys, shade_lost, time_axis
from vstestbed.report.run.tracks import Tracks

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ESTIMATES = (("est", "as estimated", LINE_COLORS[1]), ("odo", "by odometry alone", LINE_COLORS[3]))


WHEEL_PANELS = (("qd", False, "speed [rad/s]"), ("q", True, "angle [rad]"))
"""Panels of the wheels' figure: column of the measurement, whether it shows steering joints, label."""


def wheels(tracks: Tracks) -> Figure | None:
    """Wheel speeds, measured (band) and commanded (line), and below them the steering angles."""
    if tracks.setting.ground_task is None:
        return None
    panels = _wheel_panels(tracks)
    names = list(dict.fromkeys(n for _, measured, commanded, _ in panels for n in (*measured, *commanded)))
    if not names:
        return None
    color = {name: LINE_COLORS[i % len(LINE_COLORS)] for i, name in enumerate(names)}
    figure = new_figure(0.9 + 1.9 * len(panels) + 0.16 * -(-len(names) // 4))
    grid = np.ravel(figure.subplots(len(panels), 1, sharex=True, squeeze=False))
    for axes, (stem, measured, commanded, label) in zip(grid, panels, strict=True):
        for name in measured:
            axes.plot(tracks.t, tracks.column(f"{stem}_{name}"), color=color[name], **BAND)
        for name in commanded:
            axes.plot(tracks.t, tracks.column(f"ctrl_{name}"), color=color[name], linewidth=1.0)
        axes.set_ylabel(label)
    time_axis(grid[-1], tracks)
    figure.legend(handles=line_keys(names), loc="outside lower center", ncols=4)
    return figure


def _wheel_panels(tracks: Tracks) -> list[tuple[str, list[str], list[str], str]]:
    """The panels with data: column of the measurement, measured joints, commanded joints, label."""
    panels = [(stem, _joints(tracks, stem, steering), _joints(tracks, "ctrl", steering), label) for stem, steering, label in WHEEL_PANELS]
    return [panel for panel in panels if panel[1] or panel[2]]


def _joints(tracks: Tracks, stem: str, steering: bool) -> list[str]:
    """Names of the steering joints or of the wheels with values in the columns of a stem; the floating base (`root_`) is neither."""
    names = [n for n in tracks.named(stem) if not n.startswith("root_") and ("steer" in n) == steering]
    return [n for n in names if np.isfinite(tracks.column(f"{stem}_{n}")).any()]


def localisation_error(tracks: Tracks) -> Figure | None:
    """Localisation error in position and heading: of the estimate with landmarks, and of odometry alone."""
    true = tracks.planar_poses("base")
    error = {stem: tracks.planar_poses(stem) - true for stem, _, _ in ESTIMATES}
    if tracks.setting.ground_task is None or not any(np.isfinite(e).any() for e in error.values()):
        return None
    figure = new_figure(3.9)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for stem, label, color in ESTIMATES:
        if np.isfinite(error[stem]).any():
            upper.plot(tracks.t, np.hypot(error[stem][:, 0], error[stem][:, 1]), color=color, label=label)
            lower.plot(tracks.t, np.degrees(wrapped(error[stem][:, 2])), color=color)
    lower.axhline(0, color=RULE, linewidth=0.8)
    upper.set_ylim(bottom=0)  # a distance
    upper.set_ylabel("position [m]")
    lower.set_ylabel("heading [deg]")
    figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    for axes in (upper, lower):
        shade_lost(axes, tracks)
    time_axis(lower, tracks)
    return figure


def slip(tracks: Tracks) -> Figure | None:
    """Slip speed and, below, slip in yaw: motion over the floor that the encoders do not measure; older logs lack the latter."""
    # column, factor to the unit of the label, least span of the axis in that unit, label
    rows = (("slip_mps", 1e3, 1.0, "slip [mm/s]"), ("slip_radps", 180 / np.pi, 0.1, "in yaw [deg/s]"))
    panels = [(tracks.column(name) * factor, least, label) for name, factor, least, label in rows]
    panels = [panel for panel in panels if np.isfinite(panel[0]).any()]
    if not panels:
        return None
    figure = new_figure(0.9 + 1.7 * len(panels))
    grid = np.ravel(figure.subplots(len(panels), 1, sharex=True, squeeze=False))
    for axes, (value, least, label) in zip(grid, panels, strict=True):
        axes.plot(tracks.t, value, color=LINE_COLORS[0], linewidth=1.0)
        least_span(axes, least)
        axes.set_ylim(bottom=0)
        axes.set_ylabel(label)
    time_axis(grid[-1], tracks)
    return figure


def task_error(tracks: Tracks) -> Figure | None:
    """True error of a continuing task, with its tolerance after the settling time."""
    value, task = tracks.column("task_error_m"), tracks.setting.ground_task or tracks.setting
    band, settle = task.band_m, task.settle_s
    if not np.isfinite(value).any():
        return None
    figure = new_figure(3.1)
    axes = figure.add_subplot()
    if band is not None:
        last = max(float(np.nanmax(tracks.t)), settle)
        axes.fill_between([settle, last], -band, band, color=GOAL, alpha=0.14, linewidth=0, label=f"band, {band:g} m to each side")
        worst = _worst(tracks.t, value, settle)
        axes.set_title("" if np.isnan(worst) else f"at most {worst:.3f} m off once settled", loc="left")
    axes.axhline(0, color=RULE, linewidth=0.8)
    axes.plot(tracks.t, value, color=LINE_COLORS[0])
    shade_lost(axes, tracks)
    axes.set_ylabel("off [m]")
    time_axis(axes, tracks)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper right")
    return figure


def _worst(t: Array, value: Array, settled: float) -> float:
    """Largest magnitude after the settling time [s]; NaN without a value after it."""
    later = np.abs(value[(t >= settled) & np.isfinite(value)])
    return float(later.max()) if len(later) else float("nan")
