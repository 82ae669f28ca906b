"""Camera path in the world, 3-D: path, viewing pyramids, target, goal. Equal scale on all axes."""

from __future__ import annotations

import numpy as np

from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.report.html.canvas import AXIS_COLORS, GOAL, INK, LINE_COLORS, marker_colors
from vstestbed.report.html.chart import Chart
from vstestbed.report.html.space import Space
from vstestbed.report.run.tracks import Tracks

PYRAMID = np.array([[0, 0, 0], [-0.4, -0.3, 0.7], [0.4, -0.3, 0.7], [0.4, 0.3, 0.7], [-0.4, 0.3, 0.7]])
PYRAMID_LINE = [0, 1, 2, 0, 3, 4, 0, 1, 4, 3, 2]
"""Corners of a viewing pyramid of length about 1, and the order that draws all its edges in one line."""


def camera_path(tracks: Tracks) -> Chart | None:
    """The camera's path in the world, its viewing pyramids along it, the markers, the goal view; None for a ground vehicle.

    A ground vehicle's camera stays at its height: its path is drawn in the plane (`floor_plan`).
    """
    if tracks.setting.ground_task is not None:
        return None
    cameras = tracks.poses("cam")
    cameras = cameras[np.isfinite(cameras).all(axis=(1, 2))]
    if len(cameras) == 0:
        return None
    targets = tracks.poses("tgt")
    targets = targets[np.isfinite(targets).all(axis=(1, 2))]
    goal = _goal_camera(tracks, targets)
    shown = [cameras[:, :3, 3], targets[:, :3, 3]] + ([goal[None, :3, 3]] if goal is not None else [])
    if len(targets) and tracks.setting.points is not None:
        shown.append(transform(targets[-1], tracks.setting.points))
    points = np.concatenate(shown)
    chart = Chart()
    space = Space(chart.panels[0], elev=22, azim=-62)
    size = 0.13 * float(np.ptp(points, axis=0).max() or 1.0)  # [m] of a pyramid; 1 m where nothing moves and no target is known
    low, high = points.min(axis=0) - size, points.max(axis=0) + size
    span = np.maximum(high - low, 0.3 * (high - low).max())  # a flat scene gets some thickness
    space.box((low + high - span) / 2, (low + high + span) / 2)
    _draw_cameras(space, cameras, goal, size)
    _draw_target(space, targets, tracks.setting.points, size)
    chart.fit(1.9, 4.2)
    return chart


def _goal_camera(tracks: Tracks, targets: Array) -> Array | None:
    """Goal pose T_world_camera (4, 4) for the target's last pose; None without a goal view."""
    view = tracks.setting.T_camera_target
    return targets[-1] @ inverse(view) if view is not None and len(targets) else None


def _draw_cameras(space: Space, cameras: Array, goal: Array | None, size: float) -> None:
    path = cameras[:, :3, 3]
    space.plot(*path.T, color=LINE_COLORS[0], linewidth=1.8, label="camera, to its end")
    # four views evenly over the frames, without start and end
    for k in np.unique(np.linspace(0, len(cameras) - 1, 6).astype(int))[1:-1]:
        space.plot(*_pyramid(cameras[k], 0.6 * size), color=LINE_COLORS[0], linewidth=0.7, alpha=0.45)
    space.plot(*_pyramid(cameras[0], size), color=INK, linewidth=1.0, label="start")
    space.plot(*_pyramid(cameras[-1], size), color=LINE_COLORS[0], linewidth=1.4)
    if goal is not None:
        space.plot(*_pyramid(goal, 1.25 * size), color=GOAL, linewidth=1.1, linestyle=(0, (4, 2)), label="goal")


def _draw_target(space: Space, targets: Array, points: Array | None, size: float) -> None:
    """Path of a moving target, and at its last pose the axes and the markers of the target."""
    if len(targets) == 0:
        return
    if np.ptp(targets[:, :3, 3], axis=0).max() > 1e-6:
        space.plot(*targets[:, :3, 3].T, color=INK, linewidth=1.0, linestyle=":", label="target")
    T = targets[-1]
    for axis, color in enumerate(AXIS_COLORS):
        tip = T[:3, 3] + 0.7 * size * T[:3, axis]
        space.plot(*np.stack([T[:3, 3], tip]).T, color=color, linewidth=1.2)
    if points is None:
        return
    p = transform(T, points)
    for place, color in zip(p, marker_colors(len(p)), strict=True):
        space.plot(*place[:, None], color=color, fill=color, marker="o", markersize=5, linewidth=0, label="markers")


def _pyramid(T: Array, size: float) -> Array:
    """Edges of the viewing pyramid of a camera pose T_world_camera (4, 4) as one line, shape (3, 11)."""
    return transform(T, size * PYRAMID)[PYRAMID_LINE].T
