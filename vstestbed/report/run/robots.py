"""Figures of vehicles and craft: wheels, slip, localisation, floor plan; velocity, attitude, rotors."""

from __future__ import annotations

from typing import Any

import numpy as np

from vstestbed.core.geometry import Array, adjoint, inverse, transform
from vstestbed.core.planar import wrapped
from vstestbed.report.html.canvas import GOAL, INK, LINE_COLORS, marker_colors
from vstestbed.report.html.chart import Chart, ChartPanel
from vstestbed.report.run.figures import BAND, over_time
from vstestbed.report.run.tracks import GroundTask, Tracks, largest_deviation, visible_region

# Figures over time of a quadrotor: velocity, attitude and body rates with their references; rotors, wind.


LIMIT_RADPS = 1000.0  # Speed limit of a rotor [rad/s], from models/quadrotor.xml


def velocity(tracks: Tracks) -> Chart | None:
    """Velocity in the level frame: commanded (thin line) and estimated by the craft (pale band)."""
    flown, camera = tracks.columns("est_vx", "est_vy", "est_vz"), tracks.setting.camera
    if camera is None or not np.isfinite(flown).any():
        return None
    # applied_*: the camera twist in the camera frame after the robot's limits; the mount's adjoint takes it to the craft
    applied = tracks.columns(*(f"applied_{name}" for name in ("vx", "vy", "vz", "wx", "wy", "wz")))
    commanded = applied @ adjoint(camera.mount.T).T
    return _three(tracks, flown, commanded, [f"{axis} [m/s]" for axis in ("ahead", "left", "up")])


def tilt(tracks: Tracks) -> Chart | None:
    """Roll and pitch: true (pale band), estimated by the craft (thin line), and the reference of its velocity loop (dotted)."""
    estimated, reference, camera = tracks.columns("est_roll", "est_pitch"), tracks.columns("ref_roll", "ref_pitch"), tracks.setting.camera
    if camera is None or not np.isfinite(estimated).any():
        return None
    up = (tracks.poses("cam") @ inverse(camera.mount.T))[:, 2, :3]  # the world's z axis in the base frame: independent of yaw
    true = np.column_stack([np.arctan2(up[:, 1], up[:, 2]), -np.arcsin(np.clip(up[:, 0], -1, 1))])
    chart = Chart(3.0)
    (panel,) = chart.panels
    panel.rule(0)
    for i, name in enumerate(("roll", "pitch")):
        panel.plot(tracks.t, np.degrees(true[:, i]), color=LINE_COLORS[i], **BAND)
        panel.plot(tracks.t, np.degrees(estimated[:, i]), color=LINE_COLORS[i], linewidth=1.0, label=name)
        panel.plot(tracks.t, np.degrees(reference[:, i]), color=LINE_COLORS[i], linewidth=1.0, linestyle=":")
    panel.labels = "", "tilt [deg]"
    return over_time(chart, tracks)


def rates(tracks: Tracks) -> Chart | None:
    """Body rates: reference of the attitude loop (thin line) and gyro less its bias (pale band)."""
    flown, reference = (tracks.columns(*(f"{what}_{name}" for name in ("wx", "wy", "wz"))) for what in ("est", "ref"))
    if not np.isfinite(flown).any():
        return None
    return _three(tracks, np.degrees(flown), np.degrees(reference), [f"{axis} [deg/s]" for axis in ("roll", "pitch", "yaw")])


def _three(tracks: Tracks, measured: Array, reference: Array, labels: list[str]) -> Chart:
    """Three panels with a column each of what was measured (pale band) and its reference (thin line), both (T, 3)."""
    chart = Chart(4.4, 3)
    for i, panel in enumerate(chart.panels):
        panel.rule(0)
        panel.plot(tracks.t, measured[:, i], color=LINE_COLORS[i], **BAND)
        panel.plot(tracks.t, reference[:, i], color=LINE_COLORS[i], linewidth=1.0)
        panel.labels = "", labels[i]
    return over_time(chart, tracks)


