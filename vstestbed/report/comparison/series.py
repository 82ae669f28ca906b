"""The error in the image of many runs over time, resampled to one time grid.

Logs are read one at a time and only INSTANTS values of each are kept, so that memory does not grow with the length of the logs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.loop.log_file import open_log
from vstestbed.report.comparison.columns import ComparisonResults
from vstestbed.report.run.tracks import MeasuredError

INSTANTS = 240
"""Points of the time grid: more than can be resolved in one panel of a figure."""
SAMPLED, LEAST_SAMPLED = 2000, 20
"""Logs that are read in all, shared among the controllers, and fewest of each: to read one takes a millisecond."""
_FAR = 1e30
"""Error that stands for a lost target: larger than any real one, but finite, since quantiles interpolate (inf - inf is NaN)."""


@dataclass(frozen=True)
class Series:
    """RMS image error of every run over time.

    Attributes:
        t: the common time grid, shape (G,) [s].
        errors: of each controller, shape (runs, G) [unit of `measured`]; NaN while the target is lost and for runs without a log.
        sampled: of so many first runs of each controller; None: of all.
        measured: which error it is of each controller, with the threshold.
    """

    t: Array
    errors: tuple[NDArray[np.float32], ...]
    sampled: int | None = None
    measured: tuple[MeasuredError, ...] = ()

    def units(self) -> dict[MeasuredError, list[int]]:
        """The controllers that are measured in the same, by number."""
        found: dict[MeasuredError, list[int]] = {}
        for i, error in enumerate(self.measured):
            found.setdefault(error, []).append(i)
        return found

    def quartiles(self, controller: int) -> Array:
        """First quartile, median and third quartile over the runs, shape (3, G); inf where so many runs have lost the target.

        A run without target ranks behind every run that sees it. If such runs were left out, a controller that loses its worst
        runs would look better than one that keeps them in view.
        """
        errors = self.errors[controller].astype(float)
        if not len(errors):
            return np.full((3, len(self.t)), np.inf)
        quartiles = np.quantile(np.where(np.isfinite(errors), errors, _FAR), [0.25, 0.5, 0.75], axis=0)
        return np.where(quartiles < 1e-3 * _FAR, quartiles, np.inf)  # also where _FAR was only a part of the interpolation


def read_series(folder: Path, comparison: ComparisonResults, measured: Sequence[MeasuredError] = ()) -> Series:
    """Read the errors of the runs of a comparison, of very many the first of each controller; after its end a run holds its last value.

    Args:
        folder: the comparison's folder; the table's column `folder` is relative to it.
        comparison: the comparison. measured: which error of each controller; by default that of markers.

    Raises:
        RunFolderError: a log is damaged.
    """
    # the duration of the longest run; 1 s if no run has any, so that the grid is not empty
    longest = comparison.table["sim_time_s"].cast(pl.Float64, strict=False).max() if "sim_time_s" in comparison.table.columns else None
    t = np.linspace(0, longest if isinstance(longest, float) and longest > 0 else 1.0, INSTANTS)
    most = max(SAMPLED // max(len(comparison.controllers), 1), LEAST_SAMPLED)
    measured = tuple(measured) or (MeasuredError(),) * len(comparison.controllers)
    of_controllers = []
    for controller, error in zip(comparison.controllers, measured, strict=True):
        places = controller.runs["folder"].head(most).to_list()  # the first, not a random choice: the same page from the same table
        errors = np.full((len(places), len(t)), np.nan, dtype=np.float32)  # single precision halves the memory of large comparisons
        for i, place in enumerate(places):
            errors[i] = _resampled(folder / str(place) / "log.parquet", error.column, t)
        of_controllers.append(errors)
    sampled = most if any(len(c.runs) > most for c in comparison.controllers) else None
    return Series(t, tuple(of_controllers), sampled, measured)


def _resampled(path: Path, column: str, t: Array) -> Array:
    """Zero-order hold of a log's error at the times t (G,) [s]; NaN before its first frame, and everywhere where there is no log."""
    if not path.is_file():  # of a run that crashed
        return np.full(len(t), np.nan)
    blocks = list(open_log(path.parent).blocks(("t", column)))
    # 1e-9 s: a grid point that rounding has put just before its frame belongs to that frame
    times, error = (np.concatenate([np.empty(0), *(block[name] for block in blocks)]) for name in ("t", column))
    frame = np.searchsorted(times, t + 1e-9, side="right") - 1
    return np.where(frame >= 0, error[np.maximum(frame, 0)], np.nan) if len(error) else np.full(len(t), np.nan)
