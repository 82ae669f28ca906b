"""Completion: what a shell is offered, through the variables by which it asks."""

from __future__ import annotations

import subprocess

import pytest

import vstestbed as vs
from vstestbed.cli import complete
from vstestbed.core.errors import ParameterError
from vstestbed.scenario.catalogue import catalogue, looked_up
from vstestbed.scenario.plugins import registries


def offered(process: tuple[list[str], dict[str, str]], *words: str) -> list[str]:
    command, environment = process
    asked = {
        "COMP_WORDS": " ".join(("vstestbed", *words)),
        "COMP_CWORD": str(len(words)),
        complete.VARIABLE: "complete_bash",
    }
    ended = subprocess.run(
        command, env=environment | asked, capture_output=True, text=True, timeout=60, check=True
    )
    assert ended.stderr == ""
    return ended.stdout.split()


@pytest.mark.process
def test_a_shell_is_offered_names(vstestbed_process) -> None:
    assert offered(vstestbed_process, "run", "arm_pb") == ["arm_pbvs"]
    assert offered(vstestbed_process, "run", "arm_ibvs", "--set", "stop.dur") == ["stop.duration_s"]


@pytest.mark.process
def test_a_shell_gets_its_script(vstestbed_process) -> None:
    command, environment = vstestbed_process
    ended = subprocess.run(
        [*command, "--show-completion", "bash"],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert complete.VARIABLE in ended.stdout


def test_scenarios_and_comparisons() -> None:
    assert complete.scenarios("arm_pbvs") == ["arm_pbvs"]
    assert complete.experiments("canonical_") == ["canonical_arm", "canonical_arm_tuned"]
    assert complete.figures("time_to") == ["time_to_converge_s", "time_to_goal_s"]
    assert complete.scenarios("./mine") == []  # the shell then offers files


def test_kinds_are_those_that_describe_knows() -> None:
    assert complete.kinds("pbv") == ["pbvs"]
    bundled = {
        kind
        for room in registries().values()
        for kind, cls in room.members.items()
        if cls.__module__.startswith("vstestbed.")
    }
    assert bundled <= set(complete.kinds(""))
    assert {"law", "stop", "noise"} <= set(complete.kinds(""))
    assert complete.kinds("camera.s") == [
        "camera.sensor",
        "camera.shadows",
        "camera.spherical",
        "camera.stream",
    ]
    of_stop = (
        "converged",
        "duration_s",
        "frozen_after_s",
        "lost_after_m",
        "lost_after_s",
        "rest_after_s",
    )
    assert complete.kinds("stop.") == [f"stop.{name}" for name in of_stop]
    assert complete.kinds("robot.gears.s") == ["robot.gears.stiffness_nmprad"]
    entries = catalogue(scenario=vs.Scenario)
    for word in complete.kinds(""):
        try:
            assert looked_up(word, entries)
        except ParameterError as several:
            assert str(several).endswith("give one of these names")
    assert all(
        looked_up(word, entries)
        for owner in complete.kinds("")
        for word in complete.kinds(f"{owner}.")
    )
    assert complete.kinds("nope.") == []
    assert complete.kinds("metr") == ["metrics"]


def test_dotted_paths() -> None:
    for begun, words in (
        ("camera.lat", ["camera.latency_s"]),
        (
            "stop.conv",
            [
                "stop.converged.error_px",
                "stop.converged.position_m",
                "stop.converged.rotation_deg",
                "stop.converged.error_grey",
                "stop.converged.hold_s",
            ],
        ),
        ("law.no_such", []),
        ("no_such.field", []),
        ("see", ["seed"]),
    ):
        assert complete.paths(begun) == words


def test_a_field_of_several_kinds_is_offered_with_what_is_in_each() -> None:
    assert {
        f"robot.parameters.{name}" for name in ("track_m", "wheel_speed_radps", "arm_m")
    } <= set(complete.paths("robot.par"))


def test_a_block_alone_is_offered_with_what_is_in_it() -> None:
    assert "law.gain" in complete.paths("la") and "law.gain" in complete.paths("law.")
