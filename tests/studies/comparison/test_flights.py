"""Runs that fly in one batch: the logs, the summaries and the folders of runs that fly by themselves, and what flies by itself."""

from __future__ import annotations

import io
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from tests.shortcuts import run_here
from tests.studies.comparison.test_campaign import logs, timeless
from vstestbed.laws import IBVS
from vstestbed.laws.views import has_batch
from vstestbed.scenario.dump import dump
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison import Comparison, chosen, compare, controllers, jobs
from vstestbed.studies.comparison.campaign import LEAST, MOST, BatchRequest, batches, flies_in_batch
from vstestbed.studies.comparison.folder import table_of
from vstestbed.studies.comparison.pools import RUNNING, execute, request_of
from vstestbed.vision import Oracle

MOODS = ("wall_time_s", "real_time_factor", "time_ms", "batch")
"""What depends on the machine, and the word that a run has flown in a batch."""


@pytest.fixture(scope="module")
def canonical() -> dict[str, list[Scenario]]:
    """For each law of the bundled comparison the scenarios of all its tasks."""
    comparison = chosen(["canonical"], {}, {}, None)
    of: dict[str, list[Scenario]] = {}
    for job in jobs(controllers(comparison), comparison.seeds):
        of.setdefault(str(job.controller.values["law"]), []).append(job.scenario())
    return of


def number(column: pl.Series) -> np.ndarray:
    return column.cast(pl.Float64).to_numpy()


def must_agree(alone: dict[str, Any], together: dict[str, Any], where: str) -> None:
    """Two summaries: words and whole numbers are equal, others agree to far more digits than any table shows."""
    assert list(alone) + ["batch"] == list(together), where
    for name in alone.keys() - set(MOODS):
        a, b = alone[name], together[name]
        assert b == (pytest.approx(a, rel=1e-6, abs=1e-6) if isinstance(a, float) else a), (where, name)


LAWS = ("points", "points_desired", "points_mean", "polar", "spherical", "lines", "partitioned", "partitioned_damped")
LAWS += ("pose", "pose_origin", "hybrid")


@pytest.mark.parametrize("law", LAWS)
def test_a_batch_gives_the_folders_of_single_runs(canonical: dict[str, list[Scenario]], law: str):
    """A run of each task by one of the laws, of one by the others beside another; the study below compares all."""
    whole, first = canonical[law], LAWS.index(law) % 5
    picked = [(first + i) % 5 for i in range(3 if law == "points" else 2)]  # seed by seed: the first of each task
    flown = BatchRequest.of("a", [whole[i] for i in picked]).perform()
    assert [i for i, files in zip(picked, flown, strict=True) if files is None] == []
    for i, files in list(zip(picked, flown, strict=True))[: 3 if law == "points" else 1]:
        single = execute(request_of("a", whole[i], False))
        assert files is not None and single.keys() == files.keys()
        assert files["scenario.yaml"].decode() == dump(whole[i], defaults=True) == single["scenario.yaml"].decode()
        assert files["model.xml"] == single["model.xml"]
        must_agree(json.loads(single["summary.json"]), json.loads(files["summary.json"]), f"{law} {i}")
        one, other = (pl.read_parquet(io.BytesIO(f["log.parquet"])) for f in (single, files))
        assert one.schema == other.schema
        for column in one.columns:
            assert number(other[column]) == pytest.approx(number(one[column]), rel=1e-6, abs=1e-6, nan_ok=True), (law, i, column)


def test_runs_whose_way_rounding_decides_fly_by_themselves(canonical: dict[str, list[Scenario]]):
    """An exact half turn goes either way round; where a marker is lost, the loop says what the robot does."""
    for law in ("points", "pose"):
        half_turn, quarter = canonical[law][38], canonical[law][20]
        assert [files is None for files in BatchRequest.of("a", [half_turn, quarter]).perform()] == [True, False]
    turned = canonical["pose"][22]  # by 25 degrees: of half the width in picture and sight, two markers are outside
    limited = replace(turned, camera=replace(turned.camera, width=500, height=500), detector=Oracle(field_of_view="limited"))
    assert [f is None for f in BatchRequest.of("a", [limited, replace(limited, robot=canonical["pose"][6].robot)]).perform()] == [
        True,
        False,
    ]


def test_a_failed_run_has_its_picture_and_its_reason(canonical: dict[str, list[Scenario]]):
    slow = [replace(s, stop=replace(s.stop, duration_s=0.4)) for s in canonical["pose"][:2]]
    for scenario, files in zip(slow, BatchRequest.of("a", slow).perform(), strict=True):
        single = execute(request_of("a", scenario, False))
        assert files is not None and single.keys() == files.keys() >= {"end.png"}
        assert files["end.png"] == single["end.png"]
        must_agree(json.loads(single["summary.json"]), json.loads(files["summary.json"]), "slow")


