"""The search for all gains of the suite's laws, one budget for each group of tasks, and its record.

    python -m docs.build.suite_tuning               # all missing in scenarios/suite/VS-1_tuned.csv
    python -m docs.build.suite_tuning arm latency   # of these groups alone
    python -m docs.build.suite_tuning --again arm   # anew
    python -m docs.build.suite_tuning --write       # the record's gains into VS-1.yaml there

A trial is a setting of all gains of a law at once. It flies the group's task from starts that are
none of the suite's, in each of the task's cases: random ones, and of lists of motions the middles
between two neighbours (from random starts alone the search finds gains that lose large motions).
Its number is the suite's own: the mean of the task's metric, a failure at the task's limit. A law
with three gains has as many trials as one with one. Settings are chosen as `vstestbed tune` does
(`apps/tune/search_space.py`). Trials see the oracle, which is some ten times quicker than pictures;
the best one then flies the same starts with pictures, and both means are in the record. For natural
features there is no oracle: their trials see pictures; and `ideal` has the oracle itself.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy: one process computes

import polars as pl

import vstestbed as vs
from vstestbed.apps.suite.suite import LAW, TO_GOAL, SuiteEntry, opened
from vstestbed.apps.tune.search_space import Range, SearchSpace, Trial, next_settings
from vstestbed.core.files import write_whole
from vstestbed.core.geometry import Pose
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison.plan import (
    TUNED,
    Comparison,
    Job,
    Jobs,
    StartTable,
    changed,
    controllers,
    read_comparison,
)
from vstestbed.tasks.metrics import Metric

TRIALS = 24
BATCH = 4  # trials that are chosen together
SEED = 0  # of the search
ORACLE = {"detector": {"kind": "oracle", "field_of_view": "limited"}, "noise.pixel_sigma_px": 0.05}
GAIN = re.compile(r"(\w+_)?gain(_\w+)?")
RECORD = Path(__file__).resolve().parents[2] / "scenarios" / "suite" / "VS-1_tuned.csv"
KEYS = ["group", "law"]


@dataclass(frozen=True)
class Group:
    """Tasks that are flown with the same gains.

    plan: the task whose starts are searched. writes: where the gains stand in a law's block: its
    own, or that of a task. starts: of a trial, in each case of the plan, or of each of its lists.
    low, high: the range of each gain [1/s], searched on a logarithmic scale.
    set: as of a comparison, for the trials, empty where the task's own detector is theirs. by: what
    the trials see.
    """

    plan: str
    writes: tuple[str, ...]
    starts: int
    low: float = 0.2
    high: float = 16.0
    set: Mapping[str, Any] = field(default_factory=lambda: dict(ORACLE))
    by: str = "oracle"


GROUPS = {
    "arm": Group("arm", (LAW,), 3),  # also `border`, `calibration`, `realism`
    "latency": Group("latency", ("latency",), 4),
    # at 25 pictures a second a gain of 25 ends in one
    "ideal": Group("ideal", ("ideal",), 3, high=24.0, set={}),
    "tracking": Group("tracking", ("tracking",), 3, high=24.0),
    "base": Group("base", ("base",), 2),
    "craft": Group("craft", ("craft",), 2, low=0.1, high=4.0),
    "natural": Group("poster", ("poster", "boxes"), 6, set={}, by="pictures"),
}


def gains(block: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, float]]:
    """The gains of a law's block, of the laws within it too, by their dotted paths."""
    for name, value in block.items():
        if GAIN.fullmatch(name) and isinstance(value, int | float):
            yield f"{above}{name}", float(value)
        elif isinstance(value, Mapping):
            yield from gains(value, f"{above}{name}.")
        elif isinstance(value, list):
            for i, part in enumerate(value):
                if isinstance(part, Mapping):
                    yield from gains(part, f"{above}{name}.{i}.")


def with_gains(block: Mapping[str, Any], values: Mapping[str, object]) -> dict[str, Any]:
    """The block with other gains, by the dotted paths of `gains`."""
    new = json.loads(json.dumps(block))
    for path, value in values.items():
        *way, last = path.split(".")
        place = new
        for part in way:
            place = place[int(part)] if isinstance(place, list) else place[part]
        place[last] = value
    return new


def trial_plan(
    entry: SuiteEntry, group: Group, blocks: Mapping[str, Mapping[str, Any]], oracle: bool
) -> Comparison:
    """The comparison of a law's blocks, by their names, from the starts of the trials."""
    plan = read_comparison(entry.path.parent / entry.suite.tasks[group.plan].plan)
    settings = dict(plan.set) | (dict(group.set) if oracle else {})
    cases = {LAW: {name: {LAW: dict(block)} for name, block in blocks.items()}, **plan.cases}
    tables = {
        name: other_starts(table, plan.limit, group.starts) for name, table in plan.tasks.items()
    }
    return changed(plan, set=settings, cases=cases, tasks=tables, seeds=None, limit=None)


