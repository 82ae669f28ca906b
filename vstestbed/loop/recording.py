"""The record of a run: frames become rows (`columns`), rows a log; `log_file` writes the same numbers to disk."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, ClassVar, Protocol

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome
from vstestbed.loop.columns import Kept, Layout, kept
from vstestbed.loop.metrics import summarise
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Frame

if TYPE_CHECKING:
    import polars


class Watcher(Protocol):
    """Receives every frame of a run: the log on disk, a video, a progress bar."""

    def frame(self, frame: Frame) -> None:
        """One frame is complete."""
        ...


class Log:
    """Frames in memory; every CHUNK of them become rows at once, which costs 3 us a row instead of 170 one at a time."""

    CHUNK: ClassVar[int] = 256

    def __init__(self, layout: Layout):
        self._layout = layout
        self._rows: list[Array] = []
        self._waiting: list[Kept] = []

    def append(self, frame: Frame) -> None:
        """Keep one more frame, whose arrays must not be written to again: they are not copied."""
        self._waiting.append(kept(frame))
        if len(self._waiting) == self.CHUNK:
            self._turn()

    def _turn(self) -> None:
        if self._waiting:
            self._rows.append(self._layout.rows(self._waiting))
            self._waiting = []

    def table(self) -> Array:
        """All rows, shape (rows, columns)."""
        self._turn()  # what waits for a full chunk
        return np.concatenate(self._rows) if self._rows else np.zeros((0, len(self._layout.columns)))


@dataclass(frozen=True)
class Recording:
    """A finished run: scenario, outcome, log, wall time by part.

    Attributes:
        columns: names of the log's columns; `table` holds them as (frames, columns).
        time_ms: wall time by part, in all [ms]: physics render detect law record video.
        wall_time_s: wall time of the run [s]; loop_s: of its loop alone, without building and closing the scene [s].
        versions: of the packages and the renderer used.
    """

    scenario: Scenario
    outcome: Outcome
    reason: str
    columns: tuple[str, ...]
    table: Array
    wall_time_s: float = math.nan
    loop_s: float = math.nan
    time_ms: dict[str, float] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        """One column as a numpy array; KeyError names the column."""
        if name not in self.columns:
            raise KeyError(f"no column {name!r} in the log; columns: {', '.join(self.columns)}")
        return self.table[:, self.columns.index(name)]

    def frame(self) -> polars.DataFrame:
        """The log as a polars table, one row a camera frame."""
        return to_frame(self.columns, self.table)

    def summary(self) -> dict[str, object]:
        """The metrics of the run, as in `summary.json`; `time_ms` is the mean wall time of a frame by part [ms]."""
        figures = summarise(self.scenario, self.outcome, {name: self.table[:, i] for i, name in enumerate(self.columns)})
        sim_time = float(self["t"][-1]) if len(self.table) else 0.0
        frames = max(len(self.table), 1)
        ended = {"outcome": self.outcome.name, "success": self.outcome.success, "reason": self.reason, "seed": self.scenario.seed}
        cost = {
            "wall_time_s": self.wall_time_s,
            "real_time_factor": sim_time / self.wall_time_s if self.wall_time_s > 0 else None,
            "time_ms": {k: v / frames for k, v in self.time_ms.items()},
            "versions": self.versions,
        }
        return {"scenario": self.scenario.name} | ended | figures | cost


def to_frame(columns: tuple[str, ...], table: Array) -> polars.DataFrame:
    """A table of doubles as a polars table with its own types: `frame` whole numbers, `lost` true or false."""
    import polars as pl

    frame = pl.DataFrame({name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(columns)})
    return frame.with_columns(pl.col("frame").cast(pl.Int64), pl.col("lost").cast(pl.Boolean))
