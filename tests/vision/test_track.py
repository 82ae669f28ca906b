"""Blobs in a camera with panels: counted once, handed over at a seam, looked for where they may
turn up.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.shortcuts import one_quick
from vstestbed.camera import Perspective, Picture, SphericalCamera
from vstestbed.core.geometry import Array, Pose, direction, exp, inverse, rigid_error, transform
from vstestbed.targets.base import Points, Square, Target
from vstestbed.targets.markers import Sphere
from vstestbed.vision import Blobs, Oracle, TruthView
from vstestbed.vision.blobs import BlobsState, hand_over, regions_of

RNG = np.random.default_rng(0)
CAMERA = SphericalCamera(width=640, height=640)
PANEL = CAMERA.panels[0].lens
FRONT, RIGHT, BACK, LEFT, UP, DOWN = range(6)
TARGET = Square(pose=Pose(), side=0.4, marker=Sphere(radius=0.05))


def drawn(target: Target, T: Array, panels: tuple[int, ...] = (0, 1, 2, 3, 4, 5)) -> Picture:
    """Panels with the target's spheres, one sample a pixel: the rays that meet one (|ray x p| <=
    radius, p before the lens).
    """
    grid = (
        np.stack(np.meshgrid(np.arange(CAMERA.face_px), np.arange(CAMERA.face_px)), axis=-1)
        .reshape(-1, 2)
        .astype(float)
    )
    images: list[NDArray[np.uint8] | None] = []
    for i, panel in enumerate(CAMERA.panels):
        if i not in panels:
            images.append(None)
            continue
        rays = panel.lens.ray(grid) @ panel.R_camera_panel.T
        image = np.full((CAMERA.face_px**2, 3), 120, np.uint8)
        for p, rgb in zip(transform(T, target.points), target.colors, strict=True):
            meets = (np.linalg.norm(np.cross(rays, p), axis=1) <= target.marker.radius) & (
                rays @ p > 0
            )
            image[meets] = np.rint(255 * rgb)
        images.append(image.reshape(CAMERA.face_px, CAMERA.face_px, 3))
    return Picture(0.0, tuple(images), whole=len(panels) == 6)


def placed(theta: float, phi: float, distance: float = 1.2) -> Array:
    """A square pose T_camera_target whose middle lies in that direction, facing the camera, turned
    a little.
    """
    ray = direction(np.array([theta, phi]))
    x = np.cross([0.0, 1.0, 0.0], ray)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.stack([x, np.cross(ray, x), ray], axis=1), distance * ray
    return T @ Pose(rpy_deg=(5, -8, 20)).T


def errors(uv: Array, T: Array) -> Array:
    """Angles [rad] between measured and true directions."""
    p = transform(T, TARGET.points)
    true = p / np.linalg.norm(p, axis=1, keepdims=True)
    return np.linalg.norm(np.cross(CAMERA.ray(uv), true), axis=1)


@pytest.mark.parametrize("theta", one_quick(0.02, 0.78, 1.57, 2.36, 3.1, every=2))
@pytest.mark.parametrize("phi", [0.1, 0.78, 2.0, -1.57])
def test_markers_all_around_are_found_once_and_exactly(theta: float, phi: float):
    blobs, T = Blobs(), placed(theta, phi)
    _, found = blobs.detect(blobs.init(), drawn(TARGET, T), None, CAMERA, TARGET, RNG)
    assert found.seen.all()
    assert found.T_camera_target is not None
    # Balls of 4.5 px radius, one sample a pixel: .1 px of rounding, .9 mrad in the middle of a
    # panel.
    assert np.median(errors(found.uv, T)) < 1.6e-3
    assert errors(found.uv, T).max() < 3e-3
    distance, angle = rigid_error(found.T_camera_target, T)
    assert distance < 0.03
    assert angle < 0.06


def test_three_markers_behind_have_a_pose_from_the_first_picture_on():
    target = Points(
        pose=Pose(), at=((0, 0, 0), (0.5, 0, 0), (0, 0.5, 0)), marker=Sphere(radius=0.06)
    )
    T = placed(2.6, 0.5)
    found = Blobs().detect(BlobsState(), drawn(target, T), None, CAMERA, target, RNG)[1]
    assert found.T_camera_target is not None
    assert rigid_error(found.T_camera_target, T)[0] < 0.05


def turning(rate: float, n: int) -> list[Array]:
    """A camera that turns about its own y by `rate` rad a frame, more and more: the target wanders
    round it.
    """
    T, out = placed(0.3, 0.2), []
    for k in range(n):
        out.append(T)
        T = inverse(exp(np.array([0, 0, 0, 0.005, rate * min(1, k / 5), 0.01]))) @ T
    return out


def test_over_the_seams_all_around_with_the_panels_asked_for(monkeypatch: pytest.MonkeyPatch):
    blobs, asked, homes = Blobs(), [], set()
    state, _ = blobs.detect(
        blobs.init(), drawn(TARGET, placed(0.3, 0.2)), None, CAMERA, TARGET, RNG
    )
    monkeypatch.setattr(Blobs, "_search", lambda *_: pytest.fail("a marker was lost"))
    for T in turning(-0.13, 52):
        regions = blobs.regions_of_interest(state, CAMERA, TARGET)
        assert regions is not None
        panels = tuple(i for i, windows in enumerate(regions) if windows)
        state, found = blobs.detect(state, drawn(TARGET, T, panels), None, CAMERA, TARGET, RNG)
        assert found.seen.all()
        assert errors(found.uv, T).max() < 4e-3
        asked.append(len(panels))
        homes.update(state.panels)
    assert homes >= {FRONT, RIGHT, BACK, LEFT}
    assert max(asked) <= 4
    assert np.mean(asked) < 3


def test_a_jump_beyond_the_window_is_found_in_the_same_pictures():
    blobs = Blobs()
    state, _ = blobs.detect(
        blobs.init(), drawn(TARGET, placed(0.6, 0.0)), None, CAMERA, TARGET, RNG
    )
    regions = blobs.regions_of_interest(state, CAMERA, TARGET)
    assert regions is not None
    panels = tuple(i for i, windows in enumerate(regions) if windows)
    assert panels == (FRONT, RIGHT)  # .2 rad from the seam at pi/4
    T = placed(0.85, 0.0)  # a quarter of a radian in one frame, without warning
    assert blobs.detect(state, drawn(TARGET, T, panels), None, CAMERA, TARGET, RNG)[1].seen.all()


def test_handed_over_only_where_the_border_is_near():
    blobs, T = Blobs(), placed(0.2, 0.0)
    state, _ = blobs.detect(blobs.init(), drawn(TARGET, T), None, CAMERA, TARGET, RNG)
    assert state.panels == (FRONT,) * 4
    assert hand_over(state, CAMERA, 8) == state
    assert regions_of(state, CAMERA, 8) is not None
    assert [len(w) for w in regions_of(state, CAMERA, 8) or ()] == [4, 0, 0, 0, 0, 0]
    moving = BlobsState(state.blobs, ((110.0, 0.0),) * 4, None, None, state.panels)
    moved = hand_over(moving, CAMERA, 8)
    assert RIGHT in moved.panels
    for before, after, home, now in zip(
        moving.blobs, moved.blobs, moving.panels, moved.panels, strict=True
    ):
        assert before is not None
        assert after is not None
        rays = [
            CAMERA.panels[i].R_camera_panel @ PANEL.ray(np.array([[b.u, b.v]]))[0]
            for b, i in ((before, home), (after, now))
        ]
        np.testing.assert_allclose(rays[0], rays[1], atol=1e-12)


def test_the_oracle_sees_all_around_and_a_perspective_camera_does_not():
    p = transform(placed(2.8, 1.0), TARGET.points)
    view = TruthView(p, np.zeros(4, dtype=bool))
    for camera, seen in ((CAMERA, True), (Perspective(), False)):
        found = Oracle().detect(None, None, view, camera, TARGET, RNG)[1]
        assert (found.seen == seen).all()
    straight_back = TruthView(np.array([[0, 0, -1.0]] * 4), np.zeros(4, dtype=bool))
    assert Oracle().detect(None, None, straight_back, CAMERA, TARGET, RNG)[1].seen.all()
