"""The command `tune`. Heavy imports are inside the functions."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from vstestbed.cli import complete
from vstestbed.cli.ending import INTERRUPTED, NOT_REACHED
from vstestbed.cli.options import (
    Json,
    Plugins,
    Settings,
    settings_of,
    vary_of,
)
from vstestbed.cli.results import RESULTS, tell
from vstestbed.core.errors import ParameterError

RANGES = (
    "A range LOW:HIGH or LOW:HIGH:log, or values to choose from; may be repeated."
    " [default: all gains, of a comparison]"
)


def tune(
    scenario: Annotated[
        str | None,
        typer.Argument(
            help=(
                "A scenario, or a comparison, each law of which is tuned before: a name or a file."
            ),
            autocompletion=complete.experiments,
        ),
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option("--vary", metavar="a.b=LOW:HIGH", help=RANGES, autocompletion=complete.paths),
    ] = None,
    metric: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Number of summary.json; less is better.",
            autocompletion=complete.figures,
        ),
    ] = "time_to_converge_s",
    maximise: Annotated[
        bool,
        typer.Option(
            "--maximise", help="More of the metric is better. [default: as is known of it]"
        ),
    ] = False,
    trials: Annotated[
        int | None, typer.Option(min=1, max=1000, help="How many settings are tried. [default: 30]")
    ] = None,
    seeds: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Random starts of each trial. [default: 10]")
    ] = None,
    batch: Annotated[
        int,
        typer.Option(min=1, max=1000, help="Trials that are chosen together; more use more cores."),
    ] = 4,
    check: Annotated[
        int, typer.Option(min=0, max=1000, help="Fresh starts on which the best is checked.")
    ] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.")] = 0,
    set_: Settings = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Worker processes. [default: one a core]")
    ] = None,
    executor: Annotated[
        str,
        typer.Option(metavar="WHERE", help="local, warp (a graphics card), or dask://HOST:PORT."),
    ] = "local",
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the results. [default: runs/tune/NUMBER]"),
    ] = None,
    resume: Annotated[
        bool,
        typer.Option("--resume", help="Go on with the search in --out DIR; --trials may be more."),
    ] = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no words.")] = False,
    plugin: Plugins = None,
) -> None:
    """The settings with which a scenario does best: a search over ranges and choices, each trial
    from the same random starts.
    """
    from vstestbed.apps.tune.tuned import names_comparison
    from vstestbed.apps.tune.tuning import begun, finished, planned
    from vstestbed.cli.progress import Counter, show_notes
    from vstestbed.studies.comparison import must_be_known

    must_be_known(executor)
    plan, settings = None, settings_of(set_)
    numbers = {"trials": trials or 30, "seeds": seeds, "batch": batch, "check": check, "seed": seed}
    if names_comparison(scenario) and not resume:
        numbers |= {"metric": metric, "maximise": maximise or None}
        _tune_comparison(
            str(scenario),
            vary_of(vary),
            out,
            settings,
            plugin or [],
            jobs,
            executor,
            quiet,
            numbers,
        )
        return
    if not resume:
        plan = planned(
            scenario,
            vary_of(vary),
            settings,
            plugin or [],
            metric=metric,
            maximise=maximise or None,
            **numbers,
        )
    elif any((scenario, vary, settings)):
        raise ParameterError(
            "--resume",
            "goes on with what the folder searches; leave the rest out, but for --trials",
        )
    with begun(plan, out, trials, plugin or []) as search:
        show_notes(not quiet)
        search.jobs, search.executor = jobs, executor
        try:
            with Counter(search.total, 0, not quiet and not as_json) as counter:
                search.listener = counter
                result = finished(search)
        except KeyboardInterrupt:
            words = (
                f"interrupted: {len(search.trials)} of {search.plan.trials} trials"
                " are done; go on with: "
            )
            typer.echo(
                f"{words}vstestbed tune --resume --out {shlex.quote(str(search.folder))}", err=True
            )
            raise typer.Exit(INTERRUPTED) from None
    lines = [result.headline, *(f"  {words}" for words in result.sentences())]
    lines += [f"  take it   {result.command}"] if result.best else []
    tell(as_json, quiet, result.plain, lambda: "\n".join([*lines, RESULTS.format(result.folder)]))
    if result.best is None:
        raise typer.Exit(NOT_REACHED)


def _tune_comparison(
    name: str,
    vary: dict[str, tuple[object, ...]],
    out: Path | None,
    settings: dict[str, object],
    plugins: list[str],
    jobs: int | None,
    executor: str,
    quiet: bool,
    numbers: dict[str, Any],
) -> None:
    """Tune each law of a comparison, then compare them."""
    from vstestbed.apps.tune.tuned import tune_comparison
    from vstestbed.core.files import study_folder
    from vstestbed.report.comparison.tables import statistics_text

    def say(words: str) -> None:
        if not quiet:
            typer.echo(words, err=True)

    with study_folder("tune", out) as folder:
        table, laws = tune_comparison(
            name, vary, folder, settings, plugins, jobs, executor, say=say, **numbers
        )
    for law in laws:
        say(f"  {law.words()}")
    say("\n".join(filter(None, (statistics_text(table.folder), RESULTS.format(table.folder)))))
