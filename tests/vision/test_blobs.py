"""Blobs on rendered and on drawn pictures: how well, what is not seen, tracking."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.shortcuts import one_quick
from tests.vision.conftest import TakePicture
from tests.vision.parts import in_windows
from vstestbed.camera import Camera, Catadioptric, Perspective, Picture
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, exp, inverse, rigid_error, transform
from vstestbed.targets.base import Points, Square, Target
from vstestbed.targets.markers import Disc, Marker, Sphere
from vstestbed.vision import Blobs, Detection
from vstestbed.vision.colour import noise_level

CAMERA = Perspective()  # 640 x 480, f = 384 px
RNG = np.random.default_rng(0)


def _square(marker: Marker, side: float = 0.3) -> Square:
    return Square(pose=Pose(), side=side, marker=marker)


def _tilted(tilt: float, direction: float, spin: float, t: tuple[float, float, float]) -> Array:
    T = exp(np.array([0, 0, 0, tilt * np.cos(direction), tilt * np.sin(direction), 0])) @ exp(
        np.array([0, 0, 0, 0, 0, spin])
    )
    T[:3, 3] = t
    return T


FRONT = _tilted(0.3, 0.7, 0.2, (0.02, -0.03, 1.0))


def _poses(n: int) -> list[Array]:
    """Views from .7 to 1.3 m, tilted up to 45 degrees, turned every way,
    the whole target in view.
    """
    rng = np.random.default_rng(1)
    draws = rng.uniform([0, -3, -3, -0.1, -0.1, 0.7], [0.8, 3, 3, 0.1, 0.1, 1.3], (n, 6))
    return [_tilted(d[0], d[1], d[2], (d[3], d[4], d[5])) for d in draws]


def _detect(
    frame: Picture, target: Target, blobs: Blobs | None = None, camera: Camera = CAMERA
) -> Detection:
    blobs = blobs or Blobs()
    return blobs.detect(blobs.init(), frame, None, camera, target, RNG)[1]


def _errors(
    picture: TakePicture, target: Target, blobs: Blobs, camera: Perspective = CAMERA, n: int = 20
) -> Array:
    """Distances [px] of all markers in n views from the analytic projection; every marker must be
    seen.
    """
    errors = []
    for T in _poses(n):
        found = _detect(picture(target, T, camera), target, blobs, camera)
        assert found.seen.all()
        errors.append(
            np.linalg.norm(found.uv - camera.project(transform(T, target.points)), axis=1)
        )
    return np.concatenate(errors)


MARKERS = [Disc(radius=0.02), Disc(radius=0.06), Sphere(radius=0.02), Sphere(radius=0.06)]


@pytest.mark.parametrize("marker", MARKERS, ids=lambda m: f"{m.kind} {m.radius}")
def test_error_against_projection(picture: TakePicture, marker: Marker) -> None:
    # One sample a pixel: discs of 5 to 12 px radius have .04 to .1 px of rounding; an error of zero
    # would be the truth leaking.
    errors = _errors(picture, _square(marker), Blobs())
    assert np.median(errors) < 0.1
    assert errors.max() < 0.35
    assert errors.min() > 0


@pytest.mark.parametrize("marker", [Disc(radius=0.06), Sphere(radius=0.06)], ids=lambda m: m.kind)
def test_correction_of_the_centre_matters_for_large_markers(
    picture: TakePicture, marker: Marker
) -> None:
    with_it = np.median(_errors(picture, _square(marker), Blobs()))
    without = np.median(_errors(picture, _square(marker), Blobs(correct_centre=False)))
    assert with_it < 0.06
    assert without > 4 * with_it


@pytest.mark.parametrize(
    ("marker", "bound"),
    one_quick((Disc(radius=0.02), 0.06), (Sphere(radius=0.02), 0.1)),
    ids=["disc", "sphere"],
)
def test_grey_moments_with_multisampling(
    picture: TakePicture, marker: Marker, bound: float
) -> None:
    # A fixed threshold would be .27 px off towards the light on balls.
    camera = Perspective(multisampling=4)
    grey = _errors(picture, _square(marker), Blobs(moments="grey"), camera)
    binary = _errors(picture, _square(marker), Blobs(moments="binary"), camera)
    assert np.median(grey) < bound
    assert np.median(grey) < np.median(binary)


def test_pose_comes_with_the_detection(picture: TakePicture) -> None:
    target = _square(Disc(radius=0.02))
    found = _detect(picture(target, FRONT, CAMERA), target)
    assert found.p_camera is None
    assert found.T_camera_target is not None
    distance, angle = rigid_error(found.T_camera_target, FRONT)
    assert distance < 3e-3
    assert angle < 0.015


def test_markers_that_do_not_glow_keep_their_hue(picture: TakePicture) -> None:
    target = _square(Sphere(radius=0.05))
    for T in _poses(10):
        lit, glowing = (
            _detect(picture(target, T, CAMERA, lit=lit), target) for lit in (True, False)
        )
        assert lit.seen.all()
        assert glowing.seen.all()
        assert np.abs(lit.uv - glowing.uv).max() < 0.15


def test_twelve_markers(picture: TakePicture) -> None:
    at = tuple(
        (0.12 * i, 0.12 * j, 0.02 * ((i + j) % 3))
        for i, j in itertools.product(range(-2, 2), range(-1, 2))
    )
    target = Points(pose=Pose(), at=at, marker=Disc(radius=0.02))
    for T in _poses(5):
        found = _detect(picture(target, T, CAMERA), target)
        assert found.seen.all()
        assert (
            np.linalg.norm(found.uv - CAMERA.project(transform(T, target.points)), axis=1).max()
            < 0.35
        )


@pytest.mark.parametrize(
    "hues",
    [
        ("magenta", "yellow", "cyan", 215.0),
        ("red", "red", "green", "blue"),
        (0.0, 12.0, 24.0, 36.0),
    ],
)
def test_colours_of_ones_own_are_told_apart(
    picture: TakePicture, hues: tuple[str | float, ...]
) -> None:
    """Also two of one colour, by the pose that explains them,
    and four shades from red to yellow.
    """
    target = _square(Disc(radius=0.03, hues=hues))
    assert target.hues_deg == tuple(
        {"magenta": 300, "yellow": 60, "cyan": 180, "red": 0, "green": 120, "blue": 240}.get(h, h)
        for h in hues
    )
    for T in _poses(5):
        found = _detect(picture(target, T, CAMERA), target)
        assert (
            np.linalg.norm(found.uv - CAMERA.project(transform(T, target.points)), axis=1).max()
            < 0.35
        )


def test_another_number_of_colours_is_refused() -> None:
    with pytest.raises(
        ParameterError, match=r"marker\.hues must be 4 colours, one for each marker, or none"
    ):
        _square(Disc(hues=("red", "green")))


def test_twenty_four_markers_are_told_apart(picture: TakePicture) -> None:
    at = tuple((0.12 * i, 0.12 * j, 0.0) for i, j in itertools.product(range(-3, 3), range(-2, 2)))
    target = Points(pose=Pose(), at=at, marker=Disc(radius=0.02))
    T = Pose(xyz=(0.05, 0.05, 1.1), rpy_deg=(10, 10, 5)).T
    found = _detect(picture(target, T, CAMERA), target)
    assert found.seen.all()
    assert (
        np.linalg.norm(found.uv - CAMERA.project(transform(T, target.points)), axis=1).max() < 0.35
    )


# What is not seen


def test_cut_by_the_border_is_not_seen(picture: TakePicture) -> None:
    target = _square(Disc(radius=0.03))
    # half the picture is .833 m wide at 1 m: the right markers (at +.15) are cut, then outside
    for shift in (0.65, 0.68, 0.7, 0.8):
        T = Pose(xyz=(shift, 0, 1)).T
        true = CAMERA.project(transform(T, target.points))
        whole = CAMERA.inside(true, margin=0.03 * CAMERA.f + 1)
        found = _detect(picture(target, T, CAMERA), target)
        assert found.seen.tolist() == whole.tolist()
    assert not whole[1]


PLATE = '<geom type="box" size="{w} {w} .001" pos="{x} {y} {z}" rgba="{rgba}"/>'


def _plate(i: int, offset: float, T: Array, target: Target, rgba: str = ".5 .5 .5 1") -> str:
    """A small plate in front of marker i whose edge passes `offset` marker radii right of the
    centre: it hides what is left of it.
    """
    p, r = transform(T, target.points)[i], target.marker.radius
    w = 2 * r
    x, y, z = p[0] - w + offset * r, p[1], p[2] - 0.03
    return PLATE.format(w=w, x=x, y=y, z=z, rgba=rgba)


@pytest.mark.parametrize("offset", [-0.5, 0.0, 0.5])
@pytest.mark.parametrize("rgba", [".5 .5 .5 1", ".9 .1 .6 1"], ids=["grey", "coloured"])
def test_half_hidden_is_not_seen_and_spoils_nothing(
    picture: TakePicture, offset: float, rgba: str
) -> None:
    target = _square(Disc(radius=0.02))
    found = _detect(picture(target, FRONT, CAMERA, _plate(2, offset, FRONT, target, rgba)), target)
    assert found.seen.tolist() == [True, True, False, True]
    true = CAMERA.project(transform(FRONT, target.points))
    assert np.linalg.norm(found.uv - true, axis=1)[found.seen].max() < 0.35


@pytest.mark.study
def test_little_hidden_shifts_little(picture: TakePicture) -> None:
    # However much of a marker is hidden, what is reported is never off by more than about a pixel.
    target = _square(Disc(radius=0.02))
    true = CAMERA.project(transform(FRONT, target.points))
    for offset in np.arange(-1.2, 1.4, 0.1):
        found = _detect(
            picture(target, FRONT, CAMERA, _plate(0, float(offset), FRONT, target)), target
        )
        assert found.seen[1:].all()
        if found.seen[0]:
            assert np.linalg.norm(found.uv - true, axis=1)[0] < 1.2


def test_half_hidden_among_few_markers(picture: TakePicture) -> None:
    for at in (((0, 0, 0), (0.2, 0, 0), (0, 0.2, 0)), ((0, 0, 0), (0.2, 0, 0)), ((0, 0, 0),)):
        target = Points(pose=Pose(), at=at, marker=Disc(radius=0.025))
        assert _detect(picture(target, FRONT, CAMERA), target).seen.all()
        found = _detect(picture(target, FRONT, CAMERA, _plate(0, 0.0, FRONT, target)), target)
        assert found.seen.tolist() == [False] + [True] * (len(at) - 1)


def test_three_markers_have_a_pose_from_the_first_picture_on(picture: TakePicture) -> None:
    target = Points(pose=Pose(), at=((0, 0, 0), (0.3, 0, 0), (0, 0.3, 0)), marker=Disc(radius=0.03))
    right = 0
    for T in _poses(10):
        found = _detect(picture(target, T, CAMERA), target)
        assert found.seen.all()
        # noise can make two of the poses that three points leave one, and then none
        if found.T_camera_target is not None:
            assert rigid_error(found.T_camera_target, T)[1] < 0.1
            right += 1
    assert right >= 8


def test_behind_the_camera_and_no_target(picture: TakePicture) -> None:
    target = _square(Disc(radius=0.02))
    found = _detect(picture(target, Pose(xyz=(0, 0, -1)).T, CAMERA), target)
    assert not found.seen.any()
    assert found.T_camera_target is None


def test_smaller_things_of_the_same_hue_are_not_taken(picture: TakePicture) -> None:
    target = _square(Disc(radius=0.02))
    extra = '<geom type="sphere" size=".012" pos=".3 .2 1" rgba="1 0 0 1"/>'
    found = _detect(picture(target, FRONT, CAMERA, extra), target)
    assert found.seen.all()
    assert np.abs(found.uv - CAMERA.project(transform(FRONT, target.points))).max() < 0.3


# Tracking


def _path(n: int) -> list[Array]:
    """A camera that approaches, turns and sidesteps at up to 12 px a frame."""
    T, out = _tilted(0.4, 1.0, 0.3, (0.1, 0.05, 1.4)), []
    for k in range(n):
        out.append(T)
        T = (
            inverse(
                exp(
                    np.array([0.1 * np.sin(k / 6), 0.05, 0.5, 0.1, 0.4 * np.cos(k / 5), 0.6]) * 0.04
                )
            )
            @ T
        )
    return out


@pytest.mark.parametrize("camera", [CAMERA, Perspective(multisampling=4)], ids=["sharp", "smooth"])
def test_windows_give_the_same_bytes_as_the_whole_picture(
    picture: TakePicture, camera: Perspective, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, blobs = _square(Sphere(radius=0.02)), Blobs()
    frames = [picture(target, T, camera) for T in _path(25)]
    whole = [_detect(frame, target, blobs, camera) for frame in frames]
    state, _ = blobs.detect(blobs.init(), frames[0], None, camera, target, RNG)
    monkeypatch.setattr(Blobs, "_search", None)  # from here on, windows must do
    for frame, expected in zip(frames[1:], whole[1:], strict=True):
        state, found = blobs.detect(state, frame, None, camera, target, RNG)
        assert found.seen.all()
        assert found.uv.tobytes() == expected.uv.tobytes()


@pytest.mark.parametrize("camera", [CAMERA, Perspective(multisampling=4)], ids=["sharp", "smooth"])
def test_what_was_drawn_of_a_picture_does_not_change_what_is_found(
    picture: TakePicture, camera: Perspective
) -> None:
    target, blobs = _square(Sphere(radius=0.02)), Blobs()
    jump = inverse(exp(np.array([0, 0, 0, 0.15, -0.1, 0.3])))  # 60 px and more, without warning
    views = _path(6) + [jump @ T for T in _path(12)[6:]]
    state, asked, needed = blobs.init(), [], []
    for k, T in enumerate(views):
        whole = picture(target, T, camera)
        regions = blobs.regions_of_interest(state, camera, target)
        asked.clear()
        part = whole if regions is None else in_windows(whole, regions, asked)
        (state, found), (_, expected) = (
            blobs.detect(state, p, None, camera, target, RNG) for p in (part, whole)
        )
        assert found.seen.all() and found.uv.tobytes() == expected.uv.tobytes()
        needed += [k] if asked else []
    assert needed == [6, 7]  # the jump; and after it, since it was no steady motion


def test_motion_of_a_marker_is_remembered_while_it_is_lost(
    picture: TakePicture, monkeypatch: pytest.MonkeyPatch
) -> None:
    target, blobs = _square(Disc(radius=0.02)), Blobs()
    # 23 px a frame: more than the windows' margin
    steps = [Pose(xyz=(-0.3 + 0.06 * k, 0, 1)).T for k in range(7)]
    state = blobs.init()
    for k, T in enumerate(steps[:5]):
        frame = picture(
            target,
            T,
            CAMERA,
            PLATE.format(w=0.8, x=0, y=0, z=0.5, rgba=".5 .5 .5 1") if k == 3 else "",
        )
        state, found = blobs.detect(state, frame, None, CAMERA, target, RNG)
        assert found.seen.all() == (k != 3)
    monkeypatch.setattr(Blobs, "_search", lambda *_: pytest.fail("not in its window"))
    for T in steps[5:]:
        state, found = blobs.detect(state, picture(target, T, CAMERA), None, CAMERA, target, RNG)
        assert found.seen.all()


def test_lost_and_found_again(picture: TakePicture) -> None:
    target, blobs = _square(Disc(radius=0.02)), Blobs()
    state = blobs.init()
    screen = PLATE.format(w=0.4, x=0, y=0, z=0.5, rgba=".5 .5 .5 1")
    seen = []
    for k, T in enumerate(_path(12)):
        state, found = blobs.detect(
            state,
            picture(target, T, CAMERA, screen if 4 <= k < 8 else ""),
            None,
            CAMERA,
            target,
            RNG,
        )
        seen.append(int(found.seen.sum()))
    assert seen == [4] * 4 + [0] * 4 + [4] * 4


def test_marker_that_leaves_the_picture_and_comes_back(picture: TakePicture) -> None:
    target, blobs = _square(Disc(radius=0.02)), Blobs()
    state = blobs.init()
    for x in [*np.arange(0.5, 0.8, 0.02), *np.arange(0.8, 0.5, -0.02)]:
        T = Pose(xyz=(float(x), 0, 1)).T
        state, found = blobs.detect(state, picture(target, T, CAMERA), None, CAMERA, target, RNG)
        true = CAMERA.project(transform(T, target.points))
        whole = CAMERA.inside(true, margin=0.02 * CAMERA.f + 0.7)
        assert found.seen[whole].all()
        assert not found.seen[~CAMERA.inside(true, margin=0.02 * CAMERA.f - 0.7)].any()
        assert np.abs(found.uv - true)[found.seen].max() < 0.35


# Drawn pictures


def _drawn(
    centres: Array, colors: Array, radius: float, camera: Camera = CAMERA
) -> NDArray[np.uint8]:
    """Discs whose pixels are those with their centres inside, on grey."""
    image = np.full((camera.height, camera.width, 3), 110, np.uint8)
    v, u = np.mgrid[: camera.height, : camera.width]
    for (cu, cv), color in zip(centres, colors, strict=True):
        image[(u - cu) ** 2 + (v - cv) ** 2 <= radius**2] = np.round(255 * color)
    return image


def test_no_half_pixel_bias() -> None:
    target, blobs = _square(Disc(radius=0.02)), Blobs(correct_centre=False)
    rng = np.random.default_rng(2)
    offsets = []
    for _ in range(40):
        centres = CAMERA.project(transform(Pose(xyz=(0, 0, 1)).T, target.points)) + rng.uniform(
            -0.5, 0.5, 2
        )
        found = _detect(
            Picture(t=0.0, images=(_drawn(centres, target.colors, 7.68),)), target, blobs
        )
        assert found.seen.all()
        offsets.append(found.uv - centres)
    # 160 markers with .07 px of rounding: the mean is known within .006 px.
    assert np.abs(np.mean(offsets, axis=(0, 1))).max() < 0.02


def test_noise_in_the_picture() -> None:
    target = _square(Disc(radius=0.02))
    centres = CAMERA.project(transform(Pose(xyz=(0, 0, 1)).T, target.points))
    image = _drawn(centres, target.colors, 7.68).astype(float) + np.random.default_rng(0).normal(
        0, 8, (480, 640, 3)
    )
    found = _detect(
        Picture(t=0.0, images=(np.clip(np.round(image), 0, 255).astype(np.uint8),)), target
    )
    assert found.seen.all()
    assert np.abs(found.uv - centres).max() < 0.3


SIGMAS = (2.0, 8.0, 20.0)


def _noisy(frame: Picture, sigma: float, rng: np.random.Generator) -> Picture:
    noise = rng.normal(0.5, sigma, frame.image.shape)
    return Picture(t=0.0, images=(np.clip(frame.image + noise, 0, 255).astype(np.uint8),))


@pytest.mark.parametrize("sigma", [0.0, *SIGMAS])
def test_noise_is_estimated_from_the_picture(picture: TakePicture, sigma: float) -> None:
    image = _noisy(
        picture(_square(Sphere(radius=0.06)), FRONT, CAMERA), sigma, np.random.default_rng(3)
    ).image
    assert noise_level(image) == pytest.approx(sigma, rel=0.1)
    assert (noise_level(image) == 0) == (sigma == 0)


@pytest.mark.parametrize("height", [8, 16, 30, 31, 60])
def test_noise_of_a_low_picture(height: int) -> None:
    rng = np.random.default_rng(3)
    assert noise_level(np.full((height, 640, 3), 90, np.uint8)) == 0
    # one row of 640
    assert noise_level(rng.normal(90, 10, (height, 640, 3)).astype(np.uint8)) == pytest.approx(
        10, rel=0.2
    )


@pytest.mark.parametrize(
    "camera",
    [
        pytest.param(CAMERA, id="sharp"),
        pytest.param(Perspective(multisampling=4), id="smooth", marks=pytest.mark.study),
    ],
)
def test_centroids_scatter_with_the_noise(picture: TakePicture, camera: Perspective) -> None:
    target, blobs, rng = _square(Disc(radius=0.02)), Blobs(), np.random.default_rng(4)
    frames = [picture(target, T, camera) for T in _poses(20)]
    clean = [_detect(frame, target, blobs, camera).uv for frame in frames]
    scatter = []
    for sigma in SIGMAS:
        moved = np.array(
            [
                _detect(_noisy(frame, sigma, rng), target, blobs, camera).uv - uv
                for frame, uv in zip(frames, clean, strict=True)
            ]
        )
        assert np.count_nonzero(np.isfinite(moved).all(axis=(1, 2))) >= 0.95 * len(frames)
        assert (moved[np.isfinite(moved)] != 0).all()
        assert np.nanmax(np.abs(moved)) < 0.6
        # 80 markers: the mean of .06 px is known within .007
        assert np.abs(np.nanmean(moved, axis=(0, 1))).max() < 0.03
        scatter.append(float(np.nanstd(moved)))
    assert scatter[0] < scatter[1] < scatter[2] < 0.1
    assert scatter[2] > 1.5 * scatter[1]


@pytest.mark.parametrize("marker", one_quick(*MARKERS), ids=lambda m: f"{m.kind} {m.radius}")
def test_noise_does_not_shift_shaded_markers(picture: TakePicture, marker: Marker) -> None:
    target, rng = _square(marker), np.random.default_rng(5)
    errors = []
    for T in _poses(20):
        found = _detect(_noisy(picture(target, T, CAMERA), 8, rng), target)
        assert found.seen.all()
        errors.append(found.uv - CAMERA.project(transform(T, target.points)))
    assert np.median(np.linalg.norm(np.concatenate(errors), axis=1)) < 0.12
    assert np.abs(np.mean(errors, axis=(0, 1))).max() < 0.1


def test_much_noise_while_tracking(picture: TakePicture) -> None:
    target, blobs, rng = _square(Disc(radius=0.02)), Blobs(), np.random.default_rng(6)
    state, seen = blobs.init(), []
    for T in _path(40):
        frame = _noisy(picture(target, T, CAMERA), 20, rng)
        state, found = blobs.detect(state, frame, None, CAMERA, target, RNG)
        whole = _detect(frame, target, blobs)
        errors = np.array(
            [d.uv - CAMERA.project(transform(T, target.points)) for d in (found, whole)]
        )
        assert np.nanmax(np.abs(errors)) < 0.8
        seen.append([found.seen.all(), whole.seen.all()])
    assert np.mean(seen, axis=0).min() >= 0.95


def test_noise_alone_holds_no_markers() -> None:
    target, blobs, rng = _square(Disc(radius=0.02)), Blobs(), np.random.default_rng(7)
    grey = Picture(t=0.0, images=(np.full((CAMERA.height, CAMERA.width, 3), 128, np.uint8),))
    for sigma in SIGMAS:
        for _ in range(10):
            assert not _detect(_noisy(grey, sigma, rng), target, blobs).seen.any()


def test_grey_pictures_hold_no_markers() -> None:
    target, blobs = _square(Disc(radius=0.02)), Blobs()
    ramp = np.repeat(np.tile(np.arange(640) * 255 // 639, (480, 1))[..., None], 3, axis=2).astype(
        np.uint8
    )
    state, found = blobs.detect(
        blobs.init(), Picture(t=0.0, images=(ramp,)), None, CAMERA, target, RNG
    )
    assert not found.seen.any()
    assert state.blobs == (None,) * 4
    assert state.T_camera_target is None


def test_what_a_mirror_camera_cannot_see_is_no_marker() -> None:
    """Noise made blobs outside of the image circle, whose rays are unknown: with two of a hue, the
    search for a pose failed.
    """
    lens, target = Catadioptric(width=400, height=400, fov_deg=200), _square(Sphere(), 1.0)
    uv = lens.project(target.points + [0, 0, 1.0])
    corners = np.array([[15.0, 15], [385, 15], [385, 385], [15, 385]])
    assert np.isfinite(lens.ray(uv)).all() and np.isnan(lens.ray(corners)).all()
    both = _drawn(np.vstack([uv, corners]), np.vstack([target.colors, target.colors]), 6.0, lens)
    found = _detect(Picture(t=0.0, images=(both,)), target, Blobs(correct_centre=False), lens)
    # a corner would be 150 px off
    assert np.isfinite(found.uv).any() and np.nanmax(np.abs(found.uv - uv)) < 0.5
