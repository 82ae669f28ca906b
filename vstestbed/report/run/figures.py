"""The figures of one run: features in the image, error, twist, depth, pose error, joints.

Each function takes the run's tracks and returns a matplotlib Figure, or None if the run has no such data. True values are
wide pale bands, measured or commanded values are thin lines over them: where they agree, the line lies in its band.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.report.html.canvas import (
    AXIS_COLORS,
    GOAL,
    INK,
    LINE_COLORS,
    LOST,
    RULE,
    WIDTH_IN,
    log_scale,
    marker_colors,
    new_figure,
    note,
)
from vstestbed.report.run.tracks import Tracks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

BAND: dict[str, Any] = {"linewidth": 4.0, "alpha": 0.28}
START: dict[str, Any] = {"marker": "o", "markersize": 5, "linestyle": "none"}
END: dict[str, Any] = {"marker": "x", "markersize": 6, "markeredgewidth": 1.6, "linestyle": "none"}
AIM: dict[str, Any] = {"marker": "D", "markersize": 8, "markerfacecolor": "none", "markeredgewidth": 1.4, "linestyle": "none"}
LEAST_TWIST, LEAST_DEPTH = 2e-3, 0.02
"""Least span of the axis of twists [m/s, rad/s] and of depths (relative to the depth): below it there is only noise."""
PARTS = (("v", "translation [m/s]"), ("w", "rotation [rad/s]"))


def features(tracks: Tracks) -> Figure | None:
    """Marker trajectories in the image, true and measured, with start, end, goal and the image border."""
    if tracks.markers == 0:
        return None
    width, height = tracks.setting.width, tracks.setting.height
    aspect = height / width if width and height else 0.75  # the usual 4:3 where the size is unknown
    figure = new_figure(min(max(WIDTH_IN * aspect, 2.5), 6.5) + 0.5)
    axes = figure.add_subplot()
    draw_trails(axes, tracks.pixels(), tracks.pixels("_true"), tracks.pixels("_goal"))
    _frame_picture(axes, width, height)
    figure.legend(handles=trail_keys(), loc="outside lower center", ncols=5)
    return figure


def draw_trails(axes: Axes, measured: Array, true: Array, goal: Array) -> None:
    """Marker trajectories in a plane, each (T, N, 2), first coordinate horizontal, with start, end and goal."""
    for i, color in enumerate(marker_colors(measured.shape[1])):
        axes.plot(*true[:, i].T, color=color, **BAND)
        axes.plot(*measured[:, i].T, color=color, linewidth=1.0)
        for at, look in ((edge(measured[:, i], 0), START), (edge(measured[:, i], -1), END), (edge(goal[:, i], -1), AIM)):
            axes.plot(*at, color=color, **look)


def trail_keys() -> list[Line2D]:
    """Legend entries for the marks and lines of `draw_trails`."""
    from matplotlib.lines import Line2D

    marks = [Line2D([], [], color=INK, label=label, **look) for look, label in ((START, "start"), (END, "end"), (AIM, "goal"))]
    return [
        *marks,
        Line2D([], [], color=INK, linewidth=1.0, label="measured"),
        Line2D([], [], color=INK, label="true", **BAND),
    ]


def _frame_picture(axes: Axes, width: int | None, height: int | None) -> None:
    """Pixel axes as in the image (v down), with the image border if the size is known."""
    from matplotlib.patches import Rectangle

    axes.set_aspect("equal", adjustable="datalim" if not width else "box")
    if width and height:
        axes.add_patch(Rectangle((-0.5, -0.5), width, height, fill=False, edgecolor=INK, linewidth=1.0, alpha=0.6))
        # pixel centres are integers, so that the image begins at -0.5
        left, right, top, bottom = -0.5, width - 0.5, -0.5, height - 0.5
        x, y = axes.get_xlim(), axes.get_ylim()  # markers that leave the image are shown, up to half an image away
        left, right = min(left, max(x[0], -0.5 * width)), max(right, min(x[1], 1.5 * width))
        top, bottom = min(top, max(y[0], -0.5 * height)), max(bottom, min(y[1], 1.5 * height))
        margin = 0.015 * width
        axes.set_xlim(left - margin, right + margin)
        axes.set_ylim(bottom + margin, top - margin)
    elif not axes.yaxis_inverted():
        axes.invert_yaxis()
    axes.set_xlabel("u [px]")
    axes.set_ylabel("v [px]")


def error(tracks: Tracks) -> Figure:
    """RMS image error over time, logarithmic, with the threshold and the intervals without target.

    For a tilted craft also the error of the image rotated into its level frame, which decides convergence.
    """
    figure = new_figure(3.1)
    axes = figure.add_subplot()
    value = _positive(tracks.column("error_px"))
    if np.isfinite(value).any():
        axes.plot(tracks.t, value, color=LINE_COLORS[0], **_dot(value))
    else:
        note(axes, "no frame with a measured error")
    level = _positive(tracks.column("level_error_px"))
    if np.isfinite(level).any():
        for line in axes.lines:
            line.set(label="in the picture", alpha=0.4)
        axes.plot(tracks.t, level, color=LINE_COLORS[0], label="turned level, which counts")
    threshold = tracks.setting.threshold_px
    if threshold:
        axes.axhline(threshold, color=GOAL, linestyle="--", linewidth=1.2, label=f"threshold {threshold:g} px")
    _mark_views(axes, tracks)
    shade_lost(axes, tracks)
    time_axis(axes, tracks)
    log_scale(axes)
    axes.set_ylabel("RMS error [px]")
    _legend(axes)
    return figure


def _mark_views(axes: Axes, tracks: Tracks) -> None:
    """Mark the times at which the goal view changed to the next, with its number from 1 on."""
    view = tracks.column("view")
    for i in np.flatnonzero(np.diff(view) > 0) + 1:
        axes.axvline(tracks.t[i], color=INK, linewidth=0.8, alpha=0.6)
        label = f" view {view[i] + 1:.0f}"
        axes.annotate(label, (tracks.t[i], 0.99), xycoords=("data", "axes fraction"), va="top", fontsize=8.5, annotation_clip=False)


def pose_error(tracks: Tracks) -> Figure | None:
    """Distance and angle of the true camera (or vehicle) pose from the goal over time, logarithmic; None for a continuing task."""
    if tracks.setting.ground_task is not None and tracks.setting.ground_task.band_m is not None:
        return None
    position, angle = tracks.column("position_error_m"), np.degrees(tracks.column("rotation_error_rad"))
    if not (np.isfinite(position).any() or np.isfinite(angle).any()):
        return None
    figure = new_figure(3.9)
    upper, lower = figure.subplots(2, 1, sharex=True)
    for axes, value, color, label in ((upper, position, LINE_COLORS[0], "position [m]"), (lower, angle, LINE_COLORS[1], "rotation [deg]")):
        axes.plot(tracks.t, _positive(value), color=color, **_dot(value))
        log_scale(axes)
        shade_lost(axes, tracks)
        axes.set_ylabel(label)
    time_axis(lower, tracks)
    return figure


def twist(tracks: Tracks) -> Figure:
    """The camera's twist in its own frame: commanded (line) and true (band), translation above, rotation below."""
    figure = new_figure(4.3)
    panels = figure.subplots(2, 1, sharex=True)
    t_command = tracks.column("t_cmd")  # a command takes effect when its image has arrived
    for axes, (part, label) in zip(panels, PARTS, strict=True):
        axes.axhline(0, color=RULE, linewidth=0.8)
        for axis, color in zip("xyz", AXIS_COLORS, strict=True):
            true, command = tracks.column(f"act_{part}{axis}"), tracks.column(f"cmd_{part}{axis}")
            axes.plot(tracks.t, true, color=color, **BAND)
            axes.plot(t_command, command, color=color, linewidth=1.1, label=f"{part}{axis}", **_dot(command))
        least_span(axes, LEAST_TWIST)
        shade_lost(axes, tracks)
        axes.set_ylabel(label)
        # the zero line, then band and line of each axis in turn: every second from the third is a command
        axes.legend(handles=axes.get_lines()[2::2], loc="upper right", ncols=3)
    time_axis(panels[-1], tracks)
    return figure


