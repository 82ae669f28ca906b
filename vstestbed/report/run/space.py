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

SUFFIXES = ("", "_true", "_goal")  # of the columns of measured and true markers, and of their goals
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
    setting = tracks.setting
    chart = Chart()
    measured, true, goal = (tracks.pixels(suffix) for suffix in SUFFIXES)
    if setting.changing:  # a row goes on with another point where its goal is another
        other = np.zeros(goal.shape[:2], dtype=bool)
        other[1:] = (goal[1:] != goal[:-1]).any(axis=2)
        measured[other] = np.nan
        true[other] = np.nan
    _image_plane(chart.panels[0], tracks, (measured, true, goal), (setting.width, setting.height))
    chart.fit(2.1, 5.4)
    return chart


def other_cameras(tracks: LogArrays) -> Chart | None:
    """The same in the pictures of further cameras, one above the other."""
    cameras = tracks.setting.cameras
    if tracks.markers == 0 or not cameras:
        return None
    chart = Chart(4.2 * len(cameras), len(cameras))
    for panel, (name, size) in zip(chart.panels, cameras.items(), strict=True):
        measured, true, goal = (tracks.pixels(suffix, f"{name}_") for suffix in SUFFIXES)
        _image_plane(panel, tracks, (measured, true, goal), size)
        panel.title = name
    if len(cameras) == 1:
        chart.fit(2.1, 5.4)
    return chart


def _image_plane(
    panel: ChartPanel,
    tracks: LogArrays,
    trails: tuple[Array, Array, Array],
    size: tuple[int | None, int | None],
) -> None:
    """Draw trails, measured, true and of the goal, in the picture of a camera of this size (width,
    height) [px], with its border.
    """
    draw = draw_outlines if tracks.setting.outlined else draw_trails
    draw(panel, *trails, tracks.names)
    panel.equal = True
    panel.labels = ("u [px]", "v [px]")
    (x0, x1), (y0, y1) = panel.limits()
    width, height = size
    if not width or not height:
        panel.ylim = y1, y0  # v down, as in the image
        return
    # pixel centres are integers, so that the image begins at -0.5
    right = width - 0.5
    bottom = height - 0.5
    border_u = [-0.5, right, right, -0.5, -0.5]
    border_v = [-0.5, -0.5, bottom, bottom, -0.5]
    panel.plot(border_u, border_v, color=INK, linewidth=1.0, alpha=0.6, zorder=1)
    # markers that leave the image are shown, up to half an image away
    margin = 0.015 * width
    left = min(-0.5, max(x0, -0.5 * width)) - margin
    right = max(right, min(x1, 1.5 * width)) + margin
    top = min(-0.5, max(y0, -0.5 * height)) - margin
    bottom = max(bottom, min(y1, 1.5 * height)) + margin
    panel.xlim = left, right
    panel.ylim = bottom, top


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
            x, y = at[:, 0].tolist()
            panel.words.append(Words(x, y, name, color=color))
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
    return [
        (_edge(measured, 0), {"color": color, "fill": color} | START),
        (_edge(measured, -1), {"color": color} | END),
        (_edge(goal, -1), {"color": color} | AIM),
    ]


