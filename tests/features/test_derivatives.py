"""Every feature's L against central differences over real motions of the camera; a member added to
the room is tested too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from vstestbed.core.geometry import exp, inverse, transform
from vstestbed.features import FEATURES, ThetaU
from vstestbed.features.line import line_interaction
from vstestbed.features.pose import log_depth_interaction, translation_interaction

CASES = 200
STEP = 1e-6
"""Truncation is step^2 times third derivatives: relative 1e-12/r^2 for an angle at radius r, and
r > 2e-3 in what is drawn below; rounding is 1e-16/step = 1e-10. Both stay under the bound of 1e-6
that every feature is held to.
"""
SQUARE = 0.25 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])

Measured = Callable[[np.ndarray], np.ndarray]


def moved(T: np.ndarray) -> np.ndarray:
    """T_camera_x (..., 4, 4) after the camera has moved by plus and minus a step along each axis of
    its twist: (2, 6, ..., 4, 4).
    """
    steps = exp(STEP * np.stack([np.eye(6), -np.eye(6)]))
    return inverse(steps).reshape(2, 6, *(1,) * (T.ndim - 2), 4, 4) @ T


def differences(
    after: np.ndarray, now: np.ndarray, error: Callable[[np.ndarray, np.ndarray], np.ndarray]
) -> np.ndarray:
    """L (..., k, 6) of s after the steps (2, 6, ..., k), by way of the error so that angles may
    pass from pi to -pi.
    """
    return np.moveaxis(error(after[0], now) - error(after[1], now), 0, -1) / (2 * STEP)


def worst(measured: np.ndarray, L: np.ndarray) -> float:
    """The largest relative error of any case, |difference| / |L|."""
    return float(
        (np.linalg.norm(measured - L, axis=(-2, -1)) / np.linalg.norm(L, axis=(-2, -1))).max()
    )


def views(rng: np.random.Generator) -> np.ndarray:
    """Poses T_camera_target (200, 4, 4): turned at will, tilted up to 56 degrees, 0.8 to 2.5 m
    away.
    """
    w = np.zeros((CASES, 6))
    w[:, 3:] = rng.uniform(-1, 1, (CASES, 3)) * [0.7, 0.7, 0]
    turn = np.zeros((CASES, 6))
    turn[:, 5] = rng.uniform(-np.pi, np.pi, CASES)
    depth = rng.uniform(0.8, 2.5, (CASES, 1))
    T = exp(w) @ exp(turn)
    T[:, :3, 3] = np.hstack([rng.uniform(-0.4, 0.4, (CASES, 2)), np.ones((CASES, 1))]) * depth
    return T


def in_front(rng: np.random.Generator) -> np.ndarray:
    """Four markers near the corners of a square of 0.5 m: (200, 4, 3)."""
    T = views(rng)
    return transform(T, SQUARE + rng.uniform(-0.05, 0.05, (CASES, 4, 3)))


def in_a_plane(rng: np.random.Generator) -> np.ndarray:
    """Seven markers of a plane, within 0.3 m of its middle, in order around a star: (200, 7, 3)."""
    angle, radius = 2 * np.pi * np.arange(7) / 7, rng.uniform(0.1, 0.3, (CASES, 7))
    flat = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(radius)], axis=-1
    )
    return transform(views(rng), flat)


def on_a_disc(rng: np.random.Generator) -> np.ndarray:
    """Seven markers on the outline of a disc of 0.1 to 0.3 m: (200, 7, 3)."""
    angle, radius = rng.uniform(0, 2 * np.pi, (CASES, 7)), rng.uniform(0.1, 0.3, (CASES, 1))
    flat = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros_like(angle)], axis=-1)
    return transform(views(rng), flat)


SETS = {"moments": in_a_plane, "ellipse": on_a_disc}
"""Markers of the features that take them to lie in a plane."""


def all_around(rng: np.random.Generator) -> np.ndarray:
    """Four markers in any direction, 0.3 to 3 m away: (200, 4, 3) [m]."""
    p = rng.normal(size=(CASES, 4, 3))
    return p / np.linalg.norm(p, axis=-1, keepdims=True) * rng.uniform(0.3, 3, (CASES, 4, 1))


def seen(p: np.ndarray, inputs: tuple[str, ...]) -> tuple[np.ndarray, np.ndarray]:
    """What a feature takes of points p (..., N, 3) in the camera frame."""
    if inputs == ("xy", "depth"):
        return p[..., :2] / p[..., 2:], p[..., 2]
    if inputs == ("xyw", "depth"):
        xyw = np.concatenate([p[..., :2], np.ones_like(p[..., 2:])], axis=-1)
        return xyw / p[..., 2:], p[..., 2]
    assert inputs == ("ray", "range")
    range_ = np.linalg.norm(p, axis=-1)
    return p / range_[..., None], range_


@pytest.mark.parametrize("kind", list(FEATURES.members))
def test_features_of_markers(kind):
    feature = FEATURES.members[kind]()
    around = feature.inputs == ("ray", "range")
    p = (all_around if around else SETS.get(kind, in_front))(np.random.default_rng(0))
    assert around == bool((p[..., 2] < 0).any())  # a sphere's markers are behind the camera too
    x, distance = seen(p, feature.inputs)
    L = feature.interaction(x, distance)
    after = feature.measure(
        seen(transform(moved(np.broadcast_to(np.eye(4), (CASES, 4, 4))), p), feature.inputs)[0]
    )
    measured = differences(after, feature.measure(x), feature.error)
    rows = 4 * feature.rows_per_marker
    assert L.shape == measured.shape and (rows == 0 or L.shape == (CASES, rows, 6))
    assert worst(measured, L) < 1e-6


@pytest.mark.parametrize("kind", list(FEATURES.members))
def test_lists_will_do(kind):
    feature = FEATURES.members[kind]()
    x = seen(SETS.get(kind, in_front)(np.random.default_rng(0))[0], feature.inputs)[0]
    s = feature.measure(x.tolist())
    np.testing.assert_array_equal(s, feature.measure(x))
    np.testing.assert_array_equal(
        feature.interaction(x.tolist(), [1] * len(x)), feature.interaction(x, np.ones(len(x)))
    )
    np.testing.assert_array_equal(feature.error(s.tolist(), s.tolist()), feature.error(s, s))


@pytest.mark.parametrize("n", [2, 3])
@pytest.mark.parametrize("kind", ["line", "polygon", "segment"])
def test_features_of_fewer_markers(kind, n):
    feature, p = FEATURES.members[kind](), in_front(np.random.default_rng(1))[:, :n]
    L = feature.interaction(*seen(p, feature.inputs))
    after = transform(moved(np.broadcast_to(np.eye(4), (CASES, 4, 4))), p)
    x, later = seen(p, feature.inputs)[0], seen(after, feature.inputs)[0]
    rows = {"segment": 4, "line": 6 if n == 3 else 2, "polygon": 2}[kind]
    assert L.shape == (CASES, rows, 6)
    assert worst(differences(feature.measure(later), feature.measure(x), feature.error), L) < 1e-6


def test_log_depth():
    p = in_front(np.random.default_rng(2))
    after = transform(moved(np.broadcast_to(np.eye(4), (CASES, 4, 4))), p)
    measured = differences(np.log(after[..., 2]), np.log(p[..., 2]), np.subtract)
    assert worst(measured, log_depth_interaction(p[..., :2] / p[..., 2:], p[..., 2])) < 1e-6


def angles(where: str, rng: np.random.Generator) -> np.ndarray:
    """200 angles of rotation [rad]; "half turn" ends where a step of the differences would not yet
    cross pi.
    """
    few = 10 ** rng.uniform(-9, -2, CASES)
    return {
        "identity": few,
        "anywhere": rng.uniform(0.01, 3.1, CASES),
        "half turn": np.pi - 10 ** rng.uniform(-4, -1, CASES),
    }[where]


def poses(where: str, rng: np.random.Generator) -> np.ndarray:
    """200 poses with those angles about random axes and translations of up to 1 m: (200, 4, 4)."""
    u = rng.normal(size=(CASES, 3))
    u *= (angles(where, rng) / np.linalg.norm(u, axis=-1))[:, None]
    T = exp(np.hstack([np.zeros_like(u), u]))
    T[:, :3, 3] = rng.uniform(-1, 1, (CASES, 3))
    return T


@pytest.mark.parametrize("where", ["identity", "anywhere", "half turn"])
@pytest.mark.parametrize("of", ["cdRc", "cRcd", "cdMc", "cMcd", "cMo"])
def test_features_of_a_pose(of, where):
    now = poses(where, np.random.default_rng(3))
    later = moved(now)
    if of in ("cdRc", "cdMc"):  # the camera seen from the goal
        now, later = inverse(now), inverse(later)
    if of in ("cdRc", "cRcd"):
        feature, now, later = ThetaU(rotation=of), now[..., :3, :3], later[..., :3, :3]
        measured, L = (
            differences(feature.measure(later), feature.measure(now), np.subtract),
            feature.interaction(now),
        )
    else:
        measured, L = (
            differences(later[..., :3, 3], now[..., :3, 3], np.subtract),
            translation_interaction(now, of),
        )
    assert worst(measured, L) < 1e-6


def test_a_line_has_one_matrix_whichever_plane_holds_it():
    rng = np.random.default_rng(4)
    start, end = in_front(rng)[:, 0], in_front(rng)[:, 1]
    beside = start + rng.normal(size=(CASES, 3))
    normal = np.cross(end - start, beside - start)
    plane = np.hstack([normal, -np.sum(normal * start, axis=-1, keepdims=True)])
    ends = np.stack([start, end], axis=-2)
    feature = FEATURES.members["line"]()
    s = feature.measure(ends[..., :2] / ends[..., 2:])
    L = feature.interaction(ends[..., :2] / ends[..., 2:], ends[..., 2])
    # A third point drawn near the plane of the camera's centre makes D small; 1e-16 / 1e-5 is the
    # worst drawn here.
    np.testing.assert_allclose(line_interaction(s[:, 0], s[:, 1], plane), L, rtol=1e-9, atol=1e-9)
