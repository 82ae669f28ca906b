"""Pictures through lenses that see beyond a plane: markers where the lens projects them, no seams,
no face in vain.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.shortcuts import one_quick
from vstestbed.camera import Camera, Catadioptric, Fisheye, Picture, Regions, SphericalCamera
from vstestbed.camera.wide import Radial
from vstestbed.core.geometry import Array, Pose, direction
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.cube_map import cube_of
from vstestbed.sim.render.opengl import OpenGLRenderer, SceneCamera
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import World
from vstestbed.targets.base import Points
from vstestbed.targets.markers import Sphere
from vstestbed.vision import Blobs
from vstestbed.vision.blobs import BlobsState

LENSES = {
    "equidistant": Fisheye(width=640, height=640),
    "off centre": Fisheye(width=701, height=640, principal_px=(333.25, 310.5)),
    "kannala-brandt": Fisheye(width=640, height=640, coefficients=(-0.02, 0.003, -0.0004, 0.0)),
    "parabolic mirror": Catadioptric(width=640, height=640, xi=1.0),
    "hyperbolic mirror": Catadioptric(width=640, height=640, xi=0.8),
    "spherical": SphericalCamera(width=640, height=640),
}
NONE = np.zeros(0)
BALLS, RADIUS = 20, 0.045


def scattered(lens: Radial, seed: int) -> Array:
    """Directions all over what the lens sees, each ball clear of the others and of the rim, shape
    (BALLS, 3).
    """
    rng, out = np.random.default_rng(seed), []
    while len(out) < BALLS:
        cosine = rng.uniform(np.cos(lens.reach[1] - 0.1), 1.0)
        ray = direction(np.array([np.arccos(cosine), rng.uniform(-np.pi, np.pi)]))
        inside = lens.inside(lens.project(ray[None]), margin=15).all()
        if inside and all(ray @ other < np.cos(0.2) for other in out):
            out.append(ray)
    return np.array(out)


def stage_of(camera: Camera, points: Array) -> Scene:
    """The camera at the origin with unlit balls about it."""
    target = Points(
        at=tuple(map(tuple, points.tolist())), pose=Pose(), marker=Sphere(radius=RADIUS, lit=False)
    )
    stage = Scene(
        SceneDescription(
            Free(start=FreeStart(nominal=Pose())), camera, target, World(floor_z=-150.0), step=0.002
        ),
        camera.multisampling,
    )
    stage.place(0.0, np.eye(4), NONE, np.eye(4))
    return stage


@pytest.mark.parametrize("name", one_quick(*LENSES, every=3))
def test_rendered_balls_lie_where_the_lens_projects_them(name: str):
    lens = LENSES[name]
    points = scattered(lens, seed=1) * np.random.default_rng(2).uniform(0.9, 1.2, (BALLS, 1))
    stage = stage_of(lens, points)
    frame = Picture(0.0, OpenGLRenderer(stage, lens).images())
    # Balls all around leave no pose in one view: the bias of the centre, under .3 px, is taken from
    # the true one.
    state = BlobsState(T_camera_target=np.eye(4))
    rng = np.random.default_rng(0)
    found = Blobs().detect(state, frame, None, lens, stage.parts.target, rng)[1]
    stage.close()
    errors = found.uv - lens.project(points)
    assert found.seen.sum() >= BALLS - 1
    errors = errors[found.seen]
    # Balls of 4 to 9 px radius, one sample a pixel: .05 to .15 px of rounding. Half a pixel of
    # convention would show.
    assert np.median(np.linalg.norm(errors, axis=1)) < 0.15
    assert np.linalg.norm(errors, axis=1).max() < 0.5
    assert np.abs(errors.mean(axis=0)).max() < 0.06


@pytest.mark.parametrize("name", one_quick(*LENSES, every=3))
def test_the_own_picture_shows_them_there_too(name: str):
    # The picture that films show: for the spherical lens it is made of its panels for nothing else.
    lens = LENSES[name]
    points = scattered(lens, seed=3)
    stage = stage_of(lens, points)
    image = OpenGLRenderer(stage, lens).full_image()
    stage.close()
    u, v = np.rint(lens.project(points)).astype(int).T
    np.testing.assert_allclose(image[v, u], 255 * stage.parts.target.colors, atol=1)


@pytest.mark.parametrize("name", one_quick(*LENSES, every=3))
def test_a_world_of_one_colour_has_no_seams(name: str):
    lens = LENSES[name]
    stage = stage_of(lens, np.array([[0, 0, 990]]))  # beyond the far plane
    stage.model.tex_data[:] = 137
    image = OpenGLRenderer(stage, lens).full_image()
    stage.close()
    seen = cube_of(lens).owner >= 0
    grid = np.stack(np.meshgrid(np.arange(lens.width), np.arange(lens.height)), axis=-1).astype(
        float
    )
    np.testing.assert_array_equal(seen, np.isfinite(lens.ray(grid)[..., 0]))
    assert np.unique(image[seen]).size == 1
    assert image[seen][0, 0] > 100
    assert not image[~seen].any()  # black, which has no chroma


@pytest.mark.parametrize("name", LENSES)
def test_taps_never_leave_a_face(name: str):
    cube = cube_of(LENSES[name])
    for i, (face, patch) in enumerate(zip(cube.faces, cube.patches, strict=True)):
        at = patch.maps[0][cube.owner[patch.rows, patch.columns] == i]  # the left upper tap
        assert at.min() >= 0
        assert at[:, 0].max() + 1 < face.width
        assert at[:, 1].max() + 1 < face.height


def test_faces_are_as_fine_as_the_lens():
    # Equidistant, f px to the radian along theta everywhere, f theta / sin theta across: most at
    # the rim.
    lens = LENSES["equidistant"]
    front, *sides = cube_of(lens).faces
    end = lens.reach[1]
    assert 0.999 * lens.f < front.f < 1.05 * lens.f
    assert all(side.f == pytest.approx(lens.f * end / np.sin(end), rel=0.02) for side in sides)
    assert len(cube_of(Fisheye(fov_deg=80)).faces) == 1
    assert len(cube_of(SphericalCamera()).faces) == 6


@pytest.fixture
def renders(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the cameras that were drawn."""
    out: list[str] = []
    plain, make = SceneCamera.raw, SceneCamera.__init__

    def named(self: SceneCamera, stage: Scene, camera: str, *args: object) -> None:
        make(self, stage, camera, *args)
        self.__dict__["name"] = camera

    def counted(self: SceneCamera, *args: object) -> object:
        out.append(self.__dict__["name"])
        return plain(self, *args)

    monkeypatch.setattr(SceneCamera, "__init__", named)
    monkeypatch.setattr(SceneCamera, "raw", counted)
    return out