def trail_keys(panel: ChartPanel) -> None:
    """Legend entries for the marks and lines of `draw_trails`."""
    marks = trail_marks(np.empty((0, 2)), np.empty((0, 2)), INK)
    looks = [*(look for _, look in marks), LINE, BAND]
    for look, label in zip(looks, ("start", "end", "goal", "measured", "true"), strict=True):
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
    setting = tracks.setting
    places = tracks.planar_poses("base")
    places = places[np.isfinite(places).all(axis=1)]
    if not setting.planar or not len(places):
        return None
    landmarks = _landmarks(tracks)
    target = _known(tracks.poses("tgt"))[:, :2, 3]
    if not _moves(target, 1e-3):
        target = target[:0]
    shown = np.concatenate(
        [places[:, :2], setting.goals[:, :2], landmarks[:, :2], setting.reference_path, target]
    )
    low = shown.min(axis=0)
    high = shown.max(axis=0)
    # [m]; a vehicle that hardly moves is not magnified further
    span = float(max((high - low).max(), 0.5))
    chart = Chart()
    (panel,) = chart.panels
    _draw_views(panel, tracks, float(landmarks[:, 2].mean()) if len(landmarks) else 0.0, span)
    if len(setting.reference_path):
        route: Look = {"linewidth": 0.9, "linestyle": ":", "label": "route"}
        panel.plot(*setting.reference_path.T, color=INK, **route)
    if len(target):
        panel.plot(*target.T, color=GOAL, linewidth=1.2, label="target")
    for goal in setting.goals[:-1]:
        _dart(panel, goal, 0.045 * span, "goals on the way", GOAL, filled=False)
    for goal in setting.goals[-1:]:
        _dart(panel, goal, 0.075 * span, "goal", GOAL, filled=False)
    _draw_paths(panel, tracks, places, span)
    for place, color in zip(landmarks[:, :2], marker_colors(len(landmarks)), strict=True):
        disc = _disc(color) | {"markersize": 5.8, "label": "landmarks", "zorder": 4}
        panel.plot(*place[:, None], **disc)
    panel.equal = True
    panel.labels = ("x [m]", "y [m]")
    panel.xlim, panel.ylim = zip(low - 0.09 * span, high + 0.09 * span, strict=True)
    chart.fit(1.9, 5.0)
    return chart


def _landmarks(tracks: LogArrays) -> Array:
    """The markers (N, 3) [m] where the target was last; none where that is unknown."""
    targets = _known(tracks.poses("tgt"))
    points = tracks.setting.points
    if points is None or not len(targets):
        return np.empty((0, 3))
    return transform(targets[-1], points)


def _moves(path: Array, least: float) -> bool:
    """Whether the points (T, k) of a path differ by more than rounding, which is `least` [m]."""
    return len(path) > 0 and bool(np.ptp(path, axis=0).max() > least)


def _disc(color: str) -> Look:
    """The look of a marker of the target."""
    return {"color": color, "fill": color, "marker": "o", "linewidth": 0}


def _known(poses: Array) -> Array:
    """The poses (T, 4, 4) that are known."""
    return poses[np.isfinite(poses).all(axis=(1, 2))]


def _draw_views(panel: ChartPanel, tracks: LogArrays, height: float, span: float) -> None:
    """The region in the image at the start and at the end, in the plane at a height [m], that of
    the landmarks.
    """
    from contourpy import contour_generator  # here: of vehicles alone

    cameras = _known(tracks.poses("cam"))
    if not len(cameras):
        return
    camera = tracks.setting.camera
    assert camera is not None  # a vehicle's setting has it
    for T, color in ((cameras[0], INK), (cameras[-1], TRUE)):
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
        if seen.min() < 1:  # else all within reach is visible, which has no outline
            for line in generator.lines(0.5):
                panel.plot(*line.T, color=color, alpha=0.35, linewidth=0.7, zorder=1)


