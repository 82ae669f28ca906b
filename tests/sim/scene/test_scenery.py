"""`world.scenery`: what is drawn, hidden, touched, carried into a run's folder and refused."""

import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.scenario.load import for_another_folder
from vstestbed.sim.build import scene_files
from vstestbed.sim.render.opengl import OpenGLRenderer
from vstestbed.sim.render.rays import RayRenderer
from vstestbed.sim.scene.meshes import RANGE_GROUP, solids
from vstestbed.sim.scene.model_report import examine_model
from vstestbed.sim.scene.scene import Scene

WORKSHOP = Path(__file__).parents[3] / "scenarios" / "scenery" / "workshop.xml"
BOXES = WORKSHOP.with_name("boxes.xml")
WALL = '<geom name="wall" type="box" size=".02 2 2" pos="1.3 0 1"/>'
BOARD = (
    '<geom name="board" type="box" size=".005 .06 .06" pos=".7 -.14 .66"'
    ' contype="0" conaffinity="0"/>'
)
"""Near the camera's start: from there it is before all markers, from the goal view beside them."""


def mjcf(tmp_path: Path, inside: str, rest: str = "") -> Path:
    file = tmp_path / "my_scene.xml"
    file.write_text(f"<mujoco>{rest}\n<worldbody>\n{inside}\n</worldbody></mujoco>")
    return file


def stage_of(file: Path | None, **changes: object) -> Scene:
    """The stage of arm_ibvs in a scenery, at its start."""
    s = vs.load("arm_ibvs", ({"world.scenery": str(file)} if file else {}) | changes)
    stage = Scene(s.scene)
    stage.place(0.0, s.target.pose.T, s.robot.configuration())
    return stage


def test_both_renderers_draw_the_workshop_alike():
    stage = stage_of(WORKSHOP)
    camera = stage.parts.camera
    by_gl, by_rays = (
        eye.full_image().astype(int)
        for eye in (OpenGLRenderer(stage, camera), RayRenderer(stage, camera))
    )
    stage.close()
    apart = np.abs(by_gl - by_rays).max(axis=-1)
    assert np.median(apart) <= 2
    assert np.mean(apart > 12) < 0.05  # OpenGL smoothes the lines between boards and tiles
    without = stage_of(None)
    bare = RayRenderer(without, camera).full_image().astype(int)
    without.close()
    assert np.mean(np.abs(bare - by_rays).max(axis=-1) > 12) > 0.5


def test_its_floor_its_lights_and_its_sky_take_the_place_of_the_scenes():
    stage = stage_of(WORKSHOP)
    model = stage.model
    stage.close()
    assert model.geom("floor").group == RANGE_GROUP and model.geom("scenery/floor").group == 0
    assert not model.geom("scenery/floor").contype and model.geom("floor").contype
    assert (
        not model.light("key").active
        and model.light("fill").active
        and model.light("scenery/windows").active
    )
    skies = [
        model.texture(i).name
        for i in range(model.ntex)
        if model.tex_type[i] == mujoco.mjtTexture.mjTEXTURE_SKYBOX
    ]
    assert skies == ["scenery/evening"]
    assert model.opt.timestep == 0.002


def test_the_options_of_the_file_do_not_count(tmp_path: Path, recwarn: pytest.WarningsRecorder):
    rest = (
        '<option timestep=".01" gravity="0 0 -1" integrator="RK4"/><statistic extent="9"/>'
        '<keyframe><key name="k"/></keyframe>'
    )
    stage = stage_of(mjcf(tmp_path, '<geom size=".1" pos="0 3 1"/><camera name="mine"/>', rest))
    model = stage.model
    stage.close()
    assert (model.opt.timestep, model.opt.gravity[2], model.stat.extent) == (0.002, -9.81, 2)
    assert model.nkey == 0
    assert "scenery/mine" not in [model.camera(i).name for i in range(model.ncam)]
    assert not recwarn.list


