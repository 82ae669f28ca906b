"""The figures of one run: features in the image, error, twist, depth, pose error, joints.

Each function takes the run's tracks and returns a Chart, or None if the run has no such data. True values are wide pale bands,
measured or commanded values are thin lines over them: where they agree, the line lies in its band.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.report.html.canvas import AXIS_COLORS, GOAL, INK, LINE_COLORS, LOST, marker_colors
from vstestbed.report.html.chart import Chart, ChartPanel
from vstestbed.report.run.tracks import MeasuredError, Tracks

BAND: dict[str, Any] = {"linewidth": 4.0, "alpha": 0.28}
START: dict[str, Any] = {"marker": "o", "markersize": 5, "linestyle": "none"}
END: dict[str, Any] = {"marker": "x", "markersize": 6, "linewidth": 1.6, "linestyle": "none"}
AIM: dict[str, Any] = {"marker": "D", "markersize": 8, "linestyle": "none"}
OUTLINES: tuple[dict[str, Any], ...] = (
    {"label": "start", "color": INK, "linewidth": 1.0, "linestyle": ":"},
    {"label": "end", "color": INK, "linewidth": 1.6},
    {"label": "goal", "color": GOAL, "linewidth": 1.0},
)
LEAST_TWIST, LEAST_DEPTH = 2e-3, 0.02
"""Least span of the axis of twists [m/s, rad/s] and of depths (relative to the depth): below it there is only noise."""
PARTS = (("v", "translation [m/s]"), ("w", "rotation [rad/s]"))


def features(tracks: Tracks) -> Chart | None:
    """Marker trajectories in the image, true and measured, with start, end, goal and the image border."""
    if tracks.markers == 0:
        return None
    width, height = tracks.setting.width, tracks.setting.height
    chart = Chart()
    (panel,) = chart.panels
    measured, true, goal = (tracks.pixels(suffix) for suffix in ("", "_true", "_goal"))
    if tracks.setting.changing:  # a row goes on with another point where its goal is another
        other = np.zeros(goal.shape[:2], dtype=bool)
        other[1:] = (goal[1:] != goal[:-1]).any(axis=2)
        measured, true = (np.where(other[..., None], np.nan, uv) for uv in (measured, true))
    draw = draw_outlines if tracks.setting.outlined else draw_trails
    draw(panel, measured, true, goal, tracks.names)
    _frame_picture(panel, width, height)
    chart.fit(2.1, 5.4)
    return chart


def draw_trails(panel: ChartPanel, measured: Array, true: Array, goal: Array, names: tuple[str, ...] = ()) -> None:
    """Marker trajectories in a plane, each (T, N, 2), first coordinate horizontal, with start, end and goal, names, and the legend."""
    for i, color in enumerate(marker_colors(measured.shape[1])):
        panel.plot(*true[:, i].T, color=color, **BAND)
        panel.plot(*measured[:, i].T, color=color, linewidth=1.0)
        for at, look in trail_marks(measured[:, i], goal[:, i], color):
            panel.plot(*at, **look)
        at = _edge(goal[:, i], -1)
        if names and at.size:
            panel.words.append((float(at[0, 0]), float(at[1, 0]), f"\N{NO-BREAK SPACE}\N{NO-BREAK SPACE}{names[i]}", "start", color))
    trail_keys(panel)


def draw_outlines(panel: ChartPanel, measured: Array, true: Array, goal: Array, names: tuple[str, ...] = ()) -> None:
    """The outline of a region (T, N, 2) at start, end and goal, and the trail of its middle, measured and true, with the legend."""
    color = marker_colors(1)[0]
    panel.plot(*true.mean(axis=1).T, color=color, **BAND)
    panel.plot(*measured.mean(axis=1).T, color=color, linewidth=1.0)
    seen = measured[np.isfinite(measured).all(axis=(1, 2))]
    for outline, look in zip((seen[:1], seen[-1:], goal[-1:]), OUTLINES, strict=True):
        if len(outline):
            panel.plot(*np.vstack([outline[0], outline[0, :1]]).T, **look)
    panel.plot([], [], label="measured", color=INK, linewidth=1.0)
    panel.plot([], [], label="true", color=INK, **BAND)


def trail_marks(measured: Array, goal: Array, color: str) -> list[tuple[Array, dict[str, Any]]]:
    """Start, end and goal of a trail (T, k): points (k, 1) and their looks; only the start's is filled."""
    start, end, aim = _edge(measured, 0), _edge(measured, -1), _edge(goal, -1)
    return [(start, {"color": color, "fill": color} | START), (end, {"color": color} | END), (aim, {"color": color} | AIM)]


