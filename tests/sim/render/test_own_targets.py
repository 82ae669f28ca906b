"""Pictures and solids of one's own: drawn alike by OpenGL and by rays, upright, in place, and found
to a fraction of a pixel.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.shortcuts import one_quick
from vstestbed.camera import (
    Camera,
    Catadioptric,
    Fisheye,
    Image,
    Perspective,
    Picture,
    SphericalCamera,
)
from vstestbed.core.geometry import Pose, inverse
from vstestbed.core.named_files import folder
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.opengl import OpenGLRenderer
from vstestbed.sim.render.rays import RayRenderer
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import Light, World
from vstestbed.targets import MeshTarget, PictureTarget, Target
from vstestbed.targets.markers import Disc, Sphere, Tag
from vstestbed.vision import Blobs, Tags

PAGE = {
    "file": str(folder("scenarios") / "targets" / "page.png"),
    "width": 0.6,
    "pose": Pose(xyz=(0, 0, 1)),
}
TAGS = {
    "at_px": ((129.5, 129.5), (1069.5, 129.5), (1069.5, 717.5), (129.5, 717.5)),
    "draw_markers": False,
}
PRINTED = PictureTarget(**PAGE, **TAGS, marker=Tag(family="aruco_4x4_50", size=0.09))
PART = {"file": str(folder("scenarios") / "targets" / "flange.stl"), "scale": 0.001}
FLANGE = MeshTarget(
    **PART,
    at=((-85, -85, 18), (85, -85, 18), (85, 85, 18), (-85, 85, 18)),
    pose=Pose(xyz=(0, 0, 1), rpy_deg=(180, 0, 0)),
    marker=Disc(radius=0.018),
)
VIEWS = (
    Pose(),
    Pose(xyz=(0.3, -0.1, -0.2), rpy_deg=(4, -15, 20)),
    Pose(xyz=(-0.2, 0.1, -0.5), rpy_deg=(-8, 12, 100)),
)


@contextmanager
def eyes(target: Target, camera: Camera, light: Light | None = None) -> Iterator[Any]:
    """The servo camera's pictures by both renderers, as a function of the camera's pose."""
    stage = Scene(
        SceneDescription(
            Free(start=FreeStart(nominal=Pose())),
            camera,
            target,
            World(floor_z=-20.0, light=light),
            step=0.002,
        ),
        camera.multisampling,
    )
    both = OpenGLRenderer(stage, camera), RayRenderer(stage, camera)

    def seen(view: Pose) -> list[Image]:
        stage.place(0.0, target.pose.T, np.zeros(0), view.T)
        return [eye.full_image().copy() for eye in both]

    yield seen
    stage.close()


def apart(images: list[Image]) -> np.ndarray:
    """The largest difference of a channel of each pixel [grey levels]."""
    return np.abs(np.subtract(*(image.astype(int) for image in images))).max(axis=-1)


LENSES = [
    Perspective(multisampling=4),
    Fisheye(width=500, height=500),
    Catadioptric(width=500, height=500),
    SphericalCamera(width=600, height=300),
]


@pytest.mark.parametrize("lens", one_quick(*LENSES), ids=lambda lens: lens.kind)
@pytest.mark.parametrize("target", [PRINTED, FLANGE], ids=["picture", "mesh"])
def test_both_renderers_draw_the_same(target: Target, lens: Camera):
    with eyes(target, lens) as seen:
        for view in (VIEWS[1], Pose(xyz=(0, 0, -3))):
            far = apart(seen(view))
            assert far.mean() < 0.5 and np.mean(far > 60) < 0.004


@pytest.mark.parametrize("view", VIEWS, ids=["frontal", "aslant", "turned"])
def test_tags_printed_in_a_picture_are_found_where_they_are(view: Pose):
    camera = Perspective(multisampling=4)
    true = camera.project(PRINTED.seen_from(inverse(PRINTED.pose.T) @ view.T))
    with eyes(PRINTED, camera) as seen:
        for image in seen(view):
            _, found = Tags().detect(
                Tags().init(),
                Picture(0.0, (image,)),
                None,
                camera,
                PRINTED,
                np.random.default_rng(0),
            )
            assert np.abs(found.uv - true).max() < 0.06


def test_coloured_dots_printed_in_a_picture_are_found_where_they_are(tmp_path: Path):
    places = [(150, 150), (650, 150), (650, 450), (150, 450)]
    page = np.full((600, 800, 3), 230, np.uint8)
    for (u, v), colour in zip(
        places, ((255, 0, 0), (127, 255, 0), (0, 255, 255), (127, 0, 255)), strict=True
    ):
        # 32 px, the hues 0, 90, 180 and 270
        cv2.circle(page, (u * 16, v * 16), 32 * 16, colour[::-1], -1, cv2.LINE_AA, 4)
    assert cv2.imwrite(str(tmp_path / "dots.png"), page)
    own = {"file": str(tmp_path / "dots.png"), "width": 0.8, "pose": Pose(xyz=(0, 0, 1))}
    target, camera = (
        PictureTarget(**own, at_px=tuple(places), draw_markers=False, marker=Disc(radius=0.032)),
        Perspective(multisampling=4),
    )
    with eyes(target, camera) as seen:
        for view in VIEWS[:2]:
            true = camera.project(target.seen_from(inverse(target.pose.T) @ view.T))
            for image in seen(view):
                _, found = Blobs().detect(
                    Blobs().init(),
                    Picture(0.0, (image,)),
                    None,
                    camera,
                    target,
                    np.random.default_rng(0),
                )
                assert np.abs(found.uv - true).max() < 0.15


def test_a_picture_is_upright_and_as_large_as_said(tmp_path: Path):
    page = np.full((300, 400, 3), 255, np.uint8)
    # red above left, blue below right
    page[:150, :200], page[150:, 200:] = (0, 0, 255), (255, 0, 0)
    assert cv2.imwrite(str(tmp_path / "quarters.png"), page)
    target = PictureTarget(
        file=str(tmp_path / "quarters.png"),
        width=0.8,
        draw_markers=False,
        lit=False,
        pose=Pose(xyz=(0, 0, 1)),
    )
    # 301 px to the metre at 1 m
    camera = Perspective(width=401, height=301, fovy_deg=2 * np.degrees(np.arctan(0.5)))
    with eyes(target, camera) as seen:
        for image in seen(Pose()):
            pixels = image.astype(int)
            for (u, v), colour in {
                (130, 100): (255, 0, 0),
                (270, 100): (255,) * 3,
                (130, 200): (255,) * 3,
                (270, 200): (0, 0, 255),
            }.items():
                assert np.abs(pixels[v, u] - colour).max() <= 2
            row, column = pixels[100, :, 0] > 250, pixels[:, 130, 0] > 250
            assert (
                np.abs(np.flatnonzero(row)[[0, -1]] - [200 - 0.4 * 301, 200 + 0.4 * 301]).max()
                <= 1.5
            )
            assert (
                np.abs(np.flatnonzero(column)[[0, -1]] - [150 - 0.3 * 301, 150 + 0.3 * 301]).max()
                <= 1.5
            )


def test_from_afar_a_fine_pattern_is_its_mean(tmp_path: Path):
    checks = (np.indices((512, 512)).sum(axis=0) % 2 * 255).astype(np.uint8)
    assert cv2.imwrite(str(tmp_path / "checks.png"), checks)
    target = PictureTarget(
        file=str(tmp_path / "checks.png"),
        width=1.0,
        draw_markers=False,
        lit=False,
        pose=Pose(xyz=(0, 0, 4)),
    )
    camera = Perspective(width=300, height=300)
    with eyes(target, camera) as seen:
        # 8 texels a pixel: without smoothing it would be black and white
        for image in seen(Pose(rpy_deg=(0, 0, 20))):
            assert (
                np.ptp(image[140:160, 140:160].astype(int)) <= 6
                and abs(image[150, 150, 0] - 127.5) < 8
            )


POSTER = PictureTarget(
    file="texture:poster", width=0.8, draw_markers=False, lit=False, pose=Pose(xyz=(0, 0, 1))
)


def area_mean(
    target: PictureTarget, lens: Perspective, T_camera_target: np.ndarray, fine: int
) -> np.ndarray:
    """The picture (H, W, 3), each pixel the mean of fine x fine points in it, by a homography from
    the file; NaN beside it.
    """
    file = np.asarray(cv2.imread(str(target.source)), np.float32)[..., ::-1]
    share = target.width / file.shape[1]
    A = np.array(
        [
            [share, 0, share * (1 - file.shape[1]) / 2],
            [0, share, share * (1 - file.shape[0]) / 2],
            [0, 0, 1],
        ]
    )
    K = np.array([[lens.f, 0, (lens.width - 1) / 2], [0, lens.f, (lens.height - 1) / 2], [0, 0, 1]])
    S = np.array([[fine, 0, (fine - 1) / 2], [0, fine, (fine - 1) / 2], [0, 0, 1]])
    H, size = S @ K @ T_camera_target[:3][:, [0, 1, 3]] @ A, (lens.width * fine, lens.height * fine)
    drawn = cv2.warpPerspective(
        file, H, size, borderMode=cv2.BORDER_CONSTANT, borderValue=(np.nan,) * 3
    )
    return drawn.reshape(lens.height, fine, lens.width, fine, 3).mean(axis=(1, 3))


def test_a_poster_is_sharp_and_in_its_place():
    """Without anisotropic sampling the last one has an RMS of 20 grey levels and is shifted by half
    a pixel.
    """
    for at, most_rms in (
        (Pose(xyz=(0, 0, 0.25)), 5.5),
        (Pose(xyz=(0.05, -0.03, 1.5), rpy_deg=(0, 0, 20)), 12),
        (Pose(xyz=(0, 0, 1), rpy_deg=(0, 65, 10)), 13),
        (Pose(xyz=(0, 0, 1.2), rpy_deg=(0, 80, 0)), 11),
    ):
        camera = Perspective(width=320, height=240, fovy_deg=51, anisotropy=8)
        true = area_mean(POSTER, camera, at.T, 6)
        inside = cv2.erode(np.isfinite(true[..., 0]).astype(np.uint8), np.ones((5, 5), np.uint8))
        grey = np.where(inside, true.mean(axis=-1), 0).astype(np.float32)
        with eyes(POSTER, camera) as seen:
            for image in seen(Pose.of(POSTER.pose.T @ inverse(at.T))):
                assert np.sqrt(np.mean((image - true)[inside > 0] ** 2)) < most_rms
                start = np.eye(2, 3, dtype=np.float32)
                _, found = cv2.findTransformECC(
                    grey,
                    image.mean(axis=-1).astype(np.float32),
                    start,
                    cv2.MOTION_TRANSLATION,
                    (3, 50, 1e-6),
                    inside,
                    1,
                )
                assert np.abs(found[:, 2]).max() < 0.05


def test_a_floor_is_sampled_once_up_to_the_horizon():
    """Software OpenGL that samples it aslant visits each of its tiles within a pixel: a picture
    from a centimetre above took minutes.
    """
    poses = (
        Pose(xyz=(0, 0, -19), rpy_deg=(135, 0, 0)),
        Pose(xyz=(0, 0, -19.99), rpy_deg=(90, 0, 40)),
    )
    pictures: list[list[Image]] = []
    for pose in poses:
        for anisotropy in (1, 8):
            with eyes(
                POSTER, Perspective(width=160, height=120, fovy_deg=51, anisotropy=anisotropy)
            ) as seen:
                pictures.append(seen(pose))
        once, aslant = pictures[-2:]
        assert len(np.unique(once[0][80:])) > 2
        assert np.array_equal(once, aslant)


@pytest.mark.parametrize(
    "light",
    [
        Light(direction=(1, 0, 1), brightness=0.7, ambient=0.2),
        Light(xyz=(-0.6, 0, 0.5), direction=(0.2, 0, 1), ambient=0.1),
    ],
)
def test_a_picture_is_lit_by_the_lamp(tmp_path: Path, light: Light):
    assert cv2.imwrite(str(tmp_path / "grey.png"), np.full((60, 80, 3), 200, np.uint8))
    target = PictureTarget(
        file=str(tmp_path / "grey.png"), width=1.0, draw_markers=False, pose=Pose(xyz=(0, 0, 1))
    )
    camera = Perspective(width=160, height=120, fovy_deg=40)
    x = (np.arange(160) - 79.5) / camera.f  # of the middle row, 1 m away
    to = (
        np.column_stack([-0.6 - x, 0 * x, 0 * x - 0.5])
        if light.xyz
        else np.tile([-1.0, 0, -1], (160, 1))
    )
    facing = -to[:, 2] / np.linalg.norm(to, axis=1)
    with eyes(target, camera, light) as seen:
        for image in seen(Pose()):
            assert (
                np.abs(
                    image[60, :, 0] - 200 * np.minimum(1, light.ambient + light.brightness * facing)
                ).max()
                < 2
            )


def test_a_highlight_is_where_the_lamp_is_mirrored(tmp_path: Path):
    assert cv2.imwrite(str(tmp_path / "grey.png"), np.full((60, 80, 3), 120, np.uint8))
    glossy = PictureTarget(
        file=str(tmp_path / "grey.png"),
        width=1.0,
        draw_markers=False,
        gloss=0.8,
        pose=Pose(xyz=(0, 0, 1)),
    )
    light = Light(direction=(0.2, 0, 1), brightness=0.6, ambient=0.1)
    with eyes(glossy, Perspective(width=160, height=120, fovy_deg=40), light) as seen:
        by_gl, by_rays = (image[60, :, 0].astype(int) for image in seen(Pose()))
    f = 60 / np.tan(np.radians(20))
    matte = 120 * (0.1 + 0.6 / np.hypot(1, 0.2))
    assert abs(int(by_gl.argmax()) - (79.5 - 0.2 * f)) < 4 and np.abs(by_gl - by_rays).max() < 4
    assert by_gl.max() == pytest.approx(matte + 0.8 * 0.6 * 255, abs=3)  # on whatever colour


@pytest.mark.parametrize(
    "marker", [Disc(radius=0.018), Sphere(radius=0.015)], ids=["disc", "sphere"]
)
@pytest.mark.parametrize("view", VIEWS[:2], ids=["frontal", "aslant"])
def test_markers_on_a_solid_are_found_where_they_are(marker: Disc | Sphere, view: Pose):
    target, camera = replace(FLANGE, marker=marker), Perspective(multisampling=4)
    true = camera.project(target.seen_from(inverse(target.pose.T) @ view.T))
    with eyes(target, camera) as seen:
        for image in seen(view):
            _, found = Blobs().detect(
                Blobs().init(),
                Picture(0.0, (image,)),
                None,
                camera,
                target,
                np.random.default_rng(0),
            )
            assert np.abs(found.uv - true).max() < 0.15


def test_discs_on_all_sides_of_a_solid_are_ellipses_of_their_own_planes():
    """The side of the neck is seen at the edge; the bias of each disc follows its own normal."""
    target = replace(FLANGE, at=((0, -100, 18), (100, 0, 18), (-70, 70, 0), (70, -70, 0)))
    camera, behind = (
        Perspective(multisampling=4, fovy_deg=40),
        Pose(xyz=(0.2, 0.1, 2.0), rpy_deg=(180, 10, 0)),
    )
    hidden = target.hides(inverse(target.pose.T) @ behind.T)
    np.testing.assert_array_equal(hidden, [True, True, False, False])
    with eyes(target, camera) as seen:
        for image in seen(behind):
            _, found = Blobs().detect(
                Blobs().init(),
                Picture(0.0, (image,)),
                None,
                camera,
                target,
                np.random.default_rng(0),
            )
            np.testing.assert_array_equal(np.isnan(found.uv[:, 0]), hidden)