def test_a_wall_before_the_target_hides_it_from_pictures_and_from_the_oracle(tmp_path: Path):
    for detector in ("blobs", "oracle"):
        changes = {
            "world.scenery": str(mjcf(tmp_path, BOARD)),
            "detector": {"kind": detector},
            "stop.duration_s": 3.0,
        }
        run = vs.run(vs.load("arm_ibvs", changes))
        assert run.outcome.name == "target_lost", detector
    wall = str(mjcf(tmp_path, WALL))
    free = vs.load("ibvs_book")
    distance = float(
        np.linalg.norm(
            free.robot.flange_pose(free.robot.configuration())[:3, 3]
            - free.target.T_world_start[:3, 3]
        )
    )
    behind = vs.load(
        "ibvs_book",
        {"world.scenery": {"file": wall, "pose": {"xyz": [200, 0, 0]}}, "stop.duration_s": 0.2},
    )
    # far away it hides nothing
    assert distance < 100 and vs.run(behind).outcome.name != "target_lost"


def test_a_goal_view_and_random_starts_that_it_hides_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    wall, oracle = {"world.scenery": str(mjcf(tmp_path, WALL))}, {"detector": "oracle"}
    words = (
        r"goal.T_camera_target: is a view in which markers 0, 1, 2, 3 are hidden"
        r" by the scenery \(geom wall\); move the goal, or"
    )
    for changes in (wall, wall | oracle):
        with pytest.raises(ScenarioError, match=words):
            vs.load("arm_ibvs", changes)
    # it sees through walls
    vs.load("arm_ibvs", wall | {"detector": {"kind": "oracle", "field_of_view": "unlimited"}})
    shelf = '<body name="shelf" pos="1.3 -.22 .92"><geom type="box" size=".02 .05 .05"/></body>'
    one = {"world.scenery": str(mjcf(tmp_path, shelf))}
    with pytest.raises(
        ScenarioError,
        match=(
            r"marker 0 is hidden by the scenery"
            r" \(geom number 1 of the body shelf \(without a name\)\)"
        ),
    ):
        vs.load("arm_ibvs", one)
    vs.load("arm_ibvs", one | {"goal.markers": [1, 2, 3]})
    # behind the target
    vs.load(
        "arm_ibvs",
        one | {"world.scenery": {"file": one["world.scenery"], "pose": {"xyz": [1, 0, 0]}}},
    )
    held = {
        "world.scenery": str(
            mjcf(tmp_path, '<geom name="pane" type="box" size=".005 .3 .3" pos="1.2 -.1 .7"/>')
        )
    }
    with pytest.raises(ScenarioError, match="geom pane"):
        vs.load("arm_eye_to_hand", held)
    monkeypatch.setattr("vstestbed.scenario.scenario.TRIES", 20)
    near = vs.load(
        "arm_ibvs", {"world.scenery": str(mjcf(tmp_path, BOARD)), "robot.start.random.q_deg": 1}
    )
    with pytest.raises(ParameterError, match="gave no start in 20 draws"):
        near.randomised(1)


def test_to_touch_it_ends_the_run_with_its_name(tmp_path: Path):
    box = mjcf(
        tmp_path,
        (
            '<body name="shelf" pos=".55 0 1.05">'
            '<geom name="low_shelf" type="box" size=".25 .5 .02"/></body>'
        ),
    )
    run = vs.run(
        vs.load(
            "arm_ibvs", {"world.scenery": str(box), "detector": "oracle", "stop.duration_s": 3.0}
        )
    )
    assert run.outcome.name == "collided"
    assert "low shelf" in run.reason and "scenery" not in run.reason


def test_wheels_roll_on_its_floor_as_on_the_scenes(tmp_path: Path):
    file = mjcf(tmp_path, '<geom type="plane" size="30 30 .1" rgba=".5 .5 .5 1"/>')
    changes = {"detector": "oracle", "stop.duration_s": 1.0}
    plain, around = (
        vs.run(vs.load("omni_ibvs", changes | more)) for more in ({}, {"world.scenery": str(file)})
    )
    np.testing.assert_array_equal(
        plain.frame()["base_x"].to_numpy(), around.frame()["base_x"].to_numpy()
    )


