"""The figures of one run in the picture and in space: markers in the image, floor plan, camera
path, polar and spherical coordinates.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.features import Polar, Spherical
from vstestbed.report.chart import Chart, ChartPanel, Space, Words
from vstestbed.report.marks import (
    AIM,
    AXIS_COLORS,
    BAND,
    END,
    GOAL,
    INK,
    LINE,
    LINE_COLORS,
    RULE,
    START,
    Look,
    marker_colors,
    with_unit,
)
from vstestbed.report.run.figures import ESTIMATES
from vstestbed.report.run.tracks import LogArrays, largest_deviation, visible_region

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d import Axes3D

OUTLINES: tuple[Look, ...] = (
    {"label": "start", "color": INK, "linewidth": 1.0, "linestyle": ":"},
    {"label": "end", "color": INK, "linewidth": 1.6},
    {"label": "goal", "color": GOAL, "linewidth": 1.0},
)


def features(tracks: LogArrays) -> Chart | None:
    """Marker trajectories in the image, true and measured, with start, end, goal and the image
    border.
    """
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
    _image_plane(panel, tracks, (measured, true, goal), width, height)
    chart.fit(2.1, 5.4)
    return chart


def other_cameras(tracks: LogArrays) -> Chart | None:
    """The same in the pictures of further cameras, one above the other."""
    cameras = tracks.setting.cameras
    if tracks.markers == 0 or not cameras:
        return None
    chart = Chart(4.2 * len(cameras), len(cameras))
    for panel, (name, (width, height)) in zip(chart.panels, cameras.items(), strict=True):
        measured, true, goal = (
            tracks.pixels(suffix, f"{name}_") for suffix in ("", "_true", "_goal")
        )
        _image_plane(panel, tracks, (measured, true, goal), width, height)
        panel.title = name
    if len(cameras) == 1:
        chart.fit(2.1, 5.4)
    return chart


def _image_plane(
    panel: ChartPanel,
    tracks: LogArrays,
    trails: tuple[Array, Array, Array],
    width: int | None,
    height: int | None,
) -> None:
    """Draw trails, measured, true and of the goal, in the picture of a camera of this size [px],
    with its border.
    """
    draw = draw_outlines if tracks.setting.outlined else draw_trails
    draw(panel, *trails, tracks.names)
    panel.equal, panel.labels = True, ("u [px]", "v [px]")
    (x0, x1), (y0, y1) = panel.limits()
    if width and height:
        # pixel centres are integers, so that the image begins at -0.5
        left, right, top, bottom = -0.5, width - 0.5, -0.5, height - 0.5
        panel.plot(
            [left, right, right, left, left],
            [top, top, bottom, bottom, top],
            color=INK,
            linewidth=1.0,
            alpha=0.6,
            zorder=1,
        )
        # markers that leave the image are shown, up to half an image away
        left, right = min(left, max(x0, -0.5 * width)), max(right, min(x1, 1.5 * width))
        top, bottom = min(top, max(y0, -0.5 * height)), max(bottom, min(y1, 1.5 * height))
        margin = 0.015 * width
        panel.xlim, panel.ylim = (left - margin, right + margin), (bottom + margin, top - margin)
    else:
        panel.ylim = y1, y0  # v down, as in the image


def draw_trails(
    panel: ChartPanel, measured: Array, true: Array, goal: Array, names: tuple[str, ...] = ()
) -> None:
    """Marker trajectories in a plane, each (T, N, 2), first coordinate horizontal, with start, end
    and goal, names, and the legend.
    """
    for i, color in enumerate(marker_colors(measured.shape[1])):
        panel.plot(*true[:, i].T, color=color, **BAND)
        panel.plot(*measured[:, i].T, color=color, **LINE)
        for at, look in trail_marks(measured[:, i], goal[:, i], color):
            panel.plot(*at, **look)
        at = _edge(goal[:, i], -1)
        if names and at.size:
            name = f"\N{NO-BREAK SPACE}\N{NO-BREAK SPACE}{names[i]}"
            panel.words.append(Words(*at[:, 0].tolist(), name, color=color))
    trail_keys(panel)


def draw_outlines(
    panel: ChartPanel, measured: Array, true: Array, goal: Array, names: tuple[str, ...] = ()
) -> None:
    """The outline of a region (T, N, 2) at start, end and goal, and the trail of its middle,
    measured and true, with the legend.
    """
    color = marker_colors(1)[0]
    panel.plot(*true.mean(axis=1).T, color=color, **BAND)
    panel.plot(*measured.mean(axis=1).T, color=color, **LINE)
    seen = measured[np.isfinite(measured).all(axis=(1, 2))]
    for outline, look in zip((seen[:1], seen[-1:], goal[-1:]), OUTLINES, strict=True):
        if len(outline):
            panel.plot(*np.vstack([outline[0], outline[0, :1]]).T, **look)
    panel.plot([], [], label="measured", color=INK, **LINE)
    panel.plot([], [], label="true", color=INK, **BAND)


def trail_marks(measured: Array, goal: Array, color: str) -> list[tuple[Array, Look]]:
    """Start, end and goal of a trail (T, k): points (k, 1) and their looks; only the start's is
    filled.
    """
    start, end, aim = _edge(measured, 0), _edge(measured, -1), _edge(goal, -1)
    return [
        (start, {"color": color, "fill": color} | START),
        (end, {"color": color} | END),
        (aim, {"color": color} | AIM),
    ]


def trail_keys(panel: ChartPanel) -> None:
    """Legend entries for the marks and lines of `draw_trails`."""
    looks = [look for _, look in trail_marks(np.empty((0, 2)), np.empty((0, 2)), INK)]
    for look, label in zip(
        (*looks, LINE, BAND), ("start", "end", "goal", "measured", "true"), strict=True
    ):
        panel.plot([], [], label=label, **look)


def _edge(trail: Array, which: int) -> Array:
    """The first (0) or last (-1) finite point of a trail (T, k), as a (k, 1) array; empty where
    there is none.
    """
    finite = trail[np.isfinite(trail).all(axis=1)]
    return finite[[which]].T if len(finite) else np.empty((trail.shape[1], 0))


# Floor plan of a vehicle's run: true path, estimated path, odometry, landmarks, and the visible
# region. Equal scale.
DART = np.array([[1.0, 0.0], [-0.7, 0.55], [-0.35, 0.0], [-0.7, -0.55]])
"""Corners of an arrow head of length about 1 that points along x: the vehicle."""
TRUE = LINE_COLORS[0]


def plane(tracks: LogArrays) -> Chart | None:
    """Paths in the plane: true, estimated and by odometry; start, end, goals; landmarks; visible
    region at both ends.
    """
    setting, places = tracks.setting, tracks.planar_poses("base")
    known = np.isfinite(places).all(axis=1)
    if not setting.planar or not known.any():
        return None
    targets, points = _known(tracks.poses("tgt")), setting.points
    # where the target was last
    landmarks = (
        transform(targets[-1], points) if points is not None and len(targets) else np.empty((0, 3))
    )
    moved = (
        targets[:, :2, 3]
        if len(targets) and np.ptp(targets[:, :2, 3], axis=0).max() > 1e-3
        else np.empty((0, 2))
    )
    shown = np.concatenate(
        [places[known, :2], setting.goals[:, :2], landmarks[:, :2], setting.reference_path, moved]
    )
    low, high = shown.min(axis=0), shown.max(axis=0)
    # [m]; a vehicle that hardly moves is not magnified further
    span = float(max((high - low).max(), 0.5))
    chart = Chart()
    (panel,) = chart.panels
    _draw_views(panel, tracks, float(landmarks[:, 2].mean()) if len(landmarks) else 0.0, span)
    if len(setting.reference_path):
        panel.plot(
            *setting.reference_path.T, color=INK, linewidth=0.9, linestyle=":", label="route"
        )
    if len(moved):
        panel.plot(*moved.T, color=GOAL, linewidth=1.2, label="target")
    for i, goal in enumerate(setting.goals):
        last = i == len(setting.goals) - 1
        label = "goal" if last else "goals on the way" if i == 0 else ""
        _dart(panel, goal, (0.075 if last else 0.045) * span, label, GOAL, filled=False)
    _draw_paths(panel, tracks, places[known], span)
    for (x, y, _), color in zip(landmarks, marker_colors(len(landmarks)), strict=True):
        panel.plot(
            [x],
            [y],
            color=color,
            fill=color,
            marker="o",
            markersize=5.8,
            linewidth=0,
            label="landmarks",
            zorder=4,
        )
    panel.equal, panel.labels = True, ("x [m]", "y [m]")
    panel.xlim, panel.ylim = zip(low - 0.09 * span, high + 0.09 * span, strict=True)
    chart.fit(1.9, 5.0)
    return chart


def _known(poses: Array) -> Array:
    """The poses (T, 4, 4) that are known."""
    return poses[np.isfinite(poses).all(axis=(1, 2))]


def _draw_views(panel: ChartPanel, tracks: LogArrays, height: float, span: float) -> None:
    """The region in the image at the start and at the end, in the plane at a height [m], that of
    the landmarks.
    """
    from contourpy import contour_generator  # here: of vehicles alone

    cameras = _known(tracks.poses("cam"))
    camera = tracks.setting.camera
    for T, color in ((cameras[0], INK), (cameras[-1], TRUE)) if len(cameras) else ():
        assert camera is not None  # a vehicle's setting has it
        x, y, seen = visible_region(camera, T, height, 0.45 * span)
        if not seen.any():
            continue
        # Any: its types are unions over all fill types
        generator: Any = contour_generator(x, y, seen, fill_type="OuterOffset")
        for region, start in zip(*generator.filled(0.5, 1.5), strict=True):
            # NaN between the outline and its holes, which turn the other way round: in one path
            # they are not filled
            outlines = np.insert(region, start[1:-1].astype(int), np.nan, axis=0).T
            panel.plot(*outlines, color=color, fill=color, linewidth=0, alpha=0.07, zorder=1)
        # no line where all within reach is visible
        for line in generator.lines(0.5) if seen.min() < 1 else ():
            panel.plot(*line.T, color=color, alpha=0.35, linewidth=0.7, zorder=1)


def _draw_paths(panel: ChartPanel, tracks: LogArrays, true: Array, span: float) -> None:
    """The true path (T, 3) as a pale band with headings, the other paths over it; the vehicle at
    start and end.
    """
    for stem, label, color in reversed(ESTIMATES):
        path = tracks.planar_poses(stem)
        if np.isfinite(path).any():
            panel.plot(path[:, 0], path[:, 1], color=color, linewidth=0.9, label=label, zorder=3)
    panel.plot(
        *tracks.planar_poses("base")[:, :2].T,
        color=TRUE,
        linewidth=4.0,
        alpha=0.35,
        label="true way",
        zorder=2.5,
    )
    expected = tracks.setting.expected_path
    if expected is not None and len(expected) > 1:
        label = (
            "ideal bicycle: at most"
            f" {' '.join(with_unit(largest_deviation(true[:, :2], expected), 'm'))} off"
        )
        panel.plot(
            *expected.T, color=INK, linewidth=1.0, linestyle=(0, (5, 2)), label=label, zorder=3
        )
    # headings evenly along the way, without its ends: every 0.09 of the figure's extent, at most 30
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(true[:, :2], axis=0), axis=1))])
    count = min(int(along[-1] / (0.09 * span)), 30)
    for place in true[
        np.unique(np.searchsorted(along, np.linspace(0, along[-1], count + 2)[1:-1]))
    ]:
        _dart(panel, place, 0.022 * span, "", TRUE, filled=True)
    _dart(panel, true[0], 0.05 * span, "start", INK, filled=False)
    _dart(panel, true[-1], 0.05 * span, "end", TRUE, filled=True)


def _dart(
    panel: ChartPanel, place: Array, size: float, label: str, color: str, filled: bool
) -> None:
    """An arrow head of the given size [m] at a planar pose (x, y, heading), and its entry in the
    legend.
    """
    # rows are points, hence the transposed rotation
    c, s = np.cos(place[2]), np.sin(place[2])
    x, y = (size * DART @ np.array([[c, s], [-s, c]]) + place[:2]).T
    face = color if filled else "none"
    panel.plot(
        [*x, x[0]], [*y, y[0]], color=color, fill=face, linewidth=0.5 if filled else 1.3, zorder=5
    )
    if label:
        panel.plot([], [], color=color, fill=face, label=label, marker=">", markersize=7)


# Camera path in the world, 3-D: path, viewing pyramids, target, goal. Equal scale on all axes.
PYRAMID = np.array(
    [[0, 0, 0], [-0.4, -0.3, 0.7], [0.4, -0.3, 0.7], [0.4, 0.3, 0.7], [-0.4, 0.3, 0.7]]
)
PYRAMID_LINE = [0, 1, 2, 0, 3, 4, 0, 1, 4, 3, 2]
"""Corners of a viewing pyramid of length about 1, and the order that draws all its edges in one
line.
"""


def camera_path(tracks: LogArrays) -> Chart | None:
    """The camera's path in the world, its viewing pyramids, the markers, the goal view; None for a
    vehicle, which has a floor plan.
    """
    if tracks.setting.planar:
        return None
    cameras, targets = _known(tracks.poses("cam")), _known(tracks.poses("tgt"))
    if len(cameras) == 0:
        return None
    view = tracks.setting.T_camera_target
    # for the last pose of the target
    goal = targets[-1] @ inverse(view) if view is not None and len(targets) else None
    shown = [cameras[:, :3, 3], targets[:, :3, 3]] + (
        [goal[None, :3, 3]] if goal is not None else []
    )
    if len(targets) and tracks.setting.points is not None:
        shown.append(transform(targets[-1], tracks.setting.points))
    points = np.concatenate(shown)
    chart = Chart()
    space = Space(chart.panels[0], elev=22, azim=-62)
    # [m] of a pyramid; 1 m where nothing moves and no target is known
    size = 0.13 * float(np.ptp(points, axis=0).max() or 1.0)
    low, high = points.min(axis=0) - size, points.max(axis=0) + size
    span = np.maximum(high - low, 0.3 * (high - low).max())  # a flat scene gets some thickness
    space.box((low + high - span) / 2, (low + high + span) / 2)
    path = cameras[:, :3, 3]
    space.plot(*path.T, color=LINE_COLORS[0], linewidth=1.8, label="camera, to its end")
    # four views evenly over the frames, without start and end
    for k in np.unique(np.linspace(0, len(cameras) - 1, 6).astype(int))[1:-1]:
        space.plot(
            *_pyramid(cameras[k], 0.6 * size), color=LINE_COLORS[0], linewidth=0.7, alpha=0.45
        )
    space.plot(*_pyramid(cameras[0], size), color=INK, linewidth=1.0, label="start")
    space.plot(*_pyramid(cameras[-1], size), color=LINE_COLORS[0], linewidth=1.4)
    if goal is not None:
        space.plot(
            *_pyramid(goal, 1.25 * size),
            color=GOAL,
            linewidth=1.1,
            linestyle=(0, (4, 2)),
            label="goal",
        )
    _draw_target(space, targets, tracks.setting.points, size)
    chart.fit(1.9, 4.2)
    return chart


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
        space.plot(
            *place[:, None],
            color=color,
            fill=color,
            marker="o",
            markersize=5,
            linewidth=0,
            label="markers",
        )


def _pyramid(T: Array, size: float) -> Array:
    """Edges of the viewing pyramid of a camera pose T_world_camera (4, 4) as one line, shape (3,
    11).
    """
    return transform(T, size * PYRAMID)[PYRAMID_LINE].T


# The unit sphere around the camera centre in 3-D: graticule, axes, viewpoint.
#
# Camera axes (x right, y down, z forward) are drawn as (x, z, -y), so that down is down.
FAR = 0.4  # Factor of the opacity of lines on the far side


def drawn(p: Array) -> Array:
    """Camera coordinates (..., 3) as matplotlib's x, y, z, first axis first: shape (3, ...)."""
    p = np.asarray(p, dtype=float)
    return np.stack([p[..., 0], p[..., 2], -p[..., 1]])


