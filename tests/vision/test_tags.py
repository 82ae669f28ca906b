"""Tags in rendered pictures: how well, what is not seen, tracking, the printed tags."""

from __future__ import annotations

from typing import get_args

import cv2
import numpy as np
import pytest

from tests.vision.conftest import CAMERA, TakeScene
from tests.vision.parts import in_windows
from vstestbed.camera import Perspective, Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, exp, rigid_error, transform
from vstestbed.sim.scene.world import Plate
from vstestbed.targets.base import Points, Square, Target
from vstestbed.targets.markers import Family, Marker, Tag
from vstestbed.vision import Detection, Tags
from vstestbed.vision.tags import dictionary, tag_picture

RNG = np.random.default_rng(0)


def _square(side: float = 0.3, marker: Marker | None = None) -> Square:
    return Square(pose=Pose(), side=side, marker=marker or Tag())


def _view(tilt: float, direction: float, spin: float, t: Array) -> Array:
    T = exp(np.array([0, 0, 0, tilt * np.cos(direction), tilt * np.sin(direction), 0])) @ exp(
        np.array([0, 0, 0, 0, 0, spin])
    )
    T[:3, 3] = t
    return T


FRONT = _view(0.3, 0.7, 0.2, np.array([0.02, -0.03, 1.0]))


def _views(n: int = 20, least_tilt: float = 0.0, most_tilt: float = 0.8) -> list[Array]:
    """From .7 to 1.3 m, turned every way."""
    low, high = [least_tilt, -3, -3, -0.1, -0.1, 0.7], [most_tilt, 3, 3, 0.1, 0.1, 1.3]
    return [
        _view(d[0], d[1], d[2], d[3:]) for d in np.random.default_rng(1).uniform(low, high, (n, 6))
    ]


def _detect(
    frame: Picture, target: Target, camera: Perspective = CAMERA, tags: Tags | None = None
) -> Detection:
    tags = tags or Tags()
    return tags.detect(tags.init(), frame, None, camera, target, RNG)[1]


def _errors(
    scene_picture: TakeScene, target: Target, views: list[Array], camera: Perspective = CAMERA
) -> Array:
    """Distances [px] of all centres from the analytic projection; every tag must be seen, in the
    target's order.
    """
    errors = []
    for T in views:
        found = _detect(scene_picture(target, T, camera), target, camera)
        assert found.seen.all()
        errors.append(
            np.linalg.norm(found.uv - camera.project(transform(T, target.points)), axis=1)
        )
    return np.concatenate(errors)


# How well. Measured over 40 views: median .008 px, at most .04 (tags of 19 to 75 px); the bounds
# are some three times that.


@pytest.mark.parametrize(
    "tag",
    [Tag(), Tag(lit=False), Tag(family="apriltag_16h5"), Tag(family="aruco_5x5_100", first_id=40)],
)
def test_error_against_projection(scene_picture: TakeScene, tag: Tag) -> None:
    errors = _errors(scene_picture, _square(marker=tag), _views())
    assert np.median(errors) < 0.02
    assert errors.max() < 0.12
    assert errors.min() > 0  # an error of zero would be the truth leaking


def test_error_at_forty_degrees(scene_picture: TakeScene) -> None:
    """The centroid of the corners would be off by perspective; crossed diagonals are not."""
    tilt, target = np.radians(40), _square(marker=Tag(size=0.15))
    views = _views(20, tilt, tilt)
    assert np.median(_errors(scene_picture, target, views)) < 0.03
    corners = [
        CAMERA.project(transform(T, target.points[:, None] + Tag(size=0.15).corners)) for T in views
    ]
    bias = [
        np.linalg.norm(c.mean(axis=1) - CAMERA.project(transform(T, target.points)), axis=1)
        for c, T in zip(corners, views, strict=True)
    ]
    assert np.median(bias) > 0.3


@pytest.mark.parametrize(
    "camera",
    [Perspective(multisampling=4), Perspective(distortion=(-0.2, 0.05, 0.001, -0.001, 0.0))],
    ids=["multisampled", "lens"],
)
def test_error_with_other_pictures(scene_picture: TakeScene, camera: Perspective) -> None:
    assert np.median(_errors(scene_picture, _square(), _views(10), camera)) < 0.05


def test_pose_from_all_corners(scene_picture: TakeScene) -> None:
    target = _square()
    for T in _views(10):
        found = _detect(scene_picture(target, T), target)
        assert found.T_camera_target is not None
        distance, angle = rigid_error(found.T_camera_target, T)
        assert distance < 0.5e-3
        assert angle < 2e-3


def test_one_tag_gives_the_pose(scene_picture: TakeScene) -> None:
    target = Points(pose=Pose(), at=((0.0, 0.0, 0.0),), marker=Tag(size=0.2))
    for T in _views(10):
        found = _detect(scene_picture(target, T), target)
        assert found.T_camera_target is not None
        assert rigid_error(found.T_camera_target, T)[0] < 2e-3


