"""The log of a run: one row of numbers a camera frame, in memory; in a run's folder `log.part`
while it goes on, then `log.parquet`.

`log.part` is a line of column names, then rows of float64 numbers, little-endian; the log of a run
that was killed ends with its last complete row.
"""

from __future__ import annotations

import contextlib
import io
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, ClassVar

import numpy as np

from vstestbed.core.errors import RunFolderError
from vstestbed.core.files import write_whole, writing
from vstestbed.core.geometry import Array
from vstestbed.loop.columns import LOSS, Kept, Layout, kept
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Frame

if TYPE_CHECKING:
    import polars

__all__ = ["ROW_GROUP", "Log", "LogWriter", "finish", "open_log"]

WORKS = "`vstestbed run` of the scenario.yaml beside it writes it again, into another folder"
# how `log.part` begins; the names of its columns follow, with commas between them, to the end of
# the line
HEAD = "float64: "
# rows of a row group of `log.parquet`: five minutes at 25 Hz, and 4 MB of 66 columns
ROW_GROUP = 8_192


@dataclass(frozen=True)
class Log:
    """The rows of a run's log.

    Attributes:
        columns: their names. table: the numbers, shape (rows, columns).
    """

    columns: tuple[str, ...]
    table: Array

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, name: str) -> Array:
        return self.table[:, self.columns.index(name)]

    def by_name(self) -> dict[str, Array]:
        """The columns by name, shape (rows,) each, as views."""
        return dict(zip(self.columns, self.table.T, strict=True))

    def frame(self) -> polars.DataFrame:
        """The same as a polars table: `frame` whole numbers, `lost` true or false."""
        import polars as pl

        frame = pl.DataFrame(
            {name: np.ascontiguousarray(values) for name, values in self.by_name().items()}
        )
        types = {"frame": pl.Int64, "lost": pl.Boolean}
        return frame.with_columns(
            pl.col(name).cast(kind) for name, kind in types.items() if name in self.columns
        )


class LogWriter:
    """The log of a run under way. folder: where `log.part` grows with it; None for a log in memory
    alone.

    Frames become rows many at once, which costs a tenth of the time of one after the other. No
    frame waits for more than PERIOD_S [s] of wall time, which a killed process may lose: rows are
    made when the next frame, if it took as long as the last one, would come too late.
    Raises EnvironmentLackError, OutputError: see `core.files.writing`.
    """

    PERIOD_S: ClassVar[float] = 0.1

    def __init__(self, layout: Layout, folder: Path | None = None):
        self._layout = layout
        self._folder = folder
        self._waiting: list[Kept] = []
        self._parts: list[Array] = [np.zeros((0, len(layout.columns)))]
        self._oldest = self._last = time.monotonic()
        self._file: IO[bytes] | None = None
        if folder is not None:
            with writing(folder):
                # `x`: never over an older log; its name is fixed, since it is read while it grows.
                self._file = (folder / "log.part").open("xb")
                self._file.write(f"{HEAD}{','.join(layout.columns)}\n".encode())
                self._file.flush()

    def append(self, frame: Frame) -> None:
        """Keep one more frame, whose arrays must not be written to again: they are not copied."""
        now = time.monotonic()
        if not self._waiting:
            self._oldest = now
        self._waiting.append(kept(frame))
        if 2 * now - self._last > self._oldest + self.PERIOD_S:
            self.flush()
        self._last = now

    def flush(self) -> None:
        """Make rows of the frames that wait; those of a file are handed to the system, so that a
        killed process does not lose them.
        """
        waiting, self._waiting = self._waiting, []
        if waiting:
            self.add(self._layout.rows(waiting))

    def add(self, rows: Array) -> None:
        """Add rows (n, columns)."""
        self._parts.append(rows)
        if self._file is not None and self._folder is not None:
            with writing(self._folder):
                self._file.write(rows.astype("<f8", copy=False).tobytes())
                self._file.flush()

    def log(self) -> Log:
        """The rows so far; later ones are not in it."""
        if len(self._parts) > 1:
            self._parts = [np.concatenate(self._parts)]
        return _shown(self._layout.columns, self._parts[0])

    def close(self) -> None:
        """Close the file; an error in writing its last rows is ignored, since it has ended the run
        already.
        """
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()


