"""A robot's file in a scene: the flange, however its orientation is written, and the actuators that
are kept.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.robots import Actuation, BodyFile, RobotBase
from vstestbed.robots.free import Free, FreeStart
from vstestbed.sim.scene import attach
from vstestbed.sim.scene.scene import Scene

ROBOT = """
<mujoco model="r">
  <compiler angle="{angle}"/>
  <worldbody>
    <body name="base" pos="1 2 3" euler="0 0 {quarter}">
      <joint name="swing" axis="0 1 0"/>
      <geom name="link" size="0.1" mass="1"/>
      <body name="tool" pos="0 0 0.5">
        <geom name="hand" size="0.05" mass="0.1"/>
        {site}
      </body>
    </body>
  </worldbody>
  <actuator>
    <velocity name="ideal_swing" joint="swing" kv="10"/>
    <velocity name="raw_swing" joint="swing" kv="1"/>
  </actuator>
</mujoco>
"""
FLANGE = Pose(xyz=(0.1, 0.2, 0.3), rpy_deg=(90, 0, 0)).T
"""A quarter turn about x: z of the flange is -y of its body."""


@dataclass(frozen=True)
class Swing(RobotBase):
    """A robot of one joint in a file of its own."""

    body: BodyFile | None = None
    kind: str = "swing"


@pytest.fixture
def scene_with(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Attach a robot with this site in its tool: (scene, the flange's body, the flange's pose in
    it).
    """
    monkeypatch.setattr(attach, "model_path", lambda name: tmp_path / name)
    attach._compiled.cache_clear()

    def made(site: str, angle: str = "degree", actuation: Actuation | None = None):
        (tmp_path / "swing.xml").write_text(
            ROBOT.format(site=site, angle=angle, quarter=90 if angle == "degree" else np.pi / 2)
        )
        scene = mujoco.MjSpec()
        scene.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
        return (
            scene,
            *attach.add_robot(
                scene, Swing(BodyFile("swing.xml", actuation=actuation)), "robot/", None
            ),
        )

    yield made
    attach._compiled.cache_clear()


@pytest.mark.parametrize(
    ("orientation", "angle"),
    [
        ('quat="1 1 0 0"', "degree"),  # MuJoCo normalises it
        ('euler="90 0 0"', "degree"),
        (f'euler="{np.pi / 2!r} 0 0"', "radian"),
        ('axisangle="1 0 0 90"', "degree"),
        ('xyaxes="1 0 0 0 0 1"', "degree"),
        ('zaxis="0 -1 0"', "degree"),
    ],
)
def test_the_flange_is_where_its_file_says_however_it_is_written(
    scene_with, orientation: str, angle: str
):
    """A spec's `quat` is the identity where the file writes another kind of orientation: the camera
    would look elsewhere, silently.
    """
    scene, body, T = scene_with(f'<site name="flange" pos="0.1 0.2 0.3" {orientation}/>', angle)
    # Rounding of a normalised quaternion and of the angle in the file.
    np.testing.assert_allclose(T, FLANGE, atol=1e-12)
    assert body.name == "robot/tool"
    model = scene.compile()
    data = mujoco.MjData(model)
    data.joint("robot/swing").qpos = 0.4
    mujoco.mj_forward(model, data)
    T_tool = np.eye(4)
    T_tool[:3, :3], T_tool[:3, 3] = (
        data.body("robot/tool").xmat.reshape(3, 3),
        data.body("robot/tool").xpos,
    )
    flange = data.site("robot/flange")
    np.testing.assert_allclose((T_tool @ T)[:3, :3], flange.xmat.reshape(3, 3), atol=1e-12)
    np.testing.assert_allclose((T_tool @ T)[:3, 3], flange.xpos, atol=1e-12)


@pytest.mark.parametrize("site", ["", '<site name="tip"/>'])
def test_a_model_without_a_flange_is_refused_with_what_to_add(scene_with, site: str):
    with pytest.raises(ParameterError) as told:
        scene_with(site)
    assert told.value.field == "robot.kind"
    assert (
        "has a model without a site `flange`, which carries the camera; add one to swing.xml"
        in str(told.value)
    )


def test_the_chosen_profile_keeps_its_actuators_under_the_joints_names(scene_with):
    model = scene_with(
        '<site name="flange"/>', actuation=Actuation("raw", friction=True, gravity_compensated=True)
    )[0].compile()
    assert [model.actuator(i).name for i in range(model.nu)] == ["robot/swing"]
    assert model.actuator_gainprm[0, 0] == 1.0  # kv of the raw one
    assert model.body_gravcomp[model.body("robot/base").id] == 1.0


def test_the_ideal_camera_is_a_body_without_mass():
    scene = mujoco.MjSpec()
    body, T = attach.add_robot(scene, Free(start=FreeStart(nominal=Pose())), "robot/", None)
    assert body.name == "robot/camera" and body.mocap
    np.testing.assert_array_equal(T, np.eye(4))


def test_what_a_file_says_of_views_and_solver_is_the_scenes_without_a_line_of_the_library(
    tmp_path, capfd, caplog
) -> None:
    """MuJoCo would print what differs with a line of this program's source; what changes the motion
    is refused.
    """
    pictures = (
        '<visual><map znear="0.3"/><global offwidth="300"/></visual><statistic extent="9"/>'
        '<size memory="1M" nuserdata="3"/>'
    )
    solver = '<option o_margin="1" integrator="RK4" iterations="3" magnetic="1 0 0"/>'
    arm = (
        '<body name="a" pos="0 0 0.7"><joint name="j1"/><geom size="0.1"/><body>'
        '<joint name="j2" axis="0 1 0"/>'
    )
    arm += '<geom size="0.1"/><site name="flange" pos="0.2 0 0" euler="0 90 0"/></body></body>'
    (tmp_path / "arm.xml").write_text(
        f"<mujoco>{pictures}{solver}<worldbody>{arm}</worldbody></mujoco>"
    )
    (tmp_path / "own.yaml").write_text("""
robot:
  kind: mjcf
  file: arm.xml
  flange: flange
  speed_limits: [1, 1]
  torque_limits: [5, 5]
  start: {nominal: {q_deg: [0, 10]}}
camera: {kind: perspective, fovy_deg: 60, mount: {xyz: [0, 0, 0.05]}}
target: {kind: square, side: 0.2, pose: {xyz: [1, 0, 0.7], rpy_deg: [0, -90, 0]}}
law: ibvs
goal: {T_camera_target: {xyz: [0, 0, 0.6]}}
""")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Scene(vs.load(tmp_path / "own.yaml").scene)
    printed = capfd.readouterr()
    assert "conflict" not in printed.out + printed.err + caplog.text