def trail_keys(panel: ChartPanel) -> None:
    """Legend entries for the marks and lines of `draw_trails`."""
    looks = [look for _, look in trail_marks(np.empty((0, 2)), np.empty((0, 2)), INK)]
    for look, label in zip((*looks, {"linewidth": 1.0}, BAND), ("start", "end", "goal", "measured", "true"), strict=True):
        panel.plot([], [], label=label, **look)


def _frame_picture(panel: ChartPanel, width: int | None, height: int | None) -> None:
    """Pixel axes as in the image (v down), with the image border if the size is known."""
    panel.equal, panel.labels = True, ("u [px]", "v [px]")
    (x0, x1), (y0, y1) = panel.limits()
    if not (width and height):
        panel.ylim = y1, y0
        return
    # pixel centres are integers, so that the image begins at -0.5
    left, right, top, bottom = -0.5, width - 0.5, -0.5, height - 0.5
    panel.plot([left, right, right, left, left], [top, top, bottom, bottom, top], color=INK, linewidth=1.0, alpha=0.6, zorder=1)
    # markers that leave the image are shown, up to half an image away
    left, right = min(left, max(x0, -0.5 * width)), max(right, min(x1, 1.5 * width))
    top, bottom = min(top, max(y0, -0.5 * height)), max(bottom, min(y1, 1.5 * height))
    margin = 0.015 * width
    panel.xlim, panel.ylim = (left - margin, right + margin), (bottom + margin, top - margin)


def error(tracks: Tracks) -> Chart:
    """RMS image error over time, logarithmic, with threshold and intervals without target; a panel for each unit in the log.

    Of a tilted craft also the error of the image rotated into its level frame, which decides convergence. Below, the law's mode.
    """
    modes = bool(tracks.setting.modes) and bool(np.isfinite(tracks.column("law_mode")).any())
    both = tracks.setting.image_errors
    shown = [one for one in both if (tracks.column(one.column) > 0).any()] or both[:1]
    chart = Chart(3.1 + 1.6 * (len(shown) - 1) + 0.5 * modes, len(shown) + modes)
    for panel, one in zip(chart.panels, shown, strict=False):
        _draw_error(panel, tracks, one)
        _mark_views(panel, tracks)
    if modes:
        _mark_modes(chart.panels[-1], tracks)
    return over_time(chart, tracks)


def _draw_error(panel: ChartPanel, tracks: Tracks, error: MeasuredError) -> None:
    """One error in the image over time, with its threshold."""
    panel.log, panel.labels = True, ("", error.label)
    value, level = tracks.column(error.column), tracks.column("level_error_px")
    tilted = error.unit == "px" and bool((level > 0).any())
    if (value > 0).any():
        panel.plot(tracks.t, value, color=LINE_COLORS[0], **({"label": "in the picture", "alpha": 0.4} if tilted else {}))
    if tilted:
        panel.plot(tracks.t, level, color=LINE_COLORS[0], label="turned level, which counts")
    if not panel.curves:
        panel.title = "no frame with a measured error"
    if error.threshold:
        words = f"threshold {error.threshold:g} {error.unit}"
        panel.rule(error.threshold, color=GOAL, linestyle="--", linewidth=1.2, label=words)


def _mark_modes(panel: ChartPanel, tracks: Tracks) -> None:
    """A strip with the mode of the law over time, a colour for each."""
    panel.share, panel.ylim, panel.labels, panel.in_words = 0.22, (0.0, 1.0), ("", "mode"), (None, lambda _: "")
    mode, t = tracks.column("law_mode"), tracks.t
    starts = np.flatnonzero(np.diff(mode, prepend=np.nan) != 0)
    for a, b in zip(starts, [*starts[1:], len(t) - 1], strict=True):
        number = int(np.nan_to_num(mode[a]))
        word = tracks.setting.modes[number] if number < len(tracks.setting.modes) else f"mode {number}"
        panel.area((t[a], t[b]), (0.0, 1.0), LINE_COLORS[(number + 1) % len(LINE_COLORS)], 0.75, word)


def _mark_views(panel: ChartPanel, tracks: Tracks) -> None:
    """Mark the times at which the goal view changed to the next, with its number from 1 on."""
    view = tracks.column("view")
    for i in np.flatnonzero(np.diff(view) > 0) + 1:
        panel.plot([tracks.t[i]] * 2, [-np.inf, np.inf], color=INK, linewidth=0.8, alpha=0.6)
        panel.words.append((tracks.t[i], np.inf, f" view {view[i] + 1:.0f}", "start", INK))


