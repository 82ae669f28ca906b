"""The command `export`: runs for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from vstestbed.cli.options import Plugins, Quiet
from vstestbed.cli.progress import ProgressBar, show_notes
from vstestbed.core import files
from vstestbed.core.apps import loaded, offered
from vstestbed.core.errors import OutputError, ParameterError

if TYPE_CHECKING:
    from vstestbed.report.recorded_run import ExportFormat

    Format = str
else:
    Format = Literal[tuple(offered("exports"))]
Only = Literal["all", "successes"]


def export(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A run's folder, or a comparison's.")
    ],
    to: Annotated[
        Format,
        typer.Option(
            "--to",
            help=(
                "mcap: Foxglove, PlotJuggler, rerun. rosbag2: ROS 2."
                " lerobot: a dataset v3.0. csv: tables."
            ),
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="A new file or folder. [default: beside DIR]"),
    ] = None,
    only: Annotated[
        Only,
        typer.Option("--only", help="Of a comparison all runs, or the successes: demonstrations."),
    ] = "all",
    task: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT",
            help="lerobot: what all episodes are to do. [default: the scenario's description]",
        ),
    ] = None,
    start: Annotated[
        float | None,
        typer.Option(
            min=0, metavar="SECONDS", help="mcap, rosbag2: what t = 0 is, since 1970. [default: 0]"
        ),
    ] = None,
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """A run, or a comparison's runs, for other tools: with pictures, calibration, poses and time
    series.
    """
    form: ExportFormat = loaded("exports", to)
    if start is not None and "--start" not in form.heeds:
        raise ParameterError.only_for(
            "--start", "--to mcap and rosbag2; the times of other formats begin at 0"
        )
    if task is not None and "--task" not in form.heeds:
        raise ParameterError.only_for("--task", "--to lerobot")
    from vstestbed.apps.export.runs import found_in
    from vstestbed.report import recorded_run

    found = found_in(folder, plugin or [], only)
    beside = found.folder.resolve()
    becomes_file = bool(form.suffix) and found.within is None
    ending = form.suffix if becomes_file else f"_{to}"
    path = out or beside.with_name(f"{beside.name}{ending}")
    if not becomes_file:
        files.must_be_new(path, "give a new folder with --out")
    elif path.exists() or path.is_symlink():
        raise OutputError(path, "exists", "give a new file with --out")
    show_notes(not quiet)
    with ProgressBar((), not quiet, "exporting", found.frames) as bar:
        files.make_parents(path)
        runs = recorded_run.opened(found.runs, found.plugins)
        asked = recorded_run.ExportRequest(
            runs, path, found.within, found.table, task, start or 0.0, bar.were_done
        )
        form.write(asked)
    if not quiet:
        typer.echo("\n".join([*found.left_out, str(path)]), err=True)
