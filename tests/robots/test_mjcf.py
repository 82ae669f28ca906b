"""Any arm by its file: kinematics as MuJoCo has them, convergence from rendered pictures by YAML
alone, and sentences for mistakes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from spatialmath import SE3

import vstestbed as vs
from tests.robots.arms import BLOCKS, HERE, NEEDS_PANDA, block
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Pose
from vstestbed.robots import ROBOTS, Mjcf
from vstestbed.robots.mjcf import servo_gains
from vstestbed.scenario.dump import dump
from vstestbed.scenario.load import seeded
from vstestbed.sim.build import scene_files
from vstestbed.sim.scene.joint_chain import compiled, joint_chain
from vstestbed.sim.scene.model_files import speeds_in
from vstestbed.sim.scene.model_report import examine_model

JACO = "package:dm_control/third_party/kinova/jaco_arm.xml"
HAND = {"xyz": [0.06, 0, 0.02]}
SEEN = {"square": [(0.05, -0.04, 0.75), (8, -6, 15)], "flat": [(0.05, -0.04, 0.7), (0, 0, 25)]}


def arm(name: str, **more: Any) -> Mjcf:
    return ROBOTS.members["mjcf"](**{k: v for k, v in block(name, **more).items() if k != "kind"})


def written(
    folder: Path,
    name: str,
    robot: dict[str, Any],
    target: dict[str, Any],
    goal: dict[str, Any],
    **more: Any,
) -> vs.Scenario:
    """A scenario file, as its user writes it, loaded."""
    import yaml

    blocks = {
        "robot": robot,
        "target": target,
        "goal": {"T_camera_target": goal},
        "law": {"kind": "ibvs", "gain": 0.8},
    }
    blocks["camera"] = {"kind": "perspective", "fovy_deg": 60, "mount": more.pop("mount", HAND)}
    blocks["stop"] = {"duration_s": 20, "converged": {"error_px": 0.3}}
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(blocks | more))
    return vs.load(folder / f"{name}.yaml")


def square_before(
    robot: Mjcf, xyz: tuple[float, ...], rpy_deg: tuple[float, ...]
) -> dict[str, Any]:
    """A square in front of the camera at the start, turned and shifted."""
    x, y, z = HAND["xyz"]
    T = (
        robot.flange_pose(robot.configuration())
        @ Pose(xyz=(x, y, z)).T
        @ Pose(xyz=xyz, rpy_deg=rpy_deg).T
    )
    pose = {
        "xyz": T[:3, 3].tolist(),
        "rpy_deg": SE3(T, check=False).rpy(unit="deg", order="zyx").tolist(),
    }
    return {
        "kind": "square",
        "side": 0.25,
        "pose": pose,
        "marker": {"kind": "disc", "radius": 0.012},
    }


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
        place, turn = (
            (data.xpos[body], data.xmat[body])
            if site < 0
            else (data.site_xpos[site], data.site_xmat[site])
        )
        np.testing.assert_allclose(T[:3, 3], place, atol=1e-12)
        np.testing.assert_allclose(T[:3, :3].ravel(), turn, atol=1e-12)
        h, differences = 1e-6, np.empty((6, n))
        for i, step in enumerate(h * np.eye(n)):
            D = np.linalg.inv(T) @ (robot.kinematics(q + step)[0] - robot.kinematics(q - step)[0])
            differences[:, i] = np.array([*D[:3, 3], D[2, 1], D[0, 2], D[1, 0]]) / (2 * h)
        np.testing.assert_allclose(differences, J, atol=1e-8)


@pytest.mark.parametrize(
    ("name", "actuation", "seen"),
    one_quick(
        ("seven", "file", "square"), ("seven", "velocity", "square"), ("scara", "velocity", "flat")
    ),
)
def test_it_converges_from_rendered_pictures_by_yaml_alone(
    name: str, actuation: str, seen: str, tmp_path: Path
) -> None:
    robot = arm(name)
    scenario = written(
        tmp_path,
        name,
        block(name, actuation=actuation),
        square_before(robot, *SEEN[seen]),
        {"xyz": [0, 0, 0.6]},
    )
    summary: dict[str, Any] = vs.run(scenario).summary()
    assert summary["outcome"] == "converged", summary["reason"]
    assert (
        summary["final_error_px"] < 0.3
        and summary["final_position_error_m"] < 0.003
        and summary["final_rotation_error_deg"] < 0.3
    )


def test_a_camera_in_the_room_guides_its_hand(tmp_path: Path) -> None:
    robot = arm("seven")
    T = (
        robot.flange_pose(robot.configuration())
        @ Pose(xyz=(0, 0, 0.05), rpy_deg=(180, 0, 0)).T
        @ Pose(xyz=(-0.06, 0.05, -0.75)).T
    )
    camera = {
        "xyz": T[:3, 3].tolist(),
        "rpy_deg": SE3(T, check=False).rpy(unit="deg", order="zyx").tolist(),
    }
    marker = {"kind": "disc", "radius": 0.01}
    held = {
        "kind": "square",
        "side": 0.16,
        "pose": {"xyz": [0, 0, 0.05], "rpy_deg": [180, 0, 0]},
        "marker": marker,
        "motion": {"kind": "held"},
    }
    goal = {"xyz": [0, 0, 0.65], "rpy_deg": [5, -5, 10]}
    scenario = written(
        tmp_path, "room", block("seven", actuation="velocity"), held, goal, mount=camera
    )
    recording = vs.run(scenario)
    summary: dict[str, Any] = recording.summary()
    assert summary["outcome"] == "converged", summary["reason"]
    assert (
        summary["final_error_px"] < 0.3
        and summary["final_position_error_m"] < 0.003
        and summary["final_rotation_error_deg"] < 0.3
    )
    # the camera stands, the arm moves
    assert np.ptp(recording["cam_x"]) == 0 and np.ptp(recording["q_j1"]) > 0.02


def test_the_gains_of_added_servos_are_in_the_summary(tmp_path: Path) -> None:
    near = square_before(arm("scara"), (0.0, 0.0, 0.6), (0, 0, 1))
    for actuation in ("velocity", "ideal"):
        scenario = written(
            tmp_path,
            actuation,
            block("scara", actuation=actuation),
            near,
            {"xyz": [0, 0, 0.6]},
            detector="oracle",
        )
        summary: dict[str, Any] = vs.run(scenario).summary()
        servos = {servo.joint: servo for servo in scenario.robot.body.actuation.servos}
        assert summary["servo_kp"] == {name: servo.kp for name, servo in servos.items()}
        assert summary["servo_kv"] == {name: servo.kv for name, servo in servos.items()}
        assert summary["servo_torque"]["shoulder"] is None  # no limit
        assert summary["servo_torque"]["lift"] == (200 if actuation == "velocity" else None)
        for started in (
            seeded(scenario, 3).resolved,
            scenario.displaced(Pose(xyz=(0.02, 0, 0)), "camera"),
        ):
            assert started.robot.configuration() != pytest.approx(scenario.robot.configuration())
            assert (
                started.robot.body.actuation.gains() == scenario.robot.body.actuation.gains()
                or actuation == "ideal"
            )
    assert arm("seven", actuation="file").body.actuation.gains() == {}


def test_two_links_see_one_marker_come_to_the_middle(tmp_path: Path) -> None:
    down = {"xyz": [0, 0, -0.06], "rpy_deg": [180, 0, 0]}
    target = {
        "kind": "points",
        "at": [[0, 0, 0]],
        "pose": {"xyz": [0.45, 0.45, 0.1], "rpy_deg": [180, 0, 0]},
        "marker": {"kind": "disc", "radius": 0.02},
    }
    scenario = written(
        tmp_path,
        "two",
        block("two_link"),
        target,
        {"xyz": [0, 0, 0.84]},
        mount=down,
        law={"kind": "ibvs", "depth": "goal"},
    )
    recording = vs.run(scenario)
    assert recording.outcome is vs.Outcome.converged, recording.reason
    tip = scenario.robot.flange_pose(
        np.array([recording["q_shoulder"][-1], recording["q_elbow"][-1]])
    )
    assert tip[:2, 3] == pytest.approx([0.45, 0.45], abs=3e-3)


def test_the_file_is_found_beside_the_scenario_and_remembered_whole(tmp_path: Path) -> None:
    (tmp_path / "mine.xml").write_text((HERE / "scara.xml").read_text())
    target = square_before(arm("scara"), *SEEN["flat"])
    scenario = written(
        tmp_path, "beside", block("scara") | {"file": "mine.xml"}, target, {"xyz": [0, 0, 0.6]}
    )
    assert scenario.robot.body.file == str(tmp_path / "mine.xml")
    (tmp_path / "again.yaml").write_text(dump(scenario, defaults=True))
    assert vs.load(tmp_path / "again.yaml", {"name": scenario.name}) == scenario


def test_jaco_from_an_installed_package_takes_its_meshes_along(tmp_path: Path) -> None:
    robot = {
        "kind": "mjcf",
        "file": JACO,
        "flange": "wristsite",
        "speed_limits": [0.8] * 6,
        "start": {"nominal": {"q_deg": [0, 194, 90, 63, 96, 0]}},
    }
    jaco = ROBOTS.members["mjcf"](**{k: v for k, v in robot.items() if k != "kind"})
    s = written(tmp_path, "jaco", robot, square_before(jaco, *SEEN["square"]), {"xyz": [0, 0, 0.6]})
    assert np.isinf(s.robot.body.limits[0]).all()
    assert s.robot.body.limits[1] == pytest.approx([0.820305, 5.462881])
    xml, assets = scene_files(s.scene)
    assert sum(name.endswith(".stl") for name in assets) == 5
    for name, content in assets.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    (tmp_path / "model.xml").write_text(xml)
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml")).nmesh >= 5


def test_servos_follow_a_step_of_speed_with_the_files_torque() -> None:
    # As the Puma's: 40 ms of rise, a small overshoot. The slide has 200 N by its file.
    robot = arm("scara")
    servos = {servo.joint: servo for servo in robot.body.actuation.servos}
    assert (
        servos["lift"].torque == 200
        and np.isinf(servos["shoulder"].torque or 0)
        and servos["lift"].speed == 0.4
    )
    # quill, wrist, armature
    assert servos["lift"].kp == pytest.approx(4500 * (0.8 + 0.3 + 0.1), rel=1e-6)
    assert servos["shoulder"].kv == pytest.approx(servos["shoulder"].kp / 40, rel=1e-3)
    assert [s.torque for s in arm("seven", actuation="file").body.actuation.servos] == [None] * 7
    given = arm(
        "scara", torque_limits=[9, 9, 90, 1], servo_kp=[800, 400, 6000, 40]
    ).body.actuation.servos
    assert [(s.torque, s.kp, s.kv) for s in given] == [
        (9, 800, 20),
        (9, 400, 10),
        (90, 6000, 150),
        (1, 40, 1),
    ]


@pytest.mark.parametrize("step", [0.002, 0.04])
def test_the_servo_of_a_joint_with_friction_and_hardly_any_inertia_is_stable(step: float) -> None:
    """The bound of `servo_gains`, h^2 kp < 4 M + 2 h kv, from both sides."""
    kp, kv = servo_gains(1e-6, 1.21, False)
    assert (
        np.degrees(1.21 / kp) == pytest.approx(0.5, rel=1e-3)
        and servo_gains(0.01, 0.0, False)[0] == 45
    )
    assert servo_gains(1e-6, 20.0, True)[0] == 20 / 1e-3
    assert swing(kp, kv, step) <= 0.1 < 1 < swing(kp, 0.45 * step * kp, step)


def swing(kp: float, kv: float, step: float) -> float:
    """How far a hinge of 1e-6 kg m^2 gets within 40 steps after it was let go 0.1 rad from its
    servo's position [rad].
    """
    spec = mujoco.MjSpec()
    spec.option.integrator, spec.option.timestep = mujoco.mjtIntegrator.mjINT_IMPLICITFAST, step
    body = spec.worldbody.add_body(mass=1, inertia=[1e-6] * 3, explicitinertial=True)
    body.add_joint(name="j")
    spec.add_actuator(target="j", trntype=mujoco.mjtTrn.mjTRN_JOINT).set_to_intvelocity(
        kp=kp, kv=kv
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[0] = 0.1
    farthest = 0.0
    for _ in range(40):
        mujoco.mj_step(model, data)
        farthest = max(farthest, abs(float(data.qpos[0])))
    return farthest


def test_one_number_holds_for_all_joints(tmp_path: Path) -> None:
    robot = block("scara") | {"speed_limits": 2, "torque_limits": 50, "servo_kp": [400]}
    made = written(
        tmp_path,
        "one",
        robot,
        {"kind": "square", "side": 0.25, "pose": {"xyz": [0.5, 0.5, 0.1]}},
        {"xyz": [0, 0, 0.6]},
    ).robot
    assert isinstance(made, Mjcf)
    assert (made.speed_limits, made.torque_limits, made.servo_kp) == (
        (2.0,) * 4,
        (50.0,) * 4,
        (400.0,) * 4,
    )


class TestMistakes:
    def refused(self, tmp_path: Path, **more: Any) -> str:
        robot = block("scara") | more
        with pytest.raises(ScenarioError) as error:
            written(
                tmp_path,
                "wrong",
                robot,
                {"kind": "square", "side": 0.25, "pose": {"xyz": [0.5, 0.5, 0.1]}},
                {"xyz": [0, 0, 0.6]},
            )
        return str(error.value)

    @pytest.mark.parametrize(
        ("more", "words"),
        [
            ({"flange": "tol"}, "flange: is no site and no body of the file; its sites: tool"),
            ({"file": "none.xml"}, "file: is not there"),
            (
                {"file": "package:no_such_package/arm.xml"},
                "names the package no_such_package, which is not installed",
            ),
            (
                {"joints": ["shoulder", "lift"]},
                (
                    "must be those between the root and tool, in their order:"
                    " shoulder, elbow, lift, roll"
                ),
            ),
            (
                {"speed_limits": [1, 1, 1]},
                "speed_limits: must be 4 speeds, of shoulder, elbow, lift, roll",
            ),
            (
                {"torque_limits": [1, 1, 1]},
                "torque_limits: must be 4 torques, of shoulder, elbow, lift, roll",
            ),
            ({"servo_kv": [1, 1, 1]}, "servo_kv: must be 4 gains, of shoulder, elbow, lift, roll"),
            ({"start": {"nominal": {"q_deg": [0, 0, 0]}}}, "must be 4 positions"),
            (
                {"start": {"nominal": {"q_deg": [0, 0, 0.2, 0]}}},
                "must be within lift's range, -0.3 to 0.1 m",
            ),
            (
                {"start": {"nominal": {"q_deg": [170, 0, 0, 0]}}},
                "must be within shoulder's range, -150 to 150 deg",
            ),
            (
                {"actuation": "file"},
                "shoulder has no actuator there, which follows no speed; works: velocity",
            ),
        ],
    )
    def test_of_the_block(self, more: dict[str, Any], words: str, tmp_path: Path) -> None:
        assert words in self.refused(tmp_path, **more)

    @pytest.mark.parametrize(
        ("old", "new", "words"),
        [
            (
                '<joint name="shoulder" range="-150 150"/>',
                "<freejoint/>",
                "must be hinges and slides",
            ),
            (
                '<joint name="elbow" range="-140 140"/>',
                '<joint name="elbow" type="ball"/>',
                "elbow is a ball joint",
            ),
            (
                '<joint name="elbow" range="-140 140"/>',
                '<joint range="-140 140"/>',
                "must name each joint before tool; joint 2",
            ),
            (
                'range="-140 140"',
                'range="140 -140"',
                "must give elbow a range from its lower to its upper end, got 140 to -140",
            ),
            (
                'range="-140 140"',
                'range="-140 140" frictionloss="-1"',
                "must give elbow frictionloss of 0 or more, got -1",
            ),
            ("<worldbody>", "<wordbody>", "wrong.xml:8: it is not well-formed XML"),
            ("</mujoco>", "", "wrong.xml:29: it is not well-formed XML"),
        ],
    )
    def test_of_the_file(self, old: str, new: str, words: str, tmp_path: Path) -> None:
        text = (HERE / "scara.xml").read_text()
        assert old in text
        (tmp_path / "wrong.xml").write_text(text.replace(old, new))
        assert words in self.refused(tmp_path, file="wrong.xml")

    def test_a_motor_follows_no_speed(self, tmp_path: Path) -> None:
        text = (HERE / "scara.xml").read_text()
        motors = "".join(
            f'<motor name="m_{j}" joint="{j}" gear="2" ctrlrange="-7 7"/>'
            for j in ("shoulder", "elbow", "lift", "roll")
        )
        (tmp_path / "motors.xml").write_text(
            text.replace("</mujoco>", f"<actuator>{motors}</actuator></mujoco>")
        )
        assert "shoulder has a motor actuator there" in self.refused(
            tmp_path, file="motors.xml", actuation="file"
        )
        assert (
            "shoulder: hinge, -150 to 150 deg, at most 14 Nm [a motor actuator, line 11]"
            in told_of(tmp_path / "motors.xml")["joint"]
        )


def told_of(file: str | Path) -> dict[str, list[str]]:
    """What `doctor FILE.xml` has found, by what it looked at."""
    lines: dict[str, list[str]] = {}
    for what, _, found, _ in examine_model(str(file)):
        lines.setdefault(what, []).append(found)
    return lines


class TestUrdf:
    """A URDF shows its `visual` shapes, has its fixed links as flanges, and finds the meshes of its
    package.
    """

    LINK = (
        '<inertial><mass value="1"/>'
        '<inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    SHAPE = '<{0}><origin xyz="0 0 0.15"/><geometry>{1}</geometry></{0}>'
    JOINT = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>{4}</joint>'
    HINGE = (
        '<origin xyz="0 0 .3"/><axis xyz="0 {} {}"/>'
        '<limit lower="-2" upper="2" effort="60" velocity="0.7"/>'
    )

    def written(self, folder: Path, mesh: str) -> Path:
        """Two links, the first to be seen by a box and a mesh, and to be touched by a cylinder; a
        tool on a fixed joint.
        """
        shapes = (
            ("visual", '<box size=".1 .1 .3"/>'),
            ("visual", f'<mesh filename="{mesh}"/>'),
            ("collision", '<sphere radius=".1"/>'),
        )
        links = ["base", "one", "two", "tool0"]
        drawn = "".join(self.SHAPE.format(*shape) for shape in shapes)
        text = ["<link name='base'/>", f"<link name='one'>{self.LINK}{drawn}</link>"]
        round_end = self.SHAPE.format("collision", '<sphere radius=".05"/>')
        text += [f"<link name='two'>{self.LINK}{round_end}</link>", "<link name='tool0'/>"]
        ends = self.HINGE.format(0, 1), self.HINGE.format(1, 0), '<origin xyz="0 0 .2"/>'
        for name, kind, parent, child, more in zip(
            "abc", ("revolute", "revolute", "fixed"), links, links[1:], ends, strict=False
        ):
            text.append(self.JOINT.format(name, kind, parent, child, more))
        (folder / "my_arm" / "urdf").mkdir(parents=True)
        (folder / "my_arm" / "urdf" / "arm.urdf").write_text(
            "\n".join(['<robot name="arm">', *text, "</robot>"])
        )
        return folder / "my_arm" / "urdf" / "arm.urdf"

    def test_what_is_seen_and_where_it_ends(self, tmp_path: Path) -> None:
        file = self.written(tmp_path, "package://my_arm/meshes/one.obj")
        absent = (
            r"names the mesh package://my_arm/meshes/one\.obj,"
            r" and no folder my_arm with it is beside the file or above it"
        )
        with pytest.raises(ParameterError, match=absent):
            compiled(str(file))
        (tmp_path / "my_arm" / "meshes").mkdir()
        (tmp_path / "my_arm" / "meshes" / "one.obj").write_text(
            "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
        )
        assert told_of(file)["as an arm"] == [
            "robot: {kind: mjcf}, for instance with flange: tool0"
        ]
        assert "speed_limits: [0.7, 0.7]" in told_of(file)["scenario"][0]
        model = compiled(str(file))
        seen = {"one": [1, 1, 3], "two": [0]}  # shapes for contacts alone are in group 3
        assert {
            name: sorted(model.geom_group[model.geom_bodyid == model.body(name).id].tolist())
            for name in seen
        } == seen
        robot = ROBOTS.members["mjcf"](
            file=str(file),
            flange="tool0",
            speed_limits=[1, 1],
            start={"nominal": {"q_deg": [0, 30]}},
        )
        np.testing.assert_allclose(
            robot.flange_pose(robot.configuration())[:3, 3],
            [0.1, 0, 0.6 + 0.2 * np.sqrt(0.75)],
            atol=1e-12,
        )

    def test_a_mesh_that_cannot_be_read_is_not_seen_and_a_xacro_is_none(
        self, tmp_path: Path
    ) -> None:
        file = self.written(tmp_path, "one.dae")
        model = compiled(str(file))
        assert (model.nmesh, model.ngeom) == (0, 3)
        file.with_name("x.urdf").write_text(
            '<robot xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include filename="b"/></robot>'
        )
        with pytest.raises(
            ParameterError,
            match=r"is a xacro, and no URDF yet; `xacro x\.urdf > arm\.urdf` writes one",
        ):
            compiled(str(file.with_name("x.urdf")))

    def test_names_with_a_prefix_and_a_xacro_in_a_comment_are_read(self, tmp_path: Path) -> None:
        """The first was a traceback of the report, the second refused as a xacro."""
        file = self.written(tmp_path, "one.dae")
        text = file.read_text().replace(
            "</robot>", '<!-- <xacro:gripper/> --><drake:joint_limits drake:a="1"/></robot>'
        )
        file.write_text(text)
        assert joint_chain(str(file), "tool0", ()).names == ("a", "b")
        assert speeds_in(file) == {"a": 0.7, "b": 0.7}
        file.write_text(text.replace('velocity="0.7"', 'velocity="${fast}"'))
        with pytest.raises(
            ParameterError,
            match=r"arm\.urdf cannot be read .*fast.*a URDF whose limits are numbers",
        ):
            speeds_in(file)

    @pytest.mark.parametrize(
        ("given", "range_or_words"),
        [
            ("soft_lower_limit='-1' soft_upper_limit='.5' k_velocity='9'", (-1, 0.5)),
            ("soft_lower_limit='-9' soft_upper_limit='.5'", (-2, 0.5)),
            ("k_velocity='9'", (-2, 2)),
            ("soft_lower_limit='-1'", "safety_controller of a with soft_lower_limit below"),
            ("soft_lower_limit='0' soft_upper_limit='0'", "and has 0 and 0"),
            ("soft_lower_limit='3' soft_upper_limit='4'", "limits of -2 to 2, and has 3 and 4"),
            ("soft_lower_limit='x' soft_upper_limit='4'", "a URDF whose limits are numbers"),
        ],
    )
    def test_a_safety_controller_narrows_the_range(
        self, tmp_path: Path, given: str, range_or_words: Any
    ) -> None:
        """It was dropped without a word: the arm moved to where its driver would stop it."""
        file = self.written(tmp_path, "one.dae")
        soft = f"<safety_controller {given}/></joint>"
        file.write_text(file.read_text().replace("</joint>", soft, 1))
        if isinstance(range_or_words, str):
            with pytest.raises(ParameterError, match=range_or_words):
                joint_chain(str(file), "tool0", ())
            return
        limits = joint_chain(str(file), "tool0", ()).limits
        assert limits.tolist() == [pytest.approx(range_or_words), [-2, 2]]

    def test_a_safety_controller_gives_a_range_to_a_joint_that_turns_without_end(
        self, tmp_path: Path
    ) -> None:
        file = self.written(tmp_path, "one.dae")
        text = file.read_text().replace('"revolute"', '"continuous"')
        text = text.replace('lower="-2" upper="2" ', "")
        soft = "<safety_controller soft_lower_limit='-3' soft_upper_limit='4'/></joint>"
        file.write_text(text.replace("</joint>", soft, 1))
        limits = joint_chain(str(file), "tool0", ()).limits
        assert limits.tolist() == [[-3, 4], [-np.inf, np.inf]]

    def test_what_stands_on_a_body_has_not_the_material_of_its_class(self, tmp_path: Path) -> None:
        """A class of the file with a material gave it to the camera's shape, whose material MuJoCo
        then did not find.
        """
        text = (HERE / "two_link.xml").read_text()
        assert "<worldbody>" in text
        classed = (
            '<default><default class="arm"><geom material="white"/></default></default><asset>'
            '<material name="white"/></asset>'
        )
        (tmp_path / "arm.xml").write_text(
            text.replace("<worldbody>", f"{classed}<worldbody>").replace(
                "<body ", '<body childclass="arm" ', 1
            )
        )
        robot = block("two_link", file=str(tmp_path / "arm.xml"))
        target = square_before(arm("two_link"), *SEEN["flat"])
        with vs.Session(
            written(tmp_path, "classed", robot, target, {"xyz": [0, 0, 0.7]})
        ) as session:
            assert session.reset().truth is not None


class TestNumbersNoRobotHas:
    """MuJoCo takes them: the report ended in a traceback of NumPy, or called a gain `nan` well."""

    WRONG = (
        ("seven.xml", 'pos="0 0 nan"', "pos='0 0 nan' in <body> link, line 4, and all its numbers"),
        ("seven.xml", 'pos="0 0 1e400"', "pos='0 0 1e400' in <body> link, line 4"),
        ("seven.xml", 'pos="0 2e6 0"', "and at most 1e+06 m can be"),
        ("seven.xml", 'quat="1e200 0 0 0"', "and at most 1e+16 can be"),
        ("arm.urdf", "<origin xyz='0 0 nan'/>", "xyz='0 0 nan' in <origin> after joint a, line 6"),
        ("arm.urdf", "<origin rpy='0 0 -inf'/>", "rpy='0 0 -inf' in <origin> after joint a"),
        ("arm.urdf", "<origin xyz='0 0 1e200'/>", "and at most 1e+06 m can be"),
    )
    MJCF = (
        '<mujoco>\n<worldbody><body>\n<joint name="a" range="-1 1"/><geom size=".1"/>\n'
        '<body name="link" {}><joint name="b" axis="0 1 0" range="-1 1"/><geom size=".1"/>'
        "</body></body></worldbody></mujoco>"
    )

    def test_are_refused_with_their_element_and_attribute(self, tmp_path: Path) -> None:
        urdf = TestUrdf().written(tmp_path, "one.dae")
        text = urdf.read_text()
        assert text.count('<origin xyz="0 0 .3"/>') == 2
        for name, part, words in self.WRONG:
            file = tmp_path / name if name.endswith("xml") else urdf
            right = self.MJCF.format(part)
            if file == urdf:
                right = text.replace('<origin xyz="0 0 .3"/>', part, 1)
            file.write_text(right)
            compiled.cache_clear()
            ((what, sound, found, remedy),) = examine_model(str(file))
            assert (what, sound, remedy) == ("model", False, "correct it there")
            assert words in found
        urdf.write_text(text.replace('mass value="1"', 'mass value="1e12"'))
        compiled.cache_clear()
        with pytest.raises(ParameterError, match=r"<mass> after link one.*at most 1e\+09 kg"):
            compiled(str(urdf))

    def test_of_a_file_that_is_included_and_of_shapes_whose_masses_are(
        self, tmp_path: Path
    ) -> None:
        (tmp_path / "part.xml").write_text(self.MJCF.format('pos="0 inf 0"'))
        (tmp_path / "arm.xml").write_text('<mujoco><include file="part.xml"/></mujoco>')
        with pytest.raises(ParameterError, match=r"pos='0 inf 0' in <body> link.*part\.xml"):
            compiled(str(tmp_path / "arm.xml"))
        big = self.MJCF.format('pos="0 0 1"').replace('size=".1"', 'size="1e5"')
        (tmp_path / "arm.xml").write_text(big)
        compiled.cache_clear()
        with pytest.raises(ParameterError, match=r"gives the body 1 a mass of 4\.19e\+18 kg"):
            compiled(str(tmp_path / "arm.xml"))

    def test_what_stands_fast_may_be_as_large_as_a_hill(self, tmp_path: Path) -> None:
        """Its mass moves nothing: it ran as scenery, which the report refused."""
        (tmp_path / "hill.xml").write_text(
            '<mujoco><worldbody><body name="hill" pos="0 0 -51">'
            '<geom type="box" size="500 500 50"/></body></worldbody></mujoco>'
        )
        assert told_of(tmp_path / "hill.xml")["as scenery"]

    def test_limits_may_be_infinite_and_names_may_be_words_of_numbers(self, tmp_path: Path) -> None:
        file = TestUrdf().written(tmp_path, "one.dae")
        text = file.read_text().replace('effort="60"', 'effort="1.79769e+308"')
        text = text.replace('"two"', '"nan"').replace("'two'", "'nan'")
        file.write_text(text.replace('velocity="0.7"', 'velocity="inf" acceleration="inf"'))
        assert joint_chain(str(file), "tool0", ()).names == ("a", "b")

    def test_lengths_in_millimetres_are_told(self, tmp_path: Path) -> None:
        file = TestUrdf().written(tmp_path, "one.dae")
        file.write_text(file.read_text().replace("0 0 .2", "0 0 200").replace("0 0 .3", "0 0 300"))
        words = r"at most 200 m from the first joint to tool0, and has 500 m:.*like millimetres"
        with pytest.raises(ParameterError, match=words):
            joint_chain(str(file), "tool0", ())


class TestCoupledJoints:
    """Joints that the file couples were taken as free: the law's twists did not come about. A
    gripper's beyond the arm stay.
    """

    ARM = """<mujoco><worldbody>{world}
        <body name="one"><joint name="a" range="-90 90"/><geom size=".1" mass="1"/>
        <body name="two" pos="0 0 .3"><joint name="b" axis="0 1 0" range="-90 90"/>
        <geom size=".1" mass="1"/>
        <body name="three" pos="0 0 .3"><joint name="c" axis="0 1 0" range="-90 90"/>
        <geom size=".1" mass="1"/><site name="hand"/>
        <body name="left"><joint name="l" type="slide"/><geom size=".1" mass="1"/></body>
        <body name="right"><joint name="r" type="slide"/><geom size=".1" mass="1"/></body>
        </body></body></body></worldbody>
        <tendon><fixed name="t">
        <joint joint="b" coef="1"/><joint joint="c" coef="1"/></fixed></tendon>
        <equality>{equality}</equality></mujoco>"""

    @pytest.mark.parametrize(
        ("equality", "coupled"),
        [
            (
                '<joint joint1="c" joint2="b" polycoef="0 -1 0 0 0"/>',
                "couples c (equality joint, such as a URDF's <mimic>)",
            ),
            ('<joint joint1="b"/>', "couples b (equality joint"),
            ('<tendon tendon1="t"/>', "couples b, c (equality tendon)"),
            (
                '<connect body1="three" body2="one" anchor="0 0 0"/>',
                "couples b, c (equality connect)",
            ),
            ('<weld body1="free" body2="three"/>', "couples a, b, c (equality weld)"),
            ('<joint joint1="c" joint2="b" active="false"/>', ""),
            (
                (
                    '<joint joint1="r" joint2="l"/>'
                    '<connect body1="left" body2="right" anchor="0 0 0"/>'
                ),
                "",
            ),
            # a finger that follows the wrist leaves it free
            ('<joint joint1="r" joint2="c"/>', ""),
        ],
    )
    def test_those_of_the_chain_are_refused_by_name(
        self, tmp_path: Path, equality: str, coupled: str
    ) -> None:
        (tmp_path / "arm.xml").write_text(
            self.ARM.format(equality=equality, world='<body name="free" mocap="true"/>')
        )
        if not coupled:
            assert joint_chain(str(tmp_path / "arm.xml"), "hand", ()).names == ("a", "b", "c")
            return
        with pytest.raises(ParameterError) as refused:
            joint_chain(str(tmp_path / "arm.xml"), "hand", ())
        assert coupled in str(refused.value)

    @pytest.mark.parametrize(
        ("tendon", "coupled"),
        [
            ('<fixed name="s" limited="true" range="-.1 .1">{b}{c}</fixed>', "limits b, c by the"),
            ('<fixed name="s" range="-.1 .1">{b}</fixed>', "limits b by the range of tendon s"),
            (
                '<spatial name="s" limited="true" range="0 1"><site site="foot"/>'
                '<site site="hand"/></spatial>',
                "limits a, b, c by the range of tendon s",
            ),
            ('<fixed name="s" stiffness="5">{b}{c}</fixed>', ""),
            (
                '<spatial name="s" stiffness="5"><site site="foot"/><site site="hand"/></spatial>',
                "",
            ),
            ('<fixed name="s" range="0 1"><joint joint="l" coef="1"/></fixed>', "no"),
        ],
    )
    def test_limited_tendons_are_refused_and_others_that_pull_are_told(
        self, tmp_path: Path, tendon: str, coupled: str
    ) -> None:
        """A range of the sum of two joints was none to the law, whose servos fought with it."""
        of = {name: f'<joint joint="{name}" coef="1"/>' for name in "bc"}
        text = self.ARM.format(equality="", world='<site name="foot" pos=".3 0 0"/>')
        file = tmp_path / "arm.xml"
        file.write_text(text.replace("<tendon>", f"<tendon>{tendon.format(**of)}"))
        compiled.cache_clear()
        if coupled not in ("", "no"):
            with pytest.raises(ParameterError, match=f"{coupled}.*works: the file without it"):
                joint_chain(str(file), "hand", ())
            return
        joints = "a, b, c" if "spatial" in tendon else "b, c"
        told = [f"s: pulls at {joints}, as its file has it; laws do not know of it"]
        assert told_of(file).get("tendon", []) == ([] if coupled else told)

    def test_an_equality_of_a_spatial_tendon_couples_too(self, tmp_path: Path) -> None:
        text = self.ARM.format(equality='<tendon tendon1="s"/>', world='<site name="foot"/>')
        spatial = '<spatial name="s"><site site="foot"/><site site="hand"/></spatial>'
        (tmp_path / "arm.xml").write_text(text.replace("<tendon>", f"<tendon>{spatial}", 1))
        compiled.cache_clear()
        with pytest.raises(ParameterError, match=r"couples a, b, c \(equality tendon\)"):
            joint_chain(str(tmp_path / "arm.xml"), "hand", ())

    def test_a_mimic_joint_of_a_urdf_is_one(self, tmp_path: Path) -> None:
        file = TestUrdf().written(tmp_path, "one.dae")
        head, second, rest = file.read_text().partition('<joint name="b"')
        file.write_text(
            head
            + second
            + rest.replace("</joint>", '<mimic joint="a" multiplier="-1"/></joint>', 1)
        )
        with pytest.raises(
            ParameterError,
            match=(
                r"couples b \(equality joint,"
                r" such as a URDF's <mimic>\).*a flange before these joints"
            ),
        ):
            joint_chain(str(file), "tool0", ())


class TestDoctor:
    """`doctor FILE.xml` says what of a file can be used, and for what; the scenario that it prints
    runs.
    """

    @pytest.mark.parametrize(
        ("file", "flange"),
        one_quick(
            (str(HERE / "two_link.xml"), "flange"),
            (str(HERE / "scara.xml"), "tool"),
            (str(HERE / "seven.xml"), "hand"),
            (JACO, "wristsite"),
            pytest.param(
                "package:dm_robotics.panda/assets/panda/panda.xml", "wrist_site", marks=NEEDS_PANDA
            ),
        ),
    )
    def test_the_scenario_that_it_prints_converges(
        self, file: str, flange: str, tmp_path: Path
    ) -> None:
        (tmp_path / "first.yaml").write_text(told_of(file)["scenario"][0].partition("\n")[2])
        scenario = vs.load(tmp_path / "first.yaml", {"detector": "oracle"})
        assert (
            scenario.robot.flange == flange
            and np.isfinite([s.torque for s in scenario.robot.body.actuation.servos]).all()
        )
        recording = vs.run(scenario)
        assert recording.outcome is vs.Outcome.converged, recording.reason
        # its random starts have the target in view
        assert seeded(scenario, 1).resolved.robot != scenario.robot

    def test_a_sound_file(self, command: Any, tmp_path: Path) -> None:
        told = command("doctor", str(HERE / "scara.xml"))
        assert told.code == 0 and "tool: shoulder, elbow, lift, roll" in told.out
        assert "lift: slide, -0.3 to 0.1 m, at most 200 N [no actuator, line 17]" in told.out
        assert (
            "shoulder: hinge, -150 to 150 deg [no torque limit (actuatorfrcrange);"
            " no actuator, line 11]" in told.out
        )
        assert "lift: kp 5400 N/m, kv 135 N s/m, added by actuation: velocity" in told.out
        assert (
            "as scenery   no: has the joint shoulder (line 11), and scenery stands still"
            in told.out
        )

    def test_friction_that_winds_servos_up(self, tmp_path: Path) -> None:
        text = (HERE / "seven.xml").read_text().replace('name="j7"', 'name="j7" frictionloss="70"')
        (tmp_path / "rough.xml").write_text(text.replace('name="j6"', 'name="j6" frictionloss="0"'))
        own, added = (
            line
            for line in reversed(told_of(tmp_path / "rough.xml")["servo"])
            if line.startswith("j7")
        )
        assert "winds it up by 0.5 deg, added" in added
        assert "friction of 70 Nm winds it up by 1 deg (WARNING: over 0.5 deg" in own
        assert not any(
            "j6" in line and "winds" in line for line in told_of(tmp_path / "rough.xml")["servo"]
        )

    def test_a_gripper_is_no_part_of_the_arm(self, tmp_path: Path) -> None:
        finger = (
            '<body name="{0}"><joint name="{0}" type="slide" range="0 .04"/>'
            '<geom size=".01" mass=".05"/></body>'
        )
        text = (
            (HERE / "scara.xml")
            .read_text()
            .replace(
                '<site name="tool"',
                finger.format("left") + finger.format("right") + '<site name="tool"',
            )
        )
        (tmp_path / "hand.xml").write_text(text)
        told = told_of(tmp_path / "hand.xml")
        assert told["as an arm"] == ["robot: {kind: mjcf}, for instance with flange: tool"]
        assert "left: shoulder, elbow, lift, roll, left" in told["flange"]

    def test_links_that_always_touch(self, tmp_path: Path) -> None:
        text = (HERE / "two_link.xml").read_text().replace('contype="0" conaffinity="0"', "")
        assert "contact" not in told_of(HERE / "two_link.xml")
        (tmp_path / "touching.xml").write_text(
            text.replace(
                'size=".05"/>', 'size=".05"/><geom type="box" pos=".25 0 1" size=".02 .02 .02"/>'
            )
        )
        assert told_of(tmp_path / "touching.xml")["contact"] == [
            "world and upper touch, in the best of 100 postures, too"
        ]

    def test_scenery_with_a_door_is_no_arm(self, command: Any, tmp_path: Path) -> None:
        door = '<body name="door"><joint name="hinge"/><geom type="box" size=".4 .02 1"/></body>'
        (tmp_path / "room.xml").write_text(
            f"<mujoco><worldbody><geom type='box' size='1 1 .1'/>\n{door}</worldbody></mujoco>"
        )
        told = command("doctor", str(tmp_path / "room.xml"))
        assert told.code == 2 and "1 joint, 0 actuators, 0 sites, 2 geoms" in told.out
        assert (
            "missing  as an arm    door: flange must be after 2 to 7 joints, and door is after 1"
            in told.out
        )
        assert (
            "missing  as scenery   has the joint hinge (line 2), and scenery stands still"
            in told.out
            and "-> remove it" in told.out
        )

    def test_files_that_are_no_arms(self, command: Any, tmp_path: Path) -> None:
        told = command(
            "doctor",
            "models/quadrotor.xml"
            if Path("models").is_dir()
            else str(HERE.parents[2] / "models/quadrotor.xml"),
        )
        assert told.code == 2 and "root is a free joint" in told.out
        (tmp_path / "broken.xml").write_text("<mujoco>\n<wordbody/>\n</mujoco>")
        told = command("doctor", str(tmp_path / "broken.xml"))
        assert told.code == 2 and "missing  model" in told.out and "broken.xml:2: " in told.out
        assert command("doctor", str(tmp_path / "none.xml")).code == 2
