"""Things of marker colours that are no markers:
what geometry rules out steals no correspondence.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.shortcuts import one_quick
from tests.vision.conftest import TakePicture
from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, Pose, exp, rigid_error, transform
from vstestbed.targets.base import Square
from vstestbed.targets.markers import Disc
from vstestbed.vision import Blobs

CAMERA = Perspective()  # 640 x 480, f = 384 px
RNG = np.random.default_rng(0)
TARGET = Square(pose=Pose(), side=0.3, marker=Disc(radius=0.02))
COLORS = {0: "1 0 0", 1: ".5 1 0", 2: "0 1 1", 3: ".5 0 1"}
BALL = '<geom type="sphere" size="{r}" pos="{x} {y} {z}" rgba="{rgb} 1"/>'
SCREEN = '<geom type="box" size=".06 .06 .001" pos="{x} {y} {z}" rgba=".5 .5 .5 1"/>'


def _tilted(angle: float, about: float, t: tuple[float, float, float]) -> Array:
    T = exp(np.array([0, 0, 0, angle * np.cos(about), angle * np.sin(about), 0.3]))
    T[:3, 3] = t
    return T


FRONT = _tilted(0.3, 0.7, (0.02, -0.03, 1.0))


def _ball(marker: int, x: float, y: float, r: float = 0.022, z: float = 1.0) -> str:
    return BALL.format(r=r, x=x, y=y, z=z, rgb=COLORS[marker])


def _check(found, wanted: list[bool], T: Array) -> None:
    """What is reported is there, to half a pixel; nothing else is."""
    true = CAMERA.project(transform(T, TARGET.points))
    assert found.seen.tolist() == wanted
    assert np.abs(found.uv - true)[found.seen].max() < 0.5


def _seen(picture: TakePicture, T: Array, extra: str):
    return Blobs().detect(
        Blobs().init(), picture(TARGET, T, CAMERA, extra), None, CAMERA, TARGET, RNG
    )[1]


@pytest.mark.parametrize("radius", one_quick(0.015, 0.022, 0.05))
@pytest.mark.parametrize("markers", [(0,), (2,), (0, 1), (1, 3), (0, 1, 2, 3)], ids=str)
def test_from_the_first_picture_on(
    picture: TakePicture, markers: tuple[int, ...], radius: float
) -> None:
    # One decoy for each of the markers, larger and smaller than those, beside the target.
    extra = "".join(_ball(m, -0.4 + 0.2 * m, (-0.35, 0.33)[m % 2], radius) for m in markers)
    _check(_seen(picture, FRONT, extra), [True] * 4, FRONT)


def test_several_of_one_hue(picture: TakePicture) -> None:
    extra = "".join(_ball(1, x, 0.33) for x in (-0.3, 0.0, 0.3))
    _check(_seen(picture, FRONT, extra), [True] * 4, FRONT)


@pytest.mark.parametrize("marker", range(4))
@pytest.mark.parametrize(
    "pose", [FRONT, _tilted(0.5, 2.5, (-0.1, 0.05, 1.1))], ids=["front", "tilted"]
)
def test_a_decoy_beside_a_hidden_marker_is_not_it(
    picture: TakePicture, marker: int, pose: Array
) -> None:
    p = transform(pose, TARGET.points)[marker] * 0.9
    extra = SCREEN.format(x=p[0], y=p[1], z=p[2]) + _ball(
        marker, p[0] + 0.13, p[1], 0.02, pose[2, 3]
    )
    _check(_seen(picture, pose, extra), [i != marker for i in range(4)], pose)


def test_a_decoy_that_passes_in_front_of_a_marker_does_not_take_it_along(
    picture: TakePicture,
) -> None:
    blobs = Blobs()
    state, whole = blobs.init(), 0
    u, v, _ = transform(FRONT, TARGET.points)[2]
    for x in np.arange(-0.12, 0.12, 0.02):  # 8.5 px a frame, right through marker 2's window
        frame = picture(TARGET, FRONT, CAMERA, _ball(2, u * 0.9 + float(x), v * 0.9, 0.018, 0.9))
        state, found = blobs.detect(state, frame, None, CAMERA, TARGET, RNG)
        true = CAMERA.project(transform(FRONT, TARGET.points))
        assert found.seen[[0, 1, 3]].all()
        # While it covers a part, what is left may be taken whole: off by at most a third of a
        # marker's radius.
        assert np.abs(found.uv - true)[found.seen].max() < 2.6
        assert found.T_camera_target is not None
        assert rigid_error(found.T_camera_target, FRONT)[0] < 0.02
        whole += bool(found.seen[2])
    assert found.seen.all()
    assert whole > 4  # of 12: it is lost only while the two touch


@pytest.mark.parametrize("known", [True, False], ids=["tracked before", "first picture"])
def test_with_a_marker_hidden_none_jumps_to_decoys_of_all_hues(
    picture: TakePicture, known: bool
) -> None:
    """Three markers continue a pose that is known; without one any three blobs make a pose, and
    nothing is told from another.
    """
    blobs, p = Blobs(), transform(FRONT, TARGET.points)[0] * 0.9
    state = blobs.init()
    if known:
        state, _ = blobs.detect(
            state, picture(TARGET, FRONT, CAMERA, ""), None, CAMERA, TARGET, RNG
        )
    decoys = "".join(_ball(m, -0.45 + 0.3 * m, (-0.36, 0.36)[m % 2], 0.024) for m in range(4))
    extra = SCREEN.format(x=p[0], y=p[1], z=p[2]) + decoys
    _, found = blobs.detect(state, picture(TARGET, FRONT, CAMERA, extra), None, CAMERA, TARGET, RNG)
    if known:
        _check(found, [False, True, True, True], FRONT)
    else:
        assert not found.seen.any()


def test_tracked_windows_are_not_left_for_a_decoy_nearby(picture: TakePicture) -> None:
    blobs = Blobs()
    state = blobs.init()
    extra = _ball(
        0, transform(FRONT, TARGET.points)[0][0] + 0.06, transform(FRONT, TARGET.points)[0][1], 0.02
    )
    # marker 0 goes behind the decoy and comes back
    for shift in [*np.linspace(0, 0.05, 8), *np.linspace(0.05, 0, 8)]:
        T = FRONT.copy()
        T[0, 3] += shift
        state, found = blobs.detect(
            state, picture(TARGET, T, CAMERA, extra), None, CAMERA, TARGET, RNG
        )
        # a third of a marker's radius
        assert np.nanmax(np.abs(found.uv - CAMERA.project(transform(T, TARGET.points)))) < 2.6
        assert np.count_nonzero(found.seen) >= 2  # of three markers the areas may rule out one more
    assert found.seen.all()