def ray_at(theta: ArrayLike, phi: ArrayLike) -> Array:
    """Unit rays (..., 3) at colatitude theta and longitude phi [rad]."""
    a, b = np.broadcast_arrays(np.asarray(theta, float), np.asarray(phi, float))
    return np.stack([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), np.cos(a)], axis=-1)


def towards_viewer(axes: Axes3D | Space) -> Array:
    """Unit vector (3,) in camera coordinates from the centre towards the viewer."""
    elevation, azimuth = np.radians(axes.elev), np.radians(axes.azim)
    return np.array(
        [
            np.cos(elevation) * np.cos(azimuth),
            -np.sin(elevation),
            np.cos(elevation) * np.sin(azimuth),
        ]
    )


def draw_curve(
    axes: Axes3D | Space, p: Array, alpha: float = 1.0, hide_back: bool = False, **look: Any
) -> None:
    """A line through points of the sphere (T, 3); the far side is paler, or hidden."""
    near = np.where((p @ towards_viewer(axes) >= 0)[:, None], p, np.nan)
    if not hide_back:
        axes.plot(*drawn(p), alpha=FAR * alpha, **look)
    axes.plot(*drawn(near), alpha=alpha, **look)


def draw_net(axes: Axes3D | Space, reach: float, step: float, hide_back: bool = False) -> None:
    """Circles of equal theta every `step` [rad] up to `reach`, and meridians every 30 degrees; the
    far side paler or hidden.
    """
    line = np.linspace(0, 2 * np.pi, 121)
    lines = [
        ray_at(theta, line) for theta in np.arange(step, min(reach, np.pi - 1e-6) + 1e-6, step)
    ]
    lines += [ray_at(np.linspace(0, reach, 61), phi) for phi in np.arange(12) * np.pi / 6]
    for p in lines:
        draw_curve(axes, p, hide_back=hide_back, color=RULE, linewidth=0.6)


