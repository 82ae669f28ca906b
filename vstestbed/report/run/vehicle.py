"""Figures over time of a ground vehicle: wheels, slip, localisation error, error of the task."""

from __future__ import annotations

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.planar import wrapped
from vstestbed.report.html.canvas import GOAL, LINE_COLORS
from vstestbed.report.html.chart import Chart
from vstestbed.report.run.figures import BAND, over_time
from vstestbed.report.run.tracks import Tracks

ESTIMATES = (("est", "as estimated", LINE_COLORS[1]), ("odo", "by odometry alone", LINE_COLORS[3]))


WHEEL_PANELS = (("qd", False, "speed [rad/s]"), ("q", True, "angle [rad]"))
"""Panels of the wheels' figure: column of the measurement, whether it shows steering joints, label."""


def wheels(tracks: Tracks) -> Chart | None:
    """Wheel speeds, measured (band) and commanded (line), and below them the steering angles."""
    if tracks.setting.ground_task is None:
        return None
    panels = _wheel_panels(tracks)
    names = list(dict.fromkeys(n for _, measured, commanded, _ in panels for n in (*measured, *commanded)))
    if not names:
        return None
    color = {name: LINE_COLORS[i % len(LINE_COLORS)] for i, name in enumerate(names)}
    chart = Chart(0.6 + 1.9 * len(panels), len(panels))
    for panel, (stem, measured, commanded, label) in zip(chart.panels, panels, strict=True):
        for name in measured:
            panel.plot(tracks.t, tracks.column(f"{stem}_{name}"), color=color[name], **BAND)
        for name in commanded:
            panel.plot(tracks.t, tracks.column(f"ctrl_{name}"), color=color[name], linewidth=1.0)
        panel.labels = "", label
    for name in names:  # an entry of full colour, where the first curve may be a pale band
        chart.panels[0].plot([], [], color=color[name], label=name)
    over_time(chart, tracks)
    return chart


def _wheel_panels(tracks: Tracks) -> list[tuple[str, list[str], list[str], str]]:
    """The panels with data: column of the measurement, measured joints, commanded joints, label."""
    panels = [(stem, _joints(tracks, stem, steering), _joints(tracks, "ctrl", steering), label) for stem, steering, label in WHEEL_PANELS]
    return [panel for panel in panels if panel[1] or panel[2]]


def _joints(tracks: Tracks, stem: str, steering: bool) -> list[str]:
    """Names of the steering joints or of the wheels with values in the columns of a stem; the floating base (`root_`) is neither."""
    names = [n for n in tracks.named(stem) if not n.startswith("root_") and ("steer" in n) == steering]
    return [n for n in names if np.isfinite(tracks.column(f"{stem}_{n}")).any()]


def localisation_error(tracks: Tracks) -> Chart | None:
    """Localisation error in position and heading: of the estimate with landmarks, and of odometry alone."""
    true = tracks.planar_poses("base")
    error = {stem: tracks.planar_poses(stem) - true for stem, _, _ in ESTIMATES}
    if tracks.setting.ground_task is None or not any(np.isfinite(e).any() for e in error.values()):
        return None
    chart = Chart(3.9, 2)
    upper, lower = chart.panels
    for stem, label, color in ESTIMATES:
        if np.isfinite(error[stem]).any():
            upper.plot(tracks.t, np.hypot(error[stem][:, 0], error[stem][:, 1]), color=color, label=label)
            lower.plot(tracks.t, np.degrees(wrapped(error[stem][:, 2])), color=color)
    lower.rule(0)
    upper.lowest = 0  # a distance
    upper.labels = "", "position [m]"
    lower.labels = "", "heading [deg]"
    over_time(chart, tracks)
    return chart


def slip(tracks: Tracks) -> Chart | None:
    """Slip speed and, below, slip in yaw: motion over the floor that the encoders do not measure; older logs lack the latter."""
    # column, factor to the unit of the label, least span of the axis in that unit, label
    rows = (("slip_mps", 1e3, 1.0, "slip [mm/s]"), ("slip_radps", 180 / np.pi, 0.1, "in yaw [deg/s]"))
    panels = [(tracks.column(name) * factor, least, label) for name, factor, least, label in rows]
    panels = [panel for panel in panels if np.isfinite(panel[0]).any()]
    if not panels:
        return None
    chart = Chart(0.9 + 1.7 * len(panels), len(panels))
    for panel, (value, least, label) in zip(chart.panels, panels, strict=True):
        panel.plot(tracks.t, value, color=LINE_COLORS[0], linewidth=1.0)
        panel.least, panel.lowest = least, 0
        panel.labels = "", label
    over_time(chart, tracks)
    return chart


def task_error(tracks: Tracks) -> Chart | None:
    """True error of a continuing task, with its tolerance after the settling time."""
    value, task = tracks.column("task_error_m"), tracks.setting.ground_task or tracks.setting
    band, settle = task.band_m, task.settle_s
    if not np.isfinite(value).any():
        return None
    chart = Chart(3.1)
    (panel,) = chart.panels
    if band is not None:
        last = max(float(np.nanmax(tracks.t)), settle)
        panel.area((settle, last), (-band, band), GOAL, 0.14, f"band, {band:g} m to each side")
        worst = _worst(tracks.t, value, settle)
        panel.title = "" if np.isnan(worst) else f"at most {worst:.3f} m off once settled"
    panel.rule(0)
    panel.plot(tracks.t, value, color=LINE_COLORS[0])
    panel.labels = "", "off [m]"
    over_time(chart, tracks)
    return chart


def _worst(t: Array, value: Array, settled: float) -> float:
    """Largest magnitude after the settling time [s]; NaN without a value after it."""
    later = np.abs(value[(t >= settled) & np.isfinite(value)])
    return float(later.max()) if len(later) else float("nan")
