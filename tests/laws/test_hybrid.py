"""2.5D: finite differences of its error, both sources of rotation and ratio agree, the target's
image goes straight.
"""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest

import vstestbed as vs
from tests.laws.flight import book_camera, fly
from tests.laws.test_pbvs import camera_poses
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, exp, inverse, transform
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Hybrid
from vstestbed.laws.points import NO_POSE, TOO_FEW
from vstestbed.targets.base import Square
from vstestbed.vision.homography import relative_view

CAMERA, POINTS = book_camera(), Square(side=0.5, pose=Pose()).points
TILTED = Pose(xyz=(0.1, -0.05, 1.1), rpy_deg=(20, 10, -15)).T
AWAY = Pose(xyz=(0.2, -0.1, 1.6), rpy_deg=(10, -25, 70)).T


def view(T: Array, goal: Goal) -> Observation:
    p = transform(T, POINTS)
    uv = CAMERA.project(p)
    xy = CAMERA.normalise(uv)
    relative = relative_view(goal.xy, xy, goal.normal)
    return Observation(t=0, uv=uv, xy=xy, depth=p[:, 2], T_camera_target=T, relative=relative)


def test_the_matrix_is_the_derivative_of_the_error():
    goal, law, h = Goal.from_view(CAMERA, POINTS, TILTED), Hybrid(source="model"), 1e-6

    def feature(T: Array) -> tuple[Array, Array]:
        return law.of_middle(
            T[:3, 3] / TILTED[2, 3], TILTED[:3, :3] @ T[:3, :3].T, goal.T_camera_target[:3, 3]
        )

    L = feature(AWAY)[1]
    for i, twist in enumerate(np.eye(6)):
        ahead, back = (feature(exp(-s * h * twist) @ AWAY)[0] for s in (1, -1))
        assert (ahead - back) / (2 * h) == pytest.approx(L[:, i], abs=1e-8)


@pytest.mark.parametrize("goal_pose", [Pose(xyz=(0, 0, 1)).T, TILTED], ids=["square", "tilted"])
def test_homography_and_model_order_the_same(goal_pose: Array):
    goal = Goal.from_view(CAMERA, POINTS, goal_pose)
    o = view(AWAY, goal)
    laws = [Hybrid(source="homography"), Hybrid(source="model")]
    twists = [law.step(law.init(goal), o, goal, np.eye(6))[1].twist for law in laws]
    # findHomography computes in single precision
    assert twists[0] == pytest.approx(twists[1], abs=1e-6)


@pytest.mark.parametrize("source", ["homography", "model"])
def test_the_change_between_two_views_is_the_motion_between_them(source: str):
    """e = L xi to second order, with xi the motion of the camera: so that the feedforward finds the
    target's motion.
    """
    goal, law = Goal.from_view(CAMERA, POINTS, TILTED), Hybrid(source=source)  # pyright: ignore[reportArgumentType] - of a parameter
    moved = np.array([0.01, -0.02, 0.015, 0.03, -0.02, 0.04])
    e, L = law.change(view(AWAY, goal), view(exp(-moved) @ AWAY, goal), goal)
    assert np.linalg.solve(L, e) == pytest.approx(moved, abs=2e-3 * np.linalg.norm(moved) + 1e-5)


def test_the_image_of_the_targets_origin_goes_straight():
    r = fly(Hybrid(), (0.6, 0.3, -2.0), rpy_deg=(8, -14, 100))
    assert r.outcome is vs.Outcome.converged
    o = np.array([inverse(T)[:3, 3] for T in camera_poses(r)])
    xy = o[:, :2] / o[:, 2:]
    way = xy[0] / np.linalg.norm(xy[0])
    # of 1: the goal's image is (0, 0)
    assert np.abs(xy[:, 0] * way[1] - xy[:, 1] * way[0]).max() < 5e-3


