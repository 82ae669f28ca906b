"""Routes on the floor: length, ends, curvature against closed form; the nearest point, also where a
route crosses itself.
"""

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.planar import GroundPose
from vstestbed.targets.route import CircularRoute, FigureEight, Piece, Straight, Track

OVAL = Track(
    pieces=(
        Piece(length_m=4),
        Piece(turn_deg=180, radius_m=2),
        Piece(length_m=4),
        Piece(turn_deg=180, radius_m=2),
    )
)
ALL = [
    Straight(length_m=7),
    CircularRoute(radius_m=-2.5),
    FigureEight(length_m=12, width_m=5),
    OVAL,
    Track(pieces=(Piece(turn_deg=-90, radius_m=1.5),)),
]


@pytest.mark.parametrize("route", ALL, ids=lambda r: r.kind)
class TestEvery:
    def test_arc_length_is_the_distance_travelled(self, route):
        s = np.linspace(0, route.length, 4001)
        x, y, *_ = route.at(s).T
        # Chords of 1 to 10 mm on bends of 1.5 m or more: shorter than their arcs by under 1e-5.
        assert np.hypot(np.diff(x), np.diff(y)).sum() == pytest.approx(route.length, rel=1e-4)

    def test_heading_is_the_way_and_curvature_its_change(self, route):
        s, d = np.linspace(0.3, route.length - 0.3, 500), 1e-3
        before, here, after = route.at(s - d), route.at(s), route.at(s + d)
        along = np.arctan2(after[:, 1] - before[:, 1], after[:, 0] - before[:, 0])
        # samples of 1 cm, bends of 1.4 m
        np.testing.assert_allclose(np.angle(np.exp(1j * (along - here[:, 2]))), 0, atol=4e-3)
        bend = (after[:, 2] - before[:, 2]) / (2 * d)
        near_joint = np.abs(bend - here[:, 3]) > 0.02
        assert near_joint.mean() < 0.03  # only where straight and bend meet

    def test_it_starts_where_it_is_told_to(self, route):
        moved = type(route)(
            **{
                f: getattr(route, f)
                for f in ("radius_m", "length_m", "width_m", "pieces")
                if hasattr(route, f)
            },
            start=GroundPose(x=3, y=-1, heading_deg=90),
        )
        np.testing.assert_allclose(moved.at(0.0)[:3], [3, -1, np.pi / 2], atol=1e-9)
        local = route.at(1.0)
        np.testing.assert_allclose(moved.at(1.0)[:2], [3 - local[1], -1 + local[0]], atol=1e-9)

    def test_the_nearest_point_of_a_point_beside_it(self, route):
        for s in np.linspace(0.5, route.length - 0.5, 23):
            x, y, heading, _ = route.at(s)
            for aside in (-0.2, 0.1):
                xy = np.array([x - aside * np.sin(heading), y + aside * np.cos(heading)])
                found, offset = route.nearest(xy, around=s + 0.3)
                assert found == pytest.approx(s, abs=2e-3)
                assert offset == pytest.approx(aside, abs=1e-4)


def test_what_is_closed():
    assert [r.closed for r in ALL] == [False, True, True, True, False]
    np.testing.assert_allclose(OVAL.at(OVAL.length + 1.0)[:2], OVAL.at(1.0)[:2], atol=1e-9)
    # the heading runs on
    assert OVAL.at(OVAL.length + 1.0)[2] == pytest.approx(OVAL.at(1.0)[2] + 2 * np.pi)


def test_an_open_route_goes_straight_on():
    quarter = ALL[-1]
    end = quarter.at(quarter.length)
    np.testing.assert_allclose(
        quarter.at(quarter.length + 2.0)[:3],
        [end[0] + 2 * np.cos(end[2]), end[1] + 2 * np.sin(end[2]), end[2]],
    )
    np.testing.assert_allclose(quarter.at(-1.0)[:3], [-1, 0, 0], atol=1e-12)
    assert quarter.nearest(np.array([-0.7, 0.4]), around=0.0)[1] == pytest.approx(0.4)


def test_a_circle_is_a_circle():
    xy = CircularRoute(radius_m=-2.5).at(np.linspace(0, 15, 100))[:, :2]
    # chords of 1 cm: 1e-2^2 / 8 / 2.5
    np.testing.assert_allclose(np.hypot(xy[:, 0], xy[:, 1] + 2.5), 2.5, atol=1e-5)


def test_the_figure_of_eight_has_its_size_and_its_bends():
    eight = FigureEight(length_m=12, width_m=5)
    p = np.linspace(0, 2 * np.pi, 100001)  # its equations, and their curvature
    dx, dy, ddx, ddy = 6 * np.cos(p), 5 * np.cos(2 * p), -6 * np.sin(p), -10 * np.sin(2 * p)
    curvature = np.abs(dx * ddy - dy * ddx) / np.hypot(dx, dy) ** 3
    assert eight.least_radius_m == pytest.approx(1 / curvature.max(), rel=1e-3)
    assert eight.length == pytest.approx(np.trapezoid(np.hypot(dx, dy), p), rel=1e-6)
    assert abs(np.ptp(eight.samples[2][[0, -1]])) < 1e-6  # as much to the left as to the right
    assert Straight().least_radius_m == np.inf


def test_at_a_crossing_the_branch_is_the_one_asked_about():
    eight = FigureEight(length_m=12, width_m=5)
    beside = np.array([0.05, 0.1])
    first, second = (
        eight.nearest(beside, around=0.0),
        eight.nearest(beside, around=eight.length / 2),
    )
    assert abs(first[0]) < 0.3 and abs(second[0] - eight.length / 2) < 0.3


@pytest.mark.parametrize(
    "wrong", [{}, {"length_m": 1.0, "turn_deg": 90, "radius_m": 1.0}, {"turn_deg": 90}]
)
def test_a_piece_is_straight_or_a_bend(wrong):
    with pytest.raises(ParameterError, match="either length_m"):
        Piece(**wrong)


def test_a_circle_needs_a_radius():
    with pytest.raises(ParameterError, match=r"radius_m must be at least 0\.1 m"):
        CircularRoute(radius_m=0.01)
