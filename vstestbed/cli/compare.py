"""The command `compare`: runs in parallel, and what they conclude."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from vstestbed.cli import complete
from vstestbed.cli.options import Force, Json, Plugins, Quiet, SettingsOfAll, settings_of, vary_of
from vstestbed.core.errors import ParameterError


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
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """Every scenario, with every value that is varied, from every seed: one table, one report, one
    film.
    """
    from vstestbed.cli import comparing
    from vstestbed.studies import comparison as study

    study.must_be_known(executor)
    places = [Path(name) for name in scenarios or []]
    shown = not quiet and not as_json
    if again:
        comparing.again(places, out, jobs, executor, not quiet)
        return
    if merge:
        comparing.merge(places, out, figures, as_json, quiet)
        return
    if baseline is None and (fail or tolerance is not None):
        option = "--fail-on-regression" if fail else "--tolerance"
        raise ParameterError.needs(
            option, "the earlier results", why="--baseline OLD, a comparison's folder"
        )
    before = None if baseline is None else study.Baseline.read(baseline)
    fields = {
        "seeds": seeds,
        "limit": limit,
        "primary": primary,
        "reference": reference,
        "first_seed": first_seed,
    }
    asked = study.asked_for(scenarios or [], vary_of(vary), settings_of(set_), plugin or [], fields)
    if plan and asked is not None:
        typer.echo("\n".join(comparing.lines_of_plan(asked, force)))
        return
    share = None if shard is None else study.Shard.read(shard)
    if resume:
        ready = study.resumed(out, asked, plugin or [], film=film, force=force, shard=share)
    else:
        ready = study.begun(asked, out, film=film, force=force, baseline=before, shard=share)
    with ready as campaign:
        campaign.baseline = before
        table = comparing.flown(campaign, jobs, executor, figures, quiet, shown)
    comparing.tell(table, as_json, quiet)
    if table.baseline is not None:
        comparing.tell_changes(table.baseline, tolerance, fail, shown)