def window(uv: Array) -> tuple[int, int, int, int]:
    u, v = np.rint(uv).astype(int).tolist()
    return u - 8, v - 8, u + 9, v + 9


def test_only_faces_that_are_looked_at_are_drawn(renders: list[str]):
    lens = LENSES["equidistant"]
    points = direction(np.array([[0.1, 0.0], [1.4, 0.0], [np.pi / 4, 0.0], [1.4, np.pi / 2]]))
    stage = stage_of(lens, points)
    eye = OpenGLRenderer(stage, lens)
    for markers, faces in (
        ([0], {"eye"}),
        ([1], {"eye_right"}),
        ([2], {"eye", "eye_right"}),
        ([0, 3], {"eye", "eye_down"}),
    ):
        renders.clear()
        regions: Regions = (tuple(window(lens.project(points[i : i + 1])[0]) for i in markers),)
        image = eye.images(regions)[0]
        assert set(renders) == faces
        assert len(renders) == len(faces)
        assert not eye.whole
        for left, top, right, bottom in regions[0]:
            np.testing.assert_array_equal(
                image[top:bottom, left:right], eye.full_image()[top:bottom, left:right]
            )
    stage.close()


def test_only_panels_that_are_looked_at_are_drawn(renders: list[str]):
    lens = LENSES["spherical"]
    stage = stage_of(lens, np.array([[0, 0, 1.0]]))
    eye = OpenGLRenderer(stage, lens)
    some = eye.images(((), ((1, 1, 9, 9),), (), (), ((1, 1, 9, 9), (20, 20, 30, 30)), ()))
    assert renders == ["eye_right", "eye_up"]
    assert [image is not None for image in some] == [False, True, False, False, True, False]
    assert not eye.whole
    assert len([image for image in eye.images() if image is not None]) == 6
    assert eye.whole
    stage.close()
