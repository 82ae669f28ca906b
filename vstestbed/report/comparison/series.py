"""The error of many runs over time on one grid: logs are read one at a time, and a few hundred numbers kept of each."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.report.comparison.columns import ComparisonResults

INSTANTS = 240
"""Points of the time grid: more than a figure's panel can show apart."""
_FAR = 1e30
"""Stands for a run that sees nothing, which ranks behind all that do; finite, so that quantiles can be computed."""


@dataclass(frozen=True)
class Series:
    """RMS error of every run.

    Attributes:
        t: the common time grid, shape (G,) [s].
        errors: of each controller, shape (runs, G) [px]; NaN while the target is lost and for runs without a log.
    """

    t: Array
    errors: tuple[NDArray[np.float32], ...]

    def quartiles(self, controller: int) -> Array:
        """First quartile, median and third quartile over the runs, shape (3, G); inf where so many runs see nothing.

        A run that has lost its target counts as farther away than any that sees it: else a controller that loses
        its worst runs would look better than one that keeps them.
        """
        errors = self.errors[controller].astype(float)
        if not len(errors):
            return np.full((3, len(self.t)), np.inf)
        made = np.quantile(np.where(np.isfinite(errors), errors, _FAR), [0.25, 0.5, 0.75], axis=0)
        return np.where(made < 1e-3 * _FAR, made, np.inf)


def read_series(folder: Path, comparison: ComparisonResults) -> Series:
    """The errors of all runs of a comparison's folder; a run that has ended holds its last value.

    Args:
        folder: of the comparison; the table's `folder` is relative to it.
        comparison: whose runs.
    """
    longest = comparison.table["sim_time_s"].cast(pl.Float64, strict=False).max() if "sim_time_s" in comparison.table.columns else None
    t = np.linspace(0, longest if isinstance(longest, float) and longest > 0 else 1.0, INSTANTS)
    made = []
    for controller in comparison.controllers:
        errors = np.full((len(controller.runs), len(t)), np.nan, dtype=np.float32)
        for i, place in enumerate(controller.runs["folder"].to_list()):
            errors[i] = _resampled(folder / str(place) / "log.parquet", t)
        made.append(errors)
    return Series(t, tuple(made))


def _resampled(path: Path, t: Array) -> Array:
    """A log's error at the last frame before or at each time (G,); NaN before its first, and all NaN where no log can be read."""
    try:
        log = pl.read_parquet(path, columns=["t", "error_px"])
    except (OSError, pl.exceptions.PolarsError):
        return np.full(len(t), np.nan)
    frame = np.searchsorted(log["t"].to_numpy(), t + 1e-9, side="right") - 1
    error = log["error_px"].cast(pl.Float64).fill_null(np.nan).to_numpy()
    return np.where(frame >= 0, error[np.maximum(frame, 0)], np.nan) if len(error) else np.full(len(t), np.nan)
