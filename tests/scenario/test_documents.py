"""The two documents of a run: what was given, over which other values do what their words say, and
what ran, with all that was drawn.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.registry import to_mapping
from vstestbed.effects.joints import CurrentLoops
from vstestbed.robots.realism import Level
from vstestbed.scenario.dump import changes, documents, given_text, load_run
from vstestbed.scenario.load import GIVEN, RESOLVED, parse
from vstestbed.studies.comparison import chosen, controllers

WORN = {
    "robot.wheel_spread": {"sigma": 0.01},
    "robot.uneven_floor": {"rms_m": 0.002, "correlation_m": 2.0},
}
SHORT = {"detector": "oracle", "stop.duration_s": 0.2}
DRAWN = [
    {"field": "law.gain", "uniform": [0.4, 0.9]},
    {"field": "robot.realism", "choice": ["lab", "field"]},
]
RUNS: dict[str, tuple[str, dict[str, Any], int | None]] = {
    "an arm": ("arm_ibvs", {}, None),
    "an arm, its start": ("arm_ibvs", {}, 3),
    "an arm in the field": ("arm_ibvs", {"robot.realism": "field"}, 3),
    "its geometry": (
        "arm_ibvs",
        {"robot.geometry_error": {"sigma_m": 0.001, "sigma_deg": 0.1}},
        None,
    ),
    "a base, its wheels and floor": ("omni_ibvs", WORN, 3),
    "a car in the field": ("car_pbvs", {"robot.realism": "field"}, 3),
    "a craft": ("quadrotor_hover", {"robot.realism": "lab"}, 5),
    "noise": ("ibvs_book", {"noise.pixel_sigma_px": 0.5}, 4),
    "fields": ("arm_ibvs", {"randomise": DRAWN, "seed": 7}, None),
    "clutter": ("ibvs_book", {"world.clutter": {"pose": {"xyz": [0, 0, 1]}, "count": 3}}, 2),
}
"""A bundled scenario, settings, and a seed as of `--seed`."""


def both(scenario: vs.Scenario) -> tuple[vs.Scenario, vs.Scenario]:
    """A scenario read again from the two documents of its run."""
    given, resolved = (parse(text, name) for name, text in documents(scenario).items())
    return given, resolved


@pytest.mark.parametrize("case", one_quick(*RUNS, every=3))
def test_both_documents_repeat_the_run(case: str) -> None:
    name, settings, seed = RUNS[case]
    scenario = vs.load(name, SHORT | settings, seed)
    given, resolved = both(scenario)
    assert given == scenario
    assert given.resolved == resolved == scenario.resolved
    assert resolved.resolved is resolved  # nothing is left to draw
    tables = [vs.run(one).rows.table for one in (scenario, given, resolved)]
    for table in tables[1:]:
        np.testing.assert_array_equal(table, tables[0])


def test_a_folder_has_both_and_either_gives_the_same_bytes(tmp_path: Path) -> None:
    vs.run_into(
        tmp_path / "a",
        vs.load("arm_ibvs", SHORT | {"robot.realism": "field"}, seed=3),
        "none",
        report=False,
    )
    for name in (GIVEN, RESOLVED):
        vs.run_into(tmp_path / name, vs.load(tmp_path / "a" / name), "none", report=False)
        assert (tmp_path / name / "log.parquet").read_bytes() == (
            tmp_path / "a/log.parquet"
        ).read_bytes()
    assert (tmp_path / GIVEN / GIVEN).read_bytes() == (tmp_path / "a" / GIVEN).read_bytes()
    assert (tmp_path / RESOLVED / RESOLVED).read_bytes() == (tmp_path / "a" / RESOLVED).read_bytes()
    again = load_run(tmp_path / "a")
    assert (again, again.given) == (
        vs.load(tmp_path / "a" / RESOLVED),
        vs.load(tmp_path / "a" / GIVEN),
    )


def test_what_was_given_holds_neither_defaults_nor_presets_nor_draws() -> None:
    file = vs.load("arm_ibvs")
    found = vs.load("arm_ibvs", {"robot.realism": "lab", "law.gain": 0.7}, seed=3).made_of
    assert found is not None and file.made_of is not None
    robot, law = found["robot"], found["law"]
    assert robot == file.made_of["robot"] | {"realism": "lab"}
    assert law == file.made_of["law"] | {"gain": 0.7}
    assert {**found, "robot": 0, "law": 0} == {
        **file.made_of,
        "robot": 0,
        "law": 0,
        "seed": 3,
        "draw_start": True,
    }


def test_what_ran_has_every_draw_and_no_spread() -> None:
    ran: Any = vs.load("omni_ibvs", WORN | {"randomise": DRAWN[:1]}, seed=3).resolved
    assert ran.robot.wheel_spread.sigma == 0 and len(set(ran.robot.wheel_spread.errors)) == 4
    assert ran.robot.uneven_floor.seed is not None and not ran.draw_start and ran.randomise == ()
    assert 0.4 <= ran.law.gain.value <= 0.9


TWEAKS: dict[str, tuple[str, dict[str, Any]]] = {
    "arm": ("arm_ibvs", {}),
    "arm, own": (
        "arm_ibvs",
        {"robot.gears": None, "robot.drives.delay_s": 0.002, "robot.geometry_error.sigma_m": 0.002},
    ),
    "arm, payload": ("arm_ibvs", {"robot.payload.mass_kg": 1.0, "robot.ripple": {"share": 0.05}}),
    "car, own": (
        "car_pbvs",
        {"robot.drive_lag_s": 0.3, "robot.uneven_floor.rms_m": 0.001, "robot.tyres": None},
    ),
    "base": ("omni_ibvs", {"robot.drive_lag_s": None}),
    "craft": ("quadrotor_hover", {"robot.battery.charge": 0.5, "robot.vibration": None}),
}
"""A bundled scenario, and what a user gives of its robot's imperfections."""