def _shown(columns: tuple[str, ...], table: Array) -> Log:
    """A log, without the columns of a loss where there was none."""
    n = len(columns) - len(LOSS)
    if columns[n:] != LOSS or table[:, n:].any():
        return Log(columns, table)
    return Log(columns[:n], table[:, :n])


def finish(folder: Path, log: Log) -> None:
    """Replace `log.part` by `log.parquet`, which appears whole or not at all."""
    # not polars into the file, which drops the reason why a file could not be written
    written = io.BytesIO()
    log.frame().write_parquet(
        written, compression="zstd", statistics=False, row_group_size=ROW_GROUP
    )
    write_whole(folder / "log.parquet", written.getvalue())
    (folder / "log.part").unlink(missing_ok=True)  # only after log.parquet is complete


def open_log(
    folder: Path, scenario: Scenario | None = None, names: Sequence[str] | None = None
) -> Log:
    """The log of a run's folder: `log.parquet`, or what there is of `log.part` when the run was cut
    off. names: only these columns. scenario: of a run, whose times go on. Raises RunFolderError:
    neither can be read, or it is damaged, or lacks a column that runs of `scenario` have.
    """
    import polars as pl  # here: a run needs it only at its end

    whole = folder / "log.parquet"
    try:
        log = _of_parquet(whole, names) if whole.is_file() else _of_part(folder / "log.part", names)
        return log if scenario is None else _complete(log, whole, Layout(scenario).columns)
    except FileNotFoundError:
        words = "no run here" if folder.is_dir() else "no such folder"
        raise RunFolderError(folder, words) from None
    # A panic of polars is no Exception, and comes from damaged pages.
    except (OSError, ValueError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        path = whole if whole.is_file() else folder / "log.part"
        words = str(error).strip().partition("\n")[0][:200]
        raise RunFolderError(path, f"cannot be read ({words})", WORKS) from None


def _of_parquet(path: Path, names: Sequence[str] | None) -> Log:
    import polars as pl  # here: a run needs it only at its end

    frame = pl.read_parquet(path, columns=None if names is None else list(names))
    for column in frame:
        if not (column.dtype.is_numeric() or column.dtype == pl.Boolean) or column.null_count():
            raise ValueError(f"the column {column.name} holds something else than numbers")
    return Log(tuple(frame.columns), frame.cast(pl.Float64).to_numpy())


def _complete(log: Log, path: Path, columns: Sequence[str]) -> Log:
    """The log, which has all these columns; those of torques, which logs of before do not have, are
    added without values.
    """
    lacking = [name for name in columns if name not in (*log.columns, *LOSS)]
    if not all(name.startswith("tau_") for name in lacking):
        raise RunFolderError(path, f"has no column {lacking[0]}", WORKS)
    if lacking:
        unknown = np.full((len(log), len(lacking)), np.nan)
        log = Log((*log.columns, *lacking), np.column_stack([log.table, unknown]))
    if not (np.isfinite(log["t"]).all() and (np.diff(log["t"]) >= 0).all()):
        raise ValueError("its times do not go on")
    if not np.isin(log["lost"], (0, 1)).all():
        raise ValueError("the column lost holds something else than 0 and 1")
    return log


def _of_part(path: Path, names: Sequence[str] | None) -> Log:
    if not path.is_file():  # to open a pipe would wait for ever
        raise FileNotFoundError
    head, newline, content = path.read_bytes().partition(b"\n")
    if not newline:
        raise ValueError("log.part ends before its first line does")
    text = head.decode("ascii").strip()
    if not text.startswith(HEAD):
        raise ValueError(f"log.part does not begin with {HEAD!r}")
    columns = tuple(text.removeprefix(HEAD).split(","))
    row = 8 * len(columns)  # what follows the last whole row is not complete yet, or was cut off
    numbers = np.frombuffer(content[: len(content) // row * row], "<f8").astype(float)
    table = numbers.reshape(-1, len(columns))
    if names is None:
        return _shown(columns, table)
    return Log(tuple(names), table[:, [columns.index(name) for name in names]])
