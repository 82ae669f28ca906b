"""Runs are counted before any is made, and made one by one; mistakes of a comparison's file have
their place in it.
"""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.studies.comparison import Comparison, Jobs, chosen, controllers
from vstestbed.studies.comparison.plan import MOST_RUNS, StartTable, Variants, must_be_few

TENTHS = tuple(i / 10 for i in range(1, 11))


def test_too_many_are_refused_before_one_is_made():
    for comparison, product in (
        (
            Comparison(base=("ibvs_book",), seeds=10**9),
            r"1,000,000,000 runs \(1,000,000,000 seeds\)",
        ),
        (
            Comparison(base=("ibvs_book", "pbvs_book"), axes={f"a{i}": TENTHS for i in range(9)}),
            r"2,000,000,000 runs \(2 scenarios x 10 of a0",
        ),
        (
            Comparison(base=("ibvs_book",), tasks={"t": StartTable(seeds=MOST_RUNS + 1)}),
            r"100,001 starts of the tasks",
        ),
    ):
        with pytest.raises(ParameterError, match=rf"{product}.*more than 100,000 need --force"):
            controllers(comparison)
        must_be_few(comparison, force=True)


def test_the_limit_itself_is_allowed():
    must_be_few(Comparison(base=("ibvs_book",), seeds=MOST_RUNS))
    with pytest.raises(ParameterError, match="100,001 runs"):
        must_be_few(Comparison(base=("ibvs_book",), seeds=MOST_RUNS + 1))


def test_beyond_the_limit_runs_are_made_one_by_one(quick: Path):
    comparison = Comparison(base=(str(quick),), seeds=10**9, axes={"law.gain": (3, 6)})
    made = Jobs(controllers(comparison, force=True), comparison.seeds)
    assert len(made) == 2 * 10**9
    assert [job.folder for job in itertools.islice(made, 3)] == [
        "runs/quick/law.gain=3/0/0",  # a thousand in each folder
        "runs/quick/law.gain=6/0/0",
        "runs/quick/law.gain=3/0/1",
    ]
    assert made[2 * 1234].folder == "runs/quick/law.gain=3/1000/1234"


def test_tasks_of_different_lengths_come_seed_by_seed(quick: Path):
    comparison = Comparison(
        base=(str(quick),),
        tasks={"a": StartTable(seeds=1), "b": StartTable(seeds=3)},
        axes={"law.gain": (3, 6)},
    )
    made = Jobs(controllers(comparison), None)
    assert len(made) == 8
    assert [(job.controller.values["task"], job.seed) for job in made] == [
        ("a", 0),
        ("b", 0),
    ] * 2 + [("b", 1)] * 2 + [("b", 2)] * 2
    assert made[-1].folder == "runs/quick/law.gain=6,task=b/2"


FILE = """\
base: [quick.yaml]
set: {camera.rate_hz: 30}
cases:
  law:
    one: {law: {kind: ibvs, gain: 2}}
    two: {law: {kind: ibvs, gain: 3}}
axes:
  camera.latency_s: [0, 0.1]
tasks:
  near:
    each:
      robot.start.nominal.xyz: [[0, 0, 0], [0, 0, 0.1]]
"""


def test_a_mistake_in_the_file_has_its_place(quick: Path, tmp_path: Path):
    for change, where in (
        ({"gain: 3": "gain: nope"}, "6:29: law.gain: must be a number"),
        ({"0.1]\n": "-1]\n"}, "8:25: camera.latency_s: must be >= 0, got -1"),
        ({"[0, 0, 0.1]": "[0, 0]"}, "12:44: robot.start.nominal.xyz: must be a list of 3"),
        ({"30}": "-30}"}, "2:7: camera.rate_hz: must be > 0, got -30"),
        ({"quick.yaml": "quack.yaml"}, "1:8: base.0: quack.yaml: no such file"),
        ({"one: {law": "one: {x"}, "5:11: x: is an unknown field"),
        (
            {"one: {law: {kind: ibvs, gain: 2}}": "one: 2"},
            "5:5: cases.law.one: must be a block (a mapping), got 2",
        ),
        (
            {FILE: "# nothing\n"},
            "1:1: is empty; a comparison needs base, a scenario robot, target, law and goal",
        ),
    ):
        text = FILE
        for old, new in change.items():
            text = text.replace(old, new)
        path = tmp_path / "mine.yaml"
        path.write_text(text, encoding="utf-8")
        with pytest.raises(ScenarioError) as found:
            controllers(chosen([str(path)], {}, {}))
        assert str(found.value).startswith(f"{path}:{where}")


def test_a_contradiction_is_told_at_the_value_that_brings_it(quick: Path, tmp_path: Path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        "base: [quick.yaml]\n"
        "set: {law.depth: oracle}\n"
        "cases:\n"
        "  d: {a: {detector: oracle}, b: {detector: blobs}}\n"
    )
    with pytest.raises(
        ScenarioError, match=r"mine.yaml:2:7: law.depth: may be oracle only with detector"
    ):
        controllers(chosen([str(path)], {}, {}))
    with pytest.raises(ScenarioError, match=r"^--vary: camera.rate_hz: must be > 0"):
        controllers(chosen([str(quick)], {}, {"camera.rate_hz": (-1,)}))


@pytest.mark.parametrize(
    ("name", "field", "where"),
    [
        ("canonical", "law.gain", "canonical.yaml:21:"),
        ("canonical", "robot.start.nominal.xyz", "tasks.about the axis.each sets"),
    ],
)
def test_a_setting_that_the_file_writes_over_is_refused(name: str, field: str, where: str):
    with pytest.raises(
        ScenarioError,
        match=rf"^--set: {field}: has no effect: .*--vary {field}=VALUE is applied last",
    ) as found:
        chosen([name], {field: "nope"}, {})
    assert where in str(found.value)


HOSTILE = (
    "../../../esc",
    "/abs",
    "a/b/c/d/e/f/g/h",
    "..",
    "con",
    "x" * 300,
    "\u00e9" * 200,
    "a b",
    "a_b",
)


def test_names_of_cases_and_tasks_lead_nowhere_else(quick: Path, tmp_path: Path):
    cases = {
        name: {each: {"law.gain": 3 + i} for i, each in enumerate(HOSTILE)} for name in HOSTILE[:8]
    }
    comparison = Comparison(
        base=(str(quick),),
        cases=cases,
        tasks={"../t": StartTable(seeds=1), ".. t": StartTable(seeds=1)},
    )
    made = Variants(comparison)
    for i in (0, 1, 2, 9, len(made) // 2, len(made) - 1):
        place = made[i].folder
        # the thousand, and the variant
        assert len(Path(place).parts) == 4 and Path(place).parts[:2] == ("runs", "quick")
        assert (tmp_path / place).resolve().is_relative_to(tmp_path.resolve())
        (tmp_path / place).mkdir(parents=True)
    near = [made[i].folder.casefold() for i in range(400)]
    assert len(set(near)) == len(near)


def test_two_scenarios_of_one_folder_are_refused():
    with pytest.raises(ParameterError, match="base has a scenario, or a file name, twice"):
        Comparison(base=("a/Arm.yaml", "b/arm.yaml"))