@pytest.fixture
def started(quick: Path) -> Callable[..., list[Scenario]]:
    def with_changes(n: int = LEAST, **changes: object) -> list[Scenario]:
        return [vs.load(quick, {name.replace("__", "."): value for name, value in changes.items()}, seed=i) for i in range(n)]

    return with_changes


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"noise__pixel_sigma_px": 0.1},
        {"noise__dropout": 0.1},
        {"camera__latency_s": 0.04},
        {"camera__readout_s": 0.02},
        {"timing__drop_probability": 0.1},
        {"calibration__focal_error": 0.01},
        {"calibration__depth_factor": 1.1},
        {"detector": "blobs"},
        {"law__limits": {"speed_mps": 0.3}},
        {"law__depth": {"kind": "estimate"}},
        {"goal__markers": [0, 1, 2]},
        {"stop__converged": {"position_m": 0.01}},
        {"stop__duration_s": 400},
        {"target__motion": {"kind": "line", "velocity_mps": [0.01, 0, 0]}},
    ],
    ids=lambda change: next(iter(change), "plain"),
)
def test_only_what_a_batch_covers_flies_in_one(started: Callable[..., list[Scenario]], change: dict[str, object]):
    scenarios = started(**change)
    assert flies_in_batch(scenarios[0]) is (not change)
    assert batches(scenarios) == ([] if change else [list(range(LEAST))])


def test_batches_are_of_runs_that_differ_in_their_starts_alone(started: Callable[..., list[Scenario]]):
    slow, fast = started(MOST + 1), started(LEAST, law__gain=3.0)
    mixed = [s for pair in zip(slow, fast, strict=False) for s in pair] + slow[LEAST:]
    found = batches([None, *mixed])
    assert sorted(map(len, found)) == sorted([LEAST, -(-(MOST + 1) // 2), (MOST + 1) // 2])
    assert all(len({mixed[i - 1].law for i in places}) == 1 for places in found) and all(0 not in places for places in found)
    assert batches(started(LEAST - 1)) == []


class OtherStep(IBVS):
    """Overrides its step, and inherits the batch's."""

    def step(self, memory: Any, observation: Any, goal: Any, basis: Any) -> Any:
        """As IBVS."""
        return IBVS.step(self, memory, observation, goal, basis)


def test_a_law_that_overrides_its_step_alone_has_no_batch():
    assert has_batch(IBVS()) and not has_batch(OtherStep())


def test_a_resumed_comparison_flies_the_same_batches(quick: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Whatever is missing, and in groups of any size, the bytes are those of a comparison that was never cut off."""
    run_here(monkeypatch)
    monkeypatch.setattr("vstestbed.studies.comparison.runs.SIDE_BY_SIDE", 8)
    monkeypatch.setattr("vstestbed.studies.comparison.folder.GROUP", 6)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    seeds = 2 * LEAST
    table = compare([quick], seeds=seeds, out=whole, film=False, report=False)
    assert table["batch"].to_list() == [None] + [True] * (seeds - 1)  # the first may be filmed
    shutil.copytree(whole, cut)
    every = jobs(controllers(Comparison(base=(str(quick),), seeds=seeds)), seeds)
    monkeypatch.setattr("vstestbed.studies.comparison.folder.GROUP", 10_000)
    assert table.equals(table_of(whole, every)) and table.equals(pl.read_parquet(whole / "comparison.parquet"))
    for place in ("0/0", "0/3", "8/11"):
        (cut / f"runs/quick/as_it_is/{place}/summary.json").unlink()
    again = compare([], out=cut, resume=True, film=False, report=False)
    (cut / RUNNING).mkdir()  # of a process that was killed while it wrote the report
    assert timeless(compare([], out=cut, resume=True, film=False, report=False)).equals(timeless(again))
    assert not (cut / RUNNING).exists()
    assert timeless(again).equals(timeless(table))
    assert logs(cut) == logs(whole)
    assert len(logs(whole)) == seeds


@pytest.mark.study
@pytest.mark.parametrize("law", LAWS)
def test_all_runs_of_the_canonical_tasks_agree(canonical: dict[str, list[Scenario]], law: str):
    flown = BatchRequest.of("a", canonical[law]).perform()
    assert sum(files is None for files in flown) <= 10  # of 50: where rounding decides, which differs between builds of linear algebra
    for i, (scenario, files) in enumerate(zip(canonical[law], flown, strict=True)):
        if files is not None:
            alone = vs.run(scenario)
            must_agree(alone.summary(), json.loads(files["summary.json"]), f"{law} {i}")
            log, own = pl.read_parquet(io.BytesIO(files["log.parquet"])), alone.frame()
            for column in own.columns:
                assert number(log[column]) == pytest.approx(number(own[column]), rel=1e-6, abs=1e-6, nan_ok=True), (law, i, column)
