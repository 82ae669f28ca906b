"""Figures over time of a run with a vehicle: wheels, slip, what it thinks of its place, how far off its task it is."""

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


def wheels(tracks: Tracks) -> Figure | None:
    """Speeds of the wheels as measured (band) and as told (line), and below it steering angles likewise."""
    if tracks.setting.ground_task is None:
        return None
    turning = _shown(tracks, "qd", steering=False), _shown(tracks, "ctrl", steering=False)
    steering = _shown(tracks, "q", steering=True), _shown(tracks, "ctrl", steering=True)
    panels = [(stem, some, label) for stem, some, label in (("qd", turning, "speed [rad/s]"), ("q", steering, "angle [rad]")) if any(some)]
    if not panels:
        return None
    names = list(dict.fromkeys(n for _, (measured, told), _ in panels for n in (*measured, *told)))
    color = {name: LINE_COLORS[i % len(LINE_COLORS)] for i, name in enumerate(names)}
    figure = new_figure(0.9 + 1.9 * len(panels) + 0.16 * -(-len(names) // 4))
    grid = np.ravel(figure.subplots(len(panels), 1, sharex=True, squeeze=False))
    for axes, (stem, (measured, told), label) in zip(grid, panels, strict=True):
        for name in measured:
            axes.plot(tracks.t, tracks.column(f"{stem}_{name}"), color=color[name], **BAND)
        for name in told:
            axes.plot(tracks.t, tracks.column(f"ctrl_{name}"), color=color[name], linewidth=1.0)
        axes.set_ylabel(label)
    time_axis(grid[-1], tracks)
    figure.legend(handles=line_keys(names), loc="outside lower center", ncols=4)
    return figure


def _shown(tracks: Tracks, stem: str, steering: bool) -> list[str]:
    """Names behind a stem that steer, or those that turn; the vehicle's own degrees of freedom are neither."""
    names = [n for n in tracks.named(stem) if not n.startswith("root_") and ("steer" in n) == steering]
    return [n for n in names if np.isfinite(tracks.column(f"{stem}_{n}")).any()]


def localisation_error(tracks: Tracks) -> Figure | None:
    """How far the vehicle is from where it thinks it is, and by how much its heading is wrong: with landmarks, by odometry alone."""
    true = tracks.planar_poses("base")
    off = {stem: tracks.planar_poses(stem) - true for stem, _, _ in ESTIMATES}
    if tracks.setting.ground_task is None or not any(np.isfinite(o).any() for o in off.values()):
        return None
    figure = new_figure(3.9)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for stem, label, color in ESTIMATES:
        if np.isfinite(off[stem]).any():
            upper.plot(tracks.t, np.hypot(off[stem][:, 0], off[stem][:, 1]), color=color, label=label)
            lower.plot(tracks.t, np.degrees(wrapped(off[stem][:, 2])), color=color)
    lower.axhline(0, color=RULE, linewidth=0.8)
    upper.set_ylim(bottom=0)
    upper.set_ylabel("position [m]")
    lower.set_ylabel("heading [deg]")
    figure.legend(*upper.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    for axes in (upper, lower):
        shade_lost(axes, tracks)
    time_axis(lower, tracks)
    return figure


def slip(tracks: Tracks) -> Figure | None:
    """How fast the vehicle slid over the floor and, below, turned on it, unnoticed by its encoders; logs of old lack the turn."""
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
    """True error of a task without an end, with the band that it shall stay in once settled."""
    value, known = tracks.column("off_m"), tracks.setting.ground_task or tracks.setting
    band, settle = known.band_m, known.settle_s
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
    """Largest size after a time; NaN where there is none."""
    later = np.abs(value[(t >= settled) & np.isfinite(value)])
    return float(later.max()) if len(later) else float("nan")