def draw_axes(axes: Axes3D | Space, length: float, start: float = 0.0) -> None:
    """The optical axis as a dashed line of this length from z = `start`, labelled."""
    tip = np.array([0, 0, start + length])
    axes.plot(
        *drawn(np.stack([[0, 0, start], tip])), color=INK, linewidth=1.3, linestyle=(0, (4, 2))
    )
    _letter(axes, tip * 1.06, "z", INK)


def draw_cross_axes(axes: Axes3D | Space, at: Array, length: float, start: float = 0.0) -> None:
    """Lines of this length along x and y from `start` away from the point `at` (3,), in the axes'
    colours, labelled.
    """
    for direction, name, color in zip(np.eye(3), "xy", AXIS_COLORS, strict=False):
        axes.plot(
            *drawn(at + np.outer([start, start + length], direction)), color=color, linewidth=1.3
        )
        _letter(axes, at + (start + 1.3 * length) * direction, name, color)


def _letter(axes: Any, at: Array, letter: str, color: str) -> None:
    # Any: matplotlib's stubs have only the 2-D signature of text
    axes.text(*drawn(at).tolist(), letter, color=color, ha="center", va="center")


# Marker trajectories in the coordinates of the features `polar` and `spherical`, for runs with
# these features.
#
# Lines and marks are those of the figure in the image.
PI = math.pi
SUFFIXES = ("", "_true", "_goal")
RINGS_DEG = {30: 10, 60: 15, 100: 20, 180: 30}
"""Colatitude up to which the sphere is drawn, the smallest that holds all markers, and the spacing
of its circles [deg].
"""


