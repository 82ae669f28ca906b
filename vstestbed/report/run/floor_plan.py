"""Floor plan of a vehicle's run: true path, estimated path, odometry, landmarks, and the visible region. Equal scale."""

from __future__ import annotations

from typing import Any

import numpy as np

from vstestbed.core.geometry import Array, transform
from vstestbed.report.html.canvas import GOAL, INK, LINE_COLORS, marker_colors
from vstestbed.report.html.chart import Chart, ChartPanel
from vstestbed.report.run.expected_path import GroundTask, largest_deviation, visible_region
from vstestbed.report.run.tracks import Tracks

DART = np.array([[1.0, 0.0], [-0.7, 0.55], [-0.35, 0.0], [-0.7, -0.55]])
"""Corners of an arrow head of length about 1 that points along x: the vehicle."""
HEADING_EVERY = 0.09
"""Distance between the headings that are drawn along the path, as a share of the figure's extent."""
TRUE, ESTIMATED, ODOMETRY = LINE_COLORS[0], LINE_COLORS[1], LINE_COLORS[3]


def plane(tracks: Tracks) -> Chart | None:
    """Paths in the plane: true, estimated and by odometry; start, end, goals; landmarks; visible region at both ends."""
    ground_task, places = tracks.setting.ground_task, tracks.planar_poses("base")
    known = np.isfinite(places).all(axis=1)
    if ground_task is None or not known.any():
        return None
    landmarks = _landmarks(tracks)
    shown = [places[known, :2], ground_task.goals[:, :2], landmarks[:, :2], ground_task.reference_path, _moving_target(tracks)]
    points = np.concatenate(shown)
    low, high = points.min(axis=0), points.max(axis=0)
    span = float(max((high - low).max(), 0.5))  # [m]; a vehicle that hardly moves is not magnified further
    low, high = low - 0.09 * span, high + 0.09 * span
    chart = Chart()
    (panel,) = chart.panels
    _draw_views(panel, tracks, ground_task, landmarks, span)
    _draw_task(panel, tracks, ground_task, span)
    _draw_paths(panel, tracks, ground_task, span)
    _draw_landmarks(panel, landmarks)
    panel.equal, panel.labels = True, ("x [m]", "y [m]")
    panel.xlim, panel.ylim = (low[0], high[0]), (low[1], high[1])
    chart.fit(1.9, 5.0)
    return chart


def _landmarks(tracks: Tracks) -> Array:
    """Markers in the world at the target's last pose, shape (N, 3) [m]; empty where they are unknown."""
    poses, points = tracks.poses("tgt"), tracks.setting.points
    known = np.isfinite(poses).all(axis=(1, 2))
    return transform(poses[known][-1], points) if points is not None and known.any() else np.empty((0, 3))


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
    """Reference path, path of the target, goals."""
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
    for stem, color, label in (("odo", ODOMETRY, "by odometry alone"), ("est", ESTIMATED, "as estimated")):
        path = tracks.planar_poses(stem)
        if np.isfinite(path).any():
            panel.plot(path[:, 0], path[:, 1], color=color, linewidth=0.9, label=label, zorder=3)
    panel.plot(true[:, 0], true[:, 1], color=TRUE, linewidth=4.0, alpha=0.35, label="true way", zorder=2.5)
    if ground_task.expected_path is not None and len(ground_task.expected_path) > 1:
        known = true[np.isfinite(true).all(axis=1), :2]
        label = f"{ground_task.expected_path_name}: at most {_length(largest_deviation(known, ground_task.expected_path))} off"
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


def _draw_landmarks(panel: ChartPanel, landmarks: Array) -> None:
    for (x, y, _), color in zip(landmarks, marker_colors(len(landmarks)), strict=True):
        panel.plot([x], [y], color=color, fill=color, marker="o", markersize=5.8, linewidth=0, label="landmarks", zorder=4)


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
    """A length as text, in m, cm or mm."""
    return f"{metres:.2f} m" if metres >= 1 else f"{100 * metres:.1f} cm" if metres >= 0.01 else f"{1000 * metres:.1f} mm"
