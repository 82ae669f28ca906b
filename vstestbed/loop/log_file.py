"""A run's log on disk: `log.part` grows line by line, and becomes `log.parquet` at the end; both read the same.

`log.part` is CSV whose numbers read back exactly; the log of a run that was killed ends with its last complete line.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vstestbed.core.errors import RunFolderError
from vstestbed.loop.columns import Layout
from vstestbed.loop.recording import to_frame
from vstestbed.scenario.scenario import Scenario

if TYPE_CHECKING:
    import polars


class PartWriter:
    """Writes `log.part` row by row, line-buffered: a killed process loses no finished line."""

    def __init__(self, path: Path, layout: Layout):
        self._layout = layout
        self._file = path.open("w", encoding="ascii", newline="\n", buffering=1)
        self._file.write(",".join(layout.columns) + "\n")

    def append(self, row: list[float]) -> None:
        """Add one row of `Layout.rows`."""
        # repr: the shortest text that reads back as the same float.
        self._file.write(",".join(map(repr, row)) + "\n")

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_log(folder: Path, scenario: Scenario | None = None) -> polars.DataFrame:
    """The log of a run's folder: `log.parquet`, or what there is of `log.part` when the run was cut off.

    Args:
        folder: a run's folder.
        scenario: where given, the log must have the columns that runs of this scenario have.

    Raises:
        RunFolderError: neither is there, or neither can be read, or it is the log of another experiment.
    """
    log = _log_of(folder)
    lacking = [name for name in Layout(scenario).columns if name not in log.columns] if scenario else []
    if lacking:
        raise RunFolderError(folder, f"its log has no column {lacking[0]}, which a run of its scenario.yaml has")
    return log


def _log_of(folder: Path) -> polars.DataFrame:
    import polars as pl

    whole, part = folder / "log.parquet", folder / "log.part"
    try:
        if whole.is_file():
            return pl.read_parquet(whole)
        if part.is_file():
            return _read_part(part)
    except (OSError, ValueError, pl.exceptions.PolarsError) as error:
        raise RunFolderError(folder, f"its log cannot be read ({error})") from None
    raise RunFolderError(folder, "no run here" if folder.is_dir() else "no such folder")


def _read_part(part: Path) -> polars.DataFrame:
    lines = part.read_text(encoding="ascii").split("\n")[:-1]  # what follows the last line end was cut off
    if not lines:
        raise ValueError("log.part ends before its first line does")
    columns = tuple(lines[0].split(","))
    table = np.array([[float(v) for v in line.split(",")] for line in lines[1:]], dtype=float).reshape(-1, len(columns))
    return to_frame(columns, table)