def rotors(tracks: Tracks) -> Chart | None:
    """Rotor speeds with their limit (dotted); below them the wind, if there was any."""
    names = tracks.named("speed")
    if not names:
        return None
    wind = tracks.columns("wind_x", "wind_y", "wind_z")
    windy = bool(np.nanmax(np.abs(wind), initial=0.0) > 0)  # without wind its columns are zero
    chart = Chart(4.2 if windy else 2.8, 2 if windy else 1)
    for i, name in enumerate(names):
        speed, label = tracks.column(f"speed_{name}"), name.removeprefix("rotor_")
        chart.panels[0].plot(tracks.t, speed, color=LINE_COLORS[i], linewidth=1.0, label=label)
    chart.panels[0].rule(LIMIT_RADPS, linewidth=1.4, linestyle=":")
    chart.panels[0].labels = "", "rotors [rad/s]"
    for i in range(3) if windy else ():
        chart.panels[1].plot(tracks.t, wind[:, i], color=LINE_COLORS[i], linewidth=1.0, label=f"wind {'xyz'[i]}")
        chart.panels[1].labels = "", "wind [m/s]"
    return over_time(chart, tracks)


# Figures over time of a ground vehicle: wheels, slip, localisation error, error of the task.
ESTIMATES = (("est", "as estimated", LINE_COLORS[1]), ("odo", "by odometry alone", LINE_COLORS[3]))


WHEEL_PANELS = (("qd", False, "speed [rad/s]"), ("q", True, "angle [rad]"))
"""Panels of the wheels' figure: column of the measurement, whether it shows steering joints, label."""


def wheels(tracks: Tracks) -> Chart | None:
    """Wheel speeds, measured (band) and commanded (line), and below them the steering angles."""
    if tracks.setting.ground_task is None:
        return None
    panels = [(stem, _joints(tracks, stem, steering), _joints(tracks, "ctrl", steering), label) for stem, steering, label in WHEEL_PANELS]
    panels = [panel for panel in panels if panel[1] or panel[2]]
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
    return over_time(chart, tracks)


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
    return over_time(chart, tracks)


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
    return over_time(chart, tracks)


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
        later = np.abs(value[(tracks.t >= settle) & np.isfinite(value)])
        panel.title = f"at most {later.max():.3f} m off once settled" if len(later) else ""
    panel.rule(0)
    panel.plot(tracks.t, value, color=LINE_COLORS[0])
    panel.labels = "", "off [m]"
    return over_time(chart, tracks)


# Floor plan of a vehicle's run: true path, estimated path, odometry, landmarks, and the visible region. Equal scale.
DART = np.array([[1.0, 0.0], [-0.7, 0.55], [-0.35, 0.0], [-0.7, -0.55]])
"""Corners of an arrow head of length about 1 that points along x: the vehicle."""
HEADING_EVERY = 0.09  # Distance between the headings that are drawn along the path, as a share of the figure's extent
TRUE = LINE_COLORS[0]


def plane(tracks: Tracks) -> Chart | None:
    """Paths in the plane: true, estimated and by odometry; start, end, goals; landmarks; visible region at both ends."""
    ground_task, places = tracks.setting.ground_task, tracks.planar_poses("base")
    known = np.isfinite(places).all(axis=1)
    if ground_task is None or not known.any():
        return None
    targets, points = tracks.poses("tgt"), tracks.setting.points
    targets = targets[np.isfinite(targets).all(axis=(1, 2))]
    landmarks = transform(targets[-1], points) if points is not None and len(targets) else np.empty((0, 3))  # where the target was last
    every = [places[known, :2], ground_task.goals[:, :2], landmarks[:, :2], ground_task.reference_path, _moving_target(tracks)]
    shown = np.concatenate(every)
    low, high = shown.min(axis=0), shown.max(axis=0)
    span = float(max((high - low).max(), 0.5))  # [m]; a vehicle that hardly moves is not magnified further
    low, high = low - 0.09 * span, high + 0.09 * span
    chart = Chart()
    (panel,) = chart.panels
    _draw_views(panel, tracks, ground_task, landmarks, span)
    _draw_task(panel, tracks, ground_task, span)
    _draw_paths(panel, tracks, ground_task, span)
    for (x, y, _), color in zip(landmarks, marker_colors(len(landmarks)), strict=True):
        panel.plot([x], [y], color=color, fill=color, marker="o", markersize=5.8, linewidth=0, label="landmarks", zorder=4)
    panel.equal, panel.labels = True, ("x [m]", "y [m]")
    panel.xlim, panel.ylim = (low[0], high[0]), (low[1], high[1])
    chart.fit(1.9, 5.0)
    return chart


def _moving_target(tracks: Tracks) -> Array:
    """Path of a moving target, shape (T, 2) [m]; empty for one that stands still."""
    path = tracks.columns("tgt_x", "tgt_y")
    path = path[np.isfinite(path).all(axis=1)]
    return path if len(path) and np.ptp(path, axis=0).max() > 1e-3 else np.empty((0, 2))


