"""Values put over a scenario: another `realism` over the scenario of a run, in files, grids, draws and reports."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

import vstestbed as vs
from vstestbed.core.registry import to_mapping
from vstestbed.effects.joints import CurrentLoops
from vstestbed.robots.realism import Level
from vstestbed.scenario.dump import changes
from vstestbed.scenario.load import parse
from vstestbed.studies.comparison import chosen, controllers

TWEAKS: dict[str, tuple[str, dict[str, Any]]] = {
    "arm": ("arm_ibvs", {}),
    "arm, own": ("arm_ibvs", {"robot.gears": None, "robot.drives.delay_s": 0.002, "robot.geometry_error.sigma_m": 0.002}),
    "arm, payload": ("arm_ibvs", {"robot.payload.mass_kg": 1.0, "robot.ripple": {"share": 0.05}}),
    "car": ("car_pbvs", {}),
    "car, own": ("car_pbvs", {"robot.drive_lag_s": 0.3, "robot.uneven_floor.rms_m": 0.001, "robot.tyres": None}),
    "base": ("omni_ibvs", {"robot.drive_lag_s": None}),
    "craft": ("quadrotor_hover", {"robot.battery.charge": 0.5, "robot.vibration": None}),
}
"""A bundled scenario, and what a user gives of its robot's imperfections."""


def stored(scenario: vs.Scenario) -> str:
    """The text that a run's folder keeps."""
    return vs.dump(scenario, defaults=True)


@pytest.mark.parametrize("case", TWEAKS)
@pytest.mark.parametrize(("former", "now"), [("none", "field"), ("lab", "field"), ("field", "lab"), ("field", "none")])
def test_another_level_over_a_run_is_that_level_over_what_the_user_gave(former: Level, now: Level, case: str) -> None:
    name, own = TWEAKS[case]
    if former == "none":  # where all is off, the scenario of a run does not tell by whom
        own = {path: value for path, value in own.items() if value is not None}
    text = stored(vs.load(name, own | {"seed": 3, "robot.realism": former}))
    assert parse(text, "scenario.yaml", {"robot.realism": now}) == vs.load(name, own | {"seed": 3, "robot.realism": now})


@pytest.mark.parametrize("case", TWEAKS)
@pytest.mark.parametrize("level", ["none", "lab", "field"])
def test_a_run_and_its_short_text_are_read_again(level: Level, case: str) -> None:
    name, own = TWEAKS[case]
    scenario = vs.load(name, own | {"seed": 3, "robot.realism": level})
    assert parse(stored(scenario), "scenario.yaml") == scenario
    assert parse(stored(scenario), "scenario.yaml", {"robot.realism": level}) == scenario
    assert parse(vs.dump(scenario), "short.yaml") == scenario


def test_a_level_written_into_the_file_of_a_run_by_hand() -> None:
    text = stored(vs.load("arm_ibvs", {"seed": 3, "robot.realism": "lab"}))
    assert "realism: lab" in text
    edited = text.replace("realism: lab", "realism: field")
    assert parse(edited, "scenario.yaml") == vs.load("arm_ibvs", {"seed": 3, "robot.realism": "field"})


@pytest.mark.parametrize("former", ["none", "lab"])
def test_what_is_given_with_another_level_counts_in_any_order(former: Level) -> None:
    text = stored(vs.load("arm_ibvs", {"robot.realism": former}))
    own: dict[str, Any] = {"robot.gears": None, "robot.drives.bandwidth_hz": 500.0}  # 500 Hz as the lab has it
    for settings in (own | {"robot.realism": "field"}, {"robot.realism": "field"} | own):
        robot: Any = parse(text, "scenario.yaml", settings).robot
        assert robot.gears is None
        assert robot.drives == CurrentLoops(bandwidth_hz=500.0, delay_s=0.001)


def test_null_in_a_users_file_holds_at_every_level(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(vs.dump(vs.load("arm_ibvs")).replace("kind: puma560", "kind: puma560, gears: null"), encoding="utf-8")
    for level in ("none", "lab", "field"):
        robot: Any = vs.load(file, {"robot.realism": level}).robot
        assert (robot.gears, robot.drives is None) == (None, level == "none")


def test_levels_as_an_axis_of_a_comparison_over_a_run(tmp_path: Path) -> None:
    file = tmp_path / "scenario.yaml"
    file.write_text(stored(vs.load("arm_ibvs", {"detector": "oracle", "robot.realism": "lab", "robot.encoders": None})), encoding="utf-8")
    whole = chosen([str(file)], {}, {"robot.realism": ("none", "lab", "field")}, None)
    robots: list[Any] = [variant.scenario.robot for variant in controllers(whole)]
    assert [robot.encoders for robot in robots] == [None, None, None]
    assert [robot.drives and robot.drives.bandwidth_hz for robot in robots] == [None, 500.0, 200.0]


def test_a_level_is_drawn_from_the_seed() -> None:
    drawn = {"randomise": [{"field": "robot.realism", "choice": ["none", "lab", "field"]}], "robot.drives.delay_s": 0.002}
    first = vs.load("arm_ibvs", drawn)
    found = {to_mapping(scenario.robot)["realism"]: scenario for scenario in (first.with_seed(seed) for seed in range(12))}
    assert found.keys() == {"none", "lab", "field"}
    for level, scenario in found.items():
        wanted = vs.load("arm_ibvs", {"robot.realism": level, "robot.drives.delay_s": 0.002, "seed": scenario.seed})
        assert scenario.robot == wanted.robot


def test_a_report_names_the_level_and_not_what_it_fills() -> None:
    own = {"robot.gears": None, "robot.drives.delay_s": 0.002, "seed": 3}
    assert changes(vs.load("arm_ibvs", {"robot.realism": "field", "seed": 3})) == ("robot.realism=field",)
    assert changes(vs.load("arm_ibvs", {"robot.realism": "lab"} | own)) == (
        "robot.realism=lab",
        "robot.gears=null",
        "robot.drives={delay_s: 0.002}",
    )


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"law.kind": "qp"}, ["law.kind: .* qp has no gain, feature, interaction, depth; law=qp, without .kind, replaces the block"]),
        ({"law.kind": "qp", "law.gain": 3.0}, ["law.gain: is an unknown field of qp; .*", "law.kind: .* qp has no feature, inter.*"]),
        ({"robot.kind": "omni"}, ["robot.kind: .* omni has no actuation, start.nominal.q_deg, start.random.q_deg; robot=omni, without .*"]),
        ({"law.kind": "qpp"}, ["law.kind: is no law; valid kinds: .*"]),
    ],
)
def test_another_kind_over_the_fields_of_a_block_is_one_mistake(settings: dict[str, Any], told: list[str]) -> None:
    with pytest.raises(vs.errors.ScenarioError) as refused:
        vs.load("arm_ibvs", settings)
    found = [f"{m.field}: {m.sentence}" for m in refused.value.mistakes]
    assert len(found) == len(told) and all(re.fullmatch(words, line) for words, line in zip(told, found, strict=True)), found


def test_another_kind_without_the_fields_of_the_block() -> None:
    assert vs.load("arm_ibvs", {"law": "qp"}).law.kind == "qp"
