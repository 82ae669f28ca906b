"""Marker trajectories in the coordinates of the features `polar` and `spherical`, for runs with these features.

Lines and marks are those of the figure in the image.
"""

from __future__ import annotations

import math

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.features import Polar, Spherical
from vstestbed.report.html.canvas import marker_colors
from vstestbed.report.html.chart import Chart, ChartPanel
from vstestbed.report.html.space import Space
from vstestbed.report.run import sphere
from vstestbed.report.run.figures import BAND, draw_trails, trail_keys, trail_marks
from vstestbed.report.run.tracks import Tracks

PI = math.pi
SUFFIXES = ("", "_true", "_goal")
RINGS_DEG = {30: 10, 60: 15, 100: 20, 180: 30}
"""Colatitude up to which the sphere is drawn, the smallest that holds all markers, and the spacing of its circles [deg]."""


def polar(tracks: Tracks) -> Chart | None:
    """Marker trajectories in (phi, r), for a run with the feature `polar`."""
    feature = tracks.setting.feature
    return _plane(tracks, feature, "r [1]") if isinstance(feature, Polar) else None


def spherical(tracks: Tracks) -> Chart | None:
    """Marker trajectories in (phi, theta), for a run with the feature `spherical`."""
    feature = tracks.setting.feature
    return _plane(tracks, feature, "θ [rad]") if isinstance(feature, Spherical) else None


def _plane(tracks: Tracks, feature: Polar | Spherical, label: str) -> Chart | None:
    ways = [coordinates(tracks, feature, suffix) for suffix in SUFFIXES]
    if not np.isfinite(ways[0]).any():
        return None
    turns_joined(*(way[..., 0] for way in ways))
    # angles are drawn in multiples of pi, a radius as it is
    in_pi = np.array([1 / PI, 1 / PI if isinstance(feature, Spherical) else 1.0])
    chart = Chart(3.3)
    (panel,) = chart.panels
    measured, true, goal = (way * in_pi for way in ways)
    draw_trails(panel, measured, true, goal, tracks.names)
    panel.labels, panel.lowest = ("φ [rad]", label), 0  # from zero, so that what hardly varies does not fill the height
    panel.in_words = _in_pi, _in_pi if isinstance(feature, Spherical) else None
    return chart


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


def _in_pi(value: float) -> str:
    """A multiple of pi as text."""
    text = f"{value:.4g}".replace("-", "\N{MINUS SIGN}")
    return text if float(value) == 0 else {"1": "π", "\N{MINUS SIGN}1": "\N{MINUS SIGN}π"}.get(text, f"{text}π")


def on_sphere(tracks: Tracks) -> Chart | None:
    """Marker trajectories on the unit sphere around the camera, for a run with the feature `spherical`."""
    camera = tracks.setting.camera
    if camera is None or not isinstance(tracks.setting.feature, Spherical):
        return None
    measured, true, goal = (camera.ray(tracks.pixels(suffix)) for suffix in SUFFIXES)
    shown = np.concatenate([measured, true, goal]).reshape(-1, 3)
    shown = shown[np.isfinite(shown).all(axis=1)]
    if len(shown) == 0:
        return None
    chart = Chart()
    space = _ball(chart.panels[0], shown)
    for i, color in enumerate(marker_colors(tracks.markers)):
        sphere.draw_curve(space, true[:, i], color=color, **BAND)
        sphere.draw_curve(space, measured[:, i], color=color, linewidth=1.0)
        for at, look in trail_marks(measured[:, i], goal[:, i], color):
            sphere.draw_curve(space, at.T, **look)
    trail_keys(space.panel)
    chart.fit(1.9, 3.6)
    return chart


def _ball(panel: ChartPanel, shown: Array) -> Space:
    """The part of the sphere that the rays shown (M, 3) need, seen from ahead and from the side on which they lie."""
    farthest = math.degrees(math.acos(np.clip(shown[:, 2].min(), -1, 1)))
    reach_deg = next(reach for reach in RINGS_DEG if reach >= farthest or reach == 180)
    reach, side = math.radians(reach_deg), math.sin(math.radians(min(reach_deg, 90)))
    elev, azim = (24, 52) if reach > PI / 2 else (16, 68)
    space = Space(panel, elev, azim if shown[:, 0].mean() >= 0 else 180 - azim)
    sphere.draw_net(space, reach, math.radians(RINGS_DEG[reach_deg]))
    sphere.draw_axes(space, 0.4 * side, start=1.0)
    sphere.draw_cross_axes(space, np.array([0, 0, 1.0]), 0.25 * side)
    panel.title = f"circles every {RINGS_DEG[reach_deg]} deg from the axis"
    return space
