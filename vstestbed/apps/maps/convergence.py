"""Convergence maps: share of the seeds that reach the goal over two varied fields of a scenario,
and outcomes of the others.
"""

from __future__ import annotations

import itertools
import math
import pickle
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import polars as pl

from vstestbed.core.errors import (
    EnvironmentLackError,
    ParameterError,
    UnreachableError,
    VstestbedError,
)
from vstestbed.core.files import write_table
from vstestbed.core.outcome import Outcome
from vstestbed.loop.session import run, uninterrupted
from vstestbed.report.studies import ConvergenceMap, Sweep, write_sweep
from vstestbed.scenario.plugins import load_plugins
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison.plan import Comparison, Job, Jobs, controllers, must_be_few
from vstestbed.studies.comparison.runs import is_light
from vstestbed.studies.pools import (
    MOST_TRIES,
    Request,
    WorkerLostError,
    completed,
    pool_of,
    workers,
)

CHUNK = 4  # runs that a worker takes at a time: a run of the ideal camera takes only some 50 ms


@dataclass(frozen=True)
class RunEnding:
    """Result of one run: outcome by name, success, time to converge [s], distance from the true
    goal at the end [m]; NaN if unknown.
    """

    outcome: str
    success: bool
    time_s: float
    away_m: float

    @classmethod
    def without_run(cls, outcome: Outcome) -> RunEnding:
        """That of a run that could not begin, or ended in an error."""
        return cls(outcome.name, outcome.success, math.nan, math.nan)


Ended = Sequence[tuple[Job, RunEnding]]  # the runs that are done, in the order of the plan


def run_one(scenario: Scenario) -> RunEnding:
    """Run a scenario in memory; an exception in a plugin gives the outcome `crashed`, as in a
    comparison.
    Raises EnvironmentLackError: this machine has no OpenGL, so that every other run would fail as
    well.
    """
    try:
        recording = uninterrupted(run(scenario))
    except EnvironmentLackError:
        raise
    except UnreachableError:  # its motors cannot hold it there
        return RunEnding.without_run(Outcome.unreachable)
    except (Exception, SystemExit):  # of a plugin, also one that calls sys.exit
        return RunEnding.without_run(Outcome.crashed)
    figures = recording.summary()
    time_s, away_m = (
        math.nan if figures[k] is None else float(str(figures[k]))
        for k in ("time_to_converge_s", "final_position_error_m")
    )
    return RunEnding(recording.outcome.name, recording.outcome.success, time_s, away_m)


def request_of(folder: str, scenarios: Sequence[Scenario]) -> Request[list[RunEnding]]:
    """The request for some runs; pickled, since the scenarios may be of classes of plugins."""
    plugins = tuple(dict.fromkeys(name for one in scenarios for name in one.plugins))
    return Request(
        folder, _run_all, (plugins, pickle.dumps(scenarios)), all(map(is_light, scenarios))
    )


def _run_all(plugins: tuple[str, ...], packed: bytes, place: str | None = None) -> list[RunEnding]:
    """Do runs, in a worker; errors as of `run_one`."""
    load_plugins(plugins)  # before objects of their classes are unpacked
    return [run_one(scenario) for scenario in pickle.loads(packed)]


# a request with its jobs and their places in the plan
Work = tuple[list[tuple[int, Job]], Request[list[RunEnding]]]


