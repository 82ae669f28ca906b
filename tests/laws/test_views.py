"""Views of a batch of ideal cameras: the same quantities as an Observation's, and the law's own
source of depth.
"""

from __future__ import annotations

import numpy as np

from tests.laws.flight import book_camera
from vstestbed.core.geometry import Pose, transform
from vstestbed.features.depth import AtGoal, Constant, Depth, OracleDepth, PnP
from vstestbed.features.observation import Goal
from vstestbed.laws.base import Views
from vstestbed.targets.base import Square

POINTS = Square(side=0.5, pose=Pose()).points
GOAL = Goal.from_view(book_camera(), POINTS, Pose(xyz=(0, 0, 1), rpy_deg=(20, 0, 0)).T)
T = np.stack([Pose(xyz=(0.1, 0.2, 2), rpy_deg=(10, 20, 30)).T, Pose(xyz=(0, 0, 1.5)).T])
P = transform(T, POINTS)


def views(depth: Depth) -> Views:
    return Views(0.0, P, T, GOAL, depth)


def test_coordinates_are_true():
    made = views(PnP())
    np.testing.assert_allclose(made.xy, P[..., :2] / P[..., 2:], rtol=1e-15)
    np.testing.assert_allclose(made.ray * np.linalg.norm(P, axis=-1, keepdims=True), P, rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(made.ray, axis=-1), 1, rtol=1e-12)


def test_distances_are_those_that_the_law_knows():
    for source, depth, range_ in (
        (PnP(), P[..., 2], np.linalg.norm(P, axis=-1)),
        (OracleDepth(), P[..., 2], np.linalg.norm(P, axis=-1)),
        (Constant(depth_m=1.7), np.full((2, 4), 1.7), np.full((2, 4), 1.7)),
        (AtGoal(), np.stack([GOAL.depth] * 2), np.stack([GOAL.range] * 2)),
    ):
        made = views(source)
        np.testing.assert_allclose(made.depth, depth, rtol=1e-12)
        np.testing.assert_allclose(made.range, range_, rtol=1e-12)
