"""The golden file's matrices: an independent library's, 20 cases a feature."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from vstestbed.core.geometry import exp
from vstestbed.features import Ellipse, LineFeature, Moments, Polar, Polygon, Segment, ThetaU
from vstestbed.features.line import line_interaction
from vstestbed.features.moments import INVARIANTS, MomentSet, ellipse_moments, image_moments
from vstestbed.features.pose import log_depth_interaction, theta_u, translation_interaction

GOLDEN = json.loads(
    (Path(__file__).parents[1] / "golden" / "interaction_matrices.json").read_text()
)


def columns(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inputs (20, k), s (20, m) and L (20, m, 6) of one feature, all cases as one batch."""
    cases = GOLDEN[name]["cases"]
    assert len(cases) == 20
    return tuple(np.array([case[key] for case in cases]) for key in ("in", "s", "L"))


def agree(ours: np.ndarray, golden: np.ndarray) -> None:
    """The golden file's own tolerance, |difference| <= 1e-10 (1 + |L|), 15 digits printed."""
    assert ours.shape == golden.shape
    np.testing.assert_allclose(ours, golden, rtol=1e-10, atol=1e-10)


def pose(t: np.ndarray, tu: np.ndarray) -> np.ndarray:
    """Poses (20, 4, 4) with translations and angles times axes (20, 3)."""
    T = exp(np.hstack([np.zeros_like(tu), tu]))
    T[:, :3, 3] = t
    return T


def test_polar():
    given, s, L = columns("point_polar")
    r, phi, depth = given.T
    xy = np.stack([r * np.cos(phi), r * np.sin(phi)], axis=-1)[:, None]
    agree(Polar().interaction(xy, depth[:, None]), L)
    agree(Polar().measure(xy), s)


def test_log_depth():
    given, s, L = columns("depth_log")
    xy, depth, wanted = given[:, None, :2], given[:, 2:3], given[:, 3:]
    agree(log_depth_interaction(xy, depth), L)
    agree(np.log(depth) - np.log(wanted), s)


@pytest.mark.parametrize("rotation", ["cdRc", "cRcd"])
def test_theta_u(rotation):
    tu, s, L = columns(f"thetau_{rotation}")
    R = pose(np.zeros_like(tu), tu)[:, :3, :3]
    agree(ThetaU(rotation=rotation).interaction(R), L)
    agree(ThetaU(rotation=rotation).measure(R), s)


@pytest.mark.parametrize("name", ["cdMc", "cMcd", "cMo"])
def test_translation(name):
    given, s, L = columns(f"translation_{name}")
    T = pose(given[:, :3], given[:, 3:])
    agree(translation_interaction(T, name), L)
    agree(T[..., :3, 3], s)


def test_line_in_its_plane():
    given, _, L = columns("line")
    agree(line_interaction(given[:, 0], given[:, 1], given[:, 2:]), L)


def test_line_through_two_markers_of_its_plane():
    given, s, L = columns("line")
    (rho, theta), plane = given[:, :2].T, given[:, 2:]
    foot = np.stack([rho * np.cos(theta), rho * np.sin(theta)], axis=-1)
    # From the foot of the perpendicular along the line so that the normal is at +90 degrees:
    # direction (sin, -cos).
    xy = (
        foot[:, None]
        + np.array([-0.3, 0.4])[:, None]
        * np.stack([np.sin(theta), -np.cos(theta)], axis=-1)[:, None]
    )
    inverse_depth = -(np.einsum("nmk,nk->nm", xy, plane[:, :2]) + plane[:, 2:3]) / plane[:, 3:]
    front = (inverse_depth > 0).all(axis=-1)
    assert front.sum() >= 8  # the plane of some cases passes behind the camera there
    agree(LineFeature().measure(xy[front]), s[front])
    agree(LineFeature().interaction(xy[front], 1 / inverse_depth[front]), L[front])


def test_angle_of_a_segment():
    # The golden angle is that of the vector to the first point; ours is that to the second: the
    # same motion.
    given, _, L = columns("segment")
    given = given.reshape(20, 2, 3)
    agree(Polygon().interaction(given[..., :2], given[..., 2])[:, 1], L[:, 3])


@pytest.mark.parametrize("normalised", [False, True])
def test_segment(normalised):
    given, s, L = columns("segment_normalized" if normalised else "segment")
    given = given.reshape(20, 2, 3)
    agree(Segment(normalised=normalised).measure(given[..., :2]), s)
    agree(Segment(normalised=normalised).interaction(given[..., :2], given[..., 2]), L)


def matches(ours: np.ndarray, golden: np.ndarray) -> None:
    """To 1e-10 of the largest element of each case, which is stricter than the file's tolerance for
    small quantities.
    """
    golden = np.asarray(golden)
    assert ours.shape == golden.shape
    np.testing.assert_array_less(np.abs(ours - golden).max(), 1e-10 * np.abs(golden).max())