def other_starts(table: StartTable, limit: int | None, number: int) -> StartTable:
    """So many starts like those of a table, none of which the suite flies: random ones, those of
    its list that are left, or the middles between two neighbours of a list that is flown whole.
    """
    if table.seeds is not None:
        return replace(table, seeds=number)
    flown = set(table.numbers(limit))
    free = [i for i in range(table.runs) if i not in flown]
    lists = {("each", path): values for path, values in table.lists.each.items()}
    lists |= {
        (name, ""): getattr(table.lists, name)
        for name in table.lists._fields[1:]
        if getattr(table.lists, name)
    }
    if free:
        picked = [free[(2 * i + 1) * len(free) // (2 * number)] for i in range(number)]
        chosen = {key: tuple(values[i] for i in picked) for key, values in lists.items()}
    else:
        picked = [(2 * i + 1) * (table.runs - 1) // (2 * number) for i in range(number)]
        chosen = {
            key: tuple(middle(values[i], values[i + 1]) for i in picked)
            for key, values in lists.items()
        }
    each = {path: values for (name, path), values in chosen.items() if name == "each"}
    of_camera, of_target = (
        chosen.get((name, ""), ()) for name in ("camera_from_goal", "target_from_goal")
    )
    return StartTable(
        set=table.set, each=each, camera_from_goal=of_camera, target_from_goal=of_target
    )


def middle(one: Any, other: Any) -> Any:
    """The middle of two poses, by their numbers; of whatever is the same in both, that."""
    if isinstance(one, Pose):
        return Pose(xyz=middle(one.xyz, other.xyz), rpy_deg=middle(one.rpy_deg, other.rpy_deg))
    if isinstance(one, Mapping):
        return {key: middle(value, other[key]) for key, value in one.items()}
    if isinstance(one, Sequence) and not isinstance(one, str):
        return [middle(a, b) for a, b in zip(one, other, strict=True)]
    return (one + other) / 2 if isinstance(one, int | float) else one


def trial_scenario(job: Job) -> Scenario:
    """The scenario of a trial's run, whose start and noise no seed of the suite draws."""
    number = job.seed or 0
    seed = number if number >= TUNED else TUNED + number
    if job.controller.start is None:
        return replace(job, seed=seed).scenario()
    scenario, unreachable = job.controller.start(number)
    if unreachable:
        raise ValueError(f"{job.folder}: {unreachable}")
    return scenario.with_seed(seed)


def flown(
    entry: SuiteEntry, group: Group, plan: Comparison, worst: float
) -> dict[str, list[tuple[bool, float]]]:
    """Of each block of a plan: whether each run reached the goal, and its number as the suite has
    it, in the metric's unit.
    """
    task = entry.suite.tasks[group.plan]
    found: dict[str, list[tuple[bool, float]]] = {}
    seeds = None if plan.tasks else group.starts
    for job in Jobs(controllers(plan), seeds, TUNED):
        summary = vs.run(trial_scenario(job)).summary()
        number = summary.get(task.metric)
        value = float(number) if isinstance(number, int | float) else worst
        if task.worst is not None and not (summary["success"] or summary["outcome"] == "timed_out"):
            value = worst
        scale = Metric.named(task.metric).scale
        found.setdefault(str(job.controller.values[LAW]), []).append(
            (bool(summary["success"]), min(value, worst) * scale)
        )
    return found


def tuned(entry: SuiteEntry, name: str, group: Group, law: str) -> list[dict[str, Any]]:
    """The record's rows of a law in a group, one a gain;
    none where it has none, or takes no part.
    """
    block = entry.block(law, group.plan)
    paths = [] if isinstance(block, str) else [path for path, _ in gains(block)]
    if isinstance(block, str) or not paths or (law, group.plan) in entry.blank:
        return []
    task = entry.suite.tasks[group.plan]
    first, *_ = controllers(trial_plan(entry, group, {"as it is": block}, True))
    limit = first.scenario.stop.duration_s
    worst = limit if task.metric == TO_GOAL else float(task.worst or math.inf)
    space = SearchSpace(tuple(Range(path, group.low, group.high, True) for path in paths), None)
    began, trials = time.process_time(), list[Trial]()
    while len(trials) < TRIALS:
        settings = next_settings(space, trials, False, group.starts, BATCH, SEED)
        blocks = {
            str(len(trials) + i): with_gains(block, values) for i, values in enumerate(settings)
        }
        results = flown(entry, group, trial_plan(entry, group, blocks, True), worst)
        for number, values in zip(blocks, settings, strict=True):
            numbers = tuple(value for _, value in results[number])
            # a failure is in the number, so that the search goes by the mean alone
            trials.append(Trial(int(number), values, reached=(True,) * len(numbers), found=numbers))
    best = min(trials, key=lambda trial: trial.mean)
    best_block = {"best": with_gains(block, best.values)}
    by_search = flown(entry, group, trial_plan(entry, group, best_block, True), worst)["best"]
    by_pictures = (
        flown(entry, group, trial_plan(entry, group, best_block, False), worst)["best"]
        if group.set
        else by_search
    )
    same = {
        "low": group.low,
        "high": group.high,
        "trials": TRIALS,
        "starts": len(by_search),
        "first_start": None if group.by == "pictures" else TUNED,
        "by": group.by,
        "metric": task.metric,
        "worst": worst,
        "reached": _reached(by_search),
        "mean": _mean(by_search),
        # of a task that has the oracle itself these are no other runs
        "pictures_reached": _reached(by_pictures) if group.set else None,
        "pictures_mean": _mean(by_pictures) if group.set else None,
        "processor_s": time.process_time() - began,
    }
    return [
        {"group": name, "law": law, "gain": path, "value": best.values[path], **same}
        for path in paths
    ]


def _reached(found: Sequence[tuple[bool, float]]) -> int:
    return sum(good for good, _ in found)


def _mean(found: Sequence[tuple[bool, float]]) -> float:
    return sum(value for _, value in found) / len(found)


def record() -> pl.DataFrame | None:
    """The record so far; None without one."""
    return pl.read_csv(RECORD, comment_prefix="#") if RECORD.is_file() else None


def keep(rows: Sequence[Mapping[str, Any]], entry: SuiteEntry) -> None:
    """Put rows into the record, in the order of groups and laws, in place of those of the same law
    and group.
    """
    new = pl.DataFrame(list(rows), infer_schema_length=None).with_columns(
        pl.col("mean", "pictures_mean", "processor_s").cast(pl.Float64).round_sig_figs(4)
    )
    old = record()
    if old is not None:
        new = pl.concat([old.join(new, on=KEYS, how="anti"), new], how="vertical_relaxed")
    order = {word: i for i, word in enumerate([*GROUPS, *entry.laws])}
    by = [pl.col(key).replace_strict(order, return_dtype=pl.Int64) for key in KEYS]
    head = "# Gains of VS-1's laws as they were searched for; how: docs/build/suite_tuning.py\n"
    write_whole(RECORD, head + new.sort(*by, maintain_order=True).write_csv())


def search(names: Sequence[str], again: bool) -> None:
    """Search for what the record lacks of these groups, or for all of it."""
    entry = opened(None)
    entry.plans  # noqa: B018 - says which laws take no part
    for name in names or GROUPS:
        old = record()
        there = set() if old is None or again else set(old.filter(pl.col("group") == name)["law"])
        for law in entry.laws:
            if law not in there and (rows := tuned(entry, name, GROUPS[name], law)):
                keep(rows, entry)
                values = ", ".join(f"{row['gain']}={row['value']}" for row in rows)
                told = (
                    "reached",
                    "starts",
                    "mean",
                    "pictures_reached",
                    "pictures_mean",
                    "processor_s",
                )
                print(
                    f"{name} {law}: {values}; {', '.join(f'{key} {rows[0][key]}' for key in told)}",
                    flush=True,
                )


NUMBER = re.compile(r"\b((?:\w+_)?gain(?:_\w+)?): [-+.\de]+")


def written(text: str, found: pl.DataFrame) -> str:
    """The suite's file with the record's gains. ValueError: a law's block has other gains than were
    searched for.
    """
    for (name, law), rows in found.group_by(KEYS, maintain_order=True):
        for place in GROUPS[str(name)].writes:
            begin, end = _span(text, str(law), place)
            text = (
                text[:begin]
                + _with_numbers(text[begin:end], rows["value"].to_list(), f"{law}, {place}")
                + text[end:]
            )
    return text


def _with_numbers(block: str, values: Sequence[float], where: str) -> str:
    """A block's text with other gains, in their order."""
    places = list(NUMBER.finditer(block))
    if len(places) != len(values):
        raise ValueError(
            f"{where}: must show its {len(values)} gains as numbers,"
            f" and shows {len(places)}: {block!r}"
        )
    for place, value in reversed(list(zip(places, values, strict=True))):
        block = f"{block[: place.start()]}{place[1]}: {value:g}{block[place.end() :]}"
    return block


def _span(text: str, law: str, place: str) -> tuple[int, int]:
    """Where a law's block, or that of a task, begins and ends in the suite's file."""
    header = re.search(rf"^  {law}:\n", text, re.MULTILINE)
    after = (
        re.compile(r"^(  \w+|tasks):", re.MULTILINE).search(text, header.end()) if header else None
    )
    if header is None or after is None:
        raise ValueError(f"no law {law}")
    indent = 4 if place == LAW else 6
    begin = re.compile(rf"^{' ' * indent}{place}:", re.MULTILINE).search(
        text, header.end(), after.start()
    )
    if begin is None:
        raise ValueError(f"{law}: no line {place}")
    end = re.compile(rf"^ {{2,{indent}}}\w+:", re.MULTILINE).search(
        text, begin.end(), after.start()
    )
    return begin.start(), end.start() if end else after.start()


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("groups", nargs="*", choices=[*GROUPS, []], help="; ".join(GROUPS))
    parser.add_argument(
        "--again", action="store_true", help="search for what is in the record, too"
    )
    parser.add_argument(
        "--write", action="store_true", help="write the record's gains into the suite's file"
    )
    given = parser.parse_args()
    if not given.write:
        search(given.groups, given.again)
        return
    found = record()
    path = opened(None).path
    if found is not None:
        write_whole(path, written(path.read_text(encoding="utf-8"), found))


if __name__ == "__main__":
    main()