def _draw_paths(panel: ChartPanel, tracks: LogArrays, true: Array, span: float) -> None:
    """The true path (T, 3) as a pale band with headings, the other paths over it; the vehicle at
    start and end.
    """
    for stem, label, color in reversed(ESTIMATES):
        path = tracks.planar_poses(stem)
        if np.isfinite(path).any():
            panel.plot(path[:, 0], path[:, 1], color=color, linewidth=0.9, label=label, zorder=3)
    way: Look = {"linewidth": 4.0, "alpha": 0.35, "label": "true way", "zorder": 2.5}
    panel.plot(*tracks.planar_poses("base")[:, :2].T, color=TRUE, **way)
    expected = tracks.setting.expected_path
    if expected is not None and len(expected) > 1:
        off = " ".join(with_unit(largest_deviation(true[:, :2], expected), "m"))
        ideal: Look = {"linewidth": 1.0, "linestyle": (0, (5, 2)), "zorder": 3}
        panel.plot(*expected.T, color=INK, label=f"ideal bicycle: at most {off} off", **ideal)
    # headings evenly along the way, without its ends: every 0.09 of the figure's extent, at most 30
    steps = np.linalg.norm(np.diff(true[:, :2], axis=0), axis=1)
    along = np.cumsum([0.0, *steps])
    count = min(int(along[-1] / (0.09 * span)), 30)
    evenly = np.linspace(0, along[-1], count + 2)[1:-1]
    for place in true[np.unique(np.searchsorted(along, evenly))]:
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
    c = np.cos(place[2])
    s = np.sin(place[2])
    x, y = (size * DART[[0, 1, 2, 3, 0]] @ np.array([[c, s], [-s, c]]) + place[:2]).T
    look: Look = {"color": color, "fill": color if filled else "none"}
    panel.plot(x, y, linewidth=0.5 if filled else 1.3, zorder=5, **look)
    if label:
        panel.plot([], [], label=label, marker=">", markersize=7, **look)


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
    cameras = _known(tracks.poses("cam"))
    targets = _known(tracks.poses("tgt"))
    if len(cameras) == 0:
        return None
    view = tracks.setting.T_camera_target
    path = cameras[:, :3, 3]
    goal = None
    shown = [path, targets[:, :3, 3], _landmarks(tracks)]
    if view is not None and len(targets):
        goal = targets[-1] @ inverse(view)  # for the last pose of the target
        shown.append(goal[None, :3, 3])
    points = np.concatenate(shown)
    chart = Chart()
    space = Space(chart.panels[0], elev=22, azim=-62)
    # [m] of a pyramid; 1 m where nothing moves and no target is known
    size = 0.13 * float(np.ptp(points, axis=0).max() or 1.0)
    low = points.min(axis=0) - size
    high = points.max(axis=0) + size
    span = np.maximum(high - low, 0.3 * (high - low).max())  # a flat scene gets some thickness
    space.box((low + high - span) / 2, (low + high + span) / 2)
    blue: Look = {"color": LINE_COLORS[0]}
    space.plot(*path.T, linewidth=1.8, label="camera, to its end", **blue)
    # four views evenly over the frames, without start and end
    for k in np.unique(np.linspace(0, len(cameras) - 1, 6).astype(int))[1:-1]:
        space.plot(*_pyramid(cameras[k], 0.6 * size), linewidth=0.7, alpha=0.45, **blue)
    space.plot(*_pyramid(cameras[0], size), color=INK, linewidth=1.0, label="start")
    space.plot(*_pyramid(cameras[-1], size), linewidth=1.4, **blue)
    if goal is not None:
        dashed: Look = {"linewidth": 1.1, "linestyle": (0, (4, 2)), "label": "goal"}
        space.plot(*_pyramid(goal, 1.25 * size), color=GOAL, **dashed)
    _draw_target(space, targets, _landmarks(tracks), size)
    chart.fit(1.9, 4.2)
    return chart


def _draw_target(space: Space, targets: Array, markers: Array, size: float) -> None:
    """Path of a moving target, and at its last pose its axes and its markers (N, 3)."""
    if len(targets) == 0:
        return
    path = targets[:, :3, 3]
    if _moves(path, 1e-6):
        space.plot(*path.T, color=INK, linewidth=1.0, linestyle=":", label="target")
    T = targets[-1]
    for axis, color in enumerate(AXIS_COLORS):
        tip = T[:3, 3] + 0.7 * size * T[:3, axis]
        space.plot(*np.stack([T[:3, 3], tip]).T, color=color, linewidth=1.2)
    for place, color in zip(markers, marker_colors(len(markers)), strict=True):
        space.plot(*place[:, None], **_disc(color), markersize=5, label="markers")


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
    elevation, azimuth = np.radians([axes.elev, axes.azim])
    level = np.cos(elevation)
    return np.array([level * np.cos(azimuth), -np.sin(elevation), level * np.sin(azimuth)])


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
    colatitudes = np.arange(step, min(reach, np.pi - 1e-6) + 1e-6, step)
    lines = [ray_at(theta, line) for theta in colatitudes]
    lines += [ray_at(np.linspace(0, reach, 61), phi) for phi in np.arange(12) * np.pi / 6]
    for p in lines:
        draw_curve(axes, p, hide_back=hide_back, color=RULE, linewidth=0.6)


