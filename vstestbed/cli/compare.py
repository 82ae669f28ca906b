"""The commands `compare`, `suite` and `submit`: runs in parallel, and what they conclude. Heavy
imports are inside the functions.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vstestbed.cli import complete
from vstestbed.cli.ending import INTERRUPTED, REGRESSED
from vstestbed.cli.options import Force, Json, Plugins, SettingsOfAll, settings_of, vary_of
from vstestbed.core.errors import ParameterError

if TYPE_CHECKING:
    from polars import DataFrame

    from vstestbed.report.comparison.baseline import BaselineChanges
    from vstestbed.studies.comparison import Campaign, Comparison
    from vstestbed.studies.comparison.folder import ComparisonTable


def compare(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SCENARIO...",
            help="Scenarios, or one comparison: names or files.",
            autocompletion=complete.experiments,
        ),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option("--vary", metavar="a.b=v1,v2", help="Run with each of these values."),
    ] = None,
    set_: SettingsOfAll = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, help="How many random starts. [default: the nominal one]")
    ] = None,
    first_seed: Annotated[
        int | None, typer.Option(min=0, help="The first of their numbers. [default: 0]")
    ] = None,
    limit: Annotated[
        int | None,
        typer.Option(min=1, help="Of each task only so many starts, spread over its list."),
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Worker processes. [default: one a core]")
    ] = None,
    executor: Annotated[
        str,
        typer.Option(metavar="WHERE", help="local, warp (a graphics card), or dask://HOST:PORT."),
    ] = "local",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the results. [default: runs/compare/NUMBER]"),
    ] = None,
    force: Force = False,
    resume: Annotated[
        bool, typer.Option("--resume", help="Do what is missing in --out DIR.")
    ] = False,
    again: Annotated[
        bool,
        typer.Option(
            "--again", help="Fly a comparison's folder, the argument, again: do its runs agree?"
        ),
    ] = False,
    shard: Annotated[
        str | None,
        typer.Option(metavar="I/N", help="Only share I of N of the runs, for an array of jobs."),
    ] = None,
    merge: Annotated[
        bool, typer.Option("--merge", help="Put the shards, the arguments, together.")
    ] = False,
    film: Annotated[
        bool, typer.Option("--film/--no-film", help="Film the first seed, side by side.")
    ] = True,
    baseline: Annotated[
        Path | None,
        typer.Option(metavar="OLD", help="An earlier comparison: what changed since, run by run."),
    ] = None,
    fail: Annotated[
        bool,
        typer.Option("--fail-on-regression", help="Exit with 5 where it is worse than --baseline."),
    ] = False,
    tolerance: Annotated[
        float | None,
        typer.Option(
            min=0, metavar="SHARE", help="By how much a mean may be worse. [default: 0.02]"
        ),
    ] = None,
    figures: Annotated[
        bool,
        typer.Option(
            "--figures/--no-figures", help="The page's figures for a paper, too: PDF, SVG, PNG."
        ),
    ] = True,
    primary: Annotated[
        str | None,
        typer.Option(
            metavar="METRIC",
            help=(
                "What decides beside success. [default: time to the goal, failures at their limit]"
            ),
        ),
    ] = None,
    reference: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Compare each with this one. [default: all pairs]"),
    ] = None,
    plan: Annotated[
        bool,
        typer.Option("--plan", help="Fly nothing: say how many starts it needs for a verdict."),
    ] = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no words.")] = False,
    plugin: Plugins = None,
) -> None:
    """Every scenario, with every value that is varied, from every seed: one table, one report, one
    film.
    """
    from vstestbed.report.comparison.baseline import TOLERANCE
    from vstestbed.studies.comparison import (
        Baseline,
        Shard,
        asked_for,
        begun,
        must_be_known,
        resumed,
    )

    must_be_known(executor)
    places = [Path(name) for name in scenarios or []]
    shown = not quiet and not as_json
    if again:
        _again(places, out, jobs, executor, not quiet)
        return
    if merge:
        _merge(places, out, figures, as_json, quiet)
        return
    if baseline is None and (fail or tolerance is not None):
        option = "--fail-on-regression" if fail else "--tolerance"
        raise ParameterError.needs(
            option, "the earlier results", why="--baseline OLD, a comparison's folder"
        )
    before = None if baseline is None else Baseline.read(baseline)
    fields = {
        "seeds": seeds,
        "limit": limit,
        "primary": primary,
        "reference": reference,
        "first_seed": first_seed,
    }
    asked = asked_for(scenarios or [], vary_of(vary), settings_of(set_), plugin or [], fields)
    if plan and asked is not None:
        typer.echo("\n".join(_plan_lines(asked, force)))
        return
    share = None if shard is None else Shard.read(shard)
    if resume:
        ready = resumed(out, asked, plugin or [], film=film, force=force, shard=share)
    else:
        ready = begun(asked, out, film=film, force=force, baseline=before, shard=share)
    with ready as campaign:
        campaign.baseline = before
        table = _flown(campaign, jobs, executor, figures, quiet, shown)
    _tell(table, as_json, quiet)
    if table.baseline is not None:
        _tell_changes(table.baseline, TOLERANCE if tolerance is None else tolerance, fail, shown)


def _flown(
    campaign: Campaign,
    jobs: int | None,
    executor: str,
    figures: bool,
    quiet: bool,
    shown: bool,
) -> ComparisonTable:
    """Fly what is missing; Ctrl-C ends it with a word on how to go on."""
    from vstestbed.cli.progress import Counter, show_notes

    show_notes(not quiet)
    runner = campaign.runner
    total = len(runner.jobs)
    try:
        with Counter(total, runner.done, shown) as counter:
            return campaign.carry_out(
                jobs, executor, counter.run_done, counter.say, figures=figures
            )
    except KeyboardInterrupt:
        # counted in the folder: finished runs are there in full, others not at all
        words = (
            f"interrupted: {runner.done} of {total} runs are done;"
            f" go on with: vstestbed compare --resume --out {runner.folder}"
        )
        typer.echo(words, err=True)
        raise typer.Exit(INTERRUPTED) from None


def _plan_lines(asked: Comparison, force: bool) -> Iterator[str]:
    """How many starts a comparison needs, and how many it plans."""
    from vstestbed.report.comparison.pairs import has_every_pair
    from vstestbed.report.comparison.planning import plan_lines
    from vstestbed.studies.comparison import controllers

    variants = controllers(asked, force)
    laws = len(variants) // len(variants.task_runs)
    pairs = math.comb(laws, 2) if has_every_pair(laws, asked.reference) else laws - 1
    limit = min(variant.scenario.stop.duration_s for variant in variants)
    starts = sum(map(len, filter(None, variants.task_runs))) or asked.seeds
    return plan_lines(laws, pairs, limit, starts, asked.margin)


def _tell(table: ComparisonTable, as_json: bool, quiet: bool) -> None:
    """The runs as JSON, or what the comparison has found, in words."""
    if as_json:
        sys.stdout.write(_as_json(table) + "\n")
    elif not quiet:
        typer.echo(_summary_text(table, table.folder), err=True)


def _as_json(table: ComparisonTable) -> str:
    """The runs, the verdicts as they stand in `verdicts.json`, and the changes against a baseline
    where one was given.
    """
    from vstestbed.report.comparison.records import VERDICTS

    parts = {"runs": table.write_json()}
    if (table.folder / VERDICTS).is_file():
        parts["verdicts"] = (table.folder / VERDICTS).read_text(encoding="utf-8")
    if table.baseline is not None:
        parts["baseline"] = json.dumps(table.baseline.plain())
    return "{" + ", ".join(f'"{name}": {text.strip()}' for name, text in parts.items()) + "}"


def _tell_changes(changes: BaselineChanges, tolerance: float, fail: bool, shown: bool) -> None:
    """Say what changed against the baseline;
    exit 5 where something got worse and that is to fail.
    """
    from vstestbed.report.comparison.baseline import text

    worse = [f"worse: {words}" for words in changes.regressions(tolerance)]
    # the reason for 5 is always told
    lines = [text(changes), *(worse or ["nothing got worse"])] if shown else worse * fail
    for line in lines:
        typer.echo(line, err=True)
    if fail and worse:
        raise typer.Exit(REGRESSED)


def _merge(places: list[Path], out: Path | None, figures: bool, as_json: bool, quiet: bool) -> None:
    """Put shards together, and say what a comparison says."""
    from vstestbed.cli.progress import show_notes
    from vstestbed.studies.comparison import merge

    if not places:
        raise ParameterError.missing("--merge", "name the shards' folders, e.g. shards/*")
    show_notes(not quiet)
    table = merge(
        places,
        out,
        (lambda words: None)
        if quiet or as_json
        else lambda words: typer.echo(f"{words} ...", err=True),
        figures,
    )
    _tell(table, as_json, quiet)


def _again(
    places: list[Path], out: Path | None, jobs: int | None, executor: str, shown: bool
) -> None:
    """Fly a folder again, and say which rows agree; exit 5 where some do not."""
    import polars as pl

    from vstestbed.cli.progress import Counter
    from vstestbed.studies.comparison import again
    from vstestbed.studies.comparison.record import must_be_comparison

    if len(places) != 1:
        raise ParameterError.count(
            "--again", "one", "folder of a comparison, as the argument", list(map(str, places))
        )
    must_be_comparison(places[0])
    with Counter(
        pl.scan_parquet(places[0] / "comparison.parquet").select(pl.len()).collect().item(),
        0,
        shown,
    ) as counter:
        folder, found = again(places[0], out, jobs, executor, counter.run_done)
    for line in (*found.lines(), f"  results   {folder}"):
        typer.echo(line, err=True)
    if found.differ:
        raise typer.Exit(REGRESSED)


def _summary_text(table: DataFrame, folder: Path) -> str:
    from vstestbed.report.comparison.tables import statistics_text

    done, good = len(table), int(table["success"].sum())
    reached = (
        f"{good} of {done} runs reached the"
        f" goal{f'; {done - good} did not reach the goal' if good < done else ''}"
    )
    opened = " (open report.html)" if (folder / "report.html").exists() else ""
    return "\n".join(
        filter(None, (reached, statistics_text(folder), f"  results   {folder}{opened}"))
    )
