"""The region detector on pictures painted with known coverage: outlines to some hundredths of a
pixel, or none.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.vision.parts import in_windows
from vstestbed.camera import Perspective, Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, transform
from vstestbed.features.observation import Goal
from vstestbed.targets import Ball, Shape, Square, Target
from vstestbed.targets.regions import FIGURES, centroid, signed_area
from vstestbed.vision import Detection, RegionDetector
from vstestbed.vision.region import bare_share, edge_points

CAMERA = Perspective(width=320, height=240, fovy_deg=60, multisampling=4)
RNG = np.random.default_rng(0)
FINE = 8
"""The picture is painted so many times larger, and its pixels are means."""
FACING = Pose(xyz=(0, 0, 1), rpy_deg=(0, 0, 10)).T
TURNED = Pose(xyz=(0.05, -0.04, 1.0), rpy_deg=(20, -25, 100)).T
SQUARE = [[-0.15, -0.15], [0.15, -0.15], [0.15, 0.15], [-0.15, 0.15]]


def shape(kind: str = "whale", **more: Any) -> Shape:
    sizes: dict[str, dict[str, Any]] = {
        "whale": {"length": 0.6},
        "l_shape": {"length": 0.45},
        "disc": {"radius": 0.2},
        "polygon": {"at": SQUARE},
    }
    return Shape(pose=Pose(), figure=FIGURES.members[kind](**sizes[kind]), **more)


def border_of(target: Target, T: Array, camera: Perspective = CAMERA) -> Array:
    """The outline's image (E, 2) [px], with many corners."""
    if isinstance(target, Shape):
        corners = target.figure.corners
        return camera.project(transform(T, np.column_stack([corners, np.zeros(len(corners))])))
    assert isinstance(target, Ball)
    return camera.project(replace(target, count=96).points_at(T))


def filled(border: Array) -> NDArray[np.bool_]:
    """Whether the middle of each fine pixel is inside a polygon (E, 2) [px], by the crossings to
    its left (OpenCV's fill is too wide).
    """
    a = (border + 0.5) * FINE - 0.5
    b, rows = np.roll(a, -1, axis=0), np.arange(FINE * CAMERA.height)[:, None]
    row, side = np.nonzero((a[:, 1] <= rows) != (b[:, 1] <= rows))
    share = (row - a[side, 1]) / (b[side, 1] - a[side, 1])
    column = np.ceil(a[side, 0] + share * (b[side, 0] - a[side, 0])).astype(int)
    toggles = np.zeros((FINE * CAMERA.height, FINE * CAMERA.width + 1), np.uint8)
    np.add.at(toggles, (row, np.clip(column, 0, FINE * CAMERA.width)), 1)
    return np.cumsum(toggles[:, :-1], axis=1, dtype=np.uint8) % 2 == 1


def painted(
    *borders: Array,
    color: tuple[int, int, int] = (220, 0, 0),
    hidden: tuple[int, int, int, int] | None = None,
) -> Picture:
    """A picture with filled outlines; hidden: a grey box (left, top, right, bottom) before them."""
    large = np.full((FINE * CAMERA.height, FINE * CAMERA.width, 3), (120, 128, 140), np.uint8)
    for border in borders:
        large[filled(border)] = color
    if hidden:
        left, top, right, bottom = (FINE * side for side in hidden)
        large[top:bottom, left:right] = 90
    return Picture(
        0.0,
        (
            np.asarray(
                cv2.resize(large, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA),
                np.uint8,
            ),
        ),
    )


def found(
    target: Target, picture: Picture, detector: RegionDetector | None = None, state: Any = None
) -> tuple[Any, Detection]:
    detector = detector or RegionDetector()
    return detector.detect(
        detector.init() if state is None else state, picture, None, CAMERA, target, RNG
    )


@pytest.mark.parametrize("turn_deg", [0.0, 27.0, 45.0, 63.0, 200.0])
def test_a_straight_border_is_measured_exactly(turn_deg: float):
    across = np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))])
    fine = 32
    v, u = (np.indices((fine * 20, fine * 20)) + 0.5) / fine - 0.5
    inside = (u - 9.6) * across[0] + (v - 9.3) * across[1] < 0
    cover = inside.reshape(20, fine, 20, fine).mean(axis=(1, 3))
    edge = edge_points(cover)
    edge = edge[((edge > 3) & (edge < 16)).all(axis=1)]  # not where the picture cuts it
    assert len(edge) > 8
    np.testing.assert_allclose((edge - [9.6, 9.3]) @ across, 0, atol=0.02)


@pytest.mark.parametrize("kind", ["whale", "l_shape", "disc", "ball"])
@pytest.mark.parametrize("T", [FACING, TURNED], ids=["facing", "turned"])
def test_the_outline_in_the_targets_order(kind: str, T: Array):
    target = Ball(pose=Pose(), radius=0.15) if kind == "ball" else shape(kind)
    state, detection = found(target, painted(border_of(target, T)))
    true = CAMERA.project(target.points_at(T))
    assert np.abs(detection.uv - true).max() < 0.15
    assert np.linalg.norm(centroid(detection.uv) - centroid(true)) < 0.05
    assert signed_area(detection.uv) == pytest.approx(signed_area(true), rel=2e-3)
    again = found(target, painted(border_of(target, T)), state=state)[1]
    np.testing.assert_allclose(again.uv, detection.uv, atol=0.01)


