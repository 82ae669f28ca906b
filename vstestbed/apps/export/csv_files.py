"""Logs as CSV: a file for each run, `columns.csv` with the unit of each column and who knows it,
and a comparison's table of runs.

A number that there is not (a marker that is not seen) is an empty field; `lost` is true or false.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable
from pathlib import Path

import polars as pl
import polars.selectors as cs

from vstestbed.core.files import PartFile, make_folder, whole_folder, write_whole, writing
from vstestbed.loop.log_file import ROW_GROUP
from vstestbed.report.recorded_run import ExportFormat, ExportRequest, Meaning, RecordedRun, meaning


def write_csv(
    runs: Iterable[RecordedRun],
    out: Path,
    tick: Callable[[], None] = lambda: None,
    within: Path | None = None,
    table: pl.DataFrame | None = None,
) -> Path:
    """Write the logs of runs into a new folder `out`, which appears whole or not at all.

    `within`: the folder in which the runs' folders are; each file has the same place in `out`.
    table: of a comparison's runs. tick: called after each frame. OutputError: `out` holds something
    already, or cannot be made. EnvironmentLackError: no space.
    """
    known: dict[str, Meaning] = {}
    with whole_folder(out) as folder:
        for run in runs:
            path = folder / f"{run.place(within)}.csv"
            make_folder(path.parent)
            with writing(path), PartFile(path) as part:
                for number, block in enumerate(run.log.frame().iter_slices(ROW_GROUP)):
                    buffer = io.BytesIO()
                    block.with_columns(cs.float().fill_nan(None)).write_csv(
                        buffer, include_header=number == 0
                    )
                    part.file.write(buffer.getvalue())
                    for _ in range(len(block)):
                        tick()
            known |= {name: meaning(name, run.scenario) for name in run.log.columns}
        lines = [
            {"column": name, "unit": unit, "whose": whose, "meaning": words}
            for name, (unit, whose, words) in known.items()
        ]
        write_whole(folder / "columns.csv", pl.DataFrame(lines).write_csv())
        if table is not None:
            write_whole(folder / "comparison.csv", table.write_csv())
    return out


def _write(asked: ExportRequest) -> Path:
    return write_csv(asked.runs, asked.out, asked.tick, asked.within, asked.table)


CSV = ExportFormat(_write)
