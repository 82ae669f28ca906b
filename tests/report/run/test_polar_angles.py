"""The figures in the coordinates of `polar` and `spherical`: what is drawn is what was put into the
log.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import polars as pl
import pytest

from vstestbed.camera import Camera, Perspective, SphericalCamera
from vstestbed.core.geometry import Array, direction
from vstestbed.features import Feature, Point, Polar, Spherical
from vstestbed.report import Setting, render_page
from vstestbed.report.chart import Chart, Space
from vstestbed.report.marks import marker_colors
from vstestbed.report.run import space as angles
from vstestbed.report.run.space import drawn, towards_viewer
from vstestbed.report.run.tracks import LogArrays

PI = np.pi
FRAMES, MARKERS = 120, 3
LINES_PER_MARKER = 5  # true, measured, start, end, goal


def way(turns: float = 1.7, theta: tuple[float, float] = (0.2, 0.6)) -> Array:
    """Angles (theta, phi) of markers that turn about the axis while they leave it, shape (T, N, 2)
    [rad].
    """
    s = np.linspace(0, 1, FRAMES)[:, None]
    phi = 2 * PI * turns * s + 2 * PI * np.arange(MARKERS) / MARKERS
    return np.stack([theta[0] + (theta[1] - theta[0]) * s + 0 * phi, phi], axis=-1)


def tracks(
    camera: Camera,
    feature: Feature | None,
    angle: Array,
    lost: slice = slice(0, 0),
    offset: float = 0.0,
) -> LogArrays:
    """A run's tracks: measured like `angle`, true the same with phi more by `offset` [rad], the
    goal its end.
    """
    measured = camera.project(direction(angle))
    measured[lost] = np.nan
    true = camera.project(direction(angle + [0, offset]))
    goal = np.broadcast_to(camera.project(direction(angle[-1])), true.shape)
    columns = {"t": np.arange(len(angle)) / 25}
    for suffix, uv in (("", measured), ("_true", true), ("_goal", goal)):
        columns |= {
            f"{a}{suffix}_{i}": uv[:, i, k]
            for i in range(angle.shape[1])
            for k, a in enumerate("uv")
        }
    return LogArrays.of(pl.DataFrame(columns), Setting(feature=feature, camera=camera))


def lines(figure: Chart, marker: int) -> list[Array]:
    """What is drawn of one marker in the plane: true, measured, start, end, goal, each (T, 2), phi
    first in units of pi.
    """
    first = LINES_PER_MARKER * marker
    return [
        np.stack([curve.x, curve.y], axis=1)
        for curve in figure.panels[0].curves[first : first + LINES_PER_MARKER]
    ]


def whole_turns(phi: Array) -> None:
    """All angles (...) [rad] are one and the same multiple of a turn."""
    np.testing.assert_allclose(phi, 2 * PI * np.round(phi.mean() / (2 * PI)), atol=1e-6)


LENS = Perspective(width=640, height=480, fovy_deg=64)
SKY = SphericalCamera(width=640, height=640)


def test_polar_ways_are_angle_and_radius() -> None:
    angle = way()
    figure = angles.polar(tracks(LENS, Polar(), angle))
    for i in range(MARKERS):
        for k in (0, 1):
            drawn_way = lines(figure, i)[k]
            whole_turns(drawn_way[:, 0] * PI - angle[:, i, 1])
            np.testing.assert_allclose(drawn_way[:, 1], np.tan(angle[:, i, 0]), atol=1e-9)


@pytest.mark.parametrize("camera", [LENS, SKY])
def test_spherical_ways_are_both_angles(camera: Camera) -> None:
    angle = way(theta=(0.2, 0.6) if camera is LENS else (2.9, 0.3))
    figure = angles.spherical(tracks(camera, Spherical(), angle))
    for i in range(MARKERS):
        for k in (0, 1):
            drawn_way = lines(figure, i)[k]
            whole_turns(drawn_way[:, 0] * PI - angle[:, i, 1])
            np.testing.assert_allclose(drawn_way[:, 1] * PI, angle[:, i, 0], atol=1e-9)


def test_start_end_and_goal_lie_on_the_way() -> None:
    angle = way(turns=-2.3)
    figure = angles.polar(tracks(LENS, Polar(), angle))
    for i in range(MARKERS):
        _, measured, start, end, goal = lines(figure, i)
        np.testing.assert_array_equal(start, measured[:1])
        np.testing.assert_array_equal(end, measured[-1:])
        np.testing.assert_allclose(goal, end, atol=1e-9)  # with all the turns of the way
        assert -1 < start[0, 0] <= 1


@pytest.mark.parametrize("offset", [0.0, 0.3, -0.3])
def test_no_line_jumps_and_the_true_way_runs_beside_the_measured_one(offset: float) -> None:
    angle = way(turns=3)
    # starts where atan2 jumps
    angle[..., 1] += PI + np.random.default_rng(0).normal(0, 0.02, angle.shape[:2])
    figure = angles.polar(tracks(LENS, Polar(), angle, slice(20, 70), offset))
    for i in range(MARKERS):
        true, measured, *_ = lines(figure, i)
        assert np.isnan(measured[20:70]).all()
        for line in (true, measured):
            assert np.nanmax(np.abs(np.diff(line[:, 0]))) <= 1
        np.testing.assert_allclose(
            (true - measured)[[*range(20), *range(70, FRAMES)], 0] * PI, offset, atol=1e-6
        )


@pytest.mark.parametrize(
    ("camera", "theta"), [(LENS, (0.1, 0.5)), (SKY, (3.0, 0.3)), (SKY, (0.3, 1.2))]
)
def test_ways_on_the_sphere_are_unit_rays(
    camera: Camera, theta: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    angle = way(theta=theta)
    drawn_ways: list[tuple[Space, str, Array]] = []
    monkeypatch.setattr(
        Space,
        "plot",
        lambda space, *xyz, **look: drawn_ways.append(
            (space, look.get("color", ""), np.array(xyz))
        ),
    )
    assert angles.on_sphere(tracks(camera, Spherical(), angle)) is not None
    viewer = drawn(towards_viewer(drawn_ways[0][0]))
    for i, color in enumerate(marker_colors(MARKERS)):
        ways = [p for _, of, p in drawn_ways if of == color]
        assert len(ways) == 2 * LINES_PER_MARKER  # each pale and whole, and its near part over it
        np.testing.assert_allclose(ways[2], drawn(direction(angle[:, i])), atol=1e-9)
        for whole, near in zip(ways[::2], ways[1::2], strict=True):
            np.testing.assert_allclose(np.linalg.norm(whole, axis=0), 1, atol=1e-9)
            np.testing.assert_array_equal(np.isfinite(near[0]), viewer @ whole >= 0)


def test_only_runs_of_these_features_have_them() -> None:
    figures: list[Callable[[LogArrays], object]] = [
        angles.polar,
        angles.spherical,
        angles.on_sphere,
    ]
    for feature, has in (
        (None, [False, False, False]),
        (Point(), [False, False, False]),
        (Polar(), [True, False, False]),
        (Spherical(), [False, True, True]),
    ):
        run = tracks(LENS, feature, way())
        assert [draw(run) is not None for draw in figures] == has
        page = render_page(run.log, {}, {}, {}, run.setting)
        titles = (
            "Features in polar coordinates",
            "Features in spherical coordinates",
            "Features on the sphere",
        )
        assert [f'aria-label="{title}"' in page for title in titles] == has


@pytest.mark.filterwarnings("error")
def test_markers_that_are_never_seen_have_no_figure() -> None:
    nothing = np.full((5, MARKERS, 2), np.nan)
    for feature in (Polar(), Spherical()):
        run = tracks(SKY, feature, nothing)
        assert [draw(run) for draw in (angles.polar, angles.spherical, angles.on_sphere)] == [
            None,
            None,
            None,
        ]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("frames", [1, 2])
def test_short_runs(frames: int) -> None:
    angle = way()[:frames]
    assert angles.polar(tracks(LENS, Polar(), angle)) is not None
    assert angles.on_sphere(tracks(LENS, Spherical(), angle)) is not None


def test_marker_on_the_axis_only() -> None:
    figure = angles.polar(tracks(LENS, Polar(), np.zeros((4, 1, 2))))
    assert figure is not None
    low, high = figure.panels[0].limits()[1]
    assert low == 0 < high
