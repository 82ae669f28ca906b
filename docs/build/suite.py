"""The suite's kept runs, and what the pages make of them.

    vstestbed suite --out flown
    python -m docs.build.suite flown/runs.csv
        # keeps them as scenarios/suite/VS-1.csv, and makes docs/research/VS-1/ again
    python -m docs.build.suite --cost
        # processor time of a run of each task here, for `run_s` in VS-1.yaml

Several files are one after the other: of laws, or tasks, that were flown apart. Those of tasks that
have flown with the gains of now wait in docs/research/VS-1/flown/ for the others.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
import time
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

import vstestbed as vs
from docs.build.suite_tuning import GROUPS, TRIALS, gains, record
from vstestbed.apps.suite.scores import (
    RESAMPLES,
    Score,
    differences,
    overall,
    scores,
    write_scores,
)
from vstestbed.apps.suite.suite import HOW, LAW, fingerprint, opened, read_suite
from vstestbed.core.files import make_folder, write_whole
from vstestbed.core.geometry import Array
from vstestbed.report.comparison.statistics import CONFIDENCE, IntervalEstimate, paired_difference
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison.plan import Jobs, controllers, read_comparison

PLACE = Path(__file__).resolve().parents[1] / "research" / "VS-1"
FORMER = "32187406c2dc"
FORMER_ORACLE = ("ideal", "border", "tracking", "latency", "calibration", "base", "craft")
"""The files of the first flight, by their hash, and its tasks in which laws saw the oracle and not
pictures.
"""


SEARCH_S = {
    "arm": 70,
    "latency": 90,
    "ideal": 20,
    "tracking": 110,
    "base": 100,
    "craft": 110,
    "natural": 600,
}
"""Processor time of the search of a law, of groups of which the record has none [s]: trials times
starts times the time of a run.
"""


class Agreement(NamedTuple):
    """Spearman's rank correlation of two tasks' means over the laws that flew both, with the
    interval of resampled laws.

    least, most: the ends of what it is without one of the laws; least_without, most_without: which
    ones.
    """

    found: IntervalEstimate
    least: float
    least_without: str
    most: float
    most_without: str


class Suite:
    """The kept runs with their scores."""

    def __init__(self):
        """Read them; `former` where they are of other tasks than those of now."""
        suite, path = read_suite()
        place = path.with_suffix(".csv")
        self.sha256 = place.read_text(encoding="utf-8").split("\n", 1)[0].removeprefix("# ")
        self.former = self.sha256 != fingerprint(suite, path)
        self.runs = pl.read_csv(
            place, comment_prefix="#", schema_overrides={"start": pl.String, "value": pl.Float64}
        )
        self.scores = scores(self.runs)
        # CNS's network, by its own weights
        beside = pl.read_csv(PLACE / "cns.csv", schema_overrides={"start": pl.String})
        self.all = pl.concat([self.runs, beside.cast({"value": pl.Float64})])
        self.tasks = list(dict.fromkeys(s.task for s in self.scores))
        self.overall = overall(self.scores)
        self.laws = [s.law for s in self.overall]

    def sees(self, task: str) -> str:
        """What laws see in a task of the kept runs: `oracle`, exact pixels, or `pictures`."""
        if self.sha256.startswith(FORMER):
            return "oracle" if task in FORMER_ORACLE else "pictures"
        kinds = {one.detector.kind for one in _scenarios(task)}
        return "oracle" if kinds == {"oracle"} else "pictures"

    def moves(self, task: str) -> str:
        """How the robot of a task moves, in which no task has changed: `ideal`, as it is ordered,
        or with its `dynamics`.
        """
        robots = [one.robot for one in _scenarios(task)]
        ideal = all(
            robot.kind == "free" or getattr(robot, "actuation", "") == "ideal" for robot in robots
        )
        return "ideal" if ideal else "dynamics"

    def starts(self, task: str) -> int:
        """How many starts each law has flown in a task."""
        return len(self.runs.filter(pl.col("task") == task)["start"].unique())

    def oracle_tasks(self) -> list[str]:
        """The tasks in which laws saw the oracle."""
        return [task for task in self.tasks if self.sees(task) == "oracle"]

    def flew(self, task: str) -> list[str]:
        """The laws that flew a task."""
        return [s.law for s in self.scores if s.task == task]

    def has(self, law: str) -> bool:
        """Whether a law has flown."""
        return law in self.laws

    def beside(self) -> bool:
        """Whether CNS's network has flown the starts of the kept runs."""
        cns = self.all.filter(pl.col("law") == "cns").select("task", "start")
        return cns.join(self.runs, on=["task", "start"], how="anti").is_empty()

    def open_with_first(self) -> list[str]:
        """Of the laws that flew as many tasks as the first: those whose mean rank on tasks like
        these may be as low as its highest.
        """
        first = self.overall[0]
        return [
            f"`{s.law}`"
            for s in self.overall[1:]
            if s.tasks == first.tasks and s.alike.low <= first.alike.high
        ]

    def apart(self, task: str, one: str, other: str) -> bool:
        """Whether two laws of a task differ beyond chance, among all pairs of its laws."""
        a, b = self.of(one, task), self.of(other, task)
        assert a is not None
        assert b is not None
        found = differences(np.array([s.values for s in self.scores if s.task == task]))
        places = [self.flew(task).index(s.law) for s in (a, b)]
        return found[places[0], places[1]].p < 1 - CONFIDENCE

    def trials(self) -> int:
        """Trials of each search for gains."""
        return TRIALS

    def untuned(self) -> list[str]:
        """The groups of tasks of which laws have gains that are not in the record,
        with these laws.
        """
        there = record()
        begun = set() if there is None else set(there["group"])
        some = {
            group: ", ".join(f"`{law}`" for law in laws) for group, laws in self._lacking.items()
        }
        return [
            f"`{group}`: {laws if group in begun else 'all laws'}" for group, laws in some.items()
        ]

    def tuning_hours(self) -> str:
        """How long these searches take, by those of the record."""
        there = record()
        known = (
            {}
            if there is None
            else dict(there.group_by("group").agg(pl.col("processor_s").mean()).iter_rows())
        )
        seconds = sum(
            len(laws) * known.get(group, SEARCH_S[group]) for group, laws in self._lacking.items()
        )
        return f"about {seconds / 3600:.1f} h"

    @cached_property
    def _lacking(self) -> dict[str, list[str]]:
        there = record()
        done = set() if there is None else set(there.select("group", "law").iter_rows())
        entry = opened(None)
        lacking: dict[str, list[str]] = {}
        for name, group in GROUPS.items():
            laws = entry.plans[group.plan].cases[LAW]
            left = [
                law
                for law, block in laws.items()
                if any(gains(block[LAW])) and (name, law) not in done
            ]
            if left:
                lacking[name] = left
        return lacking

    def effort(self) -> str:
        """What a flight takes on one core, in words."""
        return opened(None).effort(jobs=1).split(";")[0]

    def of(self, law: str, task: str) -> Score | None:
        """The score of a law in a task; None where it took no part."""
        return next((s for s in self.scores if (s.law, s.task) == (law, task)), None)

    def best(self, task: str, but: str = "") -> Score:
        """The score of the law with the best mean in a task, without one of them."""
        return min(
            (s for s in self.scores if s.task == task and s.law != but), key=lambda s: s.value.mean
        )

    def difference(self, task: str, one: str, other: str, start: str = "") -> IntervalEstimate:
        """Mean of one law's number less the other's on the starts whose words have `start` in them,
        with interval and p-value.
        """
        wide = self._flown(task, start).pivot("law", index="start", values="value")
        return paired_difference(wide[one].to_numpy(), wide[other].to_numpy())

    def success(self, task: str, law: str, start: str = "") -> tuple[int, int]:
        """Successes and runs of a law on those starts."""
        part = self._flown(task, start).filter(law=law)
        return int(part["success"].sum()), len(part)

    def _flown(self, task: str, start: str) -> pl.DataFrame:
        return self.all.filter(pl.col("start").str.contains(start, literal=True), task=task)

    def mean(self, task: str, law: str) -> float:
        """Mean of a law's number in a task."""
        own = self.all.filter(task=task, law=law)
        return float(own["value"].mean())  # type: ignore[arg-type]  # numbers

    def agreement(self, one: str, other: str, but: tuple[str, ...] = ()) -> Agreement:
        """How far the laws' means of two tasks have the same order, without some of the laws."""
        laws = [
            law for law in self.laws if self.of(law, one) and self.of(law, other) and law not in but
        ]
        a, b = (np.array([self.mean(task, law) for law in laws]) for task in (one, other))
        drawn = np.random.default_rng(0).integers(0, len(laws), (RESAMPLES, len(laws)))
        low, high = np.nanpercentile(_spearman(a[drawn], b[drawn]), [2.5, 97.5])
        left_out = {
            law: float(_spearman(np.delete(a, i), np.delete(b, i))) for i, law in enumerate(laws)
        }
        least, *_, most = sorted(left_out, key=left_out.__getitem__)
        found = IntervalEstimate(float(_spearman(a, b)), float(low), float(high), len(laws))
        return Agreement(found, left_out[least], least, left_out[most], most)


