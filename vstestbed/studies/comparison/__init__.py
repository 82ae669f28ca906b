"""Comparison of controllers: every scenario with every variation from every seed, in parallel; a
table, a report, a film.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl

from vstestbed.core.errors import EnvironmentLackError, OutputError, ParameterError, RunFolderError
from vstestbed.core.files import study_folder, write_json, write_table
from vstestbed.core.planar import block_of
from vstestbed.core.registry import REGISTRIES
from vstestbed.core.shares import at_once
from vstestbed.report.comparison.baseline import FILE
from vstestbed.scenario.dump import check_plugins, dump
from vstestbed.studies.comparison.folder import (
    GROUP,
    Baseline,
    ComparisonTable,
    finish,
    must_have_reference,
    table_of,
)
from vstestbed.studies.comparison.plan import (
    Comparison,
    Job,
    Jobs,
    Variant,
    Variants,
    chosen,
    controllers,
    read_comparison,
)
from vstestbed.studies.comparison.record import (
    PLAN,
    Agreement,
    agreement,
    copied_plan,
    keep,
    moved_plugins,
    must_be_comparison,
    must_be_unchanged,
)
from vstestbed.studies.comparison.runs import OnDone, Runner
from vstestbed.studies.comparison.shards import Shard, Share, gather, must_be_done, must_be_whole
from vstestbed.studies.folder import RESUMABLE, resumed_folder, write_plan
from vstestbed.studies.pools import clear, must_be_known, must_not_be_worker, pool_of, workers

__all__ = [
    "PLAN",
    "Baseline",
    "Campaign",
    "Comparison",
    "ComparisonTable",
    "Job",
    "Jobs",
    "Runner",
    "Shard",
    "Variant",
    "again",
    "asked_for",
    "begun",
    "chosen",
    "compare",
    "controllers",
    "merge",
    "must_be_known",
    "resumed",
    "stored",
]


def compare(
    scenarios: Sequence[str | Path],
    vary: Mapping[str, Sequence[object]] | None = None,
    seeds: int | None = None,
    jobs: int | None = None,
    executor: str = "local",
    out: str | Path | None = None,
    resume: bool = False,
    set: Mapping[str, object] | None = None,
    plugins: Sequence[str] = (),
    film: bool = True,
    report: bool = True,
    on_done: OnDone = lambda job, summary: None,
    force: bool = False,
    baseline: str | Path | None = None,
    limit: int | None = None,
    figures: bool = True,
    primary: str | None = None,
    reference: str | None = None,
    first_seed: int | None = None,
    shard: str | None = None,
) -> ComparisonTable:
    """Run a comparison and write its folder; returns the table with one row per run.

    In a script, call it under `if __name__ == "__main__":`, since worker processes import the
    script.

    Args:
        scenarios: paths or bundled names; or one comparison, by path or bundled name.
        vary: lists of values by dotted path; every combination is run. seeds: number of seeds;
            None: only the nominal start.
        jobs: worker processes; None: one per core. executor: `local`, `warp` (pictures by a device,
            without films), or `dask://HOST:PORT`.
        out: the folder; None: `runs/compare/<number>`. resume: do only the runs that are missing in
            `out`.
        set: values by dotted path for all scenarios. plugins: files or modules that add kinds.
        film: whether to film the first seed. report: whether to write the page.
        on_done: called after every run with the job and its summary. force: allow more than 100,000
            runs.
        baseline: folder, or table, of an earlier comparison: the result's `baseline` then says what
            changed (`BaselineChanges`).
        limit: of each task only so many runs, spread evenly over its list.
        figures: whether to draw the page's figures for a paper as well, as PDF, SVG and PNG in
            `figures/`.
        primary, reference, first_seed: as of `Comparison`.
        shard: only one of some equal shares of the runs, `3/64` the third of 64, in an `out` of its
            own; `merge` puts them together.

    Raises ScenarioError, ParameterError: bad input, found before anything runs. RunFolderError: the
    baseline is no comparison, or has none of these runs. OutputError: `out` is taken, or another
    process writes into it. EnvironmentLackError: no OpenGL where a run needs it, no space, no
    cluster.
    """
    must_not_be_worker("compare")
    must_be_known(executor)
    folder = None if out is None else Path(out)
    earlier = None if baseline is None else Baseline.read(baseline)
    share = None if shard is None else Shard.read(shard)
    fields = {
        "seeds": seeds,
        "limit": limit,
        "primary": primary,
        "reference": reference,
        "first_seed": first_seed,
    }
    asked = asked_for(scenarios, vary or {}, set or {}, plugins, fields)
    if resume:
        ready = resumed(folder, asked, plugins, film=film, force=force, shard=share)
    else:
        ready = begun(asked, folder, film=film, force=force, baseline=earlier, shard=share)
    with ready as campaign:
        campaign.baseline = earlier
        return campaign.carry_out(jobs, executor, on_done, report=report, figures=figures)


def asked_for(
    scenarios: Sequence[str | Path],
    vary: Mapping[str, Sequence[object]],
    settings: Mapping[str, object],
    plugins: Sequence[str],
    fields: Mapping[str, Any],
) -> Comparison | None:
    """The comparison of scenarios, or one by its name, with these settings, varied values and
    fields, as of `chosen`; None where none is named.
    """
    if not scenarios:
        return None
    plain = {path: block_of(value) for path, value in settings.items()}
    axes = {path: tuple(map(block_of, values)) for path, values in vary.items()}
    return chosen([str(name) for name in scenarios], plain, axes, plugins, **fields)


@dataclass
class Campaign:
    """A comparison that is flown into its folder.

    runner: does its runs, or those of a shard. baseline: an earlier one, for what has changed.
    """

    runner: Runner
    comparison: Comparison
    baseline: Baseline | None = None

    def carry_out(
        self,
        jobs: int | None = None,
        executor: str = "local",
        on_done: OnDone = lambda job, summary: None,
        stage: Callable[[str], None] = lambda words: None,
        report: bool = True,
        figures: bool = True,
    ) -> ComparisonTable:
        """Do the missing runs, then table, film and report; `stage` is called with what is being
        done after the runs. A shard has a table alone. Raises EnvironmentLackError, OutputError: as
        of `compare`; or stored runs are gone: there is no result.
        """
        runner, folder = self.runner, self.runner.folder
        with ExitStack() as stack:
            pool = None
            try:
                if left := len(runner.jobs) - runner.done:
                    pool = pool_of(executor, workers(jobs, left), folder, runner.scenarios)
                    stack.enter_context(closing(pool))
                    runner.run(pool, on_done)
                else:
                    clear(folder)  # of a process that was killed while it wrote the report
            finally:  # also an interrupted comparison has its table
                table = table_of(folder, runner.jobs)
                write_table(folder / "comparison", table, GROUP)
            self._must_have_all(table)
            changes = None
            if self.baseline is not None:
                changes = self.baseline.changes(self.comparison, table, folder)
                write_json(folder / FILE, changes.plain())  # before the page, which reads it
            if report and Shard.in_folder(folder).of == 1:
                call = at_once if pool is None else pool.call
                finish(folder, self.comparison, table, stage, call, figures)
        return ComparisonTable.of(table, folder, self.comparison, changes)

    def _must_have_all(self, table: pl.DataFrame) -> None:
        """OutputError: runs that were stored are not there any more."""
        total = len(self.runner.jobs)
        if lost := total - len(table):
            words = (
                f"{lost} of {total} runs are not there any more,"
                " though each was stored when it was done"
            )
            advice = "see what else writes there, then do them again with --resume"
            raise OutputError(self.runner.folder, words, advice, EnvironmentLackError.exit_code)


def again(
    place: Path,
    out: Path | None = None,
    jobs: int | None = None,
    executor: str = "local",
    on_done: OnDone = lambda job, summary: None,
) -> tuple[Path, Agreement]:
    """Fly a comparison's folder again, in a new one (`out`), with the copies of its files; the new
    folder, and whether both agree.
    Raises RunFolderError: a file is not what flew. ParameterError: `place` is no comparison; others
    as of `compare`.
    """
    must_be_comparison(place)
    with study_folder("compare", out) as folder:
        copied_plan(place, folder)
        keep(folder)
    with resumed(folder, film=False, force=True) as campaign:
        table = campaign.carry_out(jobs, executor, on_done, report=False)
    return folder, agreement(pl.read_parquet(place / "comparison.parquet"), table)


def merge(
    places: Sequence[Path],
    out: Path | None = None,
    stage: Callable[[str], None] = lambda words: None,
    figures: bool = True,
) -> ComparisonTable:
    """Put the shards of a comparison together into a new folder (`out`): the same runs, table and
    page as by one process.

    The runs are links to the shards' files where the file system has them. Raises RunFolderError: a
    folder is no shard of this comparison, shards or runs are missing. OutputError: `out` is taken.
    """
    must_be_whole(places)
    comparison = read_comparison(places[0] / PLAN, moved_plugins(places[0], ()))
    jobs = Jobs(controllers(comparison, force=True), comparison.seeds, comparison.first_seed)
    must_be_done(places, jobs)
    with study_folder("compare", out) as folder:
        stage("linking the runs")
        gather(places, folder)
        return Campaign(Runner(folder, jobs), comparison).carry_out(stage=stage, figures=figures)


@contextmanager
def begun(
    asked: Comparison | None,
    out: Path | None,
    film: bool = True,
    force: bool = False,
    baseline: Baseline | None = None,
    shard: Shard | None = None,
) -> Iterator[Campaign]:
    """Check everything, make the folder, write the plan; the folder is held until the block ends.
    baseline: must have runs of it. shard: only this share of it. Errors as of `compare`.
    """
    _must_name_folder(shard, out)
    if asked is None:
        raise ParameterError.missing("SCENARIO", "name scenarios to compare, or a comparison")
    # before the folder is made: bad input leaves no folder
    found = controllers(asked, force)
    _check_workers_find(found)
    must_have_reference(asked, found)
    share = shard or Shard()
    every = Share(Jobs(found, asked.seeds, asked.first_seed), share)
    if baseline is not None:
        baseline.must_match(asked, every)
    with study_folder("compare", out, RESUMABLE) as folder:
        write_plan(folder / PLAN, asked, "base")
        share.keep(folder)
        keep(folder)
        yield Campaign(Runner(folder, every, _filmed(asked, film)), asked, baseline)


@contextmanager
def resumed(
    out: Path | None,
    asked: Comparison | None = None,
    plugins: Sequence[str] = (),
    film: bool = True,
    force: bool = False,
    shard: Shard | None = None,
) -> Iterator[Campaign]:
    """Open the folder of a comparison that was begun; it is held until the block ends. asked,
    shard: where they are given, those of the folder. plugins: besides those that it remembers.
    """
    _must_name_folder(shard, out)
    with resumed_folder("compare", out, PLAN) as folder:
        must_be_unchanged(folder, plugins)
        comparison, found = _resumed(folder, asked, force, plugins)
        there = Shard.in_folder(folder)
        if shard is not None and shard != there:
            raise ParameterError(
                "--resume",
                f"goes on with shard {there} of what the folder compares; leave --shard out",
                str(folder),
            )
        every = Share(Jobs(found, comparison.seeds, comparison.first_seed), there)
        yield Campaign(Runner(folder, every, _filmed(comparison, film)), comparison)


def _must_name_folder(shard: Shard | None, out: Path | None) -> None:
    if shard is not None and out is None:
        raise ParameterError.needs("--shard", "a folder of its own", why="--out DIR")


def _filmed(comparison: Comparison, film: bool) -> tuple[int | None, ...]:
    """The seeds of the film: the first one; a film of a few starts would not show a task."""
    if not film or comparison.tasks:
        return ()
    return (None if comparison.seeds is None else comparison.first_seed,)


def _check_workers_find(found: Variants) -> None:
    """Refuse kinds that are defined in a notebook alone, which no worker process can read; a
    script's are imported by workers.
    """
    typed_in = not hasattr(sys.modules["__main__"], "__file__")
    if typed_in and any(
        cls.__module__ == "__main__" for room in REGISTRIES for cls in room.members.values()
    ):
        for variant in found:
            check_plugins(variant.scenario)


def _resumed(
    folder: Path, requested: Comparison | None, force: bool, plugins: Sequence[str]
) -> tuple[Comparison, Variants]:
    """The comparison of a folder with its controllers."""
    comparison = read_comparison(folder / PLAN, plugins)
    found = controllers(comparison, force)
    if requested is not None and not _same(
        requested, controllers(requested, force), comparison, found
    ):
        problem = (
            "goes on with what the folder compares,"
            " which is something else (its `scenarios` are copies); leave the rest out"
        )
        raise ParameterError("--resume", problem, str(folder))
    return comparison, found


def _same(a: Comparison, of_a: Variants, b: Comparison, of_b: Variants) -> bool:
    """Whether two comparisons are equal, wherever their files are: in seeds, scenarios as loaded,
    folders of the runs.
    """

    def essence(c: Variant) -> tuple[object, ...]:
        return tuple(dump(s, defaults=True) for s in c.starts or [c.scenario]), c.folder, c.runs

    if (a.seeds, a.first_seed, a.limit) != (b.seeds, b.first_seed, b.limit):
        return False
    if len(of_a) != len(of_b):
        return False
    return all(essence(x) == essence(y) for x, y in zip(of_a, of_b, strict=True))


def report_again(folder: Path, plugins: Sequence[str] = (), figures: bool = True) -> Path:
    """Make table, film and report of a comparison's folder again from its runs; also of a shard.
    plugins: besides those that it remembers. figures: as of `compare`.
    """
    comparison, table, _ = stored(folder, plugins)
    write_table(folder / "comparison", table, GROUP)
    finish(folder, comparison, table, lambda words: None, paper=figures)
    return folder / "report.html"


def stored(folder: Path, plugins: Sequence[str] = ()) -> tuple[Comparison, pl.DataFrame, int]:
    """The comparison of a folder, the table of its finished runs, and how many there are to be;
    plugins: see `report_again`.
    """
    comparison = read_comparison(folder / PLAN, (*plugins, *moved_plugins(folder, plugins)))
    every = Share(
        Jobs(controllers(comparison, force=True), comparison.seeds, comparison.first_seed),
        Shard.in_folder(folder),
    )
    # A damaged run is named, and not left out as if it were still to come.
    table = table_of(folder, every, damaged=False)
    if table.is_empty():
        raise RunFolderError(
            folder,
            "has no finished run",
            f"`vstestbed compare --resume --out {folder}` does what is missing",
        )
    return comparison, table, len(every)
