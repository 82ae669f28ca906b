"""Pictures by rays: the same as OpenGL's, through any lens, only where somebody looks, on a machine
without OpenGL.
"""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.camera import Camera, Catadioptric, Fisheye, Perspective, Picture, SphericalCamera
from vstestbed.cli.pixel_convention import pixel_convention
from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.core.geometry import FLIP, Array, Pose, inverse, transform
from vstestbed.imaging.sensor import ImageNoise
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.sim import gl_probe as gl
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.opengl import OpenGLRenderer
from vstestbed.sim.render.pictures import servo_renderer
from vstestbed.sim.render.rays import BLANK, Caster, Raster, RayRenderer, RaySceneCamera
from vstestbed.sim.scene.meshes import LENS_GROUP, RANGE_GROUP
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import World
from vstestbed.targets.base import Points, Square, Target
from vstestbed.targets.markers import Disc, Sphere, Tag
from vstestbed.vision import Blobs
from vstestbed.vision.colour import noise_level

NONE = np.zeros(0)
BARREL = (-0.2, 0.05, 0.002, -0.001, 0.0)
ELSEWHERE = np.array([0.3, 0.2, 0.1, 0.3, 0.2, 0.4])
"""Joint angles by which the arm looks at other things [rad]."""


def free_stage(target: Target, camera: Camera) -> Scene:
    return Scene(
        SceneDescription(
            Free(start=FreeStart(nominal=Pose())), camera, target, World(floor_z=-20.0), step=0.002
        ),
        camera.multisampling,
    )


@pytest.fixture(scope="module")
def arm():
    """The arm's stage, placed by arm(offset of its joints [rad])."""
    s = vs.load("arm_ibvs")
    stage = Scene(s.scene)

    def placed(offset: Array | float = 0.0) -> Scene:
        stage.place(0.0, s.target.pose.T, s.robot.configuration() + offset)
        return stage

    yield placed
    stage.close()


@pytest.mark.parametrize(
    "marker",
    [
        Disc(radius=0.03),
        Disc(radius=0.03, lit=False),
        Sphere(radius=0.03),
        Sphere(radius=0.03, lit=False),
    ],
)
def test_markers_lie_where_opengl_draws_them(marker: Disc | Sphere):
    camera = Perspective(multisampling=4)
    target = Square(side=0.5, pose=Pose(xyz=(0, 0, 1)), marker=marker)
    stage = free_stage(target, camera)
    eyes = OpenGLRenderer(stage, camera), RayRenderer(stage, camera)
    views = (
        Pose(),
        Pose(xyz=(0.3, -0.1, -0.2), rpy_deg=(4, -15, 20)),
        Pose(xyz=(-0.2, 0.1, -0.6), rpy_deg=(-8, 10, 100)),
    )
    detector, differences = Blobs(), []
    for view in views:
        stage.place(0.0, target.pose.T, NONE, view.T)
        seen = [
            detector.detect(
                detector.init(),
                Picture(0.0, eye.images()),
                None,
                camera,
                target,
                np.random.default_rng(0),
            )
            for eye in eyes
        ]
        differences.append(seen[0][1].uv - seen[1][1].uv)
    stage.close()
    # The detector's own scatter on pictures of several samples a pixel is .02 to .04 px; half a
    # pixel would be 5 times this.
    assert np.abs(differences).max() < 0.1


@pytest.mark.parametrize(
    "lens",
    [Perspective(multisampling=4), Fisheye(width=640, height=640)],
    ids=["perspective", "fisheye"],
)
@pytest.mark.parametrize("far", [0.0, 2.0])
def test_tags_are_printed_as_opengl_prints_them(lens: Camera, far: float):
    target = Square(side=0.5, pose=Pose(xyz=(0, 0, 1)), marker=Tag(size=0.15))
    stage = free_stage(target, lens)
    eyes = OpenGLRenderer(stage, lens), RayRenderer(stage, lens)
    stage.place(0.0, target.pose.T, NONE, Pose(xyz=(0.3, -0.1, -far), rpy_deg=(4, -25, 20)).T)
    apart = np.abs(np.subtract(*(eye.full_image().astype(int) for eye in eyes))).max(axis=-1)
    stage.close()
    # of the tags: a sixth of the picture, and a thirtieth from afar
    assert apart.mean() < 0.5 and np.mean(apart > 40) < 0.003


@pytest.mark.parametrize(
    "offset", [np.zeros(6), ELSEWHERE, 2 * ELSEWHERE], ids=["start", "elsewhere", "far"]
)
def test_grey_levels_are_those_of_opengl(arm, offset: Array):
    stage = arm(offset)
    camera = stage.parts.camera
    by_gl, by_rays = (
        eye.full_image().astype(int)
        for eye in (OpenGLRenderer(stage, camera), RayRenderer(stage, camera))
    )
    apart = np.abs(by_gl - by_rays).max(axis=-1)
    # Only OpenGL smoothes the floor's far squares, draws highlights, and makes circles from 28
    # corners.
    assert np.median(apart) == 0
    assert apart.mean() < 1
    assert np.mean(apart > 8) < 0.01