def test_a_scenario_names_it_relative_to_its_own_file_and_the_run_carries_its_textures(
    tmp_path: Path,
):
    folder = tmp_path / "parts"
    folder.mkdir()
    Image.fromarray(np.full((8, 8, 3), 120, np.uint8)).save(folder / "cloth.png")
    asset = (
        '<asset><texture name="c" type="2d" file="cloth.png"/>'
        '<material name="c" texture="c"/></asset>'
    )
    file = mjcf(
        tmp_path,
        '<geom type="box" size=".5 .5 .3" pos="0 2 .31" material="c"/>',
        '<compiler texturedir="parts"/>' + asset,
    )
    scenario = tmp_path / "mine.yaml"
    bundled = (WORKSHOP.parents[1] / "arm_workshop.yaml").read_text()
    scenario.write_text(bundled.replace("scenery/workshop.xml", file.name))
    s = vs.load(str(scenario))
    assert s.world.scenery is not None and s.world.scenery.file == str(file)
    assert str(file) in for_another_folder(scenario)
    xml, assets = scene_files(s.scene)
    out = tmp_path / "elsewhere"
    for name, content in assets.items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(content)
    (out / "model.xml").write_text(xml)
    (folder / "cloth.png").unlink()
    again = mujoco.MjModel.from_xml_path(str(out / "model.xml"))
    assert "scenery/c" in [again.texture(i).name for i in range(again.ntex)]


def test_viewers_without_mujoco_get_its_geoms_and_its_finite_planes():
    stage = stage_of(WORKSHOP)
    body = stage.model.body("scenery/bench").id
    found = solids(stage.model)
    stage.close()
    assert any(solid.body == body for solid in found)
    floor = [s for s in found if s.body == 0 and np.ptp(s.vertices[:, 0]) == pytest.approx(12)]
    assert floor and max(floor[0].rgb) < 0.7


def test_doctor_says_what_becomes_of_it():
    lines = {what: found for what, works, found, _ in examine_model(str(WORKSHOP)) if works}
    assert lines["scenery"] == "23 geoms, 22 of which can be touched; 0 meshes, 4 textures"
    assert "in place of the scene's key light" in lines["lights"]
    assert (
        lines["as scenery"].startswith("world: {scenery: ")
        and lines["as an arm"] == "no: it has no joints"
    )
    assert "colours" not in lines


def test_colours_that_a_detector_takes_for_markers_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    cloth = (
        '<texture name="c" type="2d" builtin="checker" rgb1=".5 .5 .5" rgb2=".5 .5 .8"'
        ' width="8" height="8"/>'
    )
    sky = (
        '<texture name="s" type="skybox" builtin="gradient" rgb1=".6 .6 .8" rgb2=".5 .5 .5"'
        ' width="8" height="48"/>'
    )
    paints = (
        f'<asset>{cloth}{sky}<material name="c" texture="c"/>'
        '<material name="grey" rgba=".5 .5 .6 1"/></asset>'
    )
    parts = (
        # its own colour counts
        (
            '<geom name="red" type="box" size=".1 .1 .1" pos="3 0 1" rgba=".9 .1 .1 1"'
            ' material="grey"/>'
        ),
        '<geom name="grey" type="box" size=".1 .1 .1" pos="3 1 1" material="grey"/>',
        '<geom name="cloth" type="box" size=".1 .1 .1" pos="3 2 1" material="c"/>',
        # not drawn
        '<geom name="bump" type="box" size=".1 .1 .1" pos="3 3 1" rgba="1 0 0 1" group="3"/>',
    )
    file = str(mjcf(tmp_path, "\n".join(parts), paints))
    found = (
        "geom red, geom cloth, the skybox in my_scene.xml have saturated colours (max - min of r,"
        " g, b up to 0.8), which detector"
    )
    assert (
        f"{found} blobs may take for markers; keep max - min under 0.18"
        in dict(line[::2] for line in examine_model(file))["colours"]
    )
    for detector in (
        {"kind": "oracle"},
        {"kind": "blobs"},
        {"kind": "blobs"},
        {"kind": "blobs", "chroma": 120},
    ):
        vs.run(
            vs.load(
                "arm_ibvs", {"world.scenery": file, "detector": detector, "stop.duration_s": 0.04}
            )
        )
    told = [record.getMessage() for record in caplog.records]
    assert len(told) == 2 and told[0].startswith(f"world.scenery: {found} blobs")  # once
    assert told[1].startswith("world.scenery: geom red in my_scene.xml has a saturated colour")


