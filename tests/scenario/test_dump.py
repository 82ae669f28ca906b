"""Scenarios of parts in Python and the YAML that is the same: short as people write it, equal when
it is read.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML
from spatialmath import SE2, SE3

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.scenario.load import parse

T_WORLD_TARGET = SE3(1.5, 0, 0.7) * SE3.Ry(90, unit="deg")


def built(**more: Any) -> vs.Scenario:
    parts: dict[str, Any] = {
        "robot": vs.robots.Puma560(start={"nominal": {"q_deg": [0, 45, -180, 0, 45, -45]}}),
        "target": vs.targets.Square(side=0.5, pose=T_WORLD_TARGET),
        "law": vs.laws.IBVS(gain=0.5, depth="pnp"),
        "goal": vs.tasks.GoalView(T_camera_target=SE3(0, 0, 1)),
        "stop": vs.Stop(duration_s=12, converged={"error_px": 0.5}),
    }
    return vs.Scenario(**parts | more)


@pytest.mark.parametrize("name", one_quick(*sorted(bundled_scenarios()), every=3))
def test_a_bundled_scenario_is_read_again_from_its_short_text(name: str, tmp_path: Path) -> None:
    scenario, file = vs.load(name), tmp_path / f"{name}.yaml"
    text = vs.dump(scenario, file)
    assert file.read_text(encoding="utf-8") == text
    assert vs.load(file) == scenario
    assert parse(vs.dump(scenario), "text.yaml") == scenario
    assert len(text) < 0.45 * len(vs.dump(scenario, defaults=True))
    assert "null" not in text and ".0," not in text


def test_it_reads_as_if_written_by_hand(tmp_path: Path) -> None:
    text = vs.dump(
        built(name="mine", camera=vs.camera.Perspective(mount=SE3.Rx(-90, unit="deg"), rate_hz=50)),
        tmp_path / "mine.yaml",
    )
    assert (
        text
        == """\
robot: puma560
camera: {kind: perspective, fovy_deg: 64, rate_hz: 50, mount: {rpy_deg: [-90, 0, 0]}}
target: {kind: square, side: 0.5, pose: {xyz: [1.5, 0, 0.7], rpy_deg: [0, 90, 0]}}
law: ibvs
goal: {T_camera_target: {xyz: [0, 0, 1]}}
stop: {duration_s: 12, converged: {error_px: 0.5}}
"""
    )


def test_parts_in_python_are_the_scenario_of_the_same_yaml(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    scenario = built(
        name="mine",
        seed=3,
        noise=vs.Noise(pixel_sigma_px=0.25),
        timing=vs.Timing(command_latency_s=0.02),
    )
    vs.dump(scenario, file)
    assert vs.load(file) == scenario
    assert YAML(typ="safe").load(file.read_text()).keys() == {
        "seed",
        "robot",
        "target",
        "law",
        "goal",
        "stop",
        "noise",
        "timing",
    }
    nameless = built()
    vs.dump(nameless, file)
    assert vs.load(file) == replace(nameless, name="mine")


def test_a_pose_survives_yaml_to_1e_12(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    for i in range(10):
        T = (
            SE3(1.5, 0, 0.7)
            * SE3.Ry(90 + 10.0**-i, unit="deg")
            * SE3.Rand()
            * SE3.Rx(rng.uniform(-3, 3))
        )
        free = vs.robots.Free(start={"nominal": T, "random": {"xyz": [0.1, 0.1, 0.1]}})
        target = vs.targets.Square(side=0.5, pose=T * SE3(0, 0, 1.3))
        scenario = built(robot=free, target=target, detector="oracle")
        read = parse(vs.dump(scenario), "s.yaml")
        assert read == scenario
        assert np.abs(read.robot.start.nominal.T - T.A).max() < 1e-12
        assert np.abs(read.target.pose.T - (T * SE3(0, 0, 1.3)).A).max() < 1e-12


class TestOverrides:
    def test_poses_in_every_place(self) -> None:
        T = SE3(0.02, 0.01, 0.03) * SE3.RPY(0.1, 0.2, 0.3)
        s = vs.load(
            "arm_ibvs",
            {"target.pose": T_WORLD_TARGET, "camera.mount": T, "calibration.mount_error": T.inv()},
        )
        assert s.target == vs.load("arm_ibvs").target
        assert (
            np.abs(s.camera.mount.T - T.A).max() < 1e-12
            and np.abs(s.calibration.mount_error.T - T.inv().A).max() < 1e-12
        )
        s = vs.load(
            "quadrotor_path",
            {
                "goal.way.1.T_camera_target": SE3(0, 0, 3),
                "robot.start.nominal": SE3(0, 0, 2) * SE3.Rz(0.5),
            },
        )
        assert s.goal.goal_poses(s.target, np.eye(4))[1][2, 3] == 3
        assert s.robot.start.nominal.yaw_deg == round(np.degrees(0.5), 12)
        assert vs.load("car_parking", {"goal.pose": SE2(0.5, 0, 0.1)}) == vs.load(
            "car_parking", {"goal.pose": SE3(0.5, 0, 0) * SE3.Rz(0.1)}
        )

    def test_a_wrong_one_is_named_with_its_field(self) -> None:
        with pytest.raises(
            ScenarioError, match=r"overrides: target\.pose: must be one pose: .*, got 2"
        ):
            vs.load("arm_ibvs", {"target.pose": SE3.Rx([0.1, 0.2])})
        with pytest.raises(
            ScenarioError, match=r"law.gain: must be a number, or a block .* got SE3\(array"
        ):
            vs.load("arm_ibvs", {"law.gain": SE3()})


PLUGIN = """\
from typing import Literal
import vstestbed as vs
from vstestbed.laws import IBVS