def test_from_outside_too(arm):
    from vstestbed.sim.render.opengl import SceneCamera

    stage = arm(ELSEWHERE)
    by_gl = (
        SceneCamera(stage, "overview", 480, 270, shadows=False, style="outside")
        .full_image()
        .astype(int)
    )
    by_rays = RaySceneCamera(stage, "overview", 480, 270, samples=0).full_image()
    apart = np.abs(by_gl - by_rays).max(axis=-1)
    assert np.median(apart) == 0
    # an arm's length that is missing, or another arm, would be 2 % and more
    assert np.mean(apart > 10) < 0.01


def test_a_part_is_that_of_the_whole_picture_now(arm):
    stage = arm()
    view = RaySceneCamera(stage, "overview", 320, 180, samples=4)
    for step in range(3):
        arm(step * 0.1 * ELSEWHERE)
        part = view.part((90, 20, 260, 150))
        assert len(np.unique(part[20:150, 90:260].reshape(-1, 3), axis=0)) > 100  # the robot
        np.testing.assert_array_equal(part[20:150, 90:260], view.full_image()[20:150, 90:260])
        part[20:150, 90:260] = 0
        assert not part.any()


def test_rays_hit_what_single_rays_hit(arm):
    """`mj_multiRay` as it is misses the elbow and the hand from here (MuJoCo 3.17): see Caster."""
    stage = arm(ELSEWHERE)
    seen_from = stage.data.camera("overview")
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = seen_from.xmat.reshape(3, 3) @ FLIP[:3, :3], seen_from.xpos
    lens = Perspective(width=160, height=90, fovy_deg=38)
    grid = (
        np.stack(np.meshgrid(np.arange(160), np.arange(90)), axis=-1).reshape(-1, 2).astype(float)
    )
    rays = lens.ray(grid)
    groups, geom = np.ones(6, np.uint8), np.zeros(1, np.int32)
    groups[RANGE_GROUP] = False  # the ground for range finders is in no picture
    for outside in (True, False):
        groups[LENS_GROUP] = outside
        alone = []
        for ray in rays @ T[:3, :3].T:
            mujoco.mj_ray(stage.model, stage.data, T[:3, 3].copy(), ray, groups, 1, -1, geom)
            alone.append(int(geom[0]))
        np.testing.assert_array_equal(
            Caster(stage, outside).cast(T, np.split(rays, 12), np.zeros(len(rays)))[1], alone
        )
        assert len(set(alone)) > 10


@pytest.mark.parametrize("multisampling", [0, 4])
def test_windows_are_cut_from_the_whole_picture(arm, multisampling: int):
    stage = arm()
    eye = RayRenderer(stage, replace(stage.parts.camera, multisampling=multisampling))
    (whole,) = eye.images()
    windows = ((300, 100, 420, 180), (0, 0, 30, 40), (600, 430, 640, 480), (410, 150, 470, 200))
    (image,) = eye.images((windows,))
    assert whole is not None and image is not None
    blank = np.ones(image.shape[:2], dtype=bool)
    for left, top, right, bottom in windows:
        blank[top:bottom, left:right] = False
        np.testing.assert_array_equal(image[top:bottom, left:right], whole[top:bottom, left:right])
    assert (image[blank] == BLANK).all()
    assert eye.images(((),)) == (None,)


LENSES = [
    Fisheye(multisampling=4, width=800, height=800),
    Catadioptric(multisampling=4, width=800, height=800),
    SphericalCamera(multisampling=4, width=800, height=800),
    Perspective(multisampling=4, fovy_deg=90, distortion=BARREL),
]


