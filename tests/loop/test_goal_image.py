"""The goal's picture, taken by the simulated camera, and points of it as a law's points."""

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import transform
from vstestbed.features.depth import depth_at
from vstestbed.features.observation import Sight
from vstestbed.laws.ibvs import IBVS
from vstestbed.loop.controller import Controller
from vstestbed.loop.episode import Episode
from vstestbed.loop.plants import take_goal_images
from vstestbed.vision.base import goal_of_points, points_of


class Looking(IBVS):
    """A law that asks for pictures, and keeps to its markers."""

    inputs = ("xy", "depth", "image")


def scenario(name, **more):
    s = vs.load(name, {"stop.duration_s": 0.4, **more})
    return replace(s, law=Looking())


@pytest.mark.parametrize("name", ["ibvs_book", "arm_ibvs", "quadrotor_perspective"])
def test_it_shows_the_markers_where_the_goal_has_them_and_changes_no_run(name):
    s = scenario(name, **({"detector": "blobs"} if name == "ibvs_book" else {}))
    episode = Episode(s, False, (), None)
    try:
        before = episode.plant.truth()
        (sight,) = take_goal_images(s, episode.plant)
        after = episode.plant.truth()
    finally:
        episode.close()
    for field in ("T_world_camera", "T_world_target", "q", "qd", "ctrl"):
        np.testing.assert_array_equal(getattr(before, field), getattr(after, field))
    u, v = s.goal_view.uv.round().astype(int).T
    chroma = np.ptp(sight.image[v, u].astype(int), axis=1)
    assert (chroma > 100).all()  # each goal marker's middle has a saturated colour


def test_a_law_is_given_the_goals_picture_and_whole_pictures():
    s = scenario("arm_ibvs")
    with vs.Session(s) as session:
        frame = session.reset()
        assert frame.goal.image is not None and frame.observation.image is not None
        assert frame.observation.image.image.shape == (s.camera.height, s.camera.width, 3)
        np.testing.assert_array_equal(frame.image, frame.observation.image.image)
        with_pictures = [session.step().command.twist for _ in range(3)]
    with vs.Session(replace(s, law=IBVS())) as session:
        frame = session.reset()
        assert frame.goal.image is None and frame.observation.image is None
        np.testing.assert_array_equal(
            with_pictures, [session.step().command.twist for _ in range(3)]
        )


def test_a_controller_without_its_pictures_says_what_it_needs():
    s = scenario("arm_ibvs")
    with pytest.raises(ParameterError, match="goal_images must be 1"):
        Controller(s)
    with pytest.raises(ParameterError, match=r"goal_images must be of shape \(480, 640, 3\)"):
        Controller(s, [Sight(np.zeros((4, 4, 3), np.uint8))])


def test_points_of_the_goals_picture_lie_in_the_targets_plane():
    s = vs.load("arm_picture")
    goal, on_plane = s.goal_view, np.array([[0.1, -0.05, 0], [-0.2, 0.1, 0], [0.0, 0.02, 0]])
    uv = s.believed_camera.project(transform(goal.T_camera_target, on_plane))
    made = goal_of_points(goal, uv)
    np.testing.assert_allclose(points_of(made), on_plane, atol=1e-12)
    some = made.rows(np.array([2, -1, 0]))
    np.testing.assert_allclose(points_of(some)[[0, 2]], on_plane[[2, 0]], atol=1e-12)
    assert (
        some.counted is not None
        and some.counted.tolist() == [True, False, True]
        and np.isnan(some.uv[1]).all()
    )
    np.testing.assert_array_equal(goal.of(some).uv, some.uv)


def test_a_depth_picture_counts_before_the_plane_and_a_hole_does_not():
    s = vs.load("arm_picture")
    depth = np.full((s.camera.height, s.camera.width), 0.7, np.float32)
    depth[:, 320:] = np.nan
    goal = replace(s.goal_view, image=Sight(np.zeros((*depth.shape, 3), np.uint8), depth))
    made, plane = (
        goal_of_points(g, np.array([[300.2, 200.0], [340.0, 200.0]])) for g in (goal, s.goal_view)
    )
    assert made.depth[0] == np.float32(0.7) and made.depth[1] == plane.depth[1]
    np.testing.assert_array_equal(
        depth_at(depth, np.array([[-1.0, 3.0], [np.nan, np.nan], [319.4, 0.0]])),
        [np.nan, np.nan, np.float32(0.7)],
    )


def test_a_picture_taken_with_a_wrong_calibration_is_the_true_lenss():
    s = scenario("arm_ibvs", **{"calibration.focal_error": 0.1})
    with vs.Session(s) as session:
        frame = session.reset()
    u, v = s.camera.project(transform(s.goal_poses[-1], s.target.points)).round().astype(int).T
    assert frame.goal.image is not None
    assert (np.ptp(frame.goal.image.image[v, u].astype(int), axis=1) > 100).all()


def test_the_targets_picture_changes_after_the_goal_was_taught_and_nothing_else_is_drawn_anew():
    small = {
        "camera.width": 160,
        "camera.height": 120,
        "target.width": 0.3,
        "target.file": "texture:brick",
        "noise.pixel_sigma_px": 0.2,
        "noise.image_sigma": 2,
        "noise.dropout": 0.1,
    }
    noise = {"image_sigma": 12.75, "perturb": [{"kind": "erasing", "probability": 1}]}
    shown, measured = [], []
    for target in ({}, noise):
        episode = Episode(
            scenario("camera_vitvs", **small, **{"noise.target": target, "detector": "oracle"}),
            True,
            (),
            None,
        )
        try:
            (taught,) = episode.recording().goal_images
            frames = [episode.advance() for _ in range(3)]
        finally:
            episode.close()
        shown.append((taught, frames[0].image))
        measured.append([frame.observation.uv for frame in frames])
    np.testing.assert_array_equal(shown[0][0], shown[1][0])
    assert np.mean(shown[0][1] != shown[1][1]) > 0.01  # where the poster is in the picture
    np.testing.assert_array_equal(measured[0], measured[1])
