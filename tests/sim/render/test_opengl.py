"""Pictures: pixels where the camera model says, exact colours, the same bytes each time."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Perspective
from vstestbed.cli.pixel_convention import BALLS, pixel_convention
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import FLIP, Array, Pose, inverse, transform
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.opengl import OpenGLRenderer
from vstestbed.sim.scene.compose import compose
from vstestbed.sim.scene.scene import Scene
from vstestbed.sim.scene.world import World
from vstestbed.targets.base import Square, Target
from vstestbed.targets.markers import Disc

BARREL = (-0.2, 0.05, 0.002, -0.001, 0.0)
NONE = np.zeros(0)


def free_parts(camera: Perspective, target: Target) -> SceneDescription:
    return SceneDescription(
        Free(start=FreeStart(nominal=Pose())), camera, target, World(floor_z=-20.0), step=0.002
    )


@pytest.mark.parametrize(
    "camera",
    [
        Perspective(multisampling=4),
        Perspective(multisampling=4, principal_px=(300.25, 255.5)),
        Perspective(
            multisampling=4, focal_length_m=0.004, pixel_size_m=1e-5, width=601, height=499
        ),
        Perspective(multisampling=4, principal_px=(330.0, 230.0), distortion=BARREL),
    ],
    ids=["fovy", "principal", "focal", "distorted"],
)
def test_rendered_balls_lie_where_the_camera_projects_them(camera: Perspective):
    errors, _ = pixel_convention("gl", camera)
    assert errors.shape == (12, 2)
    # The project's promise with multisampling; half a pixel of convention or a flipped offset would
    # be 5 times that.
    assert np.abs(errors).max() < 0.1
    # And no constant part: twelve balls' noise of .03 px each, averaged.
    assert np.abs(errors.mean(axis=0)).max() < 0.03


def test_the_distorted_case_is_really_distorted():
    plain, lens = (
        Perspective(principal_px=(330.0, 230.0)),
        Perspective(principal_px=(330.0, 230.0), distortion=BARREL),
    )
    balls = np.array(BALLS) + [0, 0, 1.2]
    # By the model, the balls of the check above move by up to this much: 50 times its tolerance.
    assert np.abs(lens.project(balls) - plain.project(balls)).max() > 5
    corner = np.array([[0.0, 0.0]])
    # k1 r^2 = -.13 at the corner's r = .8 (384 px focal length): tens of pixels.
    assert np.linalg.norm(lens.normalise(corner) - plain.normalise(corner)) * plain.f > 30


def scenery_of(folder: Path, materials: int, textures: int) -> Path:
    """An MJCF file with a ball of so many materials and textures."""
    made = [f'<material name="m{i}"/>' for i in range(materials)]
    made += [
        f'<texture name="t{i}" type="2d" builtin="flat" width="1" height="1"/>'
        for i in range(textures)
    ]
    ball = '<geom name="ball" type="sphere" size="0.01" pos="0 0 0.5" material="m0"/>'
    path = folder / f"{materials}_{textures}.xml"
    path.write_text(f"<mujoco><asset>{''.join(made)}</asset><worldbody>{ball}</worldbody></mujoco>")
    return path


@pytest.mark.opengl
@pytest.mark.parametrize(("what", "most"), [("materials", 997), ("textures", 1000)])
def test_a_scene_of_more_than_mujoco_draws_is_told_as_such(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, what: str, most: int
):
    plain = Scene(_parts_with(scenery_of(tmp_path, 1, 1)))
    others = {"materials": plain.model.nmat, "textures": plain.model.ntex}[what] - 1
    plain.close()
    full, over = (
        scenery_of(tmp_path, *((n, 1) if what == "materials" else (1, n)))
        for n in (most - others, most - others + 1)
    )
    drawn = vs.run(vs.load("arm_ibvs", {"world.scenery": str(full), "stop.duration_s": 0.05}))
    assert "rays" not in drawn.versions["renderer"] and "OpenGL does not work" not in caplog.text
    words = (
        f"^world.scenery makes a scene of {most + 1} {what},"
        f" and MuJoCo draws at most {most} by OpenGL; .* camera.renderer=rays$"
    )
    with pytest.raises(ParameterError, match=words):
        vs.run(vs.load("arm_ibvs", {"world.scenery": str(over), "stop.duration_s": 0.05}))
    by_rays = {"world.scenery": str(over), "camera.renderer": "rays", "stop.duration_s": 0.05}
    assert "rays" in vs.run(vs.load("arm_ibvs", by_rays)).versions["renderer"]


def _parts_with(scenery: Path) -> SceneDescription:
    s = vs.load("arm_ibvs", {"world.scenery": str(scenery)})
    return s.scene


def test_mujocos_own_projection_agrees():
    s = vs.load("arm_ibvs")
    spec = compose(s.scene)
    for i in range(4):
        sensor = spec.add_sensor(name=f"pixel_{i}", type=mujoco.mjtSensor.mjSENS_CAMPROJECTION)
        sensor.objtype, sensor.objname = mujoco.mjtObj.mjOBJ_SITE, f"target/marker_{i}"
        sensor.reftype, sensor.refname = mujoco.mjtObj.mjOBJ_CAMERA, "eye"
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = s.robot.configuration()
    mujoco.mj_forward(model, data)
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3], T_world_camera[:3, 3] = (
        data.camera("eye").xmat.reshape(3, 3) @ FLIP[:3, :3],
        data.camera("eye").xpos,
    )
    uv = s.camera.project(transform(inverse(T_world_camera) @ s.target.pose.T, s.target.points))
    theirs = np.array([data.sensor(f"pixel_{i}").data for i in range(4)])
    # Their pixel centres are at halves. Intrinsics are kept in single precision: 1e-7 of 640 px.
    np.testing.assert_allclose(theirs - 0.5, uv, atol=1e-3)


@pytest.fixture(scope="module")
def square():
    """A stage with a square of unlit discs 1 m in front of the camera, and its eye."""
    camera, target = (
        Perspective(),
        Square(side=0.5, pose=Pose(xyz=(0, 0, 1)), marker=Disc(radius=0.03, lit=False)),
    )
    stage = Scene(free_parts(camera, target))
    yield stage, OpenGLRenderer(stage, camera)
    stage.close()


def view(stage: Scene, T_world_camera: Array) -> None:
    stage.place(0.0, stage.parts.target.pose.T, NONE, T_world_camera)


def test_unlit_markers_have_exactly_their_colour(square):
    stage, eye = square
    target, camera = stage.parts.target, stage.parts.camera
    # At a slant as well: no shading.
    for T in (np.eye(4), Pose(xyz=(0.3, -0.1, -0.2), rpy_deg=(4, -15, 20)).T):
        view(stage, T)
        image = eye.full_image()
        u, v = (
            np.round(camera.project(transform(inverse(T) @ target.pose.T, target.points)))
            .astype(int)
            .T
        )
        # 0 and 255 exactly; half a grey level of rounding and half of stray light for 127.5.
        colours = image[v, u].astype(int)
        wanted = 255 * target.colors
        assert np.abs(colours - wanted).max() <= 1
        pure = np.isin(wanted, [0, 255])
        np.testing.assert_array_equal(colours[pure], wanted[pure])


def test_a_view_seen_again_has_the_same_bytes(square):
    stage, eye = square
    here, there = np.eye(4), Pose(xyz=(0.1, 0, 0)).T
    view(stage, here)
    first = eye.full_image()
    view(stage, there)
    assert not np.array_equal(eye.full_image(), first)
    view(stage, here)
    np.testing.assert_array_equal(eye.full_image(), first)


# With noise each picture is drawn whole.
HASHES = """
import hashlib, vstestbed as vs
class Picture:
    def frame(self, frame): print(hashlib.sha256(frame.image.tobytes()).hexdigest())