def pose_error(tracks: Tracks) -> Chart | None:
    """Distance and angle of the true camera (or vehicle) pose from the goal over time, logarithmic; None for a continuing task."""
    if tracks.setting.ground_task is not None and tracks.setting.ground_task.band_m is not None:
        return None
    position, angle = tracks.column("position_error_m"), np.degrees(tracks.column("rotation_error_rad"))
    if not (np.isfinite(position).any() or np.isfinite(angle).any()):
        return None
    chart = Chart(3.9, 2)
    for panel, value, color, label in zip(chart.panels, (position, angle), LINE_COLORS, ("position [m]", "rotation [deg]"), strict=False):
        panel.plot(tracks.t, value, color=color)
        panel.log, panel.labels = True, ("", label)
    return over_time(chart, tracks)


def twist(tracks: Tracks) -> Chart:
    """The camera's twist in its own frame: commanded (line) and true (band), translation above, rotation below."""
    chart = Chart(4.3, 2)
    t_command = tracks.column("t_cmd")  # a command takes effect when its image has arrived
    for panel, (part, label) in zip(chart.panels, PARTS, strict=True):
        panel.rule(0)
        for axis, color in zip("xyz", AXIS_COLORS, strict=True):
            panel.plot(tracks.t, tracks.column(f"act_{part}{axis}"), color=color, **BAND)
            panel.plot(t_command, tracks.column(f"cmd_{part}{axis}"), color=color, linewidth=1.1, label=f"{part}{axis}")
        panel.least, panel.labels = LEAST_TWIST, ("", label)
    return over_time(chart, tracks)


def depth(tracks: Tracks) -> Chart | None:
    """Depth of each marker as used by the law (line), and the true depth (band) if it can be computed."""
    used, true = tracks.numbered("depth"), tracks.true_depth
    if not np.isfinite(used).any():
        return None
    chart = Chart(3.1)
    (panel,) = chart.panels
    for i, color in enumerate(marker_colors(tracks.markers)):
        if true is not None:
            panel.plot(tracks.t, true[:, i], color=color, **BAND)
        panel.plot(tracks.t, used[:, i], color=color, linewidth=1.0, **({"label": tracks.names[i]} if tracks.names else {}))
    panel.least, panel.labels = LEAST_DEPTH * float(np.nanmedian(np.abs(used))), ("", "depth [m]")
    return over_time(chart, tracks)


JOINT_PANELS = (("q", "position [rad, m]"), ("qd", "velocity [rad/s, m/s]"), ("ctrl", "input [own unit]"))


def joints(tracks: Tracks) -> Chart | None:
    """Joint positions, velocities and actuator inputs, as far as the log has them; None for a ground vehicle (see `vehicle.wheels`)."""
    if tracks.setting.ground_task is not None:
        return None
    panels = [(s, label) for s, label in JOINT_PANELS if _moving(tracks, s)]
    if not panels:
        return None
    names = list(dict.fromkeys(n for stem, _ in panels for n in _moving(tracks, stem)))
    chart = Chart(0.6 + 1.45 * len(panels), len(panels))
    for panel, (stem, label) in zip(chart.panels, panels, strict=True):
        for name in _moving(tracks, stem):
            color = LINE_COLORS[names.index(name) % len(LINE_COLORS)]
            entry = {"label": name} if len(names) <= 16 else {}
            panel.plot(tracks.t, tracks.column(f"{stem}_{name}"), color=color, linewidth=1.2, **entry)
        panel.labels = "", label
    return over_time(chart, tracks)


def _moving(tracks: Tracks, stem: str) -> list[str]:
    """The names of a stem whose columns hold values."""
    return [n for n in tracks.named(stem) if np.isfinite(tracks.column(f"{stem}_{n}")).any()]


def _edge(trail: Array, which: int) -> Array:
    """The first (0) or last (-1) finite point of a trail (T, k), as a (k, 1) array; empty where there is none."""
    finite = trail[np.isfinite(trail).all(axis=1)]
    return finite[[which]].T if len(finite) else np.empty((trail.shape[1], 0))


def over_time(chart: Chart, tracks: Tracks) -> Chart:
    """Give all panels the time from the log's first to its last row, and shade the intervals in which the target was lost."""
    t = tracks.t[np.isfinite(tracks.t)]
    for panel in chart.panels:
        panel.labels = "time [s]", panel.labels[1]
        if len(t) and t[-1] > t[0]:
            panel.xlim = float(t[0]), float(t[-1])
        for start, end in tracks.lost_intervals():
            panel.area((start, end), (-np.inf, np.inf), LOST, 0.16, "target lost")
    return chart