@dataclass(frozen=True)
class Study:
    """A comparison over two axes, and its runs.

    Args:
        comparison: the plan. force: allow more than 100,000 runs.

    Raises (from the constructor): ParameterError if it has not exactly two axes, has no seeds, or
    has tasks; or too many runs.
    """

    comparison: Comparison
    force: bool = False

    def __post_init__(self) -> None:
        """Refuse a comparison that makes no map."""
        c = self.comparison
        if len(c.axes) != 2:
            raise ParameterError.count(
                "axes",
                "two,",
                "x and y of each map",
                list(c.axes),
                why="give --vary a.b=v1,v2 twice",
            )
        if c.tasks or c.seeds is None:
            raise ParameterError("seeds", "must be given in a convergence map, which has no tasks")
        must_be_few(c, self.force)

    @cached_property
    def runs(self) -> Jobs:
        """Every run."""
        return Jobs(
            controllers(self.comparison, self.force),
            self.comparison.seeds,
            self.comparison.first_seed,
        )

    def run_all(
        self, folder: Path, processes: int | None, on_done: Callable[[int, Job, RunEnding], None]
    ) -> None:
        """Do all runs in worker processes, whose temporary files stand in `folder`;
        `on_done(place, job, ending)` is called after each.
        """
        runs, again = self.runs, list[Work]()
        waiting = enumerate(runs)
        chunks = iter(lambda: list(itertools.islice(waiting, CHUNK)), [])
        requests = (work for chunk in chunks if (work := _work(chunk, on_done)))
        with closing(pool_of("local", workers(processes, len(runs)), folder)) as pool:
            for chunk, request, future in completed(pool, requests, again):
                try:
                    endings = future.result()
                except WorkerLostError:
                    # each by itself: one of them may have killed the worker
                    if len(chunk) > 1 or pool.tries(request) < MOST_TRIES:
                        again += [work for one in chunk if (work := _work([one], on_done))]
                        continue
                    endings = [RunEnding.without_run(Outcome.crashed)]
                for (place, job), ending in zip(chunk, endings, strict=True):
                    on_done(place, job, ending)

    def maps(self, ended: Ended) -> list[ConvergenceMap]:
        """One map for each scenario and combination of cases, in their order; NaN in the cells of
        which no run is done.
        """
        # the order of the plan: the first axis is x
        axes = list(self.comparison.axes.items())
        (x_path, xs), (y_path, ys) = axes
        cells: dict[str, dict[tuple[str, str], list[RunEnding]]] = {}
        for job, one in ended:
            values = job.controller.values
            names = [str(values[name]) for name in self.comparison.cases]
            label = ", ".join(
                (
                    [job.controller.scenario.name]
                    if len(self.comparison.base) > 1 or not names
                    else []
                )
                + names
            )
            cells.setdefault(label, {}).setdefault(
                (str(values[x_path]), str(values[y_path])), []
            ).append(one)
        return [
            _map(label, found, [str(x) for x in xs], [str(y) for y in ys])
            for label, found in cells.items()
        ]

    def table(self, ended: Ended) -> pl.DataFrame:
        """One row per run, in the order of the plan: scenario, cases, values, seed, outcome."""
        rows = [
            {"scenario": job.controller.scenario.name}
            | {name: str(value) for name, value in job.controller.values.items()}
            | {"seed": job.seed, "outcome": one.outcome, "success": one.success}
            | {"time_to_converge_s": one.time_s, "final_position_error_m": one.away_m}
            for job, one in ended
        ]
        # null in parquet and an empty field in CSV, as in the other tables
        return pl.DataFrame(rows).fill_nan(None)


def _work(
    chunk: list[tuple[int, Job]], on_done: Callable[[int, Job, RunEnding], None]
) -> Work | None:
    """The request for runs; those whose start cannot be drawn have ended. None if there are no
    others.
    """
    drawn: list[tuple[tuple[int, Job], Scenario]] = []
    for place, job in chunk:
        try:
            drawn.append(((place, job), job.scenario()))
        except VstestbedError as error:  # as in a comparison
            on_done(
                place,
                job,
                RunEnding.without_run(
                    Outcome.unreachable if isinstance(error, UnreachableError) else Outcome.crashed
                ),
            )
    if not drawn:
        return None
    first = drawn[0][0][1].folder
    name = first if len(drawn) == 1 else f"{first} and {len(drawn) - 1} more"
    return [one for one, _ in drawn], request_of(name, [scenario for _, scenario in drawn])


def _map(
    label: str, found: dict[tuple[str, str], list[RunEnding]], xs: list[str], ys: list[str]
) -> ConvergenceMap:
    share, away = np.empty((len(ys), len(xs))), np.full((len(ys), len(xs)), np.nan)
    others = np.full((len(ys), len(xs)), "", dtype=object)  # object: the words differ in length
    for (i, y), (j, x) in itertools.product(enumerate(ys), enumerate(xs)):
        ended = found.get((x, y), [])
        share[i, j] = np.mean([one.success for one in ended]) if ended else math.nan
        good = [one.away_m for one in ended if one.success]
        away[i, j] = float(np.median(good)) if good else math.nan
        failed = Counter(one.outcome for one in ended if not one.success)
        others[i, j] = failed.most_common(1)[0][0] if failed else ""
    return label, share, others, away


def write(folder: Path, study: Study, ended: Ended, command: str = "") -> Path:
    """Write `convergence.csv`, `.parquet`, `.png`, `.pdf` and `report.html`, each complete or not
    at all; returns the page's path.
    """
    write_table(folder / "convergence", study.table(ended))
    axes = [
        (path, [_short(value) for value in values])
        for path, values in study.comparison.axes.items()
    ]
    left = len(study.runs) - len(ended)
    caution = (
        f"Interrupted: {left:,} of {len(study.runs):,} runs are missing,"
        " and the shares are of fewer seeds."
    )
    sweep = Sweep(
        study.maps(ended),
        axes[0],
        axes[1],
        study.comparison.seeds or 0,
        study.comparison.description,
        caution if left else "",
    )
    return write_sweep(folder, sweep, command)


def _short(value: object) -> str:
    return ", ".join(_short(v) for v in value) if isinstance(value, list | tuple) else str(value)


def summaries(maps: Sequence[ConvergenceMap]) -> Iterator[dict[str, object]]:
    """Share of all runs that converged, for each map."""
    for label, share, _, _ in maps:
        yield {"label": label, "converged": float(np.mean(share))}
