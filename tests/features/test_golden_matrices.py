"""The golden file's matrices: an independent library's, 20 cases a feature."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from vstestbed.core.geometry import exp
from vstestbed.features import LineFeature, LogDepth, Polar, Polygon, ThetaU, Translation
from vstestbed.features.line import line_interaction
from vstestbed.features.theta_u import theta_u

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "interaction_matrices.json").read_text())


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
    agree(LogDepth().interaction(xy, depth), L)
    agree(LogDepth().error(LogDepth().measure(depth), LogDepth().measure(wanted)), s)


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
    agree(Translation(pose=name).interaction(T), L)
    agree(Translation(pose=name).measure(T), s)


def test_line_in_its_plane():
    given, _, L = columns("line")
    agree(line_interaction(given[:, 0], given[:, 1], given[:, 2:]), L)


def test_line_through_two_markers_of_its_plane():
    given, s, L = columns("line")
    (rho, theta), plane = given[:, :2].T, given[:, 2:]
    foot = np.stack([rho * np.cos(theta), rho * np.sin(theta)], axis=-1)
    # From the foot of the perpendicular along the line so that the normal is at +90 degrees: direction (sin, -cos).
    xy = foot[:, None] + np.array([-0.3, 0.4])[:, None] * np.stack([np.sin(theta), -np.cos(theta)], axis=-1)[:, None]
    inverse_depth = -(np.einsum("nmk,nk->nm", xy, plane[:, :2]) + plane[:, 2:3]) / plane[:, 3:]
    front = (inverse_depth > 0).all(axis=-1)
    assert front.sum() >= 8  # the plane of some cases passes behind the camera there
    agree(LineFeature().measure(xy[front]), s[front])
    agree(LineFeature().interaction(xy[front], 1 / inverse_depth[front]), L[front])


def test_angle_of_a_segment():
    # The golden angle is that of the vector to the first point; ours is that to the second: the same motion.
    given, _, L = columns("segment")
    given = given.reshape(20, 2, 3)
    agree(Polygon().interaction(given[..., :2], given[..., 2])[:, 1], L[:, 3])


def test_rotation_matrices():
    cases = GOLDEN["rotation_conversions"]["cases"]
    agree(theta_u(np.array([case["R"] for case in cases])), np.array([case["thetau"] for case in cases]))
