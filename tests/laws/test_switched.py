"""Switched laws: the active law's own command, the choice against a state machine, crossover,
counts, refusals, a law that fails.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import vstestbed as vs
from tests.laws.flight import book_camera
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Pose, transform
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import IBVS, PBVS, Switched
from vstestbed.laws.switched import QUANTITIES, Stage, SwitchCondition
from vstestbed.loop.controller import Controller
from vstestbed.report.run import figures
from vstestbed.report.run.page import rows
from vstestbed.report.run.tracks import LogArrays, Setting
from vstestbed.studies.batch import simulate_batch, start_of
from vstestbed.targets.base import Square
from vstestbed.tasks.metrics import ErrorGrowth

NEVER = 900.0
BROYDEN = Path(__file__).parents[1] / "examples" / "broyden.py"
POINTS = Square(side=0.5, pose=Pose()).points
GOAL = Goal.from_view(book_camera(), POINTS, Pose(xyz=(0, 0, 1)).T)
RETREAT = {"kind": "switched", "laws": [{"law": "ibvs", "until": {"retreat_over_m": 0.3}}, "pbvs"]}


def half_turned(law: object, **changes: object) -> vs.Scenario:
    """A turn of 115 degrees about the optical axis, from which points make the camera retreat."""
    return vs.load(
        "ibvs_retreat", {"law": law, "detector": "oracle", "camera.rate_hz": 25, **changes}
    )


def of(first: SwitchCondition, *others: object, **fields: object) -> Switched:
    """IBVS until that, then the others."""
    return Switched(laws=(Stage(law=IBVS(), until=first), *others), **fields)  # pyright: ignore[reportArgumentType]


def seen(T: np.ndarray, t: float = 0.0, **more: object) -> Observation:
    """The view from a pose T_camera_target."""
    p = transform(T, POINTS)
    return Observation(t, book_camera().project(p), p[:, :2] / p[:, 2:], p[:, 2], T, **more)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("alone", "until"), [("ibvs", {"error_over_px": NEVER}), ("pbvs", {"error_under_px": NEVER})]
)
def test_the_command_is_that_of_the_active_law_bit_for_bit(alone: str, until: dict[str, float]):
    law = {"kind": "switched", "laws": [{"law": "ibvs", "until": until}, "pbvs"]}
    switched, plain = (vs.run(half_turned(one, **{"stop.duration_s": 3})) for one in (law, alone))
    np.testing.assert_array_equal(switched.table[:, :-1], plain.table)
    # the one that is free begins, which counts as no switch
    assert set(switched["law_mode"]) == {float(alone == "pbvs")}
    assert switched.summary()["law_switches"] == 0


numbers = st.sampled_from([1.0, 7.9, 8.0, 8.1, 10.0, 12.0, 12.1, 15.0, np.nan])


@given(
    errors=st.lists(numbers, min_size=1, max_size=25),
    prefer=st.sampled_from(["active", "first"]),
    hysteresis=st.sampled_from([0.0, 0.2]),
    dwell=st.sampled_from([0, 1, 3]),
    other=st.sampled_from(
        [
            SwitchCondition(error_under_px=8.0),
            SwitchCondition(error_over_px=12.0),
            SwitchCondition(error_over_px=12.0, error_under_px=2.0),
        ]
    ),
)
@settings(max_examples=60, derandomize=True, database=None, deadline=None)
def test_the_choice_is_that_of_a_state_machine(
    errors: list[float], prefer: Any, hysteresis: float, dwell: int, other: SwitchCondition
):
    """Three laws with thresholds on the image error; the machine is written down once more, by
    states and thresholds.
    """
    law = of(
        SwitchCondition(error_over_px=10.0),
        Stage(law=PBVS(), until=other),
        Stage(law=IBVS()),
        prefer=prefer,
        hysteresis=hysteresis,
        dwell_s=dwell / 25,
    )
    low, high = other.error_under_px or -np.inf, other.error_over_px or np.inf
    state, basis = law.init(GOAL), np.eye(6)
    active, stayed, barred = 0, 10**6, {0: False, 1: False, 2: False}
    for k, e in enumerate(errors):
        if e > 10:
            barred[0] = True
        elif e <= 10 * (1 - hysteresis):
            barred[0] = False
        if e > high or e < low:
            barred[1] = True
        elif low * (1 + hysteresis) <= e <= high * (1 - hysteresis):
            barred[1] = False
        free = [i for i in barred if not barred[i]]
        wanted = active if prefer == "active" and active in free else free[0]
        if wanted != active and stayed >= dwell:
            active, stayed = wanted, 0
        elif k == 0:
            stayed = 0
        stayed += 1
        # RMS e; NaN: nothing is seen
        view = replace(seen(GOAL.T_camera_target, k / 25), uv=GOAL.uv + e)
        state, command = law.step(state, view, GOAL, basis)
        assert law.modes[command.mode] == ("ibvs 1", "pbvs", "ibvs 2")[active], (k, e)


def test_quantities():
    T = Pose(xyz=(0.3, 0.1, 1.5), rpy_deg=(0, 0, 30)).T
    view, start = seen(T), 1.2
    assert QUANTITIES["position"][0](view, GOAL, start) == pytest.approx(
        np.linalg.norm((GOAL.T_camera_target @ np.linalg.inv(T))[:3, 3])
    )
    assert QUANTITIES["rotation"][0](view, GOAL, start) == pytest.approx(30)
    assert QUANTITIES["retreat"][0](view, GOAL, start) == pytest.approx(
        np.linalg.norm([0.3, 0.1, 1.5]) - start
    )
    assert QUANTITIES["error"][0](view, GOAL, start) == pytest.approx(
        np.sqrt(np.mean((view.uv - GOAL.uv) ** 2))
    )
    nearest = min(view.uv.min() + 0.5, 999.5 - view.uv.max())
    assert QUANTITIES["border"][0](
        replace(view, radius_px=np.full(4, 3.0)), GOAL, start
    ) == pytest.approx(nearest - 3)
    gone = replace(view, uv=np.where([[True], [False], [False], [False]], np.nan, view.uv))
    assert QUANTITIES["border"][0](gone, GOAL, start) == 0.0
    counted = replace(GOAL, counted=np.array([False, True, True, True]))
    assert QUANTITIES["border"][0](gone, counted, start) > 0
    assert np.isnan(QUANTITIES["rotation"][0](replace(view, T_camera_target=None), GOAL, start))
    assert np.isnan(QUANTITIES["joint_margin"][0](view, GOAL, start))


def test_the_margin_of_the_joints_is_that_of_the_nearest_limit():
    scenario = vs.load(
        "arm_ibvs",
        {
            "law": RETREAT
            | {"laws": [{"law": "ibvs", "until": {"joint_margin_under_deg": 5}}, "pbvs"]}
        },
    )
    robot, controller = scenario.robot, Controller(scenario)
    q = robot.start_joints()
    model = robot.own_model(vs.Reading(q, q), controller._mount_at(q))
    near = replace(model, q=np.where(np.arange(6) == 2, model.high - np.radians(4.0), q))
    assert "robot" in scenario.law.inputs
    assert QUANTITIES["joint_margin"][0](
        replace(seen(GOAL.T_camera_target), robot=near), GOAL, np.nan
    ) == pytest.approx(4)


def test_after_a_switch_the_command_crosses_over():
    jump, smooth = (
        vs.run(half_turned(RETREAT | {"blend_s": blend}, **{"stop.duration_s": 4}))
        for blend in (0.0, 0.4)
    )
    twist = [
        np.column_stack([r[f"cmd_{axis}"] for axis in ("vx", "vy", "vz", "wx", "wy", "wz")])
        for r in (jump, smooth)
    ]
    at = int(np.flatnonzero(np.diff(jump["law_mode"]))[0]) + 1
    steps = [np.abs(np.diff(one, axis=0)[at - 1 : at + 10]).max() for one in twist]
    assert steps[1] < 0.2 * steps[0]  # ten frames for what was one, while both go on
    np.testing.assert_allclose(
        twist[1][at], 0.1 * twist[0][at] + 0.9 * twist[0][at - 1], atol=1e-12
    )


def test_chattering_is_counted_and_hysteresis_or_a_dwell_time_ends_it():
    law = RETREAT | {
        "prefer": "first",
        "laws": [{"law": "ibvs", "until": {"position_over_m": 3.3}}, "pbvs"],
    }
    choices = {
        "none": {"hysteresis": 0, "dwell_s": 0},
        "hysteresis": {"hysteresis": 0.1, "dwell_s": 0},
        "dwell": {"hysteresis": 0, "dwell_s": 0.4},
    }
    found: dict[str, Any] = {
        name: vs.run(half_turned(law | one, **{"stop.duration_s": 6})).summary()
        for name, one in choices.items()
    }
    assert found["none"]["law_switches"] > 3 * max(
        found[name]["law_switches"] for name in ("hysteresis", "dwell")
    )
    assert found["none"]["law_shortest_stay_s"] == pytest.approx(0.04)
    assert found["dwell"]["law_shortest_stay_s"] > 0.4 - 1e-9
    share = found["none"]["law_mode_share"]
    assert list(share) == ["ibvs", "pbvs"] and sum(share.values()) == pytest.approx(1)


def test_the_report_shows_the_modes_and_that_of_other_laws_does_not():
    recording = vs.run(half_turned(RETREAT, **{"stop.duration_s": 1, "metrics": ["error_growth"]}))
    summary = recording.summary()
    assert ("Switches of the law", "1", "") in rows(summary)
    svg = figures.error(LogArrays.of(recording.rows, Setting.of(recording.scenario))).svg("error")
    assert "ibvs</li>" in svg and "pbvs</li>" in svg and ">mode<" in svg
    plain = vs.run(half_turned("ibvs", **{"stop.duration_s": 1}))
    assert not any(name.startswith("law") for name in (*plain.summary(), *plain.columns))
    assert ">mode<" not in figures.error(LogArrays.of(plain.rows, Setting.of(plain.scenario))).svg(
        "error"
    )


def test_growth_of_known_errors():
    setup: Any = None  # unused
    e = np.array([5, 4, 4.5, np.nan, 3, 3 + 1e-5, 6, 5])
    log = {"error_px": e, "position_error_m": -e + 9, "rotation_error_rad": 0 * e}
    assert list(ErrorGrowth().figures(log, setup).values()) == [2, 2, 0]


def test_a_law_that_fails_ends_the_run(monkeypatch: pytest.MonkeyPatch):
    def fails(*_: object) -> None:
        raise ZeroDivisionError("of its own")

    good = PBVS.step
    monkeypatch.setattr(
        PBVS, "step", lambda law, *given: good(law, *given) if given[1].t < 0.5 else fails()
    )
    recording = vs.run(half_turned(RETREAT))
    assert recording.summary()["law_switches"] == 1  # to fail is none
    assert recording.outcome is vs.Outcome.law_failed
    assert "raised ZeroDivisionError: of its own" in recording.reason


@pytest.mark.usefixtures("own_kinds")
def test_a_law_of_ones_own_may_be_one_of_them(tmp_path: Path):
    plugin = tmp_path / "nested.py"
    plugin.write_text(
        BROYDEN.read_text(encoding="utf-8").replace('"broyden"', '"nested_broyden"'),
        encoding="utf-8",
    )
    own = {"law": {"kind": "nested_broyden", "gain": 1}, "until": {"error_under_px": 100}}
    changes = {
        "law": {"kind": "switched", "laws": [own, "pbvs"]},
        "detector": "oracle",
        "stop.duration_s": 6,
    }
    recording = vs.run(vs.load("ibvs_book", changes, plugins=[str(plugin)]))
    assert set(recording["law_mode"]) == {0, 1}
    assert recording.scenario.law.modes == (
        "nested_broyden",
        "pbvs",
    )


def test_a_batch_flies_it_as_a_run_does():
    scenario = half_turned(
        RETREAT,
        **{"stop.duration_s": 20, "camera.latency_s": 0, "detector.field_of_view": "unlimited"},
    )
    flown = simulate_batch(scenario, start_of(scenario)[None])
    alone = vs.run(scenario)
    assert flown.outcome[0] is alone.outcome is vs.Outcome.converged
    assert flown.steps[0] / 25 == pytest.approx(alone["t"][-1])


def test_a_file_of_it_loads_again(tmp_path: Path):
    scenario = half_turned(RETREAT | {"dwell_s": 0.5})
    vs.dump(scenario, tmp_path / "ibvs_retreat.yaml")
    assert vs.load(tmp_path / "ibvs_retreat.yaml") == scenario


def test_during_a_run_its_numbers_change_and_its_laws_do_not():
    controller = Controller(half_turned(RETREAT))
    controller.retune(half_turned(RETREAT | {"dwell_s": 0.5}).law)
    assert controller.law.dwell_s == 0.5  # pyright: ignore[reportAttributeAccessIssue]
    third = RETREAT | {
        "laws": [*RETREAT["laws"][:1], {"law": "pbvs", "until": {"error_over_px": 9}}, "pbvs"]
    }
    with pytest.raises(ParameterError, match=r"law\.modes cannot be changed during a run"):
        controller.retune(half_turned(third).law)


CONSTANT = {"kind": "ibvs", "depth": {"kind": "constant", "depth_m": 1}}


def test_laws_that_cannot_work_in_turn_are_refused():
    for laws, words in (
        (["pbvs"], r"law\.laws: must be a list of 2 or more items"),
        (
            ["ibvs", "pbvs"],
            r"law\.laws\.0\.until: needs a condition, such as \{border_under_px: 30\}",
        ),
        (
            [{"law": "pursuit", "until": {"error_over_px": 9}}, "pbvs"],
            r"law\.laws\.0\.law\.kind: may not be pursuit, which takes gap",
        ),
        (
            [{"law": "ibvs", "until": {"error_over_px": 9}}, {"law": CONSTANT}],
            r"law\.laws\.1\.law\.depth: must be the same as that of laws\.0 \(pnp\)",
        ),
        (
            [{"law": "switched", "until": {"error_over_px": 9}}, "pbvs"],
            r"law\.laws\.0\.law: is no law; valid kinds",
        ),
        (
            [{"law": "ibvs", "until": {"border_px": 9}}, "pbvs"],
            r"until\.border_px: is an unknown field; did you mean 'border_under_px'",
        ),
    ):
        with pytest.raises(ScenarioError, match=words):
            half_turned({"kind": "switched", "laws": laws})


def test_what_it_tells_of_itself():
    law = of(SwitchCondition(border_under_px=30.0, retreat_over_m=1.0), Stage(law=PBVS()))
    assert law.tasks == ("view",) and law.modes == ("ibvs", "pbvs")
    assert law.inputs == ("xy", "depth", "T_camera_target", "radius_px")
    assert law.feature == IBVS().feature and law.limits.speed_mps is None
    assert law.markers_needed(np.eye(6)) == 3
