"""The command `export`: runs for other tools. Heavy imports are inside the functions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from vstestbed.cli.options import Plugins
from vstestbed.core.apps import loaded, offered
from vstestbed.core.errors import OutputError, ParameterError, RunFolderError

if TYPE_CHECKING:
    import polars

    from vstestbed.report.recorded_run import ExportFormat

WORKS = "a run's folder holds scenario.yaml, a comparison's comparison.yaml"

if TYPE_CHECKING:
    Format = str
else:
    Format = Literal[tuple(offered("exports"))]
Only = Literal["all", "successes"]


@dataclass(frozen=True)
class Exported:
    """What is exported: the folders of the runs. within: the comparison's folder, and table: of its
    runs, None of one run. left_out: what is missing or cut off.
    """

    folder: Path
    within: Path | None
    runs: tuple[Path, ...]
    frames: int
    table: polars.DataFrame | None
    left_out: tuple[str, ...]
    plugins: tuple[str, ...]


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
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no words.")] = False,
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
    from rich.progress import Progress, TimeRemainingColumn

    from vstestbed.cli.progress import ProgressBar, show_notes
    from vstestbed.core.files import make_parents, must_be_new
    from vstestbed.report.recorded_run import ExportRequest, opened

    found = _found(folder, plugin or [], only)
    beside = found.folder.resolve()
    becomes_file = bool(form.suffix) and found.within is None
    ending = form.suffix if becomes_file else f"_{to}"
    path = out or beside.with_name(f"{beside.name}{ending}")
    if not becomes_file:
        must_be_new(path, "give a new folder with --out")
    elif path.exists() or path.is_symlink():
        raise OutputError(path, "exists", "give a new file with --out")
    show_notes(not quiet)
    columns = *Progress.get_default_columns()[:-1], TimeRemainingColumn()
    with ProgressBar(columns, not quiet, "exporting", found.frames) as bar:
        make_parents(path)
        runs = opened(found.runs, found.plugins)
        form.write(
            ExportRequest(runs, path, found.within, found.table, task, start or 0.0, bar.were_done)
        )
    if not quiet:
        typer.echo("\n".join([*found.left_out, str(path)]), err=True)


def _found(folder: Path, plugins: list[str], only: Only = "all") -> Exported:
    """What a folder holds. Raises RunFolderError: neither a run nor a comparison, a damaged one, or
    one without a frame.
    """
    if folder.is_file():  # a person may name one of its files
        if not any(
            (folder.parent / name).is_file() for name in ("scenario.yaml", "comparison.yaml")
        ):
            raise RunFolderError(
                folder,
                "is a file, and not one of a run's or a comparison's folder",
                f"give the folder: {WORKS}",
            )
        folder = folder.parent
    if (folder / "comparison.yaml").is_file():
        return _comparison(folder, plugins, only)
    if only != "all":
        raise ParameterError.only_for("--only", "a comparison's folder", only)
    from vstestbed.report.recorded_run import RecordedRun

    run = RecordedRun.of(folder, plugins)
    frames = len(run.log)
    cut = (
        ()
        if run.summary
        else (
            (
                f"{folder}: the run has no summary: it was cut off, or goes on;"
                f" its {frames} frames so far are exported"
            ),
        )
    )
    return Exported(folder, None, (folder,), frames, None, cut, tuple(plugins))


def _has_log(run: Path) -> bool:
    return (run / "log.parquet").is_file() or (run / "log.part").is_file()


def _comparison(folder: Path, plugins: list[str], only: Only) -> Exported:
    from vstestbed.studies.comparison import stored

    comparison, every, total = stored(folder, plugins)
    table = every.filter("success") if only == "successes" else every
    if table.is_empty():
        raise RunFolderError(
            folder,
            f"has no success among {len(every)} runs; there is nothing to export",
            "leave --only out",
        )
    places = [folder / name for name in table["folder"].to_list()]
    runs = tuple(filter(_has_log, places))
    if not runs:
        raise RunFolderError(folder, "has no run with a log; there is nothing to export", WORKS)
    words = []
    if lost := len(places) - len(runs):
        words.append(f"{lost} of {len(places)} runs crashed without a log, and are left out")
    if failed := len(every) - len(table):
        words.append(f"{failed} of {len(every)} runs are no successes, and are left out")
    if left := total - len(every):
        words.append(
            f"{left} of {total} runs are not done yet;"
            f" vstestbed compare --resume --out {folder} does them"
        )
    frames = int(table["frames"].sum()) if "frames" in table.columns else 0
    return Exported(folder, folder, runs, frames, table, tuple(words), comparison.plugins)
