"""The search for the gains of the suite's laws: which gains a law has, what its file is written
with, and the record.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace

import numpy as np
import polars as pl
import pytest

from docs.build import suite_tuning
from docs.build.suite_tuning import (
    GROUPS,
    LAW,
    TRIALS,
    Group,
    gains,
    other_starts,
    record,
    trial_plan,
    trial_scenario,
    tuned,
    with_gains,
    written,
)
from vstestbed.apps.suite.suite import opened
from vstestbed.core.geometry import Pose
from vstestbed.laws.base import ConstantGain
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison.plan import (
    TUNED,
    Job,
    Jobs,
    StartTable,
    controllers,
    read_comparison,
)

BLOCK = {
    "kind": "switched",
    "laws": [{"law": {"kind": "ibvs", "gain": 1.0}}, {"law": {"kind": "partitioned", "gain_z": 2}}],
    "gain": 3.0,
}
FILE = """laws:
  one:
    law: {kind: ibvs, gain: 0.5, depth: pnp}
    tasks:
      ideal: {gain: 0.5}
      base: {gain: 1e-1, depth: floor}
  two:
    law:
      kind: switched
      laws:
        - {law: {kind: ibvs, gain: 2}}
        - {law: {kind: partitioned, gain: 2, gain_z: 3}}
tasks: {}
"""


def of(group: str, law: str, **values: float) -> pl.DataFrame:
    names = [
        {"group": group, "law": law, "gain": path, "value": value} for path, value in values.items()
    ]
    return pl.DataFrame(names)


def test_the_gains_of_a_block_are_found_in_the_laws_within_it_and_set_there() -> None:
    assert dict(gains(BLOCK)) == {"laws.0.law.gain": 1.0, "laws.1.law.gain_z": 2.0, "gain": 3.0}
    new = with_gains(BLOCK, {"laws.1.law.gain_z": 7.0})
    assert dict(gains(new)) == {"laws.0.law.gain": 1.0, "laws.1.law.gain_z": 7.0, "gain": 3.0}
    assert BLOCK["laws"][1]["law"]["gain_z"] == 2  # type: ignore[index]  # the block given is as it was


def test_gains_are_written_into_the_blocks_of_their_law_and_task_alone() -> None:
    changed = written(
        FILE, pl.concat([of("base", "one", gain=1.25), of("arm", "two", a=4.0, b=5.0, c=6.5)])
    )
    assert changed == FILE.replace("gain: 1e-1", "gain: 1.25").replace(
        "gain: 2}}", "gain: 4}}"
    ).replace("gain: 2, gain_z: 3", "gain: 5, gain_z: 6.5")
    with pytest.raises(ValueError, match="two, law: must show its 1 gains as numbers, and shows 3"):
        written(FILE, of("arm", "two", gain=4.0))
    with pytest.raises(ValueError, match="one: no line latency"):
        written(FILE, of("latency", "one", gain=4.0))


def test_no_law_of_the_suite_has_a_gain_that_is_not_searched_for() -> None:
    """Each number of a law's class that is a gain stands in its block, in each task, where `gains`
    finds it.

    `gain_xy` acts where x or y is among the axes of the partition, which by default they are not.
    """

    def held(law: object) -> list[str]:
        if isinstance(law, ConstantGain) or not is_dataclass(law):
            return []
        values = {one.name: getattr(law, one.name) for one in fields(law) if one.name != "gain_xy"}
        own = [
            name
            for name, value in values.items()
            if suite_tuning.GAIN.fullmatch(name) and isinstance(value, float | ConstantGain)
        ]
        inner = (
            [values["law"]]
            if "law" in values
            else [part.law for part in values["laws"]]
            if "laws" in values
            else []
        )
        return own + [name for one in inner for name in held(one)]

    entry = opened(None, quick=True)
    for task in ("arm", "poster", "base", "craft"):
        plan = entry.plans[task]
        for one in controllers(
            replace(plan, cases={LAW: plan.cases[LAW]}, tasks={}, limit=None, seeds=None)
        ):
            name = str(one.values[LAW])
            block = plan.cases[LAW][name][LAW]
            assert sorted(path.split(".")[-1] for path, _ in gains(block)) == sorted(
                held(one.scenario.law)
            ), (task, name)


def test_every_law_has_as_many_trials_however_many_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of runs: a time that is least where each gain is 2."""
    tried: list[dict[str, float]] = []

    def least_at_two(
        entry: object, group: Group, plan: object, worst: float
    ) -> dict[str, list[tuple[bool, float]]]:
        found = {}
        for name, block in plan.items():  # type: ignore[attr-defined]  # what trial_plan gives here
            values = dict(gains(block))
            tried.append(values)
            found[name] = [(True, 1 + sum(np.log(value / 2) ** 2 for value in values.values()))] * 2
        return found

    entry = opened(None, quick=True)
    of_limit = trial_plan
    plans = {
        law: of_limit(entry, GROUPS["arm"], {"as it is": dict(entry.suite.laws[law].law)}, True)
        for law in ("points", "partitioned")
    }
    for law, number in (("points", 1), ("partitioned", 3)):
        tried.clear()
        monkeypatch.setattr(suite_tuning, "flown", least_at_two)
        monkeypatch.setattr(
            suite_tuning,
            "trial_plan",
            lambda e, g, blocks, oracle, plan=plans[law]: plan if "as it is" in blocks else blocks,
        )
        rows = tuned(entry, "arm", GROUPS["arm"], law)
        assert len(tried) == TRIALS + 2  # the best one once more by the oracle, and with pictures
        assert len(rows) == number and {row["trials"] for row in rows} == {TRIALS}
        assert rows[0]["mean"] == min(
            1 + sum(np.log(v / 2) ** 2 for v in values.values()) for values in tried
        )


