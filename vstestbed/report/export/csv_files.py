"""Logs as CSV: a file for each run, `columns.csv` with the unit of each column and who knows it, and a comparison's table of runs.

A number that there is not (a marker that is not seen) is an empty field; `lost` is true or false.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from pathlib import Path

import polars as pl
import polars.selectors as cs

from vstestbed.core.files import PartFile, make_folder, write_whole, writing
from vstestbed.core.folders import whole_folder
from vstestbed.report.export.columns import Meaning, meaning
from vstestbed.report.export.source import RecordedRun


def write_csv(
    runs: Iterable[RecordedRun],
    out: Path,
    tick: Callable[[], None] = lambda: None,
    within: Path | None = None,
    table: pl.DataFrame | None = None,
) -> Path:
    """Write the logs of runs into a folder, which appears whole or not at all.

    Args:
        runs: the runs. out: the folder. tick: called after each frame.
        within: the folder in which the runs' folders are; each file has the same place in `out`. table: of a comparison's runs.

    Raises:
        OutputError: `out` holds something already, or cannot be made. EnvironmentLackError: no space.
    """
    known: dict[str, Meaning] = {}
    with whole_folder(out) as folder:
        for run in runs:
            place = run.folder.name if within is None else run.folder.relative_to(within).as_posix()
            path = folder / f"{place}.csv"
            make_folder(path.parent)
            _write_log(run, path, tick)
            known |= {name: meaning(name, run.scenario) for name in run.log.columns}
        lines = [{"column": name, "unit": m.unit, "whose": m.whose, "meaning": m.words} for name, m in known.items()]
        write_whole(folder / "columns.csv", pl.DataFrame(lines).write_csv())
        if table is not None:
            write_whole(folder / "comparison.csv", table.write_csv())
    return out


def _write_log(run: RecordedRun, path: Path, tick: Callable[[], None]) -> None:
    """A log, some thousands of rows at a time."""
    with writing(path), PartFile(path) as part:
        for number, block in enumerate(run.log.frames()):
            buffer = io.BytesIO()
            block.with_columns(cs.float().fill_nan(None)).write_csv(buffer, include_header=number == 0)
            part.file.write(buffer.getvalue())
            for _ in range(len(block)):
                tick()