def _scenarios(task: str) -> list[Scenario]:
    suite, path = read_suite()
    return [
        one.scenario for one in controllers(read_comparison(path.parent / suite.tasks[task].plan))
    ]


def _spearman(a: Array, b: Array) -> Array:
    """Rank correlations along the last axis."""
    from scipy.stats import rankdata

    x, y = (rankdata(values, axis=-1) for values in (a, b))
    x, y = (ranks - ranks.mean(axis=-1, keepdims=True) for ranks in (x, y))
    with np.errstate(invalid="ignore"):  # NaN where a resample has one law alone
        return (x * y).sum(axis=-1) / np.sqrt((x * x).sum(axis=-1) * (y * y).sum(axis=-1))


def keep(files: list[Path]) -> None:
    """Keep runs beside the suite's file."""
    suite, path = read_suite()
    runs = pl.concat(
        [
            pl.read_csv(file, schema_overrides={"start": pl.String, "value": pl.Float64})
            for file in files
        ]
    )
    order = {name: i for i, name in enumerate([*suite.tasks, *suite.laws])}
    by = [pl.col(name).replace_strict(order, return_dtype=pl.Int64) for name in ("task", "law")]
    runs = runs.sort(*by, maintain_order=True).with_columns(pl.col("value").round_sig_figs(6))
    write_whole(path.with_suffix(".csv"), f"# {fingerprint(suite, path)}\n{runs.write_csv()}")