def test_mistakes_are_told(tmp_path: Path):
    for inside, rest, words in (
        (
            '<body><freejoint name="f"/><geom size=".1"/></body>',
            "",
            "has the joint f (line 3), and scenery stands still",
        ),
        (WALL, '<actuator><motor name="m" site="s"/></actuator>', "cannot be compiled by MuJoCo"),
        (
            WALL + '<site name="s"/>',
            '<actuator><motor name="m" site="s"/></actuator>',
            "has the actuator m (line 1), and nothing would drive",
        ),
        (WALL + "\n" + WALL, "", "repeated name 'wall' in geom"),
        (
            '<geom size=".1" colour="red"/>',
            "",
            "my_scene.xml:3: geom: unrecognized attribute 'colour'); correct it there",
        ),
        (
            '<geom size=".1">',
            "",
            (
                "my_scene.xml:3: it is not well-formed XML"
                " (mismatched element, near the element geom))"
            ),
        ),
        (
            '<include file="gone.xml"/>',
            "",
            (
                "line 3 there or in a file that it includes:"
                " it names the file gone.xml, which is not there"
            ),
        ),
        (
            '<geom type="mesh" mesh="m"/>',
            '<asset><mesh name="m" file="gone.stl"/></asset>',
            "my_scene.xml:1: it names the file gone.stl",
        ),
        ("", "", "has no geoms"),
        ('<geom name="low" type="plane" size="1 1 1" pos="0 0 -1"/>', "", "set world.floor_z: -1"),
        (
            '<geom name="rug" type="box" size="1 1 .01" pos="0 0 -.01"/>',
            "",
            "the geom rug, whose upper face is at the height of the floor",
        ),
    ):
        with pytest.raises(ScenarioError) as told:
            vs.load("arm_ibvs", {"world.scenery": str(mjcf(tmp_path, inside, rest))})
        assert words in str(told.value) and "world.scenery" in str(told.value)
        assert str(told.value).count(str(tmp_path)) <= 1


def test_a_file_that_is_not_there_is_told():
    with pytest.raises(ScenarioError, match=r"world\.scenery: is not there; .*gone\.xml"):
        vs.load("arm_ibvs", {"world.scenery": "gone.xml"})


def test_rays_shade_a_light_that_has_a_place_by_its_distance_and_angle(tmp_path: Path):
    lamp = (
        '<light type="spot" pos="0 0 2" dir="0 0 -1" diffuse=".8 .8 .8" attenuation="1 0 .5"'
        ' cutoff="40" exponent="2"/>'
    )
    file = mjcf(tmp_path, lamp + '<geom name="floor" type="plane" size="5 5 1" rgba="1 1 1 1"/>')
    stage = stage_of(file)
    model = stage.model
    model.light_active[model.light("fill").id] = 0
    from vstestbed.sim.render.shade import Paint

    x = np.array([0.0, 0.5, 1.5, 3.0])
    points = np.stack([x, 0 * x, 0 * x], axis=1)
    eye = np.array([0.0, 0.0, 4.0])
    rays, distance = points - eye, np.linalg.norm(points - eye, axis=1)
    floor = np.full(4, model.geom("scenery/floor").id, np.int32)
    normal, apart = np.tile([0.0, 0.0, 1.0], (4, 1)), np.full(4, 1e-3)
    seen = Paint(model, stage.data).colours(
        eye, rays / distance[:, None], floor, distance, normal, apart
    )[:, 0]
    stage.close()
    d = np.hypot(x, 2.0)
    expected = 0.8 * (2 / d) * (2 / d) ** 2 / (1 + 0.5 * d**2) * (np.degrees(np.arccos(2 / d)) < 40)
    np.testing.assert_allclose(seen, 255 * expected, atol=1.0)


def test_jpeg_textures_of_a_file_are_drawn_and_kept(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.syspath_prepend(str(BOXES.parent))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    import make_boxes  # type: ignore[import-not-found]  # a script beside the scenery

    assert BOXES.read_text() == make_boxes.boxes(0)
    stage = stage_of(BOXES)
    model = stage.model
    assert model.texture("scenery/poster").width[0] == 1600
    assert sum(data[1:4] == b"PNG" for data in stage.spec.assets.values()) == 4
    half, at = (
        np.array([getattr(model.geom(f"scenery/box_{i}"), name) for i in range(6)])
        for name in ("size", "pos")
    )
    # they stand on the board in z = 0
    np.testing.assert_allclose(at[:, 2] - half[:, 2], 0, atol=1e-9)
    stage.close()
