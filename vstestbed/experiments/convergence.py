"""Convergence maps: share of the seeds that reach the goal over two varied fields of a scenario, and outcomes of the others."""

from __future__ import annotations

import io
import itertools
import math
import pickle
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import polars as pl

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import write_whole, writing
from vstestbed.experiments.comparison import Comparison, Job, controllers, jobs
from vstestbed.experiments.comparison import workers as workers_of
from vstestbed.experiments.comparison.runs import must_be_few
from vstestbed.experiments.comparison.worker import begin
from vstestbed.loop.run import run
from vstestbed.report.studies.convergence import ConvergenceMap, write_page
from vstestbed.scenario.plugins import load_plugins
from vstestbed.scenario.scenario import Scenario

CHUNK = 16
"""Runs that a worker takes at a time: a run of the ideal camera takes only some 50 ms."""


@dataclass(frozen=True)
class RunEnding:
    """Result of one run: outcome by name, success, time to converge [s], distance from the true goal at the end [m]; NaN if unknown."""

    outcome: str
    success: bool
    time_s: float
    away_m: float


def run_one(scenario: Scenario) -> RunEnding:
    """Run a scenario in memory; a function of the module, since worker processes import it by name."""
    recording = run(scenario)
    figures = recording.summary()
    time_s, away_m = (math.nan if figures[k] is None else float(str(figures[k])) for k in ("time_to_converge_s", "final_position_error_m"))
    return RunEnding(recording.outcome.name, recording.outcome.success, time_s, away_m)


def packed(scenarios: Sequence[Scenario]) -> tuple[tuple[str, ...], bytes]:
    """Scenarios for a worker, and their plugins, which it loads before it unpacks objects of their classes."""
    return tuple(dict.fromkeys(name for scenario in scenarios for name in scenario.plugins)), pickle.dumps(scenarios)


def run_all_of(plugins: Sequence[str], scenarios: bytes) -> list[RunEnding]:
    """`run_one` of each of the packed scenarios."""
    load_plugins(plugins)
    return [run_one(scenario) for scenario in pickle.loads(scenarios)]


@dataclass(frozen=True)
class Study:
    """A comparison over two axes, and its runs.

    Args:
        comparison: the plan. force: allow more than 100,000 runs.

    Raises (from the constructor): ParameterError if it has not exactly two axes, has no seeds, or has tasks; or too many runs.
    """

    comparison: Comparison
    force: bool = False

    def __post_init__(self) -> None:
        """Refuse a comparison that makes no map."""
        c = self.comparison
        if len(c.axes) != 2:
            raise ParameterError("axes", "must be two in a convergence map", list(c.axes))
        if c.tasks or c.seeds is None:
            raise ParameterError("seeds", "must be given in a convergence map, which has no tasks")
        must_be_few(c, self.force)

    @property
    def runs(self) -> Sequence[Job]:
        """Every run."""
        return jobs(controllers(self.comparison, self.force), self.comparison.seeds)

    def run_all(self, processes: int | None, progress: Callable[[int, int], None] = lambda done, of: None) -> list[tuple[Job, RunEnding]]:
        """Do all runs in worker processes; `progress(done, total)` is called after each."""
        runs = self.runs
        ended: list[tuple[Job, RunEnding]] = []
        processes = workers_of(processes, len(runs))
        # spawn: to fork a process that has threads (OpenGL, BLAS) is unsafe
        with ProcessPoolExecutor(processes, mp_context=get_context("spawn"), initializer=begin, initargs=(True,)) as pool:
            going: deque[tuple[list[Job], Future[list[RunEnding]]]] = deque()
            waiting = iter(runs)
            while (chunk := list(itertools.islice(waiting, CHUNK))) or going:
                if chunk:
                    going.append((chunk, pool.submit(run_all_of, *packed([job.scenario() for job in chunk]))))
                # a chunk more for each worker than it can do: scenarios are drawn only when they are needed
                if not chunk or len(going) >= 2 * processes:
                    done, future = going.popleft()
                    for one in zip(done, future.result(), strict=True):
                        ended.append(one)
                        progress(len(ended), len(runs))
        return ended

    def maps(self, ended: Sequence[tuple[Job, RunEnding]]) -> list[ConvergenceMap]:
        """One map for each scenario and combination of cases, in their order."""
        # the order of the plan: the first axis is x
        axes = list(self.comparison.axes.items())
        (x_path, xs), (y_path, ys) = axes
        cells: dict[str, dict[tuple[str, str], list[RunEnding]]] = {}
        for job, one in ended:
            values = job.controller.values
            names = [str(values[name]) for name in self.comparison.cases]
            label = ", ".join(([job.controller.scenario.name] if len(self.comparison.base) > 1 or not names else []) + names)
            cells.setdefault(label, {}).setdefault((str(values[x_path]), str(values[y_path])), []).append(one)
        return [_map(label, found, [str(x) for x in xs], [str(y) for y in ys]) for label, found in cells.items()]

    def table(self, ended: Sequence[tuple[Job, RunEnding]]) -> pl.DataFrame:
        """One row per run: scenario, cases, values, seed, outcome."""
        rows = [
            {"scenario": job.controller.scenario.name}
            | {name: str(value) for name, value in job.controller.values.items()}
            | {"seed": job.seed, "outcome": one.outcome, "success": one.success}
            | {"time_to_converge_s": one.time_s, "final_position_error_m": one.away_m}
            for job, one in ended
        ]
        return pl.DataFrame(rows).fill_nan(None)  # null in parquet and an empty field in CSV, as in the other tables


def _map(label: str, found: dict[tuple[str, str], list[RunEnding]], xs: list[str], ys: list[str]) -> ConvergenceMap:
    """The map of one law from the runs of each cell (x, y)."""
    share, away = np.empty((len(ys), len(xs))), np.full((len(ys), len(xs)), np.nan)
    others = np.full((len(ys), len(xs)), "", dtype=object)  # object: the words differ in length
    for (i, y), (j, x) in itertools.product(enumerate(ys), enumerate(xs)):
        ended = found[x, y]
        share[i, j] = np.mean([one.success for one in ended])
        good = [one.away_m for one in ended if one.success]
        away[i, j] = float(np.median(good)) if good else math.nan
        failed = Counter(one.outcome for one in ended if not one.success)
        others[i, j] = failed.most_common(1)[0][0] if failed else ""
    return ConvergenceMap(label, share, others, away)


def write(folder: Path, study: Study, ended: Sequence[tuple[Job, RunEnding]], command: str = "") -> Path:
    """Write `convergence.csv`, `.parquet`, `.png`, `.pdf` and `report.html`, each complete or not at all; returns the page's path.

    Raises:
        OutputError, EnvironmentLackError: a file cannot be written.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    table, parquet = study.table(ended), io.BytesIO()
    table.write_parquet(parquet)
    write_whole(folder / "convergence.parquet", parquet.getvalue())
    write_whole(folder / "convergence.csv", table.write_csv())
    axes = [(path, [_short(value) for value in values]) for path, values in study.comparison.axes.items()]
    seeds = study.comparison.seeds or 0
    return write_page(folder, study.maps(ended), axes[0], axes[1], seeds, study.comparison.description, command)


def _short(value: object) -> str:
    return ", ".join(_short(v) for v in value) if isinstance(value, list | tuple) else str(value)


def summaries(maps: Sequence[ConvergenceMap]) -> Iterator[dict[str, object]]:
    """Share of all runs that converged, for each map."""
    for one in maps:
        yield {"label": one.label, "converged": float(np.mean(one.share))}