small = {"camera.width": 320, "camera.height": 240, "target.marker.radius": 0.04}
small |= {"stop.duration_s": 0.16, "law.gain": 2, "noise.image_sigma": 1.0}
r = vs.run(vs.load("arm_ibvs", small), [Picture()])
print(hashlib.sha256(r.table.tobytes()).hexdigest())
"""


@pytest.mark.process
@pytest.mark.parametrize(
    "numbers", [("2",), pytest.param(("0", "1", "2", "3"), marks=pytest.mark.study)], ids="-".join
)
@pytest.mark.opengl
def test_any_number_of_raster_threads_draws_the_same_bytes(
    numbers: tuple[str, ...], capsys: pytest.CaptureFixture[str]
):
    # Mesa reads the number before its first context: a process for each. This one has another
    # number, of `conftest`, or a core's each.
    started = [
        subprocess.Popen(
            [sys.executable, "-c", HASHES],
            env=os.environ | {"LP_NUM_THREADS": n},
            stdout=subprocess.PIPE,
            text=True,
        )
        for n in numbers
    ]
    exec(HASHES, {})
    outputs = [capsys.readouterr().out, *(p.communicate(timeout=120)[0] for p in started)]
    assert all(p.returncode == 0 for p in started)
    assert len(set(outputs[0].split())) == 6  # five different pictures and the log
    assert len(set(outputs)) == 1
