"""Targets of one region: outlines of balls, discs and polygons, how they are drawn, and what they
refuse.
"""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.cli.running import summary_text
from vstestbed.core.errors import ScenarioError
from vstestbed.core.geometry import Pose, inverse, lengths
from vstestbed.targets import Ball, Shape
from vstestbed.targets.regions import (
    FIGURES,
    PolygonFigure,
    centroid,
    covariance,
    distance_to_conic,
    evenly_along,
    fitted_conic,
    signed_area,
)
from vstestbed.testing import check_target

VIEW = Pose(xyz=(0.1, -0.2, 1.1), rpy_deg=(25, -30, 50)).T
SIZES: dict[str, dict[str, Any]] = {
    "whale": {"length": 0.4},
    "l_shape": {"length": 0.3},
    "disc": {"radius": 0.15},
    "polygon": {"at": [[0, 0], [0.3, 0.02], [0.1, 0.25]]},
}
TURN = np.eye(4)
TURN[:3, :3] = Pose(xyz=(0, 0, 0), rpy_deg=(0, 0, 77)).T[:3, :3]


def shape(kind: str, **more: Any) -> Shape:
    return Shape(pose=Pose(), figure=FIGURES.members[kind](**SIZES[kind]), **more)


def polygon(at: list[list[float]]) -> Shape:
    return Shape(pose=Pose(), figure=PolygonFigure(at=tuple(map(tuple, at))))


def test_every_figure_has_an_example_here():
    assert set(SIZES) == set(FIGURES.members)


@pytest.mark.parametrize("kind", SIZES)
def test_the_drawn_triangles_are_the_outline(kind: str):
    target = shape(kind)
    check_target(target)
    a, b, c = np.moveaxis(target.body[0], 1, 0)
    areas = np.cross(b - a, c - a)[:, 2] / 2
    corners = target.figure.corners
    assert (areas < 0).all()  # counter-clockwise seen from the front, where z points away
    assert -areas.sum() == pytest.approx(signed_area(corners))
    if not target.figure.round:
        outline = target.points[:, :2]
        assert len(outline) >= target.count
        assert all(lengths(outline - corner).min() < 1e-12 for corner in corners)
        assert signed_area(outline) == pytest.approx(signed_area(corners))
        np.testing.assert_allclose(centroid(outline), centroid(corners), atol=1e-12)
        np.testing.assert_allclose(covariance(outline), covariance(corners), atol=1e-12)
    else:
        assert signed_area(corners) == pytest.approx(np.pi * 0.15**2)
    half = target.board_half_m
    assert (np.abs(corners) < half).all() and half[0] < 0.5


def test_moments_of_a_rectangle_by_hand():
    corners = np.array([[1.0, 2], [5, 2], [5, 4], [1, 4]])
    np.testing.assert_allclose(centroid(corners), [3, 3])
    np.testing.assert_allclose(covariance(corners), np.diag([16 / 12, 4 / 12]), atol=1e-12)


@pytest.mark.parametrize(
    "at",
    [
        [[0, 0], [1, 1], [1, 0], [0, 1]],
        [[0, 0], [1, 0], [0.5, 0]],
        [[0, 0], [2, 0], [1, 0], [1, 1]],
    ],
)
def test_a_polygon_that_meets_itself_is_refused(at: list[list[float]]):
    with pytest.raises(
        ScenarioError,
        match=r" target\.figure\.at: must not cross or touch itself: the sides from corners",
    ):
        vs.load("arm_region", {"target.figure": {"kind": "polygon", "at": at}})


def test_points_along_a_polygon_are_evenly_apart():
    # a rectangle of perimeter 8
    along = evenly_along(np.array([[0.0, 0], [3, 0], [3, 1], [0, 1]]), 8)
    np.testing.assert_allclose(
        along, [[0, 0], [1, 0], [2, 0], [3, 0], [3, 1], [2, 1], [1, 1], [0, 1]], atol=1e-12
    )