def test_a_window_is_enough_and_gives_the_same():
    target, detector, asked = shape("l_shape"), RegionDetector(), []
    picture = painted(border_of(target, TURNED))
    state, first = found(target, picture)
    regions = detector.regions_of_interest(state, CAMERA, target)
    assert regions is not None
    _, windowed = found(target, in_windows(picture, regions, asked), state=state)
    assert not asked
    np.testing.assert_allclose(windowed.uv, first.uv, atol=0.01)
    moved = painted(border_of(target, Pose(xyz=(-0.2, 0.1, 1.1)).T))
    _, searched = found(target, in_windows(moved, regions, asked), state=state)
    assert len(asked) == 1 and searched.seen.all()


@pytest.mark.parametrize("hidden", [(150, 60, 162, 180), (170, 100, 200, 130)])
def test_a_region_that_is_partly_hidden_is_lost(hidden: tuple[int, int, int, int]):
    for target in (shape(), Ball(pose=Pose(), radius=0.2)):
        picture = painted(border_of(target, Pose(xyz=(0, 0, 1)).T), hidden=hidden)
        assert not found(target, picture)[1].seen.any()


def test_a_remnant_is_no_region_that_lies_along_a_side_of_its_outline():
    for kind, T, hidden in (
        ("whale", FACING, (79, 104, 221, 161)),  # its border lay on an outline that was 3388 px off
        ("whale", TURNED, (131, 25, 184, 165)),  # 320 px
        ("l_shape", FACING, (121, 132, 206, 172)),  # 72152 px
        # the best homography folds the picture onto a line
        ("l_shape", FACING, (145, 51, 206, 172)),
    ):
        target = shape(kind)
        assert found(target, painted(border_of(target, T)))[1].seen.all()
        assert not found(target, painted(border_of(target, T), hidden=hidden))[1].seen.any()


def test_an_outline_is_bare_where_no_border_of_the_region_is_near():
    region = np.zeros((20, 40), np.uint8)
    region[5:15, 10:30] = 255
    sides = np.array([[10.0, 9], [29, 9], [20, 5], [20, 14]])
    for reach, off, share in [
        (2.5, 2.4, 0.0),
        (2.5, 9.0, 0.5),
        (2.5, 1000.0, 0.5),
        (2.5, np.nan, 0.5),
    ]:
        moved = sides + [[-off, 0], [0, 0], [0, -off], [0, 0]]
        assert bare_share(moved, region, reach) == share, off
    # within the region, but not at its border
    assert bare_share(np.array([[20.0, 9]]), region, 2.5) == 1


def test_a_region_that_reaches_the_pictures_border_is_lost():
    target = shape()
    assert not found(target, painted(border_of(target, Pose(xyz=(0.55, 0, 1)).T)))[1].seen.any()


def test_of_several_regions_the_one_that_has_the_targets_shape_and_hue_is_found():
    target = shape("l_shape")
    true = border_of(target, TURNED)
    larger = np.array([[10.0, 10], [150, 10], [150, 60], [10, 60]])
    picture = painted(larger, true)
    np.testing.assert_allclose(
        found(target, picture)[1].uv, CAMERA.project(target.points_at(TURNED)), atol=0.15
    )
    assert not found(replace(target, hue_deg=120.0), picture)[1].seen.any()


@pytest.mark.parametrize("goal_deg", [0, 90, 180, -90])
def test_a_shape_with_symmetry_is_turned_as_the_goal_shows_it(goal_deg: float):
    target, detector = shape("polygon"), RegionDetector()
    goal = Goal.of_points(
        CAMERA, target.points_at(Pose(xyz=(0, 0, 1), rpy_deg=(0, 0, goal_deg)).T), np.eye(4)
    )
    T = Pose(xyz=(0, 0, 1), rpy_deg=(10, 0, goal_deg + 30)).T
    _, detection = found(
        target, painted(border_of(target, T)), state=detector.begin(goal, CAMERA, target)
    )
    np.testing.assert_allclose(detection.uv, CAMERA.project(target.points_at(T)), atol=0.15)


def test_noise_moves_the_outline_little():
    target = shape()
    clean = painted(border_of(target, TURNED))
    assert clean.images[0] is not None
    noisy = clean.images[0] + np.random.default_rng(1).normal(0, 8, clean.images[0].shape)
    _, detection = found(target, Picture(0.0, (np.clip(noisy, 0, 255).astype(np.uint8),)))
    off = detection.uv - CAMERA.project(target.points_at(TURNED))
    assert np.sqrt((off**2).mean()) < 0.2


def test_what_it_cannot_work_with_is_refused():
    with pytest.raises(ParameterError, match="picture is missing"):
        RegionDetector().detect(RegionDetector().init(), None, None, CAMERA, shape(), RNG)
    with pytest.raises(ParameterError, match="must be a shape or a ball for detector region"):
        found(Square(pose=Pose(), side=0.3), painted())