def test_views_that_cannot_be_compared_bring_rest():
    goal = Goal.from_view(CAMERA, POINTS, TILTED)
    o = view(AWAY, goal)
    blind = Observation(t=0, uv=o.uv, xy=o.xy, depth=o.depth, T_camera_target=None, relative=None)
    for law in (Hybrid(), Hybrid(source="model")):
        command = law.step(law.init(goal), blind, goal, np.eye(6))[1]
        assert command.rest_reason == NO_POSE and not command.twist.any()


OFF_THE_ORIGIN = ((-0.25, -0.25, 0.5), (0.25, -0.25, 0.5), (0.25, 0.25, 0.5), (-0.25, 0.25, 0.5))
SLANTED = ((-0.25, -0.25, 0.2), (0.25, -0.25, 0.4), (0.25, 0.25, 0.4), (-0.25, 0.25, 0.2))


@pytest.mark.parametrize("at", [OFF_THE_ORIGIN, SLANTED], ids=["z = .5", "slanted"])
@pytest.mark.study
def test_markers_in_another_plane_than_the_origins(at: tuple[tuple[float, float, float], ...]):
    laws = [Hybrid(source="homography"), Hybrid(source="model")]
    runs = [fly(law, (0.3, 0.3, -2), 0.4, at=at) for law in laws]
    assert all(r.outcome is vs.Outcome.converged for r in runs)
    assert len(runs[0]["t"]) == pytest.approx(len(runs[1]["t"]), abs=1)


@pytest.mark.parametrize(
    ("fourth", "words"),
    [
        ((-0.25, 0.25, 0.2), ".*not in one plane.*source: model"),
        ((0.0, -0.25, 0.0), "all markers but one on a line.*source: model"),
    ],
)
def test_markers_that_make_no_homography_are_refused(
    fourth: tuple[float, float, float], words: str
):
    at = ((-0.25, -0.25, 0.0), (0.25, -0.25, 0.0), (0.25, 0.25, 0.0), fourth)
    with pytest.raises(ParameterError, match=f"^target has {words}"):
        fly(Hybrid(), at=at)
    assert fly(Hybrid(source="model"), (0.1, 0, -1.2), at=at).outcome is vs.Outcome.converged


class TestFlat:
    """Markers count as lying in a plane (on a line) up to a thousandth of their extent."""

    @pytest.mark.parametrize(("height", "flat"), [(0.9e-3, True), (1.1e-3, False)])
    def test_a_plane(self, height: float, flat: bool):
        # extents 1, 1, height
        corners = np.array([[-1.0, -1, 1], [1, -1, -1], [1, 1, 1], [-1, 1, -1]]) * [
            0.5,
            0.5,
            0.5 * height,
        ]
        law, goal = Hybrid(), Goal.from_view(CAMERA, POINTS, TILTED)
        with nullcontext() if flat else pytest.raises(ParameterError, match="not in one plane"):
            law.check(corners, goal)

    def test_only_a_homography_asks(self):
        Hybrid(source="model").check(
            np.random.default_rng(0).normal(size=(4, 3)), Goal.from_view(CAMERA, POINTS, TILTED)
        )

    def test_five_with_four_on_a_line_are_refused_and_with_three_are_not(self):
        line = np.array([[-0.2, 0, 0], [-0.1, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0, 0.2, 0]])
        goal = Goal.from_view(CAMERA, POINTS, TILTED)
        with pytest.raises(ParameterError, match="all markers but one on a line"):
            Hybrid().check(line, goal)
        line[0, 1] = 0.1
        Hybrid().check(line, goal)

    @pytest.mark.parametrize(("source", "needed"), [("homography", 4), ("model", 3)])
    def test_markers_needed(self, source: str, needed: int):
        law, goal = Hybrid(source=source), Goal.from_view(CAMERA, POINTS, TILTED)  # pyright: ignore[reportArgumentType]
        assert law.markers_needed(np.eye(6)) == needed and law.state_size == 0
        o = view(AWAY, goal)
        for visible, reason in ((needed, ""), (needed - 1, TOO_FEW)):
            o.uv[:, 0] = np.where(np.arange(4) < visible, 1.0, np.nan)
            assert law.step(law.init(goal), o, goal, np.eye(6))[1].rest_reason == reason
