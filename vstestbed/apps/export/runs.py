"""What a folder has to export: a run, or a comparison's runs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import polars as pl

from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.report.recorded_run import RecordedRun
from vstestbed.studies.comparison import stored

Only = Literal["all", "successes"]
WORKS = "a run's folder holds scenario.yaml, a comparison's comparison.yaml"


@dataclass(frozen=True)
class Exported:
    """What is exported: the folders of the runs. within: the comparison's folder, and table: of its
    runs, None of one run. left_out: what is missing or cut off.
    """

    folder: Path
    within: Path | None
    runs: tuple[Path, ...]
    frames: int
    table: pl.DataFrame | None
    left_out: tuple[str, ...]
    plugins: tuple[str, ...]


def found_in(folder: Path, plugins: Sequence[str], only: Only = "all") -> Exported:
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


def _comparison(folder: Path, plugins: Sequence[str], only: Only) -> Exported:
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