@pytest.mark.parametrize("lens", one_quick(*LENSES), ids=lambda lens: lens.kind)
def test_twenty_balls_lie_where_the_lens_projects_them_by_both_renderers(lens: Camera):
    rng = np.random.default_rng(3)
    grid = np.stack(
        [rng.uniform(30, lens.width - 30, 4000), rng.uniform(30, lens.height - 30, 4000)], axis=-1
    )
    chosen: list[Array] = []
    # straight behind, a ball would be drawn out round the rim
    for uv in grid[lens.ray(grid)[:, 2] > -0.85]:
        if len(chosen) < 20 and all(np.linalg.norm(uv - other) > 60 for other in chosen):
            chosen.append(uv)
    assert len(chosen) == 20
    radius = 0.045 if isinstance(lens, SphericalCamera) else 0.015  # [m], 2 to 6 px
    balls = lens.ray(np.array(chosen)) * rng.uniform(1, 1.5, (20, 1))
    target = Points(
        at=tuple(map(tuple, balls.tolist())), pose=Pose(), marker=Sphere(radius=radius, lit=False)
    )
    stage = free_stage(target, lens)
    stage.place(0.0, np.eye(4), NONE, np.eye(4))
    pictures = [
        eye(stage, lens).full_image().astype(float) for eye in (RayRenderer, OpenGLRenderer)
    ]
    stage.close()
    np.testing.assert_allclose(lens.project(balls), chosen, atol=1e-6)
    wanted = np.array([outline_centre(lens, ball, radius) for ball in balls])
    found = []
    for picture in pictures:
        weight = picture.max(axis=-1) - picture.min(axis=-1)
        weight[weight < 60] = 0  # the sky's
        found.append(np.array([centroid(weight, *np.round(uv).astype(int)) for uv in wanted]))
        errors = np.linalg.norm(found[-1] - wanted, axis=1)
        assert np.median(errors) < 0.15
        assert errors.max() < 0.25
    # Two renderers that share no code but the lens: rays of its pixels, and its remapped faces of a
    # cube.
    assert np.median(np.linalg.norm(found[0] - found[1], axis=1)) < 0.1


def outline_centre(lens: Camera, ball: Array, radius: float) -> Array:
    """Centre of area [px] of a ball's picture:
    of the polygon through the rays that touch the ball.
    """
    distance = np.linalg.norm(ball)
    axis, half = ball / distance, np.arcsin(radius / distance)
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)[:, None]
    rays = np.cos(half) * axis + np.sin(half) * (
        np.cos(turn) * side + np.sin(turn) * np.cross(axis, side)
    )
    uv, middle = lens.project(rays), lens.project(ball)
    a, b = uv - middle, np.roll(uv, -1, axis=0) - middle
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return middle + ((a + b) * area[:, None]).sum(axis=0) / (3 * area.sum())


def centroid(weight: Array, u: int, v: int) -> Array:
    """Weighted centre [px] of the 41 x 41 pixels round (u, v)."""
    left, top = max(u - 20, 0), max(v - 20, 0)
    part = weight[top : v + 21, left : u + 21]
    y, x = np.mgrid[top : top + part.shape[0], left : left + part.shape[1]]
    return np.array([(part * x).sum(), (part * y).sum()]) / part.sum()


def test_balls_of_the_pixel_check_lie_where_they_should():
    errors, renderer = pixel_convention("rays")
    assert renderer == "rays (mj_multiRay)"
    assert np.abs(errors).max() < 0.1
    assert np.abs(errors.mean(axis=0)).max() < 0.03


def test_no_ray_is_black(arm):
    image = RayRenderer(arm(), Fisheye(width=64, height=64)).full_image()
    assert (image[0, 0] == 0).all()
    assert image[32, 32].min() > 0


def test_unlit_markers_have_exactly_their_colour():
    camera, target = (
        Perspective(),
        Square(side=0.5, pose=Pose(xyz=(0, 0, 1)), marker=Disc(radius=0.03, lit=False)),
    )
    stage = free_stage(target, camera)
    T = Pose(xyz=(0.3, -0.1, -0.2), rpy_deg=(4, -15, 20)).T
    stage.place(0.0, target.pose.T, NONE, T)
    u, v = (
        np.round(camera.project(transform(inverse(T) @ target.pose.T, target.points))).astype(int).T
    )
    assert np.abs(RayRenderer(stage, camera).full_image()[v, u] - 255 * target.colors).max() <= 1
    stage.close()


def test_with_noise_to_come_its_level_is_estimated_as_from_the_whole_picture(arm):
    stage = arm()
    eye = RayRenderer(stage, stage.parts.camera, noisy=True)
    rng = np.random.default_rng(5)
    for sigma in (1.0, 3.0, 9.0):
        noise = ImageNoise(sigma, rng).next()
        part, whole = (
            noise(eye.images(regions))[0] for regions in ((((300, 100, 420, 180),),), None)
        )
        assert part is not None and whole is not None and not np.array_equal(part, whole)
        assert noise_level(part) == noise_level(whole) > 0


class TestWhatRaysCannotDraw:
    def test_shadows(self, arm):
        camera = replace(arm().parts.camera, shadows=True)
        with pytest.raises(
            ParameterError, match=r"camera.renderer must be gl or auto: shadows need OpenGL"
        ):
            RayRenderer(arm(), replace(camera, renderer="rays"))
        with pytest.raises(
            EnvironmentLackError, match=r"shadows need OpenGL; .*install libegl1 libgl1"
        ):
            RayRenderer(arm(), camera)