def test_a_polygon_is_the_same_whichever_way_round_it_is_given():
    at = SIZES["polygon"]["at"]
    there, back = (polygon(way) for way in (at, at[::-1]))
    assert (
        signed_area(there.points[:, :2]) == pytest.approx(signed_area(back.points[:, :2]))
        and signed_area(back.points[:, :2]) > 0
    )


def test_a_discs_points_lie_on_it_and_do_not_show_how_it_is_turned():
    disc = shape("disc")
    p = disc.points_at(VIEW)
    on = (p - VIEW[:3, 3]) @ VIEW[:3, :3]
    np.testing.assert_allclose(on[:, 2], 0, atol=1e-12)
    np.testing.assert_allclose(np.hypot(on[:, 0], on[:, 1]), 0.15, rtol=1e-12)
    np.testing.assert_allclose(disc.points_at(VIEW @ TURN), p, atol=1e-12)
    np.testing.assert_allclose(disc.points_at(np.stack([VIEW, VIEW @ TURN]))[1], p, atol=1e-12)
    assert signed_area(p[:, :2] / p[:, 2:]) > 0  # clockwise in the picture
    facing = disc.points_at(Pose(xyz=(0, 0, 1)).T)
    np.testing.assert_allclose(facing, disc.points + [0, 0, 1], atol=1e-12)
    # a part is behind the image plane
    assert np.isnan(disc.points_at(Pose(xyz=(0, 0, 0.1), rpy_deg=(80, 0, 0)).T)).all()


def test_a_conic_is_found_again_from_its_points():
    p = shape("disc", count=24).points_at(VIEW)
    conic = fitted_conic(p[:, :2] / p[:, 2:])
    np.testing.assert_allclose(distance_to_conic(conic, p[:, :2] / p[:, 2:]), 0, atol=1e-12)
    assert abs(distance_to_conic(conic, p[:1, :2] / p[:1, 2:] + [1e-4, 0])[0]) == pytest.approx(
        1e-4, rel=0.1
    )