def polar(tracks: LogArrays) -> Chart | None:
    """Marker trajectories in (phi, r), for a run with the feature `polar`."""
    feature = tracks.setting.feature
    return _plane(tracks, feature, "r [1]") if isinstance(feature, Polar) else None


def spherical(tracks: LogArrays) -> Chart | None:
    """Marker trajectories in (phi, theta), for a run with the feature `spherical`."""
    feature = tracks.setting.feature
    return _plane(tracks, feature, "θ [rad]") if isinstance(feature, Spherical) else None


def _plane(tracks: LogArrays, feature: Polar | Spherical, label: str) -> Chart | None:
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
    # from zero, so that what hardly varies does not fill the height
    panel.labels, panel.lowest = ("φ [rad]", label), 0
    panel.in_words = _in_pi, _in_pi if isinstance(feature, Spherical) else None
    return chart


def coordinates(tracks: LogArrays, feature: Polar | Spherical, suffix: str) -> Array:
    """The feature's coordinates of each marker, phi first, (T, N, 2) [rad, and 1 or rad]; suffix:
    "" (measured), `_true` or `_goal`.
    """
    camera, uv = tracks.setting.camera, tracks.pixels(suffix)
    if camera is None:
        return np.full(uv.shape, np.nan)
    seen = camera.normalise(uv) if isinstance(feature, Polar) else camera.ray(uv)
    return feature.measure(seen).reshape(uv.shape)[..., ::-1]


