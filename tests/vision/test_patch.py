"""A poster tracked whole, in rendered pictures: how well, hidden, out of the picture, lost and
found, under other lenses and light.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from tests.vision.conftest import CAMERA, TakeScene
from tests.vision.parts import in_windows
from vstestbed.camera import Camera, Fisheye, Perspective, Picture, SphericalCamera
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Array, Pose, exp, transform
from vstestbed.sim.scene.world import Plate
from vstestbed.targets.base import Square
from vstestbed.targets.picture import PictureTarget
from vstestbed.vision import Detection, PatchDetector
from vstestbed.vision.patch import PatchState, normalised, template_of

RNG = np.random.default_rng(0)


@pytest.fixture(scope="module")
def poster(tmp_path_factory: pytest.TempPathFactory) -> PictureTarget:
    """Noise at many scales with discs and bars over it, .6 m wide."""
    rng = np.random.default_rng(0)
    image = np.zeros((600, 800, 3))
    for k in range(6):
        image += cv2.resize(
            rng.normal(size=(3 * 2**k, 4 * 2**k, 3)), (800, 600), interpolation=cv2.INTER_CUBIC
        )
    for _ in range(120):
        (x, y, r), colour = (
            rng.integers([0, 0, 8], [800, 600, 50]).tolist(),
            rng.uniform(-3, 3, 3).tolist(),
        )
        cv2.circle(image, (x, y), r, colour, -1) if rng.random() < 0.5 else cv2.rectangle(
            image, (x, y), (x + 2 * r, y + r), colour, -1
        )
    path = tmp_path_factory.mktemp("poster") / "poster.png"
    cv2.imwrite(str(path), np.clip(128 + 32 * image, 0, 255).astype(np.uint8))
    return PictureTarget(pose=Pose(), file=str(path), width=0.6, draw_markers=False)


def _view(tilt: float, spin: float, t: tuple[float, float, float], direction: float = 0.7) -> Array:
    T = exp(np.array([0, 0, 0, tilt * np.cos(direction), tilt * np.sin(direction), 0])) @ exp(
        np.array([0, 0, 0, 0, 0, spin])
    )
    T[:3, 3] = t
    return T


FRONT = _view(0.3, 0.2, (0.02, -0.03, 0.8))


def _detect(
    poster: PictureTarget, seen: Picture, camera: Camera = CAMERA, state: PatchState | None = None
) -> Detection:
    before = state or PatchDetector().init()
    return PatchDetector().detect(before, seen, None, camera, poster, RNG)[1]


def _known(poster: PictureTarget, T: Array, before: Array | None = None) -> PatchState:
    """The state after a picture from a pose, and one before it."""
    unit = template_of(poster.source, 0, poster.width, PatchDetector().texels).unit_m
    G, G_before = (
        None if at is None else normalised(at[:3][:, [0, 1, 3]] @ np.diag([unit, unit, 1]))
        for at in (T, before)
    )
    return PatchState(G, G_before, True, 0.0)


def _errors(poster: PictureTarget, found: Detection, T: Array, camera: Camera = CAMERA) -> Array:
    """Corners (4, 2) against the truth [px]."""
    return found.uv - camera.project(transform(T, poster.points))


def _changed(seen: Picture, change: Callable[[Array], Array]) -> Picture:
    images = tuple(
        None if i is None else np.clip(change(i.astype(float)) + 0.5, 0, 255).astype(np.uint8)
        for i in seen.images
    )
    return replace(seen, images=images)


@pytest.mark.parametrize(
    ("distance", "tilt", "sigma", "bias", "most"),
    one_quick(
        (0.6, 0.2, 0.0, 0.03, 0.15),
        (1.0, 0.5, 0.0, 0.03, 0.12),
        (1.0, 0.5, 2.0, 0.03, 0.12),
        (2.0, 0.3, 2.0, 0.04, 0.2),
    ),
)
def test_corners_are_found_to_a_tenth_of_a_pixel(
    poster: PictureTarget,
    scene_picture: TakeScene,
    distance: float,
    tilt: float,
    sigma: float,
    bias: float,
    most: float,
):
    rng, errors = np.random.default_rng(1), []
    for _ in range(3):
        spin, direction, x, y = rng.uniform([-3, -3, -0.03, -0.03], [3, 3, 0.03, 0.03])
        T = _view(tilt, spin, (x, y, distance), direction)
        seen = _changed(
            scene_picture(poster, T), lambda image: image + rng.normal(0, sigma, image.shape)
        )
        errors.append(_errors(poster, _detect(poster, seen), T))
    assert np.linalg.norm(np.mean(errors, axis=(0, 1))) < bias
    assert np.linalg.norm(errors, axis=-1).max() < most


def test_it_tracks_what_keypoints_no_longer_find(poster: PictureTarget, scene_picture: TakeScene):
    """At 74 degrees, from the views before, 2 degrees a picture."""
    before, last, now = (_view(tilt, 0.2, (0, 0, 1)) for tilt in (1.23, 1.265, 1.3))
    seen = scene_picture(poster, now)
    assert not _detect(poster, seen).seen.any()
    assert (
        np.abs(
            _errors(poster, _detect(poster, seen, state=_known(poster, last, before)), now)
        ).max()
        < 0.3
    )


def test_a_wrong_prediction_costs_nothing(poster: PictureTarget, scene_picture: TakeScene):
    """It moved by 25 px, and stands still now."""
    before = _view(0.3, 0.2, (-0.03, -0.03, 0.8))
    state = _known(poster, FRONT, before)
    assert (
        np.abs(
            _errors(poster, _detect(poster, scene_picture(poster, FRONT), state=state), FRONT)
        ).max()
        < 0.12
    )


def test_hidden_corners_are_known_by_the_others(poster: PictureTarget, scene_picture: TakeScene):
    # its left 40 %, with two corners
    plate = Plate(pose=Pose(xyz=(-0.17, 0, 0.6)), width=0.2, height=0.6)
    error = np.abs(
        _errors(
            poster,
            _detect(
                poster, scene_picture(poster, FRONT, CAMERA, (plate,)), state=_known(poster, FRONT)
            ),
            FRONT,
        )
    )
    assert error[1:3].max() < 0.25 and error.max() < 1.5


def test_out_of_the_picture_corners_are_extrapolated_until_too_little_is_seen(
    poster: PictureTarget, scene_picture: TakeScene
):
    beyond, gone = _view(0.2, 0.2, (0.38, 0, 0.7)), _view(0.2, 0.2, (0.72, 0, 0.7))
    found = _detect(poster, scene_picture(poster, beyond), state=_known(poster, beyond))
    assert not CAMERA.inside(found.uv).all() and np.abs(_errors(poster, found, beyond)).max() < 0.6
    assert not _detect(poster, scene_picture(poster, gone), state=_known(poster, gone)).seen.any()


def test_one_that_is_expected_outside_of_the_picture_is_lost(poster: PictureTarget):
    beside = _known(poster, _view(0.3, 0.2, (5.0, 0.0, 0.8)))
    grey = np.full((CAMERA.height, CAMERA.width, 3), 128, np.uint8)
    assert not _detect(poster, Picture(0.1, (grey,)), state=beside).seen.any()


def test_lost_and_found_again_at_the_next_search(poster: PictureTarget, scene_picture: TakeScene):
    there, d = scene_picture(poster, FRONT), PatchDetector(search_s=0.2)
    elsewhere = scene_picture(poster, _view(0.3, 1.8, (0.1, 0.05, 1.1)))
    state, found = d.detect(d.init(), there, None, CAMERA, poster, RNG)
    assert found.seen.all()
    empty = _changed(there, lambda image: 0 * image + 128)
    seen = []
    for t, what in (
        (0.24, empty),
        (0.28, elsewhere),
        (0.32, elsewhere),
        (0.48, elsewhere),
        (0.52, elsewhere),
    ):
        state, found = d.detect(state, replace(what, t=t), None, CAMERA, poster, RNG)
        seen.append(bool(found.seen.all()))
    assert seen == [False, False, False, True, True]  # it searched at 0.24 s, and again 0.2 s later


def test_light_that_changes_over_the_plane_does_not_move_it(
    poster: PictureTarget, scene_picture: TakeScene
):
    shade = np.linspace(0.35, 1, CAMERA.width)[None, :, None]
    seen = _changed(scene_picture(poster, FRONT), lambda image: 0.8 * shade * image + 15)
    assert np.abs(_errors(poster, _detect(poster, seen), FRONT)).max() < 0.3


@pytest.mark.parametrize(
    "camera",
    one_quick(
        Perspective(distortion=(-0.2, 0.05, 0.001, -0.002, 0.0)),
        Fisheye(),
        SphericalCamera(width=512, height=512, face_px=320),
    ),
    ids=["distorted", "fisheye", "spherical"],
)
def test_every_lens(poster: PictureTarget, scene_picture: TakeScene, camera: Camera):
    T = _view(0.3, 0.2, (0.15, -0.1, 0.5))
    found = _detect(poster, scene_picture(poster, T, camera), camera)
    assert np.abs(_errors(poster, found, T, camera)).max() < 0.2


def test_in_its_window_it_finds_the_same(poster: PictureTarget, scene_picture: TakeScene):
    far = _view(0.3, 0.2, (0.05, 0, 1.6))
    state, whole, asked = _known(poster, far), scene_picture(poster, far), []
    regions = PatchDetector().regions_of_interest(state, CAMERA, poster)
    assert regions is not None
    found = _detect(poster, in_windows(whole, regions, asked), state=state)
    assert np.abs(found.uv - _detect(poster, whole, state=state).uv).max() < 0.02 and not asked
    # not there: the whole picture of the same exposure is searched
    elsewhere = scene_picture(poster, _view(0.3, 0.2, (0.15, 0, 1.6)))
    assert (
        _detect(
            poster, in_windows(elsewhere, regions, asked), state=replace(state, searched_s=-1.0)
        ).seen.all()
        and asked
    )


def test_what_cannot_be_tracked_is_refused(poster: PictureTarget):
    with pytest.raises(
        ScenarioError,
        match=r"target: must be a picture for detector patch, which tracks it.*got 'square'",
    ):
        vs.load("arm_ibvs", {"detector": "patch"})
    d, black = PatchDetector(), Picture(0.0, (np.zeros((480, 640, 3), np.uint8),))
    with pytest.raises(ParameterError, match="must be a picture"):
        d.detect(d.init(), black, None, CAMERA, Square(pose=Pose(), side=0.3), RNG)
    with pytest.raises(ParameterError, match="detector patch needs one"):
        d.detect(d.init(), None, None, CAMERA, poster, RNG)
