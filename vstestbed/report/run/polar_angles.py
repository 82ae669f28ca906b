"""Marker trajectories in the coordinates of the features `polar` and `spherical`, for runs with these features.

Lines and marks are those of the figure in the image.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.features import Polar, Spherical
from vstestbed.report.html.canvas import fill, marker_colors, new_figure, new_space
from vstestbed.report.run import sphere
from vstestbed.report.run.figures import AIM, BAND, END, START, draw_trails, edge, trail_keys
from vstestbed.report.run.tracks import Tracks

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from mpl_toolkits.mplot3d import Axes3D

PI = math.pi
SUFFIXES = ("", "_true", "_goal")
RINGS_DEG = {30: 10, 60: 15, 100: 20, 180: 30}
"""Colatitude up to which the sphere is drawn, the smallest that holds all markers, and the spacing of its circles [deg]."""


def polar(tracks: Tracks) -> Figure | None:
    """Marker trajectories in (phi, r), for a run with the feature `polar`."""
    feature = tracks.setting.feature
    return _plane(tracks, feature, "r [1]") if isinstance(feature, Polar) else None


def spherical(tracks: Tracks) -> Figure | None:
    """Marker trajectories in (phi, theta), for a run with the feature `spherical`."""
    feature = tracks.setting.feature
    return _plane(tracks, feature, "θ [rad]") if isinstance(feature, Spherical) else None


def _plane(tracks: Tracks, feature: Polar | Spherical, label: str) -> Figure | None:
    ways = [coordinates(tracks, feature, suffix) for suffix in SUFFIXES]
    if not np.isfinite(ways[0]).any():
        return None
    turns_joined(*(way[..., 0] for way in ways))
    # angles are drawn in multiples of pi, a radius as it is
    in_pi = np.array([1 / PI, 1 / PI if isinstance(feature, Spherical) else 1.0])
    figure = new_figure(3.6)
    axes = figure.add_subplot()
    draw_trails(axes, *(way * in_pi for way in ways))
    axes.set_ylim(0, 1.08 * axes.dataLim.y1 or 1.0)  # from zero, so that what hardly varies does not fill the height
    axes.set_xlabel("φ [rad]")
    axes.set_ylabel(label)
    _count_in_pi(axes.xaxis, 9)
    if isinstance(feature, Spherical):
        _count_in_pi(axes.yaxis, 7)
    figure.legend(handles=trail_keys(), loc="outside lower center", ncols=5)
    return figure


def coordinates(tracks: Tracks, feature: Polar | Spherical, suffix: str) -> Array:
    """The feature's two coordinates of each marker, phi first, shape (T, N, 2) [rad, and 1 or rad]; NaN where not seen.

    Args:
        tracks: the run.
        feature: the feature that measures them.
        suffix: "" for the measured markers, `_true` or `_goal`.
    """
    camera, uv = tracks.setting.camera, tracks.pixels(suffix)
    if camera is None:
        return np.full(uv.shape, np.nan)
    seen = camera.normalise(uv) if isinstance(feature, Polar) else camera.ray(uv)
    return feature.measure(seen).reshape(uv.shape)[..., ::-1]


def turns_joined(measured: Array, true: Array, goal: Array) -> None:
    """Unwrap angles about the axis, each (T, N) [rad], in place: multiples of 2 pi are added so that no line jumps.

    The measured trajectory keeps its first angle. The true one is shifted next to it, and the goal next to its end.
    """
    for seen, real, target in zip(measured.T, true.T, goal.T, strict=True):  # views: they write into the arrays
        # the true angle bridges gaps of the measurement, in which the marker may turn by more than half a turn
        path = _unwrapped(np.where(np.isfinite(seen), seen, real))
        seen[:] = np.where(np.isfinite(seen), path, np.nan)
        real[:] = _unwrapped(real)
        real += _whole_turns(path - real)
        target += _whole_turns((path - target)[np.isfinite(path)][-1:])


def _unwrapped(phi: Array) -> Array:
    """Angles (T,) with steps of at most pi between consecutive known values; NaN stays."""
    phi, known = phi.copy(), np.isfinite(phi)
    phi[known] = np.unwrap(phi[known])
    return phi


def _whole_turns(difference: Array) -> float:
    """The multiple of 2 pi nearest to the median of differences (T,) [rad]; 0 if none is known."""
    known = difference[np.isfinite(difference)]
    return float(2 * PI * np.round(np.median(known) / (2 * PI))) if len(known) else 0.0


def _count_in_pi(axis: Axis, most: int) -> None:
    """Up to `most` ticks on an axis whose data are in multiples of pi."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(most, steps=[1, 2.5, 5, 10]))
    axis.set_major_formatter(lambda value, _: _in_pi(value))


def _in_pi(value: float) -> str:
    text = f"{value:.4g}".replace("-", "\N{MINUS SIGN}")
    return text if float(value) == 0 else {"1": "π", "\N{MINUS SIGN}1": "\N{MINUS SIGN}π"}.get(text, f"{text}π")


def on_sphere(tracks: Tracks) -> Figure | None:
    """Marker trajectories on the unit sphere around the camera, for a run with the feature `spherical`."""
    camera = tracks.setting.camera
    if camera is None or not isinstance(tracks.setting.feature, Spherical):
        return None
    measured, true, goal = (camera.ray(tracks.pixels(suffix)) for suffix in SUFFIXES)
    shown = np.concatenate([measured, true, goal]).reshape(-1, 3)
    shown = shown[np.isfinite(shown).all(axis=1)]
    if len(shown) == 0:
        return None
    figure = new_figure(4.4)
    axes = new_space(figure, computed_zorder=False)  # artists drawn later lie on top: matplotlib's own order is by mean depth
    _draw_ball(axes, shown)
    for i, color in enumerate(marker_colors(tracks.markers)):
        sphere.draw_curve(axes, true[:, i], color=color, **BAND)
        sphere.draw_curve(axes, measured[:, i], color=color, linewidth=1.0)
        for at, look in ((edge(measured[:, i], 0), START), (edge(measured[:, i], -1), END), (edge(goal[:, i], -1), AIM)):
            sphere.draw_curve(axes, at.T, color=color, **look)
    fill(axes, box=False)
    figure.legend(handles=trail_keys(), loc="lower center", ncols=5)
    return figure


def _draw_ball(axes: Axes3D, shown: Array) -> None:
    """The part of the sphere that the rays shown (M, 3) need, seen from ahead and from the side on which they lie."""
    farthest = math.degrees(math.acos(np.clip(shown[:, 2].min(), -1, 1)))
    reach_deg = next(reach for reach in RINGS_DEG if reach >= farthest or reach == 180)
    reach, side = math.radians(reach_deg), math.sin(math.radians(min(reach_deg, 90)))
    elev, azim = (24, 52) if reach > PI / 2 else (16, 68)
    azim = azim if shown[:, 0].mean() >= 0 else 180 - azim
    sphere.frame(axes, np.array([-side, -side, math.cos(reach)]), np.array([side, side, 1.0]), elev=elev, azim=azim, zoom=1)
    sphere.draw_net(axes, reach, math.radians(RINGS_DEG[reach_deg]))
    sphere.draw_axes(axes, 0.4 * side, start=1.0)
    sphere.draw_cross_axes(axes, np.array([0, 0, 1.0]), 0.25 * side)
    axes.figure.text(0.015, 0.98, f"circles every {RINGS_DEG[reach_deg]} deg\nfrom the axis", va="top", fontsize=8.5)