def turns_joined(measured: Array, true: Array, goal: Array) -> None:
    """Unwrap angles about the axis, each (T, N) [rad], in place: multiples of 2 pi are added so
    that no line jumps.

    The measured trajectory keeps its first angle. The true one is shifted next to it, and the goal
    next to its end.
    """
    # views: they write into the arrays
    for seen, real, target in zip(measured.T, true.T, goal.T, strict=True):
        # the true angle bridges gaps of the measurement, in which the marker may turn by more than
        # half a turn
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
    text = f"{value:.4g}".replace("-", "\N{MINUS SIGN}")
    return (
        text
        if float(value) == 0
        else {"1": "π", "\N{MINUS SIGN}1": "\N{MINUS SIGN}π"}.get(text, f"{text}π")
    )


def on_sphere(tracks: LogArrays) -> Chart | None:
    """Marker trajectories on the unit sphere around the camera, for a run with the feature
    `spherical`.
    """
    camera = tracks.setting.camera
    if camera is None or not isinstance(tracks.setting.feature, Spherical):
        return None
    measured, true, goal = (camera.ray(tracks.pixels(suffix)) for suffix in SUFFIXES)
    shown = np.concatenate([measured, true, goal]).reshape(-1, 3)
    shown = shown[np.isfinite(shown).all(axis=1)]
    if len(shown) == 0:
        return None
    chart = Chart()
    # the part of the sphere that the rays need, seen from ahead and from the side on which they lie
    farthest = math.degrees(math.acos(np.clip(shown[:, 2].min(), -1, 1)))
    reach_deg = next(reach for reach in RINGS_DEG if reach >= farthest or reach == 180)
    reach, side = math.radians(reach_deg), math.sin(math.radians(min(reach_deg, 90)))
    elev, azim = (24, 52) if reach > PI / 2 else (16, 68)
    space = Space(chart.panels[0], elev, azim if shown[:, 0].mean() >= 0 else 180 - azim)
    draw_net(space, reach, math.radians(RINGS_DEG[reach_deg]))
    draw_axes(space, 0.4 * side, start=1.0)
    draw_cross_axes(space, np.array([0, 0, 1.0]), 0.25 * side)
    space.panel.title = f"circles every {RINGS_DEG[reach_deg]} deg from the axis"
    for i, color in enumerate(marker_colors(tracks.markers)):
        draw_curve(space, true[:, i], color=color, **BAND)
        draw_curve(space, measured[:, i], color=color, **LINE)
        for at, look in trail_marks(measured[:, i], goal[:, i], color):
            draw_curve(space, at.T, **look)
    trail_keys(space.panel)
    chart.fit(1.9, 3.6)
    return chart