def test_noise_scatters_in_proportion(scene_picture: TakeScene) -> None:
    target, rng = _square(), np.random.default_rng(2)
    true, image = (
        CAMERA.project(transform(FRONT, target.points)),
        scene_picture(target, FRONT).image,
    )
    spread = []
    for sigma in (5.0, 10.0):
        errors = []
        for _ in range(20):
            noisy = np.clip(image + rng.normal(0, sigma, image.shape) + 0.5, 0, 255).astype(
                np.uint8
            )
            errors.append(_detect(Picture(0.0, (noisy,)), target).uv - true)
        spread.append(np.nanstd(errors))
    assert spread[0] < 0.05
    assert 1.5 < spread[1] / spread[0] < 2.7


def test_what_opencv_leaves_uncorrected(scene_picture: TakeScene) -> None:
    """Its own refinements of the same tags: a constant (+.43, +.43) px with `apriltag`; half a
    pixel and more inwards with others.
    """
    target, offsets, outward = _square(), [], []
    for how, out in (
        (cv2.aruco.CORNER_REFINE_APRILTAG, offsets),
        (cv2.aruco.CORNER_REFINE_CONTOUR, outward),
    ):
        settings = cv2.aruco.DetectorParameters()
        settings.cornerRefinementMethod = how
        detector = cv2.aruco.ArucoDetector(dictionary("apriltag_36h11"), settings)
        for T in _views(10):
            quads, numbers, _ = detector.detectMarkers(
                cv2.cvtColor(scene_picture(target, T).image, cv2.COLOR_RGB2GRAY)
            )
            for quad, number in zip(quads, np.asarray(numbers).ravel(), strict=True):
                true = CAMERA.project(transform(T, target.points[number] + Tag().corners))
                error = np.asarray(quad, float).reshape(4, 2) - true
                away = true - true.mean(axis=0)
                out.append(
                    error
                    if out is offsets
                    else (error * away).sum(axis=1) / np.linalg.norm(away, axis=1)
                )
    assert np.mean(np.concatenate(offsets), axis=0) == pytest.approx([0.43, 0.43], abs=0.03)
    assert np.mean(outward) == pytest.approx(-0.7, abs=0.15)


# Which is which, and what is not seen


def test_numbers_by_order_and_others_ignored(scene_picture: TakeScene) -> None:
    drawn = _square(marker=Tag(first_id=10))
    frame = scene_picture(drawn, FRONT)
    true = CAMERA.project(transform(FRONT, drawn.points))
    assert np.abs(_detect(frame, drawn).uv - true).max() < 0.1
    # its markers 0 and 1 are the picture's 2 and 3
    shifted = _detect(frame, _square(marker=Tag(first_id=12)))
    assert shifted.seen.tolist() == [True, True, False, False]
    assert np.abs(shifted.uv[:2] - true[2:]).max() < 0.1
    assert not _detect(frame, _square(marker=Tag(family="aruco_6x6_250", first_id=10))).seen.any()


@pytest.mark.parametrize("corner", [False, True])
@pytest.mark.parametrize("offset", [-0.45, -0.2, 0.0, 0.3])
def test_half_hidden_is_not_seen_and_spoils_nothing(
    scene_picture: TakeScene, offset: float, corner: bool
) -> None:
    """A plate before tag 2 whose right edge passes at `offset` tag sizes from its centre; or which
    only takes its lower left corner.
    """
    target, size = _square(), Tag().size
    p = transform(FRONT, target.points)[2]
    y = p[1] + (size * 0.75 if corner else 0.0)
    at = Pose(xyz=(float(p[0] - size / 2 + offset * size), float(y), float(p[2] - 0.03)))
    found = _detect(
        scene_picture(target, FRONT, CAMERA, (Plate(pose=at, width=size, height=size * 1.1),)),
        target,
    )
    true = CAMERA.project(transform(FRONT, target.points))
    if not corner or offset > -0.2:
        assert found.seen.tolist() == [True, True, False, True]
    assert np.linalg.norm(found.uv - true, axis=1)[found.seen].max() < 0.1
    assert found.T_camera_target is not None
    assert rigid_error(found.T_camera_target, FRONT)[0] < 1e-3


def test_a_small_thing_before_the_middle_is_not_read_over(scene_picture: TakeScene) -> None:
    target = _square()
    p = transform(FRONT, target.points)[1]
    plate = Plate(
        pose=Pose(xyz=(float(p[0]), float(p[1]), float(p[2] - 0.03))), width=0.03, height=0.03
    )
    assert _detect(scene_picture(target, FRONT, CAMERA, (plate,)), target).seen.tolist() == [
        True,
        False,
        True,
        True,
    ]