@pytest.mark.parametrize("case", TWEAKS)
@pytest.mark.parametrize(
    ("former", "now"), [("none", "field"), ("lab", "field"), ("field", "lab"), ("field", "none")]
)
def test_another_level_over_a_run_is_that_level_over_what_the_user_gave(
    former: Level, now: Level, case: str
) -> None:
    name, own = TWEAKS[case]
    text = given_text(vs.load(name, own | {"robot.realism": former}, seed=3))
    assert parse(text, GIVEN, {"robot.realism": now}) == vs.load(
        name, own | {"robot.realism": now}, seed=3
    )


def test_settings_over_a_run_are_settings_over_its_file() -> None:
    for settings, seed in (
        ({}, 5),
        ({"seed": 5}, None),
        ({"robot.start.random.q_deg": 5}, None),
        ({"robot.start.nominal.q_deg": [0, 40, -170, 0, 45, -45]}, 5),
        ({"robot.geometry_error.sigma_m": 0.003, "law.gain": 0.8}, None),
    ):
        text = given_text(vs.load("arm_ibvs", {"robot.realism": "field"}, seed=3))
        found = parse(text, GIVEN, settings, seed)
        wanted = vs.load(
            "arm_ibvs", {"robot.realism": "field", "seed": 3, "draw_start": True} | settings, seed
        )
        assert found == wanted and found.resolved == wanted.resolved
        assert found.resolved != vs.load("arm_ibvs", {"robot.realism": "field"}, seed=3).resolved


def test_a_start_over_a_run_is_where_it_begins() -> None:
    text = given_text(vs.load("car_pbvs", seed=3))
    for start in (
        {"robot.start.nominal": {"x": 2.5, "y": 1.5, "heading_deg": 30}},
        {"robot.start.nominal.x": 2.5},
    ):
        found = parse(text, GIVEN, start)
        assert (
            not found.draw_start
            and found.resolved.robot.start == found.robot.start
            and found.robot.start.nominal.x == 2.5
        )
        about = parse(text, GIVEN, start | {"draw_start": True})
        assert about.resolved.robot.start.nominal not in (
            found.robot.start.nominal,
            parse(text, GIVEN).resolved.robot.start.nominal,
        )
    assert (
        parse(text, GIVEN, {"robot": "omni"}).resolved.robot.start.nominal
        == vs.robots.Omni().start.nominal
    )


