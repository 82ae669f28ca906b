"""The command `sweep`: share of converged runs over two varied fields. Heavy imports are inside the function."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vstestbed.cli.ending import INTERRUPTED
from vstestbed.cli.tools import Experiments, Force, Json, Plugins, SettingsOfAll, renamed, settings_of

if TYPE_CHECKING:
    from vstestbed.experiments.comparison import Job
    from vstestbed.experiments.convergence import Ended, RunEnding, Study

convergences = typer.Typer()


@convergences.command("sweep")
def sweep(
    scenarios: Experiments,
    vary: Annotated[list[str] | None, typer.Option("--vary", metavar="a.b=v1,v2", help="A map's axis: first x, then y.")] = None,
    set_: SettingsOfAll = None,
    seeds: Annotated[int | None, typer.Option(min=1, help="How many random starts in each cell.")] = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Worker processes. [default: one a core]")] = None,
    out: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder of the results. [default: runs/sweep/NUMBER]")] = None,
    force: Force = False,
    as_json: Json = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No words.")] = False,
    plugin: Plugins = None,
) -> None:
    """How many seeds reach the goal over two varied fields, one map a law; runs leave no folders of their own."""
    from vstestbed.cli.compare import vary_of
    from vstestbed.core.folders import study_folder
    from vstestbed.experiments.comparison import chosen
    from vstestbed.experiments.convergence import Study, summaries

    study = Study(chosen(scenarios, settings_of(set_), vary_of(vary), seeds, plugin or []), force)
    shown, command = not (quiet or as_json), shlex.join(["vstestbed", *sys.argv[1:]]) if len(sys.argv) > 1 else ""
    with study_folder("sweep", out) as folder:
        ended = _carried_out(study, folder, jobs, shown, command)
    if as_json:
        sys.stdout.write(study.table(ended).write_json() + "\n")
    elif not quiet:
        for one in summaries(study.maps(ended)):
            typer.echo(f"{one['label']}: {100 * float(str(one['converged'])):.1f} % of all runs converged", err=True)
        typer.echo(f"  results   {folder} (open report.html)", err=True)


def _carried_out(study: Study, folder: Path, jobs: int | None, shown: bool, command: str) -> Ended:
    """Do all runs and write the folder; an interrupted sweep has the map of the runs that are done."""
    from vstestbed.experiments.convergence import write

    found: dict[int, tuple[Job, RunEnding]] = {}
    total = len(study.runs)

    def done(place: int, job: Job, ending: RunEnding) -> None:
        found[place] = job, ending
        # a line every 100 runs: a run takes some 50 ms
        if shown and (len(found) == total or len(found) % 100 == 0):
            typer.echo(f"{len(found)} of {total} runs", err=True)

    ended: Ended = ()
    try:
        study.run_all(folder, jobs, done)
    except KeyboardInterrupt:
        words = f"; their map is in {folder} (open report.html)" if found else ""
        typer.echo(f"interrupted: {len(found)} of {total} runs are done{words}", err=True)
        raise typer.Exit(INTERRUPTED) from None
    finally:
        if found:
            ended = [found[place] for place in sorted(found)]
            write(folder, study, ended, command)
    return ended


renamed(convergences, "convergence", "sweep", sweep)