def test_cut_by_the_border_is_not_seen(scene_picture: TakeScene) -> None:
    target = _square()
    # half the picture is .833 m wide at 1 m; the right tags' edges lie at .15 +- .05
    for shift in np.arange(0.6, 0.85, 0.01):
        T = Pose(xyz=(float(shift), 0, 1)).T
        found = _detect(scene_picture(target, T), target)
        corners = CAMERA.project(transform(T, target.points[:, None] + Tag().corners))
        whole = CAMERA.inside(corners).all(axis=1)
        assert not (found.seen & ~whole).any()
        room = CAMERA.inside(corners, 5.0).all(axis=1)  # the quiet zone must show
        assert (found.seen | ~room).all()
        assert (
            not found.seen.any()
            or np.nanmax(np.abs(found.uv - CAMERA.project(transform(T, target.points)))) < 0.1
        )


def test_no_target(scene_picture: TakeScene) -> None:
    found = _detect(scene_picture(_square(), Pose(xyz=(0, 0, -1)).T), _square())
    assert not found.seen.any()
    assert found.T_camera_target is None


# Tracking


def test_windows_say_what_the_whole_picture_says(
    scene_picture: TakeScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    from vstestbed.vision import tags as module

    target, tags, looked = _square(side=0.4), Tags(), []
    read = module._read
    monkeypatch.setattr(
        module,
        "_read",
        lambda grey, window, *rest: looked.append(window) or read(grey, window, *rest),
    )
    state = tags.init()
    for k in range(12):
        T = _view(0.4, 0.1 * k, 0.03 * k, np.array([0.01 * k, 0.0, 1.3 - 0.02 * k]))
        frame = scene_picture(target, T)
        looked.clear()
        regions = tags.regions_of_interest(state, CAMERA, target)
        state, found = tags.detect(state, frame, None, CAMERA, target, RNG)
        assert len(looked) == (4 if k else 1)
        assert regions == ((tuple(looked),) if k else None)
        assert np.abs(found.uv - _detect(frame, target).uv).max() < 0.02


def test_a_jump_out_of_the_windows_is_found_in_the_whole_picture_and_its_motion_is_kept(
    scene_picture: TakeScene,
) -> None:
    target, tags, asked, needed = _square(), Tags(), [], []
    state, gone = tags.init(), np.array([3.0, 0.0, 1.2])
    places = (
        [np.array([x, 0.0, 1.2]) for x in (-0.3, -0.2, -0.1)]
        + [gone]
        + [np.array([x, 0.0, 1.2]) for x in (0.1, 0.2, 0.3)]
    )
    for k, t in enumerate(places):  # 32 px a frame: more than the windows' margin
        whole, regions = (
            scene_picture(target, _view(0.1, 0.0, 0.0, t)),
            tags.regions_of_interest(state, CAMERA, target),
        )
        asked.clear()
        part = whole if regions is None else in_windows(whole, regions, asked)
        state, found = tags.detect(state, part, None, CAMERA, target, RNG)
        assert found.seen.all() == (t is not gone)
        needed += [k] if asked else []
    # The first move; out of view. Found again in a whole picture, they are where their last known
    # motion takes them.
    assert needed == [1, 3]


def test_lost_and_found_again(scene_picture: TakeScene) -> None:
    target, tags = _square(), Tags()
    state, away = tags.init(), FRONT.copy()
    away[0, 3] += 0.65
    for T, seen in ((FRONT, 4), (away, 2), (FRONT, 4)):
        state, found = tags.detect(state, scene_picture(target, T), None, CAMERA, target, RNG)
        assert np.count_nonzero(found.seen) == seen
        assert found.T_camera_target is not None
        assert rigid_error(found.T_camera_target, T)[0] < 1e-3


# As printed


@pytest.mark.parametrize("family", get_args(Family))
def test_families_are_opencvs(family: str) -> None:
    tag, its = Tag(family=family), dictionary(family)  # pyright: ignore[reportArgumentType]
    assert (tag.modules, tag.count) == (its.markerSize + 2, len(its.bytesList))


def test_a_tag_with_its_quiet_zone() -> None:
    tag = Tag(size=0.08)
    image = tag_picture(tag, 3, px=4)
    assert image.shape == (40, 40)
    assert set(np.unique(image)) == {0, 255}
    assert (image[:4] == 255).all()
    assert (image[4:8, 4:-4] == 0).all()
    assert tag.tile == pytest.approx(0.1)
    assert tag.radius == pytest.approx(0.1 / np.sqrt(2))


def test_a_missing_picture_is_refused() -> None:
    tags = Tags()
    with pytest.raises(ParameterError, match="picture is missing"):
        tags.detect(tags.init(), None, None, CAMERA, _square(), RNG)