def cost() -> None:
    """Say how long the runs of `--quick` take on one core, of each task."""
    entry = opened(None, quick=True)
    for task, plan in entry.plans.items():
        jobs, began = (
            list(Jobs(controllers(plan), plan.seeds, plan.first_seed)),
            time.process_time(),
        )
        for job in jobs:
            vs.run(job.scenario())
        print(
            f"{task}: {(time.process_time() - began) / len(jobs):.2f} s a run, of {len(jobs)}",
            flush=True,
        )


def draw() -> None:
    """Make page, tables and figures of the kept runs."""
    found, entry = Suite(), opened(None)
    entry.plans  # noqa: B018 - says which laws take no part
    tasks = entry.shown_tasks(found.laws)
    which = "A former flight, of other tasks than those of now" if found.former else "All starts"
    about = f"{entry.suite.description}. {which}; files {found.sha256[:12]}. {HOW}"
    with tempfile.TemporaryDirectory() as made:
        write_scores(Path(made), found.runs, tasks, "Suite VS-1", about, entry.command)
        for name in (
            "report.html",
            "scores.csv",
            "ranks.csv",
            "scores.tex",
            "figures/ranks.png",
            "figures/profile.png",
        ):
            shutil.copyfile(Path(made) / name, make_folder(PLACE) / Path(name).name)


if __name__ == "__main__":
    if sys.argv[1:] == ["--cost"]:
        cost()
    else:
        if len(sys.argv) > 1:
            keep([Path(name) for name in sys.argv[1:]])
        draw()