@pytest.mark.parametrize("of", ["points", "region"])
def test_moments(of):
    golden = GOLDEN["moments_discrete_points" if of == "points" else "moments_dense_polygon"]
    for case in golden["cases"]:
        xy, plane = np.reshape(case["polygon_xy"], (-1, 2)), np.array(case["ABC"])
        if of == "region":
            xy = xy[:-1]  # the last vertex is the first again
        m = image_moments(xy, of, 3)
        matches(
            np.array([m[p, q] for q in range(4) for p in range(4 - q)]),
            case["m_pq(q=0..3,p=0..3-q)"],
        )
        m = MomentSet.measured(xy, of, 6).in_plane(plane)
        matches(
            np.array([m.central(p, q).value for p, q in ((2, 0), (1, 1), (0, 2))]),
            case["mu20_mu11_mu02"],
        )
        matches(m.area.rate, case["L_area"][0])
        for name, (invariant, _) in INVARIANTS.items():
            i, row = list(INVARIANTS).index(name), invariant(m)[name]
            matches(np.atleast_1d(row.value), case["cinvariant"][i : i + 1])
            # the matrix of c5 is wrong there: it has a rate of turning, and c5 does not
            if name != "c5":
                matches(row.rate, case["L_cinvariant"][i])


@pytest.mark.parametrize("of", ["points", "region"])
def test_rows_of_moments(of):
    feature = Moments(of=of, rows=("xg", "yg", "xn", "yn", "an", "alpha"))
    golden = GOLDEN["moments_discrete_points" if of == "points" else "moments_dense_polygon"]
    for case in golden["cases"]:
        xy, (A, B, C) = np.reshape(case["polygon_xy"], (-1, 2)), case["ABC"]
        xy = xy[:-1] if of == "region" else xy
        s, L = feature.measure(xy)[:6], feature.interaction(xy, 1 / (xy @ [A, B] + C))
        unit = case["Zstar"] * np.sqrt(case["desired_surface"])  # the print's rows in metres
        matches(s[:2], case["gravity"])
        matches(L[:2], case["L_gravity"])
        matches(unit * s[2:4], case["gravity_normalized"])
        assert unit * s[4] == pytest.approx(case["an"][0], rel=1e-10)
        matches(unit * L[4], case["L_an"][0])
        assert s[5] == pytest.approx(np.squeeze(case["alpha"]), rel=1e-10)
        matches(L[5], np.reshape(case["L_alpha"], 6))
        theirs = np.array(case["L_gravity_normalized"])
        # vx of the first row is wrong there: finite differences agree with ours (test_moments)
        if of == "region":
            theirs[0, 0] = unit * L[2, 0]
        matches(unit * L[2:4], theirs)


def outline(centre: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Seven points (20, 7, 3) of circles around centres (20, 3), across (20, 3, 2): two radii at a
    right angle.
    """
    t = np.array([0.1, 0.7, 1.9, 2.5, 3.6, 4.4, 5.5])
    return centre[:, None] + np.einsum("nkj,jt->ntk", across, np.stack([np.cos(t), np.sin(t)]))


def test_ellipse():
    given, s, L = columns("ellipse")
    m = ellipse_moments(given[:, :5]).in_plane(given[:, 5:])
    rows = [
        m.coordinate(0),
        m.coordinate(1),
        *(m.central(p, q) / m.central(0, 0) for p, q in ((2, 0), (1, 1), (0, 2))),
    ]
    agree(np.stack([row.value for row in rows], axis=-1), s)
    agree(np.stack([row.rate for row in rows], axis=-2), L)


def test_ellipse_of_a_circle():
    given, s, L = columns("ellipse_from_circle")
    T = pose(given[:, :3], given[:, 3:6])
    p = outline(given[:, :3], given[:, 6, None, None] * T[:, :3, :2])
    agree(Ellipse().measure(p[..., :2] / p[..., 2:]), s)
    agree(Ellipse().interaction(p[..., :2] / p[..., 2:], p[..., 2]), L)


def test_ellipse_of_a_sphere():
    given, s, L = columns("ellipse_from_sphere")
    P, share = given[:, :3], 1 - given[:, 3] ** 2 / np.sum(given[:, :3] ** 2, axis=-1)
    # The circle in which the cone of tangents touches the sphere: its centre is nearer, its radius
    # smaller.
    one = np.cross(P, [1.0, 0, 0])
    two = np.cross(P, one)
    across = np.stack(
        [one / np.linalg.norm(one, axis=-1)[:, None], two / np.linalg.norm(two, axis=-1)[:, None]],
        axis=-1,
    )
    p = outline(share[:, None] * P, (given[:, 3] * np.sqrt(share))[:, None, None] * across)
    agree(Ellipse().measure(p[..., :2] / p[..., 2:]), s)
    agree(Ellipse().interaction(p[..., :2] / p[..., 2:], p[..., 2]), L)
    assert (np.linalg.matrix_rank(L, rtol=1e-9) == 3).all()


def test_rotation_matrices():
    cases = GOLDEN["rotation_conversions"]["cases"]
    agree(
        theta_u(np.array([case["R"] for case in cases])),
        np.array([case["thetau"] for case in cases]),
    )