def test_trials_fly_the_tasks_of_their_group_from_starts_that_the_suite_does_not() -> None:
    entry = opened(None)
    block = entry.block("points", "latency")
    assert not isinstance(block, str)
    plan = trial_plan(entry, GROUPS["latency"], {"as it is": block}, True)
    found = list(Jobs(controllers(plan), GROUPS["latency"].starts, TUNED))
    assert {job.controller.values["late"] for job in found} == {
        "on time",
        "80 ms late",
        "160 ms late",
    }
    assert min(job.seed or 0 for job in found) == TUNED
    assert {job.controller.scenario.detector.kind for job in found} == {"oracle"}
    assert all(trial_scenario(job).seed >= TUNED for job in found)


def place(job: Job, scenario: Scenario) -> tuple[str, int | None]:
    """Where a run begins: a place of a list, or what a seed draws."""
    return str(
        (scenario.robot.start, scenario.goal_poses)
    ), scenario.seed if job.controller.start is None else None


def test_of_lists_trials_fly_what_the_suite_leaves_or_the_middles_between_what_it_flies() -> None:
    table = StartTable(each={"camera.rate_hz": tuple(range(1, 21))})
    others = other_starts(table, 10, 3).each["camera.rate_hz"]
    assert len(others) == 3 and not {value - 1 for value in others} & set(table.numbers(10))
    turns = StartTable(
        camera_from_goal=tuple(Pose(rpy_deg=(0, 0, turn)) for turn in (20, 40, 60, 180)),
        set={"camera.rate_hz": 20},
    )
    between = other_starts(turns, None, 3)
    assert [pose.rpy_deg[2] for pose in between.camera_from_goal] == [
        30,
        50,
        120,
    ] and between.set == turns.set
    starts = StartTable(
        each={
            "robot.start.nominal": (
                {"xyz": [0, 0, -1], "rpy_deg": [0, 0, 10]},
                {"xyz": [0, 0, -2], "rpy_deg": [0, 0, 30]},
            )
        }
    )
    assert other_starts(starts, None, 1).each == {
        "robot.start.nominal": ({"xyz": [0, 0, -1.5], "rpy_deg": [0, 0, 20]},)
    }
    assert other_starts(StartTable(seeds=30), None, 4).seeds == 4
    entry = opened(None)
    for group in ("ideal", "arm", "natural"):
        block = dict(entry.suite.laws["pose"].law)
        plan = trial_plan(entry, GROUPS[group], {"as it is": block}, True)
        own = read_comparison(entry.path.parent / entry.suite.tasks[GROUPS[group].plan].plan)
        tried = {place(job, trial_scenario(job)) for job in Jobs(controllers(plan), None, TUNED)}
        assert len(tried) == GROUPS[group].starts * len(own.tasks)
        assert not tried & {place(job, job.scenario()) for job in Jobs(controllers(own), None)}, (
            group
        )


def test_the_suite_s_gains_are_those_of_the_record() -> None:
    found = record()
    assert found is not None
    entry = opened(None)
    for (group, law), rows in found.group_by(suite_tuning.KEYS, maintain_order=True):
        for place in GROUPS[str(group)].writes:
            block = entry.block(str(law), GROUPS[str(group)].plan if place == LAW else place)
            assert not isinstance(block, str)
            assert dict(gains(block)) == dict(zip(rows["gain"], rows["value"], strict=True)), (
                group,
                law,
                place,
            )
    # one budget for each group
    assert (
        found.select("group", "trials", "low", "high").unique().height == found["group"].n_unique()
    )