def _draw_views(panel: ChartPanel, tracks: Tracks, ground_task: GroundTask, landmarks: Array, span: float) -> None:
    """The region in the image at the start and at the end, in the plane at the mean height of the landmarks."""
    from contourpy import contour_generator

    cameras = tracks.poses("cam")
    cameras = cameras[np.isfinite(cameras).all(axis=(1, 2))]
    height = float(landmarks[:, 2].mean()) if len(landmarks) else 0.0
    for T, color in ((cameras[0], INK), (cameras[-1], TRUE)) if len(cameras) else ():
        x, y, seen = visible_region(ground_task.camera, T, height, 0.45 * span)
        if seen.any():
            generator: Any = contour_generator(x, y, seen, fill_type="OuterOffset")  # Any: its types are unions over all fill types
            for region, start in zip(*generator.filled(0.5, 1.5), strict=True):
                # NaN between the outline and its holes, which turn the other way round: in one path they are not filled
                outlines = np.insert(region, start[1:-1].astype(int), np.nan, axis=0).T
                panel.plot(*outlines, color=color, fill=color, linewidth=0, alpha=0.07, zorder=1)
            for line in generator.lines(0.5) if seen.min() < 1 else ():  # else all within reach is visible
                panel.plot(*line.T, color=color, alpha=0.35, linewidth=0.7, zorder=1)


def _draw_task(panel: ChartPanel, tracks: Tracks, ground_task: GroundTask, span: float) -> None:
    if len(ground_task.reference_path):
        panel.plot(*ground_task.reference_path.T, color=INK, linewidth=0.9, linestyle=":", label="route")
    target = _moving_target(tracks)
    if len(target):
        panel.plot(*target.T, color=GOAL, linewidth=1.2, label="target")
    for i, goal in enumerate(ground_task.goals):
        last = i == len(ground_task.goals) - 1
        label = "goal" if last else "goals on the way" if i == 0 else ""
        _dart(panel, goal, (0.075 if last else 0.045) * span, label, GOAL, filled=False)


def _draw_paths(panel: ChartPanel, tracks: Tracks, ground_task: GroundTask, span: float) -> None:
    """The true path as a pale band with headings, the other paths over it; the vehicle at start and end."""
    true = tracks.planar_poses("base")
    for stem, label, color in reversed(ESTIMATES):
        path = tracks.planar_poses(stem)
        if np.isfinite(path).any():
            panel.plot(path[:, 0], path[:, 1], color=color, linewidth=0.9, label=label, zorder=3)
    panel.plot(true[:, 0], true[:, 1], color=TRUE, linewidth=4.0, alpha=0.35, label="true way", zorder=2.5)
    if ground_task.expected_path is not None and len(ground_task.expected_path) > 1:
        known = true[np.isfinite(true).all(axis=1), :2]
        label = f"ideal bicycle: at most {_length(largest_deviation(known, ground_task.expected_path))} off"
        panel.plot(*ground_task.expected_path.T, color=INK, linewidth=1.0, linestyle=(0, (5, 2)), label=label, zorder=3)
    known = true[np.isfinite(true).all(axis=1)]
    for place in known[_evenly(known[:, :2], HEADING_EVERY * span)]:
        _dart(panel, place, 0.022 * span, "", TRUE, filled=True)
    _dart(panel, known[0], 0.05 * span, "start", INK, filled=False)
    _dart(panel, known[-1], 0.05 * span, "end", TRUE, filled=True)


def _evenly(xy: Array, distance: float) -> Any:
    """Indices of points (T, 2) that are spaced evenly along their path, without its ends; at most 30."""
    # arc length of each point
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
    count = min(int(along[-1] / distance), 30)
    return np.unique(np.searchsorted(along, np.linspace(0, along[-1], count + 2)[1:-1]))


def _dart(panel: ChartPanel, place: Array, size: float, label: str, color: str, filled: bool) -> None:
    """An arrow head of the given size [m] at a planar pose (x, y, heading), and its entry in the legend."""
    # rows are points, hence the transposed rotation
    c, s = np.cos(place[2]), np.sin(place[2])
    x, y = (size * DART @ np.array([[c, s], [-s, c]]) + place[:2]).T
    face = color if filled else "none"
    panel.plot([*x, x[0]], [*y, y[0]], color=color, fill=face, linewidth=0.5 if filled else 1.3, zorder=5)
    if label:
        panel.plot([], [], color=color, fill=face, label=label, marker=">", markersize=7)


def _length(metres: float) -> str:
    return f"{metres:.2f} m" if metres >= 1 else f"{100 * metres:.1f} cm" if metres >= 0.01 else f"{1000 * metres:.1f} mm"