@vs.LAWS.add
@vs.spec
class Mine(IBVS):
    kind: Literal["mine"] = "mine"
    boost: float = 1.0
"""


@pytest.mark.usefixtures("own_kinds")
class TestOwnKinds:
    def test_of_a_plugin_file(self, tmp_path: Path) -> None:
        (tmp_path / "laws").mkdir()
        (tmp_path / "laws" / "mine_dumped.py").write_text(PLUGIN)
        (tmp_path / "own.yaml").write_text(
            "plugins: [laws/mine_dumped.py]\n"
            + vs.dump(built()).replace("law: ibvs", "law: {kind: mine, boost: 2}")
        )
        scenario = vs.load(tmp_path / "own.yaml")
        assert "law: {kind: mine, boost: 2}" in (text := vs.dump(scenario, tmp_path / "own.yaml"))
        # relative, since it is below the file's folder
        assert "plugins: [laws/mine_dumped.py]" in text
        assert vs.load(tmp_path / "own.yaml") == scenario
        assert f"plugins: [{tmp_path}/laws/mine_dumped.py]" in vs.dump(scenario)
        assert parse(vs.dump(scenario), "elsewhere.yaml") == scenario
        with pytest.raises(
            ParameterError,
            match=(
                r"law is Mine of .*mine_dumped.py, which the file would not name;"
                r" give the scenario plugins="
            ),
        ):
            vs.dump(replace(scenario, plugins=()))

    def test_of_a_notebook(self) -> None:
        # of no file, as a notebook's __main__
        space = sys.modules["a_notebook_of_the_tests"] = ModuleType("a_notebook_of_the_tests")
        exec(PLUGIN, space.__dict__)
        with pytest.raises(
            ParameterError,
            match=(
                r"law is Mine, which is defined in the program"
                r" that runs .* put the class into a file"
            ),
        ):
            vs.dump(built(law=space.Mine(boost=2)))

    def test_of_an_imported_module(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "mine_imported.py").write_text(PLUGIN)
        monkeypatch.syspath_prepend(str(tmp_path))
        __import__("mine_imported")
        law = sys.modules["mine_imported"].Mine(gain=1.0)
        for named in (("mine_imported",), (str(tmp_path / "mine_imported.py"),)):
            scenario = built(law=law, plugins=named)
            assert parse(vs.dump(scenario), "s.yaml") == scenario


def test_files_are_named_for_the_place_of_the_yaml(tmp_path: Path) -> None:
    (tmp_path / "act.py").write_text("def act(observation):\n    return [0, 0, 0, 0, 0, 0]\n")
    scenario = built(name="s", law=vs.laws.Policy(file=f"{tmp_path}/act.py:act"))
    assert "file: 'act.py:act'" in vs.dump(scenario, tmp_path / "s.yaml")
    assert vs.load(tmp_path / "s.yaml") == scenario
    (tmp_path / "beside").mkdir()
    assert f"{tmp_path}/act.py:act" in vs.dump(scenario, tmp_path / "beside" / "s.yaml")
    assert vs.load(tmp_path / "beside" / "s.yaml") == scenario


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="scenario must be a Scenario"):
        vs.dump("arm_ibvs")  # pyright: ignore[reportArgumentType]
    with pytest.raises(vs.errors.OutputError, match="cannot be written"):
        vs.dump(built(), tmp_path / "no" / "folder.yaml")