def test_a_balls_rays_touch_it_and_its_size_gives_its_place():
    ball = Ball(pose=Pose(), radius=0.2)
    check_target(ball)
    centre = np.array([0.3, -0.1, 1.0])
    T = np.eye(4)
    T[:3, 3] = centre
    p = ball.points_at(T)
    np.testing.assert_allclose(lengths(p - centre), 0.2, rtol=1e-12)
    # the ray is a tangent
    np.testing.assert_allclose(((p - centre) * p).sum(axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(ball.points_at(T @ TURN), p)
    np.testing.assert_allclose(ball.seen_from(inverse(T)), p, atol=1e-12)
    ray = p / lengths(p)
    np.testing.assert_allclose(np.asarray(ball.by_size(ray)), p, atol=1e-12)
    ray[::3] = np.nan  # some are not reported
    np.testing.assert_allclose(np.asarray(ball.by_size(ray))[1::3], p[1::3], atol=1e-12)
    assert np.isnan(np.asarray(ball.by_size(np.full_like(ray, np.nan)))).all()
    assert np.isnan(ball.points_at(np.eye(4))).all()  # from inside


ALIKE = (
    "of this robot's 6 motions at the goal, since a ball looks alike from other places;"
    " use law.redundant: true"
)
DISC: dict[str, Any] = {
    "target.figure": {"kind": "disc", "radius": 0.15},
    "law.depth": "goal",
    "stop.converged.position_m": None,
    "stop.converged.rotation_deg": None,
}
SLANT = {"goal.T_camera_target.rpy_deg": [30, 0, 0]}


def test_what_does_not_go_together_is_refused():
    for name, settings, words in (
        (
            "arm_ball",
            {"law.depth": "pnp"},
            (
                "law.depth: may not be pnp: the outline of a ball does not tell how it is turned,"
                " and so has no pose; use"
            ),
        ),
        ("arm_ibvs", {"law.depth": "size"}, "law.depth: may not be size without target ball"),
        (
            "arm_ball",
            {"law.feature": "point", "law.redundant": False},
            f"law.feature: point tells 3 {ALIKE}, which leaves the others open$",
        ),
        (
            "arm_ball",
            {"law.redundant": False},
            f"law.feature: ellipse tells 3 {ALIKE}, which leaves the others alone$",
        ),
        (
            "arm_region",
            DISC | {"law.feature": "point"},
            "point tells 3 of this robot's 6 motions at the goal, since a disc looks alike",
        ),
        (
            "arm_region",
            DISC | {"law.feature": "spherical"} | SLANT,
            "spherical tells 5 of this robot's 6 motions",
        ),
        (
            "arm_ball",
            {"stop.converged": {"position_m": 0.003, "rotation_deg": 0.3}},
            (
                "stop.converged.position_m: needs the target's pose,"
                " which the outline of a ball does not tell; works: error_px alone"
            ),
        ),
        (
            "arm_ball",
            {"stop.converged.rotation_deg": 0.3},
            "stop.converged.rotation_deg: needs the target's pose",
        ),
        (
            "arm_region",
            {"law.depth": "goal"},
            (
                "needs the target's pose, which law.depth goal does not estimate;"
                " works: law.depth pnp, or error_px alone"
            ),
        ),
        ("arm_ball", {"detector": {"kind": "blobs"}}, "with outline use detector .*region"),
        (
            "arm_ibvs",
            {"detector": {"kind": "region"}},
            "detector region sees outline; with disc use detector blobs or oracle$",
        ),
        (
            "arm_region",
            {"goal.markers": [0, 1, 2, 3]},
            "goal.markers: must be left out: the points of an outline count together",
        ),
        (
            "arm_region",
            {"target.names": ["tail"]},
            "target.names: is for markers; the points of an outline have none",
        ),
        ("arm_ball", {"target.pad": {"side": 0.5}}, "target.pad: is for target square or points"),
        ("arm_ball", {"goal.T_camera_target.xyz": [0, 0, 0.15]}, "outside the 640 x 480 picture"),
    ):
        with pytest.raises(ScenarioError, match=words):
            vs.load(name, settings)


IDEAL = {"detector": "oracle", "robot.actuation": "ideal", "stop.duration_s": 15.0}


def test_arm_region_goes_straight_to_its_goal():
    recording = vs.run(vs.load("arm_region", IDEAL).randomised(1))
    assert recording.outcome is vs.Outcome.converged
    # with sx and sy, which hardly tell a whale's tilt, 5
    assert recording.summary()["path_ratio"] < 1.03


def test_a_ball_leaves_motions_free_and_no_pose_is_the_goal(tmp_path: Path):
    recording = vs.run(vs.load("arm_ball", IDEAL | {"stop.duration_s": 0.2}))
    words = summary_text(recording, tmp_path, filmed=False)
    assert recording.summary()["path_ratio"] is None and "straight line" not in words
    assert "deg from the goal, where 3 motions are free (law.redundant)" in words
    free = [
        vs.load(name).free_motions for name in ("quadrotor_ball", "arm_avoid_limits", "arm_region")
    ]
    assert free == [1, 2, 0]


@pytest.mark.parametrize(
    ("name", "settings", "free"),
    [
        ("arm_ball", {"law.feature": "point"}, 3),
        ("arm_ball", {"law.feature": "polar"}, 3),
        ("quadrotor_ball", {"law.feature": "point"}, 1),
        ("arm_region", DISC | {"law.feature": "point", "law.redundant": True}, 3),
        ("arm_region", DISC | SLANT | {"law.feature": "point", "law.redundant": True}, 1),
        ("arm_region", DISC | SLANT | {"law.feature": "ellipse", "law.redundant": True}, 1),
        ("arm_region", {"law.feature": "point", "law.redundant": True}, 0),
    ],
)
def test_points_of_an_outline_tell_no_more_than_its_picture(
    name: str, settings: dict[str, Any], free: int
):
    assert vs.load(name, settings).free_motions == free


@pytest.mark.study
@pytest.mark.parametrize("name", ["arm_region", "quadrotor_region", "arm_ball", "quadrotor_ball"])
def test_rendered_runs_reach_their_goals(name: str):
    scenario = vs.load(name)
    assert [vs.run(scenario.randomised(seed)).outcome for seed in range(10)] == [
        vs.Outcome.converged
    ] * 10