class TestChoice:
    def test_each_word_is_heard(self, arm):
        camera = arm().parts.camera
        names = {
            word: servo_renderer(arm(), replace(camera, renderer=word)).name
            for word in ("auto", "gl", "rays")
        }
        assert names["auto"] == names["gl"] != names["rays"] == "rays (mj_multiRay)"

    @pytest.mark.opengl
    def test_auto_takes_rays_without_opengl_and_gl_does_not(
        self, arm, monkeypatch: pytest.MonkeyPatch
    ):
        from vstestbed.sim import gl_probe as gl

        monkeypatch.setenv("MUJOCO_GL", "disable")
        monkeypatch.setattr(gl, "_lack", [])
        camera = arm().parts.camera
        assert servo_renderer(arm(), camera).name == "rays (mj_multiRay)"
        with pytest.raises(EnvironmentLackError, match="no OpenGL: MUJOCO_GL=disable is set"):
            servo_renderer(arm(), replace(camera, renderer="gl"))
        with pytest.raises(
            EnvironmentLackError,
            match=r"shadows need OpenGL \(no OpenGL: MUJOCO_GL=disable is set\); unset MUJOCO_GL",
        ):
            servo_renderer(arm(), replace(camera, shadows=True))


def test_arm_ibvs_converges_with_the_same_bytes_each_time():
    scenario = vs.load("arm_ibvs", {"camera.renderer": "rays", "law.gain": 1.0})
    first, second = (
        vs.run(scenario),
        vs.run(replace(scenario, stop=replace(scenario.stop, duration_s=1.0))),
    )
    assert first.outcome.name == "converged"
    assert first.versions["renderer"] == "rays (mj_multiRay)"
    assert (
        len(second.table) > 20
        and first.table[: len(second.table)].tobytes() == second.table.tobytes()
    )
    assert first.summary()["frames_lost"] == 0
    # Markers as exactly found as in OpenGL's pictures of one sample a pixel.
    off = [first[f"{c}_{i}"] - first[f"{c}_true_{i}"] for c in "uv" for i in range(4)]
    assert np.median(np.abs(off)) < 0.1


@pytest.mark.parametrize(
    "latency_s",
    [0.0, pytest.param(0.04, marks=pytest.mark.study), pytest.param(0.1, marks=pytest.mark.study)],
)
def test_nothing_is_lost_for_looking_in_windows(latency_s: float):
    """However late pictures come: with some on their way, whole ones are cast."""
    settings = {
        "camera.renderer": "rays",
        "camera.latency_s": latency_s,
        "law.gain": 1.0,
        "stop.duration_s": 0.8,
    }
    recording = vs.run(vs.load("arm_ibvs", settings))
    assert recording.summary()["frames_lost"] == 0
    assert all(np.isfinite(recording[f"u_{i}"]).all() for i in range(4))


@pytest.mark.process
@pytest.mark.study
def test_a_machine_without_opengl_runs_films_and_all(tmp_path: Path, vstestbed_process):
    """The loader finds empty files in place of libEGL and libGL. A smaller picture and a higher
    gain, for time's sake.
    """
    (tmp_path / "fake").mkdir()
    for name in ("libEGL.so.1", "libGL.so.1"):
        (tmp_path / "fake" / name).touch()
    words, environment = vstestbed_process
    quick = [
        "law.gain=1.5",
        "camera.width=320",
        "camera.height=240",
        "camera.rate_hz=10",
        "stop.converged.error_px=0.4",
    ]
    words = [*words, "run", "arm_ibvs", "--out", "done", *[w for q in quick for w in ("--set", q)]]
    environment |= {"LD_LIBRARY_PATH": str(tmp_path / "fake")}
    done = subprocess.run(
        words, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    lines = done.stderr.splitlines()
    lack = "no OpenGL: libEGL.so.1 and libGL.so.1 not found"
    assert lines[0].startswith(
        "films by rays are small, 320 x 180 from outside with 5 pictures a second; --fine"
    )
    assert lines[1] == f"{lack}; rays draw the pictures instead, without shadows; {gl.remedy()}"
    assert lines[2].startswith("converged: ")
    summary = json.loads((tmp_path / "done" / "summary.json").read_text())
    assert (summary["outcome"], summary["versions"]["renderer"]) == (
        "converged",
        "rays (mj_multiRay)",
    )
    assert all(
        (tmp_path / "done" / name).stat().st_size > 10000
        for name in ("camera.mp4", "overview.mp4", "report.html")
    )


def test_a_raster_of_one_row_knows_how_far_its_rays_are_apart() -> None:
    flat = Raster(Perspective(width=640, height=8), np.eye(3), 0, 0.1)
    assert flat.apart.shape == (1, 64)
    assert np.all(flat.apart > 0)
