"""Any arm by its file: kinematics as MuJoCo has them, convergence from rendered pictures by YAML alone, and sentences for mistakes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from spatialmath import SE3

import vstestbed as vs
from tests.robots.arms import BLOCKS, HERE, block
from vstestbed.core.errors import ScenarioError
from vstestbed.core.geometry import Pose
from vstestbed.robots import ROBOTS, Mjcf
from vstestbed.scenario.dump import dump
from vstestbed.sim.build import scene_files

HAND = {"xyz": [0.06, 0, 0.02]}
SEEN = {"square": [(0.05, -0.04, 0.75), (8, -6, 15)], "flat": [(0.05, -0.04, 0.7), (0, 0, 25)]}


def arm(name: str, **more: Any) -> Mjcf:
    return ROBOTS.members["mjcf"](**{k: v for k, v in block(name, **more).items() if k != "kind"})


def written(folder: Path, name: str, robot: dict[str, Any], target: dict[str, Any], goal: dict[str, Any], **more: Any) -> vs.Scenario:
    """A scenario file, as its user writes it, loaded."""
    import yaml

    blocks = {"robot": robot, "target": target, "goal": {"T_camera_target": goal}, "law": {"kind": "ibvs", "gain": 0.8}}
    blocks["camera"] = {"kind": "perspective", "fovy_deg": 60, "mount": more.pop("mount", HAND)}
    blocks["stop"] = {"duration_s": 20, "converged": {"error_px": 0.3}}
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(blocks | more))
    return vs.load(folder / f"{name}.yaml")


def square_before(robot: Mjcf, xyz: tuple[float, ...], rpy_deg: tuple[float, ...]) -> dict[str, Any]:
    """A square in front of the camera at the start, turned and shifted."""
    x, y, z = HAND["xyz"]
    T = robot.flange_pose(robot.configuration()) @ Pose(xyz=(x, y, z)).T @ Pose(xyz=xyz, rpy_deg=rpy_deg).T
    pose = {"xyz": T[:3, 3].tolist(), "rpy_deg": SE3(T, check=False).rpy(unit="deg", order="zyx").tolist()}
    return {"kind": "square", "side": 0.25, "pose": pose, "marker": {"kind": "disc", "radius": 0.012}}


@pytest.mark.parametrize("name", BLOCKS)
def test_it_passes_the_suite_of_robots(name: str) -> None:
    vs.testing.check_robot(arm(name))


@pytest.mark.parametrize("name", BLOCKS)
def test_its_kinematics_are_mujocos_and_their_own_differences(name: str) -> None:
    robot = arm(name)
    model = mujoco.MjModel.from_xml_path(str(HERE / f"{name}.xml"))
    data, rng, n = mujoco.MjData(model), np.random.default_rng(0), len(robot.joints)
    for _ in range(20):
        q = rng.uniform(-0.3, 0.3, n) + robot.configuration()
        T, J = robot.kinematics(q)
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, robot.flange)
        body = model.body(robot.flange if site < 0 else int(model.site_bodyid[site])).id
        place, turn = (data.xpos[body], data.xmat[body]) if site < 0 else (data.site_xpos[site], data.site_xmat[site])
        np.testing.assert_allclose(T[:3, 3], place, atol=1e-12)
        np.testing.assert_allclose(T[:3, :3].ravel(), turn, atol=1e-12)
        h, differences = 1e-6, np.empty((6, n))
        for i, step in enumerate(h * np.eye(n)):
            D = np.linalg.inv(T) @ (robot.kinematics(q + step)[0] - robot.kinematics(q - step)[0])
            differences[:, i] = np.array([*D[:3, 3], D[2, 1], D[0, 2], D[1, 0]]) / (2 * h)
        np.testing.assert_allclose(differences, J, atol=1e-8)


@pytest.mark.parametrize(
    ("name", "actuation", "seen"), [("seven", "file", "square"), ("seven", "velocity", "square"), ("scara", "velocity", "flat")]
)
def test_it_converges_from_rendered_pictures_by_yaml_alone(name: str, actuation: str, seen: str, tmp_path: Path) -> None:
    robot = arm(name)
    scenario = written(tmp_path, name, block(name, actuation=actuation), square_before(robot, *SEEN[seen]), {"xyz": [0, 0, 0.6]})
    summary: dict[str, Any] = vs.run(scenario).summary()
    assert summary["outcome"] == "converged", summary["reason"]
    assert summary["final_error_px"] < 0.3 and summary["final_position_error_m"] < 0.003 and summary["final_rotation_error_deg"] < 0.3


def test_a_camera_in_the_room_guides_its_hand(tmp_path: Path) -> None:
    robot = arm("seven")
    T = robot.flange_pose(robot.configuration()) @ Pose(xyz=(0, 0, 0.05), rpy_deg=(180, 0, 0)).T @ Pose(xyz=(-0.06, 0.05, -0.75)).T
    camera = {"xyz": T[:3, 3].tolist(), "rpy_deg": SE3(T, check=False).rpy(unit="deg", order="zyx").tolist()}
    marker = {"kind": "disc", "radius": 0.01}
    held = {
        "kind": "square",
        "side": 0.16,
        "pose": {"xyz": [0, 0, 0.05], "rpy_deg": [180, 0, 0]},
        "marker": marker,
        "motion": {"kind": "held"},
    }
    goal = {"xyz": [0, 0, 0.65], "rpy_deg": [5, -5, 10]}
    scenario = written(tmp_path, "room", block("seven", actuation="velocity"), held, goal, mount=camera)
    recording = vs.run(scenario)
    summary: dict[str, Any] = recording.summary()
    assert summary["outcome"] == "converged", summary["reason"]
    assert summary["final_error_px"] < 0.3 and summary["final_position_error_m"] < 0.003 and summary["final_rotation_error_deg"] < 0.3
    assert np.ptp(recording["cam_x"]) == 0 and np.ptp(recording["q_j1"]) > 0.02  # the camera stands, the arm moves


def test_the_gains_of_added_servos_are_in_the_summary(tmp_path: Path) -> None:
    near = square_before(arm("scara"), (0.0, 0.0, 0.6), (0, 0, 1))
    for actuation in ("velocity", "ideal"):
        scenario = written(tmp_path, actuation, block("scara", actuation=actuation), near, {"xyz": [0, 0, 0.6]}, detector="oracle")
        summary: dict[str, Any] = vs.run(scenario).summary()
        servos = {servo.joint: servo for servo in scenario.robot.actuator_set.servos}
        assert summary["servo_kp"] == {name: servo.kp for name, servo in servos.items()}
        assert summary["servo_kv"] == {name: servo.kv for name, servo in servos.items()}
        assert summary["servo_torque"]["shoulder"] is None  # no limit
        assert summary["servo_torque"]["lift"] == (200 if actuation == "velocity" else None)
    assert arm("seven", actuation="file").actuator_set.gains() == {}


def test_two_links_see_one_marker_come_to_the_middle(tmp_path: Path) -> None:
    down = {"xyz": [0, 0, -0.06], "rpy_deg": [180, 0, 0]}
    target = {
        "kind": "points",
        "at": [[0, 0, 0]],
        "pose": {"xyz": [0.45, 0.45, 0.1], "rpy_deg": [180, 0, 0]},
        "marker": {"kind": "disc", "radius": 0.02},
    }
    scenario = written(tmp_path, "two", block("two_link"), target, {"xyz": [0, 0, 0.84]}, mount=down, law={"kind": "ibvs", "depth": "goal"})
    recording = vs.run(scenario)
    assert recording.outcome is vs.Outcome.converged, recording.reason
    tip = scenario.robot.flange_pose(np.array([recording["q_shoulder"][-1], recording["q_elbow"][-1]]))
    assert tip[:2, 3] == pytest.approx([0.45, 0.45], abs=3e-3)


def test_the_file_is_found_beside_the_scenario_and_remembered_whole(tmp_path: Path) -> None:
    (tmp_path / "mine.xml").write_text((HERE / "scara.xml").read_text())
    target = square_before(arm("scara"), *SEEN["flat"])
    scenario = written(tmp_path, "beside", block("scara") | {"file": "mine.xml"}, target, {"xyz": [0, 0, 0.6]})
    assert scenario.robot.model == str(tmp_path / "mine.xml")
    (tmp_path / "again.yaml").write_text(dump(scenario, defaults=True))
    assert vs.load(tmp_path / "again.yaml", {"name": scenario.name}) == scenario


def test_jaco_from_an_installed_package_takes_its_meshes_along(tmp_path: Path) -> None:
    file = "package:dm_control/third_party/kinova/jaco_arm.xml"
    robot = {
        "kind": "mjcf",
        "file": file,
        "flange": "wristsite",
        "speed_limits": [0.8] * 6,
        "start": {"nominal": {"q_deg": [0, 194, 90, 63, 96, 0]}},
    }
    jaco = ROBOTS.members["mjcf"](**{k: v for k, v in robot.items() if k != "kind"})
    s = written(tmp_path, "jaco", robot, square_before(jaco, *SEEN["square"]), {"xyz": [0, 0, 0.6]})
    assert np.isinf(s.robot.joint_limits[0]).all() and s.robot.joint_limits[1] == pytest.approx([0.820305, 5.462881])
    scene = scene_files(s.robot, s.camera, s.target, s.world, s.physics)
    assert sum(name.endswith(".stl") for name in scene.assets) == 5
    for name, content in scene.assets.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    (tmp_path / "model.xml").write_text(scene.xml)
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml")).nmesh >= 5


def test_servos_follow_a_step_of_speed_with_the_files_torque() -> None:
    # As the Puma's: 40 ms of rise, a small overshoot. The slide has 200 N by its file.
    robot = arm("scara")
    servos = {servo.joint: servo for servo in robot.actuator_set.servos}
    assert servos["lift"].torque == 200 and np.isinf(servos["shoulder"].torque or 0) and servos["lift"].speed == 0.4
    assert servos["lift"].kp == pytest.approx(4500 * (0.8 + 0.3 + 0.1), rel=1e-6)  # quill, wrist, armature
    assert servos["shoulder"].kv == pytest.approx(servos["shoulder"].kp / 40)
    assert [s.torque for s in arm("seven", actuation="file").actuator_set.servos] == [None] * 7


class TestMistakes:
    def refused(self, tmp_path: Path, **more: Any) -> str:
        robot = block("scara") | more
        with pytest.raises(ScenarioError) as error:
            written(tmp_path, "wrong", robot, {"kind": "square", "side": 0.25, "pose": {"xyz": [0.5, 0.5, 0.1]}}, {"xyz": [0, 0, 0.6]})
        return str(error.value)

    @pytest.mark.parametrize(
        ("more", "words"),
        [
            ({"flange": "tol"}, "flange: is no site and no body of the file; its sites: tool"),
            ({"file": "none.xml"}, "file: is not there"),
            ({"file": "package:no_such_package/arm.xml"}, "names the package no_such_package, which is not installed"),
            (
                {"joints": ["shoulder", "lift"]},
                "must be those between the root and tool, in their order: shoulder, elbow, lift, roll",
            ),
            ({"speed_limits": [1, 1, 1]}, "speed_limits: must be 4 speeds, of shoulder, elbow, lift, roll"),
            ({"start": {"nominal": {"q_deg": [0, 0, 0]}}}, "must be 4 positions"),
            ({"start": {"nominal": {"q_deg": [0, 0, 0.2, 0]}}}, "must be within lift's range, -0.3 to 0.1 m"),
            ({"start": {"nominal": {"q_deg": [170, 0, 0, 0]}}}, "must be within shoulder's range, -150 to 150 deg"),
            ({"actuation": "file"}, "shoulder has no actuator there, which follows no speed; works: velocity"),
        ],
    )
    def test_of_the_block(self, more: dict[str, Any], words: str, tmp_path: Path) -> None:
        assert words in self.refused(tmp_path, **more)

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            ('<joint name="shoulder" range="-150 150"/>', "<freejoint/>", "must be hinges and slides"),
            ('<joint name="elbow" range="-140 140"/>', '<joint name="elbow" type="ball"/>', "elbow is a ball joint"),
            ('<joint name="elbow" range="-140 140"/>', '<joint range="-140 140"/>', "must name each joint before tool; joint 2"),
            ("<worldbody>", "<wordbody>", "wrong.xml:8: it is not well-formed XML"),
        ],
    )
    def test_of_the_file(self, old: str, new: str, words: str, tmp_path: Path) -> None:
        text = (HERE / "scara.xml").read_text()
        assert old in text
        (tmp_path / "wrong.xml").write_text(text.replace(old, new))
        assert words in self.refused(tmp_path, file="wrong.xml")

    def test_a_motor_follows_no_speed(self, tmp_path: Path) -> None:
        text = (HERE / "scara.xml").read_text()
        motors = "".join(f'<motor name="m_{j}" joint="{j}"/>' for j in ("shoulder", "elbow", "lift", "roll"))
        (tmp_path / "motors.xml").write_text(text.replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>"))
        assert "shoulder has a motor actuator there" in self.refused(tmp_path, file="motors.xml", actuation="file")


class TestDoctor:
    """`doctor FILE.xml` says what of a file can be used; the block that it prints loads."""

    def test_a_sound_file(self, command: Any, tmp_path: Path) -> None:
        told = command("doctor", str(HERE / "scara.xml"))
        assert told.code == 0 and "tool: shoulder, elbow, lift, roll" in told.out
        assert "lift: slide, -0.3 to 0.1 m, at most 200 N [no actuator, line 17]" in told.out
        assert "shoulder: hinge, -150 to 150 deg [no torque limit (actuatorfrcrange); no actuator, line 11]" in told.out
        assert "lift: kp 5400 N/m, kv 135 N s/m (added by actuation: velocity)" in told.out
        robot = next(line for line in told.out.splitlines() if "robot: {" in line).partition("robot: ")[2]
        import yaml

        scenario = written(tmp_path, "printed", yaml.safe_load(robot), square_before(arm("scara"), *SEEN["flat"]), {"xyz": [0, 0, 0.6]})
        assert scenario.robot.joints == ("shoulder", "elbow", "lift", "roll")

    def test_files_that_are_no_arms(self, command: Any, tmp_path: Path) -> None:
        told = command("doctor", "models/quadrotor.xml" if Path("models").is_dir() else str(HERE.parents[2] / "models/quadrotor.xml"))
        assert told.code == 2 and "root is a free joint" in told.out
        (tmp_path / "broken.xml").write_text("<mujoco>\n<wordbody/>\n</mujoco>")
        told = command("doctor", str(tmp_path / "broken.xml"))
        assert told.code == 2 and "missing  model" in told.out and "broken.xml:2: " in told.out
        assert command("doctor", str(tmp_path / "none.xml")).code == 2