def depth(tracks: Tracks) -> Figure | None:
    """Depth of each marker as used by the law (line), and the true depth (band) if it can be computed."""
    used, true = tracks.numbered("depth"), tracks.true_depth
    if not np.isfinite(used).any():
        return None
    figure = new_figure(3.1)
    axes = figure.add_subplot()
    for i, color in enumerate(marker_colors(tracks.markers)):
        if true is not None:
            axes.plot(tracks.t, true[:, i], color=color, **BAND)
        axes.plot(tracks.t, used[:, i], color=color, linewidth=1.0, **_dot(used[:, i]))
    least_span(axes, LEAST_DEPTH * float(np.nanmedian(np.abs(used))))
    shade_lost(axes, tracks)
    time_axis(axes, tracks)
    axes.set_ylabel("depth [m]")
    return figure


JOINT_PANELS = (("q", "position [rad, m]"), ("qd", "velocity [rad/s, m/s]"), ("ctrl", "input [own unit]"))


def joints(tracks: Tracks) -> Figure | None:
    """Joint positions, velocities and actuator inputs, as far as the log has them; None for a ground vehicle (see `vehicle.wheels`)."""
    if tracks.setting.ground_task is not None:
        return None
    panels = [(s, label) for s, label in JOINT_PANELS if _moving(tracks, s)]
    if not panels:
        return None
    names = list(dict.fromkeys(n for stem, _ in panels for n in _moving(tracks, stem)))
    figure = new_figure(0.9 + 1.45 * len(panels) + 0.16 * -(-len(names) // 4))
    grid = np.ravel(figure.subplots(len(panels), 1, sharex=True, squeeze=False))
    for axes, (stem, label) in zip(grid, panels, strict=True):
        for name in _moving(tracks, stem):
            value = tracks.column(f"{stem}_{name}")
            axes.plot(tracks.t, value, color=LINE_COLORS[names.index(name) % len(LINE_COLORS)], linewidth=1.2, **_dot(value))
        axes.set_ylabel(label)
    time_axis(grid[-1], tracks)
    if len(names) <= 16:
        figure.legend(handles=line_keys(names), loc="outside lower center", ncols=4)
    return figure


def _moving(tracks: Tracks, stem: str) -> list[str]:
    """The names of a stem whose columns hold values."""
    return [n for n in tracks.named(stem) if np.isfinite(tracks.column(f"{stem}_{n}")).any()]


def line_keys(names: list[str]) -> list[Line2D]:
    """A legend entry for each name, in the order of the line colours."""
    from matplotlib.lines import Line2D

    return [Line2D([], [], color=LINE_COLORS[i % len(LINE_COLORS)], label=plain(n)) for i, n in enumerate(names)]


def plain(name: str) -> str:
    """A name escaped for matplotlib: no mathtext, and no leading underscore, which would hide it from the legend."""
    return name.replace("$", r"\$").lstrip("_") or "(unnamed)"


def edge(trail: Array, which: int) -> Array:
    """The first (0) or last (-1) finite point of a trail (T, k), as a (k, 1) array; empty where there is none."""
    finite = trail[np.isfinite(trail).all(axis=1)]
    return finite[[which]].T if len(finite) else np.empty((trail.shape[1], 0))


def _positive(value: Array) -> Array:
    """The values with NaN where a logarithmic axis cannot show them."""
    return np.where(value > 0, value, np.nan)


def _dot(value: Array) -> dict[str, Any]:
    """A point marker where a line would show nothing: a single value, or a single one between gaps."""
    return {"marker": "."} if np.isfinite(value).sum() <= 1 else {}


def least_span(axes: Axes, least: float) -> None:
    """Widen the vertical axis about its middle if it spans less than `least`, so that noise does not fill the height."""
    low, high = axes.get_ylim()
    if high - low < least:
        axes.set_ylim((low + high - least) / 2, (low + high + least) / 2)


def shade_lost(axes: Axes, tracks: Tracks) -> None:
    """Shade the intervals in which the target was lost."""
    for i, (start, end) in enumerate(tracks.lost_intervals()):
        axes.axvspan(start, end, color=LOST, alpha=0.16, linewidth=0, label="target lost" if i == 0 else None)


def time_axis(axes: Axes, tracks: Tracks) -> None:
    """Horizontal time axis from the log's first to its last row."""
    axes.set_xlabel("time [s]")
    t = tracks.t[np.isfinite(tracks.t)]
    if len(t) and t[-1] > t[0]:
        axes.set_xlim(t[0], t[-1])


def _legend(axes: Axes) -> None:
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper right")
