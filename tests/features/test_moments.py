"""Moments: the region whichever way round, every row's derivative, the two ends of an axis, and
goals at which rows are singular.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.features.test_derivatives import differences, in_a_plane, moved, seen, worst
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose, exp, inverse, transform
from vstestbed.features import Moments
from vstestbed.features.moments import INVARIANTS, fitted_plane, image_moments
from vstestbed.targets.regions import LShape, Whale

ELBOW = np.array([[0, 0], [0.3, 0], [0.3, 0.12], [0.12, 0.12], [0.12, 0.4], [0, 0.4]]) - [0.1, 0.15]
OBLONG = np.array([[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]])
ARROW = np.array(
    [[0, 0.1], [0.25, 0.1], [0.25, 0], [0.45, 0.15], [0.25, 0.3], [0.25, 0.2], [0, 0.2]]
) - [0.2, 0.15]
OVAL = 0.2 * np.column_stack(
    [np.cos(np.arange(32) * np.pi / 16), 0.5 * np.sin(np.arange(32) * np.pi / 16)]
)
SQUARE = 0.2 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]])
WHALE, ELL = Whale(length=0.625).outline(32), LShape(length=0.625).outline(32)
ROWS = ("xn", "yn", "an", "xg", "yg", "area", "alpha")
FACING = Pose(xyz=(0, 0, 1)).T


def view(shape: np.ndarray, T_camera_target: np.ndarray = FACING) -> tuple[np.ndarray, np.ndarray]:
    """The markers xy (..., N, 2) and depth (..., N) of a flat shape (N, 2)."""
    return seen(
        transform(T_camera_target, np.column_stack([shape, np.zeros(len(shape))])), ("xy", "depth")
    )


def rolled(angle: float, T: np.ndarray = FACING) -> np.ndarray:
    """The view from a camera that has turned about its optical axis."""
    return inverse(exp(angle * np.eye(6)[5])) @ T


@pytest.mark.parametrize("of", ["points", "region"])
@pytest.mark.parametrize(
    "rows", [ROWS, *((name,) for name in INVARIANTS)], ids=lambda rows: rows[-1]
)
def test_every_row_is_the_derivative(of, rows):
    # Row by row where one may be large; invariants may have poles, near which a step of 1e-6 is not
    # small: 40 views far from these.
    feature, p = Moments(of=of, rows=rows), in_a_plane(np.random.default_rng(2))
    xy, depth = seen(p, feature.inputs)
    L = feature.interaction(xy, depth)
    calm = np.argsort(np.abs(L).max(axis=(-2, -1)))[:40]
    T = moved(np.broadcast_to(np.eye(4), (40, 4, 4)))
    after = seen(transform(T, p[calm]), feature.inputs)[0]
    assert (
        worst(
            differences(feature.measure(after), feature.measure(xy[calm]), feature.error), L[calm]
        )
        < 1e-6
    )


def test_a_region_is_the_same_from_any_corner_and_either_way_round():
    feature, (xy, depth) = (
        Moments(of="region"),
        view(ELBOW, Pose(xyz=(0.1, 0.2, 1), rpy_deg=(20, -15, 70)).T),
    )
    for order in (np.arange(6)[::-1], np.roll(np.arange(6), 2)):
        np.testing.assert_allclose(feature.measure(xy[order]), feature.measure(xy), rtol=1e-11)
        np.testing.assert_allclose(
            feature.interaction(xy[order], depth[order]),
            feature.interaction(xy, depth),
            rtol=1e-9,
            atol=1e-11,
        )
    # A corner on an edge between others adds nothing: the region is what is within, however many
    # markers its outline has.
    more = np.insert(ELBOW, 1, [0.05, -0.15], axis=0)
    np.testing.assert_allclose(
        feature.measure(view(more)[0]), feature.measure(view(ELBOW)[0]), rtol=1e-11
    )


def test_moments_of_a_rectangle_and_of_its_corners():
    m, corners = image_moments(OBLONG, "region", 4), image_moments(OBLONG, "points", 2)
    # of a width of .4, height .2: a, a w^2/12, a w^4/80
    expected = [0.08, 0, 0.08 * 0.04 / 3, 0, 0.08 * 0.0016 / 5]
    np.testing.assert_allclose(m[:, 0], expected, atol=1e-17)
    assert (
        m[2, 2] == pytest.approx(0.08 * 0.04 / 3 * 0.01 / 3)
        and corners[0, 0] == 4
        and corners[2, 0] == pytest.approx(0.16)
    )


def test_the_plane_of_points_on_a_line_has_no_tilt_about_it():
    np.testing.assert_allclose(
        fitted_plane(*view(ELBOW, Pose(xyz=(0, 0, 2), rpy_deg=(30, 0, 0)).T))[1],
        -np.tan(np.pi / 6) / 2,
        rtol=1e-12,
    )
    A, B, C = fitted_plane(np.array([[-0.1, 0], [0.1, 0], [0.3, 0]]), 1 / np.array([0.9, 1.1, 1.3]))
    np.testing.assert_allclose([A, B, C], [1, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ("shape", "most_deg"), [(ELBOW, 180), (OBLONG, 90)], ids=["elbow", "oblong"]
)
def test_third_moments_tell_the_ends_of_an_axis_apart(shape, most_deg):
    feature, goal = (
        Moments(of="region", rows=("alpha",)),
        Moments(of="region", rows=("alpha",)).measure(view(shape)[0]),
    )
    for angle in np.deg2rad([-170, -100, -80, 0.1, 60, 95, 179]):
        e = feature.error(feature.measure(view(shape, rolled(angle))[0]), goal)[0]
        # What the camera turns by, the picture turns back by: without ends, up to half a turn more
        # or less.
        over = np.round(angle / np.pi) * np.pi if most_deg == 90 else 0.0
        assert e == pytest.approx(over - angle, abs=1e-9)


def test_the_factor_of_a_facing_target_does_not_depend_on_its_distance():
    one, two = (
        Moments(of="region").interaction(*view(ELBOW, Pose(xyz=(0.2, -0.1, z)).T))[:3, :3]
        for z in (0.8, 2.4)
    )
    np.testing.assert_allclose(one, two, atol=1e-12)
    np.testing.assert_allclose(one, -one[0, 0] * np.diag([-1, -1, -1]), atol=1e-12)


def test_goals_at_which_rows_are_singular():
    for shape, rows, words in (
        (SQUARE, ("xn", "alpha"), "may not have alpha: the target is as wide as long"),
        (
            OBLONG,
            ("xn", "px", "py"),
            "may not have py: the target is symmetric about its centre in the goal view, where",
        ),
        (OBLONG, ("xn", "c4", "c6"), "may not have c4, c6: the target is symmetric"),
        (OBLONG, ("xn", "c9"), "may not have c9: the target is symmetric"),
        (
            ARROW,
            ("xn", "yn", "an", "px", "py", "alpha"),
            "where L has no inverse; use c4 and c7 in place of px and py, which have",
        ),
        (
            WHALE,
            Moments().rows,
            (
                "the condition 1.3e.03 .at most 500 is accepted.;"
                " use c4 and c7 in place of sx and sy, which have"
            ),
        ),
        (
            ELL,
            ("xn", "yn", "an", "c4", "c6", "alpha"),
            "the condition 1.6e.03 .*; use sx and py in place of c4 and c6, which have",
        ),
        (OVAL, ("xn", "xg", "an"), "may be an ellipse"),
        (
            np.array([[-0.1, -0.1], [0.1, 0.1], [0.1, -0.1], [-0.1, 0.1]]),
            ("xn",),
            "encloses no area",
        ),
        (OVAL, Moments().rows, "may be an ellipse; use fewer rows, feature ellipse"),
    ):
        with pytest.raises(ParameterError, match=words):
            Moments(of="region", rows=rows).check_goal(*view(shape))


def test_what_suits_is_accepted():
    for shape in (OBLONG, ELL):
        Moments(of="region").check_goal(*view(shape))
    for pair in (("c4", "c6"), ("c4", "c7")):
        Moments(of="region", rows=("xn", "yn", "an", *pair, "alpha")).check_goal(*view(WHALE))
    for pair in (("sx", "sy"), ("px", "py"), ("c1", "c2"), ("c4", "c6"), ("sx", "sy", "px", "py")):
        Moments(of="region", rows=("xn", "yn", "an", *pair, "alpha")).check_goal(*view(ELBOW))
    with pytest.raises(ParameterError, match="in one plane for the feature moments"):
        Moments().check_goal(
            *seen(
                np.array([[0.0, 0, 1], [0.3, 0, 1], [0, 0.2, 1], [0.2, 0.3, 1.1], [0.1, 0.1, 0.9]]),
                ("xy", "depth"),
            )
        )
    with pytest.raises(ParameterError, match="has xn twice"):
        Moments(rows=("xn", "an", "xn"))


def test_rates_stay_finite_where_rows_are_undefined():
    for shape in (
        0.2 * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]),
        np.zeros((4, 2)),
        np.array([[0.0, 0], [0.1, 0], [0.2, 0], [0.3, 0]]),
    ):
        assert np.isfinite(Moments(of="region", rows=("alpha",)).interaction(*view(shape))).all()