def test_nothing_is_put_over_what_ran(tmp_path: Path) -> None:
    (tmp_path / RESOLVED).write_text(documents(vs.load("arm_ibvs", seed=3))[RESOLVED])
    words = (
        r"resolved.yaml: is the record of a run, .*;"
        r" put other values and seeds over scenario.yaml beside it"
    )
    for settings, seed in (({"robot.realism": "lab"}, None), ({}, 4)):
        with pytest.raises(ScenarioError, match=words):
            vs.load(tmp_path / RESOLVED, settings, seed)
    assert vs.load(tmp_path / RESOLVED) == vs.load("arm_ibvs", seed=3).resolved


NAMES = ("arm_ibvs", "arm_panda", "car_pbvs", "omni_ibvs", "quadrotor_hover", "ibvs_book")
"""One scenario of each kind of robot."""


@pytest.mark.parametrize("name", NAMES)
def test_a_further_seed_draws_what_it_draws_of_the_experiment_itself(name: str) -> None:
    run, wanted = vs.load(name, seed=3), vs.load(name, seed=5)
    assert run.resolved.robot.start.nominal != wanted.resolved.robot.start.nominal
    for scenario in (
        run,
        run.resolved,
        run.randomised(4),
        replace(run, name="other").randomised(4),
    ):
        assert replace(scenario.randomised(5), name=run.name) == wanted
    assert parse(given_text(run), GIVEN, seed=5) == wanted


def test_the_box_of_a_craft_keeps_a_middle_of_its_own() -> None:
    middle = {"robot.start.random.about": {"xyz": [0.5, 0, 2.5]}}
    assert vs.load("quadrotor_hover", middle, seed=3).resolved.randomised(5) == vs.load(
        "quadrotor_hover", middle, seed=5
    )


def test_made_in_python_the_given_is_what_is_no_default() -> None:
    given = vs.load("arm_ibvs", {"robot.realism": "lab"}, seed=3)
    made = replace(given, law=vs.laws.IBVS(gain=0.25), name="mine")  # pyright: ignore[reportArgumentType] - a number is a gain
    text = documents(made)[GIVEN]
    assert made.made_of is None and parse(text, GIVEN) == made
    assert (
        "realism: lab" in text
        and "gears" not in text
        and "law: {kind: ibvs, gain: 0.25}" in text
        and "draw_start: true" in text
    )


def test_objects_among_the_settings_are_written_as_values() -> None:
    settings = {"law": vs.laws.IBVS(), "stop.duration_s": np.float64(0.25)}
    scenario = vs.load("ibvs_book", settings)
    assert parse(given_text(scenario), GIVEN) == scenario


def test_a_kind_that_no_file_names_has_both_documents() -> None:
    @vs.LAWS.add
    @vs.spec
    class Own(vs.laws.IBVS):
        """A law of this program.

        Args:
            bias: nothing.
        """

        kind: Literal["own_in_program"] = "own_in_program"  # pyright: ignore[reportIncompatibleVariableOverride]
        bias: float = 0.0

    try:
        scenario = replace(vs.load("ibvs_book"), law=Own(bias=0.5))
        given, resolved = documents(scenario).values()
    finally:
        del vs.LAWS.members["own_in_program"]
    assert "law: {kind: own_in_program, bias: 0.5}" in given and "bias: 0.5" in resolved


def test_what_was_given_with_another_level_counts_in_any_order() -> None:
    text = given_text(vs.load("arm_ibvs", {"robot.realism": "lab"}))
    # 500 Hz as the lab has it
    own: dict[str, Any] = {"robot.gears": None, "robot.drives.bandwidth_hz": 500.0}
    for settings in (own | {"robot.realism": "field"}, {"robot.realism": "field"} | own):
        robot: Any = parse(text, GIVEN, settings).robot
        assert robot.gears is None
        assert robot.drives == CurrentLoops(bandwidth_hz=500.0, delay_s=0.001)