def draw_axes(axes: Axes3D | Space, length: float, start: float = 0.0) -> None:
    """The optical axis as a dashed line of this length from z = `start`, labelled."""
    tip = np.array([0, 0, start + length])
    line = drawn(np.stack([[0, 0, start], tip]))
    axes.plot(*line, color=INK, linewidth=1.3, linestyle=(0, (4, 2)))
    _letter(axes, tip * 1.06, "z", INK)


def draw_cross_axes(axes: Axes3D | Space, at: Array, length: float, start: float = 0.0) -> None:
    """Lines of this length along x and y from `start` away from the point `at` (3,), in the axes'
    colours, labelled.
    """
    for direction, name, color in zip(np.eye(3), "xy", AXIS_COLORS, strict=False):
        line = drawn(at + np.outer([start, start + length], direction))
        axes.plot(*line, color=color, linewidth=1.3)
        _letter(axes, at + (start + 1.3 * length) * direction, name, color)


def _letter(axes: Any, at: Array, letter: str, color: str) -> None:
    # Any: matplotlib's stubs have only the 2-D signature of text
    axes.text(*drawn(at).tolist(), letter, color=color, ha="center", va="center")


# Marker trajectories in the coordinates of the features `polar` and `spherical`, for runs with
# these features.
#
# Lines and marks are those of the figure in the image.
PI = math.pi
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
    panel.labels = ("φ [rad]", label)
    panel.lowest = 0
    panel.in_words = (_in_pi, _in_pi if isinstance(feature, Spherical) else None)
    return chart


def coordinates(tracks: LogArrays, feature: Polar | Spherical, suffix: str) -> Array:
    """The feature's coordinates of each marker, phi first, (T, N, 2) [rad, and 1 or rad]; suffix:
    "" (measured), `_true` or `_goal`.
    """
    camera = tracks.setting.camera
    uv = tracks.pixels(suffix)
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
    phi = phi.copy()
    known = np.isfinite(phi)
    phi[known] = np.unwrap(phi[known])
    return phi


def _whole_turns(difference: Array) -> float:
    """The multiple of 2 pi nearest to the median of differences (T,) [rad]; 0 if none is known."""
    known = difference[np.isfinite(difference)]
    return float(2 * PI * np.round(np.median(known) / (2 * PI))) if len(known) else 0.0


def _in_pi(value: float) -> str:
    text = f"{value:.4g}".replace("-", "\N{MINUS SIGN}")
    if value == 0:
        return text
    return text.removesuffix("1") + "π" if text in ("1", "\N{MINUS SIGN}1") else f"{text}π"


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
    space = _sphere(chart.panels[0], shown)
    for i, color in enumerate(marker_colors(tracks.markers)):
        draw_curve(space, true[:, i], color=color, **BAND)
        draw_curve(space, measured[:, i], color=color, **LINE)
        for at, look in trail_marks(measured[:, i], goal[:, i], color):
            draw_curve(space, at.T, **look)
    trail_keys(space.panel)
    chart.fit(1.9, 3.6)
    return chart


def _sphere(panel: ChartPanel, rays: Array) -> Space:
    """The part of the unit sphere that rays (N, 3) need, with its axes, seen from ahead and from
    the side on which they lie.
    """
    farthest = math.degrees(math.acos(np.clip(rays[:, 2].min(), -1, 1)))
    reach_deg = next(reach for reach in RINGS_DEG if reach >= farthest or reach == 180)
    reach = math.radians(reach_deg)
    side = math.sin(math.radians(min(reach_deg, 90)))
    elev, azim = (24, 52) if reach_deg > 90 else (16, 68)
    space = Space(panel, elev, azim if rays[:, 0].mean() >= 0 else 180 - azim)
    draw_net(space, reach, math.radians(RINGS_DEG[reach_deg]))
    draw_axes(space, 0.4 * side, start=1.0)
    draw_cross_axes(space, np.array([0, 0, 1.0]), 0.25 * side)
    panel.title = f"circles every {RINGS_DEG[reach_deg]} deg from the axis"
    return space
