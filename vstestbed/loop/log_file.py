"""A run's log on disk: `log.part` grows while the run goes on, and becomes `log.parquet` at its end; both read the same.

`log.part` is a line of column names, then rows of float64 numbers, little-endian; the log of a run that was killed ends with its last
complete row. Neither file is ever read as a whole: a log of a day has a gigabyte.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from vstestbed.core.errors import RunFolderError
from vstestbed.core.files import PartFile, writing
from vstestbed.core.geometry import Array
from vstestbed.loop.columns import Layout
from vstestbed.loop.recording import BLOCK, Block, to_frame, types_of
from vstestbed.scenario.scenario import Scenario

if TYPE_CHECKING:
    import polars

WORKS = "`vstestbed run` of the scenario.yaml beside it writes it again, into another folder"
PROBE_BYTES = 1_000_000
"""More than polars writes at once: a disk without room for that has none for this."""
COMPRESSED: Final[dict[str, Any]] = {"compression": "zstd", "statistics": False, "row_group_size": BLOCK}
HEAD = "float64: "
"""How `log.part` begins; the names of its columns follow, with commas between them, to the end of the line."""


class FolderLog:
    """The rows of a run's log in its folder (`Rows`). of_a_run: refuse times that do not go on, which no run logs, when they are read.
    Raises RunFolderError: the folder has no log, or one that cannot be read.
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
            file.write(f"{HEAD}{','.join(columns)}\n".encode())
            file.flush()
        log = cls(folder)
        log._file = file
        return log

    @property
    def _parquet(self) -> Path | None:
        whole = self._folder / "log.parquet"
        return whole if whole.is_file() else None

    @contextlib.contextmanager
    def _reading(self) -> Iterator[None]:
        """Turn errors of reading into one that names the folder."""
        try:
            yield
        except FileNotFoundError:
            raise RunFolderError(self._folder, "no run here" if self._folder.is_dir() else "no such folder") from None
        except BaseException as error:
            import polars as pl  # here: a run needs it only at its end

            # A panic of polars is no Exception, and comes from damaged pages.
            if not isinstance(error, OSError | ValueError | pl.exceptions.PolarsError | pl.exceptions.PanicException):
                raise
            words = str(error).strip().partition("\n")[0][:200]
            raise RunFolderError(self._parquet or self._part, f"cannot be read ({words})", WORKS) from None

    def _header(self) -> list[str]:
        if self._parquet:
            import polars as pl

            return list(pl.read_parquet_schema(self._parquet))
        if not self._part.is_file():  # to open a pipe would wait for ever
            raise FileNotFoundError
        with self._part.open("rb") as file:
            line = file.readline()
        if not line.endswith(b"\n"):
            raise ValueError("log.part ends before its first line does")
        if not (text := line.decode("ascii").strip()).startswith(HEAD):
            raise ValueError(f"log.part does not begin with {HEAD!r}")
        return text.removeprefix(HEAD).split(",")

    def append(self, rows: Array) -> None:
        """Add rows (n, columns); they are handed to the system at once, so that a killed process loses no row of an earlier call."""
        assert self._file is not None
        with writing(self._folder):
            self._file.write(rows.astype("<f8", copy=False).tobytes())
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
                return (self._part.stat().st_size - len(file.readline())) // (8 * len(self.columns))

    def blocks(self, names: Sequence[str] | None = None) -> Iterator[Block]:
        """The rows in their order, some thousands at a time, as columns by name; `names`: only these columns."""
        wanted = self.columns if names is None else tuple(names)
        with self._reading():
            for block in self._parquet_blocks(self._parquet, wanted) if self._parquet else self._part_blocks(wanted):
                if self._of_a_run and "t" in block and not (np.isfinite(block["t"]).all() and (np.diff(block["t"]) >= 0).all()):
                    raise ValueError("its times do not go on")
                if self._of_a_run and "lost" in block and not np.isin(block["lost"], (0, 1)).all():
                    raise ValueError("the column lost holds something else than 0 and 1")
                yield block

    def frames(self, names: Sequence[str] | None = None) -> Iterator[polars.DataFrame]:
        """The same as polars tables with the types of `log.parquet`."""
        with self._reading():
            yield from map(to_frame, self.blocks(names))

    def _parquet_blocks(self, path: Path, names: Sequence[str]) -> Iterator[Block]:
        import polars as pl

        log, rows = pl.scan_parquet(path).select(names), len(self)  # scanned once: the footer of a long log is large, too
        for start in range(0, rows, BLOCK):
            frame = log.slice(start, BLOCK).collect()
            for column in frame:
                if not (column.dtype.is_numeric() or column.dtype == pl.Boolean) or column.null_count():
                    raise ValueError(f"the column {column.name} holds something else than numbers")
            yield {name: frame[name].cast(float).to_numpy() for name in names}

    def _part_blocks(self, names: Sequence[str]) -> Iterator[Block]:
        at, row = [self.columns.index(name) for name in names], 8 * len(self.columns)
        with self._part.open("rb") as file:
            file.readline()
            while len(piece := file.read(row * BLOCK)) >= row:
                # what follows the last whole row is not complete yet, or was cut off
                table = np.frombuffer(piece[: len(piece) // row * row], "<f8").reshape(-1, len(self.columns))
                yield {self.columns[i]: table[:, i].astype(float) for i in at}

    def table(self) -> Array:
        """All rows as one array in memory, shape (rows, columns)."""
        blocks = [np.column_stack(list(block.values())) for block in self.blocks()]
        return np.concatenate([np.zeros((0, len(self.columns))), *blocks])

    def finish(self) -> None:
        """Replace `log.part` by `log.parquet`, which appears whole or not at all."""
        import polars as pl
        from polars.io.plugins import register_io_source

        self.close()
        schema = dict.fromkeys(self.columns, pl.Float64()) | types_of(self.columns)
        with writing(self._folder), PartFile(self._folder / "log.parquet") as made:
            # a block in memory at a time, and one on its way: polars asks for all columns and all rows
            log = register_io_source(lambda *_: self.frames(), schema=schema)
            try:
                log.sink_parquet(made.file, **COMPRESSED)
            except pl.exceptions.ComputeError:
                # polars drops the reason why a file could not be written: the next write has it
                made.file.write(bytes(PROBE_BYTES))
                made.file.flush()
                raise
        self._part.unlink(missing_ok=True)  # only after log.parquet is complete


def open_log(folder: Path, scenario: Scenario | None = None) -> FolderLog:
    """The log of a run's folder: `log.parquet`, or what there is of `log.part` when the run was cut off.
    Raises RunFolderError: neither can be read, or it is damaged, or lacks a column that runs of `scenario` have.
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
    return pl.concat([to_frame({name: np.zeros(0) for name in log.columns}), *log.frames()])
