"""Compare controllers: every scenario with every variation from every seed, in parallel; one table, one report, one film."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from vstestbed.core.errors import ParameterError
from vstestbed.experiments.comparison.campaign import Campaign, Told
from vstestbed.experiments.comparison.folder import PLAN, new_folder, read_plan, resumable, table_of, write_plan, write_table
from vstestbed.experiments.comparison.plan import Comparison, Controller, Job, chosen, controllers, jobs
from vstestbed.experiments.comparison.pools import must_be_known, pool_of
from vstestbed.experiments.comparison.results import finish
from vstestbed.scenario.load import dump, load_plugins

if TYPE_CHECKING:
    import polars

__all__ = ["Campaign", "Comparison", "Controller", "Job", "chosen", "compare", "controllers", "jobs", "must_be_known"]


def compare(
    scenarios: Sequence[str | Path],
    vary: Mapping[str, Sequence[object]] | None = None,
    seeds: int | None = None,
    jobs: int | None = None,
    executor: str = "local",
    out: Path | None = None,
    resume: bool = False,
    set: Mapping[str, object] | None = None,
    plugins: Sequence[str] = (),
    film: bool = True,
    report: bool = True,
    told: Told = lambda job, summary: None,
) -> polars.DataFrame:
    """Run a comparison and leave its folder; the table has one row a run.

    In a script it belongs under `if __name__ == "__main__":`, since worker processes import the script.

    Args:
        scenarios: paths or bundled names; or one comparison, by path or bundled name.
        vary: lists of values by dotted path; every combination is run. seeds: how many; None for the nominal start alone.
        jobs: worker processes; None for as many as there are cores. executor: `local` or `dask://HOST:PORT`.
        out: the folder; None for `runs/compare/<number>`. resume: run only what is missing in `out`.
        set: values by dotted path for all scenarios. plugins: modules that add kinds.
        film: whether to film the first seed. report: whether to write the page and the figures.
        told: hears of every run that is done.

    Raises:
        ScenarioError, ParameterError: bad input, found before anything runs. OutputError: `out` is taken.
        EnvironmentLackError: no OpenGL where a run needs it, no space, no cluster.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):  # a worker that imports the script
        raise ParameterError("compare", "must stand under `if __name__ == '__main__':` in a script, which worker processes import")
    must_be_known(executor)
    campaign, comparison = prepare(scenarios, vary or {}, seeds, out, resume, set or {}, plugins, film)
    return carry_out(campaign, comparison, jobs, executor, told, report=report)


def carry_out(
    campaign: Campaign,
    comparison: Comparison,
    jobs: int | None = None,
    executor: str = "local",
    told: Told = lambda job, summary: None,
    stage: Callable[[str], None] = lambda words: None,
    report: bool = True,
) -> polars.DataFrame:
    """Do what is missing of a comparison, then its table, film and report; `stage` is told what is being done after the runs."""
    try:
        if campaign.missing:
            with closing(pool_of(executor, workers(jobs, len(campaign.missing)))) as pool:
                campaign.run(pool, told)
    finally:
        table = table_of(campaign.folder, campaign.jobs)
        write_table(campaign.folder, table)
    if report:
        finish(campaign.folder, comparison, table, stage)
    return table


def prepare(
    scenarios: Sequence[str | Path],
    vary: Mapping[str, Sequence[object]],
    seeds: int | None,
    out: Path | None,
    resume: bool,
    settings: Mapping[str, object],
    plugins: Sequence[str],
    film: bool,
) -> tuple[Campaign, Comparison]:
    """Check everything, open the folder, write the plan."""
    load_plugins(plugins)
    asked = None
    if scenarios:
        asked = chosen([str(s) for s in scenarios], settings, {path: tuple(values) for path, values in vary.items()}, seeds)
    elif not resume:
        raise ParameterError("SCENARIO", "is missing: name scenarios to compare, or a comparison")
    comparison = read_plan(resumable(out)) if resume else asked
    if comparison is None:
        raise ParameterError("SCENARIO", "is missing: name scenarios to compare, or a comparison")
    found = controllers(comparison)
    if asked is not None and asked is not comparison and _essence(asked, controllers(asked)) != _essence(comparison, found):
        words = "goes on with what the folder compares, which is something else (its `scenarios` are copies); leave the rest out"
        raise ParameterError("--resume", words, str(out))
    folder = new_folder(out) if out is None or not resume else out
    if not resume:
        write_plan(folder, comparison)
    first = 0 if comparison.seeds is not None else None
    filmed = (first,) if film and not comparison.tasks else ()  # a film of a few starts would not show a task
    return Campaign(folder, jobs(found, comparison.seeds), tuple(plugins), filmed), comparison


def _essence(comparison: Comparison, found: list[Controller]) -> tuple[object, ...]:
    """What makes two comparisons the same, wherever their files are."""
    return comparison.seeds, [(tuple(map(dump, c.starts or (c.scenario,))), c.folder, c.runs) for c in found]


def workers(asked: int | None, runs: int) -> int:
    """How many worker processes: as many as asked for, else one a core; no more than there are runs."""
    if asked is not None and asked < 1:
        raise ParameterError("--jobs", "must be 1 or more", asked)
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(asked or cores, runs))


def is_comparison(folder: Path) -> bool:
    """Whether a folder is a comparison's."""
    return (folder / PLAN).is_file()


def report_again(folder: Path) -> Path:
    """Table, film and report of a comparison's folder again, from its runs."""
    comparison = read_plan(folder)
    table = table_of(folder, jobs(controllers(comparison), comparison.seeds))
    write_table(folder, table)
    finish(folder, comparison, table, lambda words: None)
    return folder / "report.html"
