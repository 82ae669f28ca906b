"""The command `sweep`: share of converged runs over two varied fields. Heavy imports are inside the function."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from vstestbed.cli.tools import Experiments, Force, Json, Plugins, SettingsOfAll, renamed, settings_of

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
    from vstestbed.experiments.convergence import Study, summaries, write

    study = Study(chosen(scenarios, settings_of(set_), vary_of(vary), seeds, plugin or []), force)
    shown = not (quiet or as_json)

    def progress(done: int, of: int) -> None:
        # a line every 100 runs: a run takes some 50 ms
        if shown and (done == of or done % 100 == 0):
            typer.echo(f"{done} of {of} runs", err=True)

    with study_folder("sweep", out) as folder:
        results = study.run_all(jobs, progress)
        page = write(folder, study, results, shlex.join(["vstestbed", *sys.argv[1:]]) if len(sys.argv) > 1 else "")
    if as_json:
        sys.stdout.write(study.table(results).write_json() + "\n")
    elif not quiet:
        for one in summaries(study.maps(results)):
            typer.echo(f"{one['label']}: {100 * float(str(one['converged'])):.1f} % of all runs converged", err=True)
        typer.echo(f"  results   {page.parent} (open report.html)", err=True)


renamed(convergences, "convergence", "sweep", sweep)