def test_null_in_a_users_file_holds_at_every_level(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    file.write_text(
        vs.dump(vs.load("arm_ibvs")).replace("kind: puma560", "kind: puma560, gears: null"),
        encoding="utf-8",
    )
    for level in ("none", "lab", "field"):
        robot: Any = vs.load(file, {"robot.realism": level}).robot
        assert (robot.gears, robot.drives is None) == (None, level == "none")
        again: Any = parse(
            given_text(vs.load(file, {"robot.realism": level})), GIVEN, {"robot.realism": "field"}
        ).robot
        assert (again.gears, again.drives.bandwidth_hz) == (None, 200.0)


def test_levels_as_an_axis_of_a_comparison_over_a_run(tmp_path: Path) -> None:
    file = tmp_path / GIVEN
    file.write_text(
        given_text(
            vs.load(
                "arm_ibvs", {"detector": "oracle", "robot.realism": "lab", "robot.encoders": None}
            )
        ),
        encoding="utf-8",
    )
    whole = chosen([str(file)], {}, {"robot.realism": ("none", "lab", "field")})
    robots: list[Any] = [variant.scenario.robot for variant in controllers(whole)]
    assert [robot.encoders for robot in robots] == [None, None, None]
    assert [robot.drives and robot.drives.bandwidth_hz for robot in robots] == [None, 500.0, 200.0]


def test_a_level_is_drawn_from_the_seed() -> None:
    drawn = {
        "randomise": [{"field": "robot.realism", "choice": ["none", "lab", "field"]}],
        "robot.drives.delay_s": 0.002,
    }
    first = vs.load("arm_ibvs", drawn)
    found = {
        to_mapping(one.robot)["realism"]: one
        for one in (first.with_seed(seed).resolved for seed in range(12))
    }
    assert found.keys() == {"none", "lab", "field"}
    for level, scenario in found.items():
        wanted = vs.load(
            "arm_ibvs",
            {"robot.realism": level, "robot.drives.delay_s": 0.002, "seed": scenario.seed},
        )
        assert scenario.robot == wanted.resolved.robot


def test_a_report_names_the_level_and_not_what_it_fills_nor_the_start_that_was_drawn() -> None:
    own = {"robot.gears": None, "robot.drives.delay_s": 0.002}
    assert changes(vs.load("arm_ibvs", {"robot.realism": "field"}, seed=3)) == (
        "robot.realism=field",
    )
    assert changes(vs.load("arm_ibvs", {"robot.realism": "lab"} | own, seed=3).resolved) == (
        "robot.realism=lab",
        "robot.gears=null",
        "robot.drives={delay_s: 0.002}",
    )


def test_values_that_would_be_drawn_over_are_refused() -> None:
    for name, settings, words in (
        (
            "arm_ibvs",
            {"robot.geometry_error": {"sigma_m": 0.001, "offsets": [{}] * 6}},
            "must be empty with sigma_m",
        ),
        (
            "omni_ibvs",
            {"robot.wheel_spread": {"sigma": 0.001, "errors": [0, 0, 0, 0.01]}},
            "must be none with sigma > 0",
        ),
        ("arm_ibvs", {"robot.start.random": None, "draw_start": True}, "robot.start.random"),
    ):
        with pytest.raises(ScenarioError, match=words):
            vs.load(name, settings)


def test_a_level_put_into_a_robot_that_has_been_filled_is_refused_with_what_works() -> None:
    robot: Any = vs.load("arm_ibvs").robot
    with pytest.raises(
        ParameterError,
        match=(
            r"realism fills nothing here, where every effect is given as at none;"
            r" works: robot.at_level\('lab'\)"
        ),
    ):
        replace(robot, realism="lab")
    assert robot.at_level("lab") == vs.load("arm_ibvs", {"robot.realism": "lab"}).robot
