"""Trials of a search: their settings, what their runs gave, and which of two is better."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vstestbed.core.errors import RunFolderError
from vstestbed.core.files import read_file, write_whole
from vstestbed.report.comparison.columns import Metric

RECORD = "trials.json"


@dataclass(frozen=True)
class Trial:
    """A setting, and what its runs gave.

    Attributes:
        number: from 0 on; None for the scenario as it is, where that is no trial. values: by dotted path.
        outcomes: how each run ended. reached: whether it reached the goal.
        found: the metric of each run in its display unit, NaN where it has none.
        refused: why the scenario does not take the setting; "" where it does.
    """

    number: int | None
    values: dict[str, object]
    outcomes: tuple[str, ...] = ()
    reached: tuple[bool, ...] = ()
    found: tuple[float, ...] = ()
    refused: str = ""

    @classmethod
    def of(cls, number: int | None, values: Mapping[str, object], summaries: Sequence[Mapping[str, Any]], metric: Metric) -> Trial:
        """The trial with the summaries of its runs."""
        numbers = (one.get(metric.name) for one in summaries)
        found = tuple(math.nan if not isinstance(x, int | float) else x * metric.scale for x in numbers)
        return cls(number, dict(values), tuple(s["outcome"] for s in summaries), tuple(bool(s["success"]) for s in summaries), found)

    @property
    def failed(self) -> int:
        """Runs that did not reach the goal."""
        return len(self.reached) - sum(self.reached)

    @property
    def mean(self) -> float:
        """Mean of the metric over the runs that reached the goal; NaN where none has it."""
        known = [x for x, good in zip(self.found, self.reached, strict=True) if good and math.isfinite(x)]
        return sum(known) / len(known) if known else math.nan

    def rank(self, higher: bool) -> tuple[float, float]:
        """Less is better: first the failed runs, then the mean of the metric. A failure outweighs any number.

        Args:
            higher: whether more of the metric is better.
        """
        mean = -self.mean if higher else self.mean
        return (math.inf if self.refused else self.failed, mean if math.isfinite(mean) else math.inf)

    def score(self, higher: bool, runs: int) -> float:
        """`rank` as one number, for a search that only orders them: the failed runs, and the mean squeezed into 0 to 1 by x / (1 + |x|)."""
        failed, mean = self.rank(higher)
        squeezed = 1.0 if math.isinf(mean) else 0.5 + 0.5 * mean / (1 + abs(mean))
        return min(failed, runs + 1) + squeezed


def best_of(trials: Sequence[Trial], higher: bool) -> Trial | None:
    """The best trial, of equal ones the first; None where no run of any reached the goal."""
    ranked = min(trials, key=lambda trial: trial.rank(higher), default=None)
    return ranked if ranked is not None and any(ranked.reached) else None


def write_record(folder: Path, settings: Sequence[Mapping[str, object]]) -> None:
    """Write the settings of all trials so far: before their runs begin, so that an interrupted search goes on with the same."""
    write_whole(folder / RECORD, json.dumps([{"number": i, "values": dict(values)} for i, values in enumerate(settings)], indent=1) + "\n")


def read_record(folder: Path, paths: Sequence[str]) -> list[dict[str, object]]:
    """The settings of the trials so far; none where there is no record.

    Raises:
        RunFolderError: it is damaged.
    """
    path, works = folder / RECORD, "start again in a new folder"
    if not path.exists():
        return []
    try:
        found = [one["values"] for one in json.loads(read_file(path, works))]
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise RunFolderError(path, f"is damaged ({error})", works) from None
    if any(set(values) != set(paths) for values in found):
        raise RunFolderError(path, "has settings of other fields than tuning.yaml varies", works)
    return found
