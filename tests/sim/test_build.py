"""`model.xml`: with the controls of the log, MuJoCo alone does what the run did, by the lines that
the guide shows.
"""

import re
from pathlib import Path

import mujoco
import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.sim.build import scene_files
from vstestbed.sim.plant import MujocoPlant
from vstestbed.sim.scene.scene import Scene
from vstestbed.studies.run_folder import run_into

GUIDE = Path(__file__).resolve().parents[2] / "docs/guides/export.md"
HEAD = "log, model ="
SETTLED = "before, held = t, ctrl"


def lines_of_the_guide() -> str:
    """With one more, which keeps the joints at each row."""
    block = next(
        text
        for text in re.findall(r"```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
        if HEAD in text
    )
    lines = [line for line in map(str.strip, block.splitlines()) if line and line[0] != "#"]
    # ten besides the import and the heads of the loops
    assert len(lines) <= 13
    return block.replace(f"    {SETTLED}", f"    rows.append(data.qpos.copy())\n    {SETTLED}")


def replayed(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, **changes: object) -> float:
    """The largest difference [rad, m] of a joint of the log from that of the replay,
    over all rows.
    """
    scenario = vs.load(
        name,
        {"stop.duration_s": 2.0}
        | {key.replace("__", "."): value for key, value in changes.items()},
    )
    run_into(folder, scenario, "none", report=False)
    monkeypatch.chdir(folder)
    rows: list[np.ndarray] = []
    space: dict[str, object] = {"rows": rows}
    exec(lines_of_the_guide(), space)
    log, model = space["log"], space["model"]
    assert isinstance(log, pl.DataFrame) and isinstance(model, mujoco.MjModel)
    joints = [column for column in log.columns if column.startswith("q_")]
    places = [int(model.joint(f"robot/{joint[2:]}").qposadr[0]) for joint in joints]
    assert joints and len(rows) == len(log) > 20
    there = log.select(joints).to_numpy()
    assert np.ptp(there, axis=0).max() > 0.01  # it moved
    return float(np.abs(np.array(rows)[:, places] - there).max())


ARMS = (
    "arm_ibvs",
    "arm_ibvs_raw",
    "arm_panda",
    "arm_jaco",
    "arm_eye_to_hand",
    "arm_predictive",
    "arm_track_circle",
    "arm_stereo",
)


@pytest.mark.parametrize("name", one_quick(*ARMS))
def test_an_arm_is_replayed_to_the_last_digit(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1e-12: the same steps of the same library; a model with other names or order may add the same
    forces in another one.
    """
    assert replayed(name, tmp_path, monkeypatch, detector="oracle") < 1e-12


@pytest.mark.parametrize("name", one_quick("omni_ibvs", "omni_line", "omni_blended", "mobile_ibvs"))
def test_a_base_on_rollers_is_replayed(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1e-9 rad: contacts of 36 rollers are solved by iteration, and lengthen a difference of the
    last digit.
    """
    assert replayed(name, tmp_path, monkeypatch) < 1e-9


def test_a_step_without_six_digits_and_commands_between_pictures_are_replayed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A camera of 30 Hz has a step of 1/510 s; with a latency commands come into force between two
    pictures. 1e-12: as above.
    """
    assert (
        replayed(
            "arm_ibvs",
            tmp_path,
            monkeypatch,
            camera__rate_hz=30,
            camera__latency_s=0.05,
            detector="oracle",
        )
        < 1e-12
    )


def test_what_other_controllers_do_between_two_pictures_is_not_in_the_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The guide says so of cars: it would be wrong of it to say nothing."""
    assert replayed("car_pbvs", tmp_path, monkeypatch) > 1e-6


@pytest.mark.parametrize("name", ["arm_ibvs", "omni_ibvs", "car_pbvs", "quadrotor_hover"])
def test_the_keyframe_is_the_whole_state_in_which_a_run_begins(name: str, tmp_path: Path) -> None:
    scene = vs.load(name).resolved.scene
    (tmp_path / "model.xml").write_text(scene_files(scene)[0])
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    stage = Scene(scene)
    plant = MujocoPlant(stage, None, False, np.random.default_rng(1))
    for part in ("qpos", "act", "ctrl", "mocap_pos", "mocap_quat"):
        np.testing.assert_array_equal(getattr(data, part), getattr(stage.data, part), err_msg=part)
    assert model.opt.timestep == stage.model.opt.timestep
    # all numbers of the model, as they are computed from those in the file
    for part in (
        "body_mass",
        "body_inertia",
        "body_pos",
        "geom_pos",
        "geom_size",
        "dof_armature",
        "actuator_gainprm",
        "cam_fovy",
    ):
        np.testing.assert_allclose(
            getattr(model, part), getattr(stage.model, part), rtol=1e-12, atol=1e-15, err_msg=part
        )
    plant.close()


@pytest.mark.parametrize(
    "name", ["arm_ibvs", "arm_tags", "arm_picture", "arm_ball", "arm_eye_to_hand", "quadrotor_land"]
)
def test_the_target_is_among_what_the_viewer_shows(name: str) -> None:
    """The first three of MuJoCo's six groups of geoms; its sites, which could hide a small marker,
    are in a later one.
    """
    shown = np.array(mujoco.MjvOption().geomgroup, dtype=bool)
    assert shown.tolist() == [True, True, True, False, False, False]
    xml, assets = scene_files(vs.load(name).resolved.scene)
    model = mujoco.MjModel.from_xml_string(xml, assets)
    target = [i for i in range(model.ngeom) if model.geom(i).name.startswith("target/")]
    assert target and shown[model.geom_group[target]].all()
    sites = [i for i in range(model.nsite) if model.site(i).name.startswith("target/")]
    assert not shown[model.site_group[sites]].any()
