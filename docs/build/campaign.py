"""Comparisons of hours, in parts:
`python -m docs.build.campaign vitvs --starts 60 [--only AXIS=NAME] [--vary detector.features=orb]`.

Each call does further starts of each task, in an order drawn once for all, and adds them to what is
kept of the same command. So at any time the page has a random sample of the whole, and says how
many there are. Interrupted (Ctrl-C, SIGTERM), it ends its workers and keeps what is done. Cases
that a comparison has gained since are flown, those that it no longer has are dropped;
`--again field` flies those anew that have a value of this name:
`python -m docs.build.campaign realism_arm --starts 10 --again lab field`.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import sys
import tempfile
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from docs.build.kept import Row, keep, place_of, read, steady
from vstestbed.cli.ending import exit_code
from vstestbed.cli.options import vary_of
from vstestbed.core.errors import ParameterError, nearest
from vstestbed.studies.comparison import Job, Runner, begun, chosen, resumed
from vstestbed.studies.comparison.folder import table_of
from vstestbed.studies.comparison.plan import AMOUNT
from vstestbed.studies.comparison.record import PLAN
from vstestbed.studies.pools import pool_of

SEED = 21
"""Of the order of the starts."""


def main() -> int:
    """Do further starts and keep them; the exit code, as of a command of vstestbed."""
    parser = argparse.ArgumentParser(prog="python -m docs.build.campaign", description=__doc__)
    parser.add_argument("name", help="of a comparison, such as vitvs")
    parser.add_argument(
        "--starts", type=int, required=True, help="how many of each task there are to be in all"
    )
    parser.add_argument(
        "--vary", nargs="*", default=[], metavar="a.b=v1,v2", help="as of `vstestbed compare`"
    )
    parser.add_argument(
        "--only",
        nargs="*",
        default=[],
        metavar="AXIS=NAME",
        help="runs of this case or value alone",
    )
    parser.add_argument(
        "--again",
        nargs="*",
        default=[],
        metavar="VALUE",
        help="controllers with one of these values are flown anew",
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="worker processes")
    parser.add_argument(
        "--out",
        type=Path,
        help="a folder for the runs, gone on with where it exists; by default a temporary one",
    )
    asked = parser.parse_args()
    return exit_code(lambda: _go_on(asked))


def _go_on(asked: argparse.Namespace) -> None:
    command = shlex.join(
        ["compare", asked.name, *(part for word in asked.vary for part in ("--vary", word))]
    )
    with tempfile.TemporaryDirectory() as empty:
        out = asked.out or Path(empty) / "runs"
        resume = (out / PLAN).is_file()
        if resume:
            ready = resumed(out, film=False)
        else:
            ready = begun(chosen([asked.name], {}, vary_of(asked.vary)), out, film=False)
        with ready as campaign:
            whole = campaign.runner
            kept = {
                _key(row): row
                for row in _kept(command)
                if not set(asked.again) & {str(row[name]) for name in _named(row)}
            }
            wanted = _wanted(asked.only, whole.jobs)
            first = [
                (job, i)
                for job, i in _in_order(whole.jobs)
                if _values(job).items() >= wanted.items()
            ]
            done = [job for job, _ in first if (out / job.folder).is_dir()]
            jobs = [
                *done,
                *(
                    job
                    for job, i in first
                    if i < asked.starts and _key_of(job) not in kept and job not in done
                ),
            ]
            try:
                _run(Runner(out, jobs, ()), asked.jobs)
            finally:
                rows = json.loads(json.dumps(table_of(out, jobs).to_dicts()))
                kept |= {_key(row): row for row in map(steady, rows)}
                if known := [
                    _labelled(kept[key], job) for job in whole.jobs if (key := _key_of(job)) in kept
                ]:
                    keep(command, known)


def _values(job: Job) -> dict[str, str]:
    """The varied values of a run, as words."""
    return {axis: str(value) for axis, value in job.controller.values.items()}


def _wanted(only: Iterable[str], jobs: Iterable[Job]) -> dict[str, str]:
    """The values of `--only` by their axes.

    Raises:
        ParameterError: no run has one of them.
    """
    known = {f"{axis}={value}" for job in jobs for axis, value in _values(job).items()}
    for word in only:
        if word not in known:
            raise ParameterError(
                "--only",
                f"must be AXIS=NAME of runs that there are; {nearest(word, sorted(known))}",
                word,
            )
    return dict(word.split("=", 1) for word in only)


def _in_order(jobs: Iterable[Job]) -> list[tuple[Job, int]]:
    """All runs with the place of their start in the order drawn; the controllers of a start one
    after another.
    """
    every = list(jobs)
    drawn = (
        np.random.default_rng(SEED)
        .permutation(sorted({job.seed for job in every if job.seed is not None}))
        .tolist()
    )
    place = {seed: i for i, seed in enumerate(drawn)}
    return sorted(((job, place.get(job.seed, 0)) for job in every), key=lambda found: found[1])


def _run(runner: Runner, processes: int) -> None:
    if runner.done == len(runner.jobs):
        return
    with closing(pool_of("local", processes, runner.folder)) as pool:
        runner.run(
            pool,
            lambda job, summary: print(
                job.folder, summary.get("outcome"), file=sys.stderr, flush=True
            ),
        )


def _kept(command: str) -> list[Row]:
    place = place_of(command)
    return read(place) if place.is_file() else []


def _key(row: Row) -> str:
    """What tells a run from the others: scenario, varied values and start."""
    return json.dumps(
        {name: _plain(value) for name, value in row.items() if name in _named(row)}, sort_keys=True
    )


def _labelled(row: Row, job: Job) -> Row:
    """The row with the label that the plan gives its start now:
    rows kept before may have another.
    """
    return (
        {**row, AMOUNT: job.controller.amounts[job.seed]}
        if AMOUNT in row and job.seed is not None
        else row
    )


def _named(row: Row) -> list[str]:
    """The columns before the outcome, which say what was run."""
    names = list(row)
    return [name for name in names[: names.index("outcome")] if name not in ("folder", AMOUNT)]


def _plain(value: object) -> object:
    """As a table has it: 0 and 0.0 are one value."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    return value if isinstance(value, str | bool) else json.dumps(value)


def _key_of(job: Job) -> str:
    values: dict[str, Any] = {path: _plain(value) for path, value in job.controller.values.items()}
    return json.dumps(
        {"scenario": job.controller.scenario.name} | values | {"seed": _plain(job.seed)},
        sort_keys=True,
    )


if __name__ == "__main__":
    sys.exit(main())
