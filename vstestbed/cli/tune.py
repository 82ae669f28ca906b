"""The command `tune`: search for the settings with which a scenario does best. Heavy imports are inside the function."""

from __future__ import annotations

import json
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vstestbed.cli import complete
from vstestbed.cli.ending import INTERRUPTED, NOT_REACHED
from vstestbed.cli.tools import Json, Plugins, Settings, settings_of
from vstestbed.core.errors import ParameterError

if TYPE_CHECKING:
    from vstestbed.experiments.tuning import Search
    from vstestbed.experiments.tuning.result import TuningResult

tunings = typer.Typer()
RANGES = "A range LOW:HIGH or LOW:HIGH:log, or values to choose from; may be repeated."


@tunings.command()
def tune(
    scenario: Annotated[
        str | None, typer.Argument(help="A bundled scenario's name, or a YAML file.", autocompletion=complete.scenarios)
    ] = None,
    vary: Annotated[list[str] | None, typer.Option("--vary", metavar="a.b=LOW:HIGH", help=RANGES, autocompletion=complete.paths)] = None,
    metric: Annotated[
        str, typer.Option(metavar="NAME", help="Number of summary.json; less is better.", autocompletion=complete.figures)
    ] = "time_to_converge_s",
    maximise: Annotated[bool, typer.Option("--maximise", help="More of the metric is better. [default: as is known of it]")] = False,
    trials: Annotated[int | None, typer.Option(min=1, max=1000, help="How many settings are tried. [default: 30]")] = None,
    seeds: Annotated[int | None, typer.Option(min=1, max=1000, help="Random starts of each trial. [default: 10]")] = None,
    batch: Annotated[int, typer.Option(min=1, max=1000, help="Trials that are chosen together; more use more cores.")] = 4,
    check: Annotated[int, typer.Option(min=0, max=1000, help="Fresh starts on which the best is checked.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the search.")] = 0,
    set_: Settings = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Worker processes. [default: one a core]")] = None,
    executor: Annotated[str, typer.Option(metavar="WHERE", help="local, or dask://HOST:PORT.")] = "local",
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the results. [default: runs/tune/NUMBER]")] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on with the search in --out DIR; --trials may be more.")] = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no words.")] = False,
    plugin: Plugins = None,
) -> None:
    """The settings with which a scenario does best: a search over ranges and choices, each trial from the same random starts."""
    from vstestbed.cli.progress import show_notes
    from vstestbed.experiments.comparison import must_be_known
    from vstestbed.experiments.tuning import begun, planned

    must_be_known(executor)
    plan, settings = None, settings_of(set_)
    if not resume:
        numbers = (trials or 30, seeds, batch, check, seed)
        plan = planned(scenario, ranges_of(vary), metric, maximise or None, *numbers, settings, plugin or [])
    elif any((scenario, vary, settings)):
        raise ParameterError("--resume", "goes on with what the folder searches; leave the rest out, but for --trials")
    with begun(plan, out, trials, plugin or []) as search:
        show_notes(not quiet)
        search.jobs, search.executor = jobs, executor
        result = _finished(search, shown=not quiet and not as_json)
    _tell(result, as_json, quiet)
    if result.best is None:
        raise typer.Exit(NOT_REACHED)


def _tell(result: TuningResult, as_json: bool, quiet: bool) -> None:
    if as_json:
        sys.stdout.write(json.dumps(result.plain(), indent=1) + "\n")
    elif not quiet:
        typer.echo(_text(result), err=True)


def ranges_of(options: list[str] | None) -> dict[str, tuple[object, ...]]:
    """What is varied by `--vary`, by dotted path: values, or a range in one text."""
    from vstestbed.cli.compare import vary_of

    return vary_of(options)


def _finished(search: Search, shown: bool) -> TuningResult:
    """Do the search; an interrupt leaves with the command that goes on."""
    from vstestbed.cli.progress import Counter
    from vstestbed.experiments.tuning import finished

    try:
        with Counter(search.total, 0, shown) as counter:
            search.listener = counter
            return finished(search)
    except KeyboardInterrupt:
        words = f"interrupted: {len(search.trials)} of {search.plan.trials} trials are done; go on with: "
        typer.echo(f"{words}vstestbed tune --resume --out {shlex.quote(str(search.folder))}", err=True)
        raise typer.Exit(INTERRUPTED) from None


def _text(result: TuningResult) -> str:
    lines = [result.headline, *(f"  {words}" for words in result.sentences())]
    lines += [f"  take it   {result.command}"] if result.best else []
    return "\n".join([*lines, f"  results   {result.folder} (open report.html)"])
