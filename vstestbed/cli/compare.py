"""The command `compare`: scenarios, variations and seeds in parallel. Heavy imports are inside the function."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vstestbed.cli import complete
from vstestbed.cli.ending import INTERRUPTED
from vstestbed.cli.tools import Force, Json, Plugins, SettingsOfAll, settings_of
from vstestbed.core.errors import ParameterError

if TYPE_CHECKING:
    from polars import DataFrame

    from vstestbed.experiments.comparison import Campaign, Comparison

comparing = typer.Typer()


@comparing.command()
def compare(
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(metavar="SCENARIO...", help="Scenarios, or one comparison: names or files.", autocompletion=complete.experiments),
    ] = None,
    vary: Annotated[list[str] | None, typer.Option("--vary", metavar="a.b=v1,v2", help="Run with each of these values.")] = None,
    set_: SettingsOfAll = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="How many random starts. [default: the nominal one]")] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Worker processes. [default: one a core]")] = None,
    executor: Annotated[str, typer.Option(metavar="WHERE", help="local, or dask://HOST:PORT.")] = "local",
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the results. [default: runs/compare/NUMBER]")] = None,
    force: Force = False,
    resume: Annotated[bool, typer.Option("--resume", help="Do what is missing in --out DIR.")] = False,
    film: Annotated[bool, typer.Option("--film/--no-film", help="Film the first seed, side by side.")] = True,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no words.")] = False,
    plugin: Plugins = None,
) -> None:
    """Every scenario, with every value that is varied, from every seed: one table, one report, one film."""
    from vstestbed.cli.progress import show_notes
    from vstestbed.experiments.comparison import must_be_known, prepared

    must_be_known(executor)
    with prepared(scenarios or [], vary_of(vary), seeds, out, resume, settings_of(set_), plugin or [], film, force) as (campaign, plan):
        show_notes(not quiet)
        table = _carried_out(campaign, plan, jobs, executor, shown=not quiet and not as_json)
    if as_json:
        sys.stdout.write(table.write_json() + "\n")
    elif not quiet:
        typer.echo(_summary_text(table, campaign.folder), err=True)


def _carried_out(campaign: Campaign, plan: Comparison, jobs: int | None, executor: str, shown: bool) -> DataFrame:
    """Do the missing runs; an interrupt leaves with the command that goes on."""
    from vstestbed.cli.progress import Counter
    from vstestbed.experiments.comparison import carry_out

    total = len(campaign.jobs)
    try:
        with Counter(total, campaign.done, shown) as counter:
            return carry_out(campaign, plan, jobs, executor, counter.run_done, counter.say)
    except KeyboardInterrupt:
        # counted in the folder: finished runs are there in full, others not at all
        words = f"interrupted: {campaign.done} of {total} runs are done; go on with: vstestbed compare --resume --out {campaign.folder}"
        typer.echo(words, err=True)
        raise typer.Exit(INTERRUPTED) from None


def vary_of(options: list[str] | None) -> dict[str, tuple[object, ...]]:
    """The lists of values of `--vary` by dotted path."""
    return {path: tuple(_values(text)) for path, text in _pairs(options)}


def _pairs(options: list[str] | None) -> list[tuple[str, str]]:
    pairs = []
    for option in options or []:
        path, equals, text = option.partition("=")
        if not equals or not text.strip() or not all(part.strip() for part in path.split(".")):
            raise ParameterError("--vary", "needs the form a.b=v1,v2", option)
        pairs.append((path.strip(), text))
    if len({path for path, _ in pairs}) < len(pairs):
        raise ParameterError("--vary", "names a field twice; put all its values after one =", options)
    return pairs


def _values(text: str) -> list[object]:
    """The values between top-level commas: `1,2`, `[0, 1], [1, 0]`, `{kind: oracle}, blobs`."""
    from vstestbed.scenario.yaml_marks import read_value

    # in brackets it is a YAML list, whose reader knows which commas are inside nested brackets
    found = read_value(f"[{text}]")
    return found if isinstance(found, list) else [found]


def _summary_text(table: DataFrame, folder: Path) -> str:
    from vstestbed.report.comparison.terminal import statistics_text

    done, good = len(table), int(table["success"].sum())
    failed = f"; {done - good} did not reach the goal" if good < done else ""
    statistics = statistics_text(folder)
    return "\n".join(
        filter(None, (f"{good} of {done} runs reached the goal{failed}", statistics, f"  results   {folder} (open report.html)"))
    )
