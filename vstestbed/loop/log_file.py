"""A run's log on disk: `log.part` grows while the run goes on, and becomes `log.parquet` at its end; both read the same.

`log.part` is CSV whose numbers read back exactly; the log of a run that was killed ends with its last complete line. Neither file is
ever read as a whole: a log of a day has some gigabytes.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vstestbed.core.errors import RunFolderError
from vstestbed.core.files import PartFile, writing
from vstestbed.core.geometry import Array
from vstestbed.loop.columns import Layout
from vstestbed.loop.recording import BLOCK, Block, to_frame, types_of, whole_table
from vstestbed.scenario.scenario import Scenario

if TYPE_CHECKING:
    import polars

WORKS = "`vstestbed run` of the scenario.yaml beside it writes it again, into another folder"
READ_BYTES = 1_000_000
"""Bytes of `log.part` that are read at a time."""


class FolderLog:
    """The rows of a run's log in its folder (`Rows`).

    Args:
        folder: the run's. of_a_run: refuse times that do not go on, which no run logs, when they are read.

    Attributes:
        columns: names of the columns.

    Raises:
        RunFolderError: the folder has no log, or one that cannot be read.
    """

    def __init__(self, folder: Path, of_a_run: bool = False):
        self._of_a_run = of_a_run
        self._folder, self._part, self._file = folder, folder / "log.part", None
        with self._reading():
            self.columns = tuple(self._header())

    @classmethod
    def create(cls, folder: Path, columns: Sequence[str]) -> FolderLog:
        """A new log without rows."""
        with writing(folder):
            # `x`: never an older log, nor through a link; its name is fixed, since it is read while it grows.
            file = (folder / "log.part").open("xb")
            file.write(",".join(columns).encode() + b"\n")
            file.flush()
        log = cls(folder)
        log._file = file
        return log

    @property
    def _parquet(self) -> Path | None:
        """`log.parquet`, if the run is finished."""
        whole = self._folder / "log.parquet"
        return whole if whole.is_file() else None

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        """Turn errors of reading into one that names the folder."""
        import polars as pl

        try:
            yield
        except FileNotFoundError:
            raise RunFolderError(self._folder, "no run here" if self._folder.is_dir() else "no such folder") from None
        # A panic of polars is no Exception, and comes from damaged pages.
        except (OSError, ValueError, pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
            words = str(error).strip().partition("\n")[0][:200]
            raise RunFolderError(self._parquet or self._part, f"cannot be read ({words})", WORKS) from None

    def _header(self) -> list[str]:
        import polars as pl

        if self._parquet:
            return list(pl.read_parquet_schema(self._parquet))
        if not self._part.is_file():  # to open a pipe would wait for ever
            raise FileNotFoundError
        with self._part.open("rb") as file:
            line = file.readline()
        if not line.endswith(b"\n"):
            raise ValueError("log.part ends before its first line does")
        return line.decode("ascii").strip().split(",")

    def append(self, rows: Array) -> None:
        """Add rows (n, columns); they are handed to the system at once, so that a killed process loses no row of an earlier call."""
        import polars as pl

        text = io.BytesIO()
        pl.from_numpy(rows, schema=list(self.columns)).write_csv(text, include_header=False)  # the shortest digits that read back exactly
        assert self._file is not None
        with writing(self._folder):
            self._file.write(text.getvalue())
            self._file.flush()

    def close(self) -> None:
        """Close the file; an error in writing its last line is ignored, since it has ended the run already."""
        if self._file is not None:
            with contextlib.suppress(OSError):
                self._file.close()

    def __len__(self) -> int:
        import polars as pl

        with self._reading():
            if self._parquet:
                return int(pl.scan_parquet(self._parquet).select(pl.len()).collect().item())
            with self._part.open("rb") as file:
                return sum(piece.count(b"\n") for piece in iter(lambda: file.read(READ_BYTES), b"")) - 1

    def blocks(self, names: Sequence[str] | None = None) -> Iterator[Block]:
        """The rows in their order, some thousands at a time, as columns by name; `names`: only these columns."""
        for frame in self.frames(names):
            yield {name: frame[name].cast(float).to_numpy() for name in frame.columns}

    def frames(self, names: Sequence[str] | None = None) -> Iterator[polars.DataFrame]:
        """The same as polars tables with the types of `log.parquet`."""
        wanted = self.columns if names is None else tuple(names)
        with self._reading():
            for frame in self._parquet_frames(self._parquet, wanted) if self._parquet else self._part_frames(wanted):
                _must_be_sound(frame, self._of_a_run)
                yield frame

    def _parquet_frames(self, path: Path, names: Sequence[str]) -> Iterator[polars.DataFrame]:
        import polars as pl

        log, rows = pl.scan_parquet(path).select(names), len(self)  # scanned once: the footer of a long log is large, too
        for start in range(0, rows, BLOCK):
            yield log.slice(start, BLOCK).collect()

    def _part_frames(self, names: Sequence[str]) -> Iterator[polars.DataFrame]:
        with self._part.open("rb") as file:
            file.readline()
            rest = b""
            while piece := file.read(READ_BYTES):
                text, end, rest = (rest + piece).rpartition(b"\n")  # what follows the last line end is not complete yet, or was cut off
                if end:
                    yield self._parsed(text, names)

    def _parsed(self, text: bytes, names: Sequence[str]) -> polars.DataFrame:
        import polars as pl

        schema: Any = dict.fromkeys(self.columns, pl.Float64)
        frame = pl.read_csv(text, has_header=False, schema=schema)
        if sum(frame.null_count().row(0)):
            raise ValueError("a line of log.part has too few numbers")
        return to_frame({name: frame[name].to_numpy() for name in names})

    def finish(self) -> None:
        """Replace `log.part` by `log.parquet`, which appears whole or not at all."""
        import polars as pl

        self.close()
        with writing(self._folder), PartFile(self._folder / "log.parquet") as made:
            text = pl.scan_csv(self._part, schema=dict.fromkeys(self.columns, pl.Float64))
            log = text.with_columns(pl.col(name).cast(kind) for name, kind in types_of(self.columns).items())
            log.sink_parquet(made.file, compression="zstd", statistics=False, row_group_size=BLOCK)
        self._part.unlink(missing_ok=True)  # only after log.parquet is complete


def _must_be_sound(frame: polars.DataFrame, of_a_run: bool) -> None:
    """ValueError for anything but numbers, gaps and, in the log of a run, times that do not go on."""
    import polars as pl

    for column in frame:
        if not (column.dtype.is_numeric() or column.dtype == pl.Boolean) or column.null_count():
            raise ValueError(f"the column {column.name} holds something else than numbers")
    if of_a_run and "t" in frame.columns and not (frame["t"].is_finite().all() and frame["t"].is_sorted()):
        raise ValueError("its times do not go on")


def open_log(folder: Path, scenario: Scenario | None = None) -> FolderLog:
    """The log of a run's folder: `log.parquet`, or what there is of `log.part` when the run was cut off.

    Args:
        folder: a run's folder.
        scenario: where given, the log must have the columns that runs of this scenario have.

    Raises:
        RunFolderError: neither is there, or neither can be read, or it is damaged or the log of another experiment.
    """
    log = FolderLog(folder, of_a_run=scenario is not None)
    lacking = [name for name in Layout(scenario).columns if name not in log.columns] if scenario else []
    if lacking:
        raise RunFolderError(folder / "log.parquet", f"has no column {lacking[0]}", WORKS)
    return log


def read_log(folder: Path, scenario: Scenario | None = None) -> polars.DataFrame:
    """The same as one table in memory."""
    import polars as pl

    log = open_log(folder, scenario)
    frames = list(log.frames())
    return pl.concat(frames) if frames else to_frame(dict(zip(log.columns, whole_table(log).T, strict=True)))
