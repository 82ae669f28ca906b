"""An earlier comparison as the baseline of a new one: which of its runs are the same, and what changed in them."""

from __future__ import annotations

import io
import json
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vstestbed.core.errors import RunFolderError
from vstestbed.core.files import read_file, write_whole
from vstestbed.studies.comparison.plan import Comparison
from vstestbed.studies.comparison.runs import Job

if TYPE_CHECKING:
    import polars as pl

    from vstestbed.report.comparison.baseline import BaselineChanges
    from vstestbed.report.comparison.columns import Metric

TABLES = ("comparison.parquet", "comparison.csv")
NEEDED = ("scenario", "seed", "outcome", "success")
MOST_NAMED = 6
"""Most controllers of an earlier comparison that a message names."""
WORKS = "give the folder of a comparison, or its comparison.parquet or comparison.csv"
Key = tuple[object, ...]


@dataclass(frozen=True)
class Baseline:
    """The table of an earlier comparison.

    Attributes:
        place: the folder or the file that was given. file: the table's file. table: one row per run.
    """

    place: Path
    file: Path
    table: pl.DataFrame

    @classmethod
    def read(cls, place: str | Path) -> Baseline:
        """The table of a comparison's folder, or of its file.

        Raises:
            RunFolderError: there is none, it cannot be read, or it is not the table of a comparison.
        """
        place = Path(place)
        file = next((place / name for name in TABLES if (place / name).is_file()), place)
        if file.is_dir() or not file.exists():
            raise RunFolderError(place, "holds no comparison's results" if file.is_dir() else "no such folder or file", WORKS)
        table = _table_in(file)
        if missing := [name for name in NEEDED if name not in table.columns]:
            raise RunFolderError(file, f"is no table of a comparison (it has no column {missing[0]})", WORKS)
        return cls(place, file, table)

    def must_match(self, comparison: Comparison, jobs: Iterable[Job]) -> None:
        """Refuse a comparison none of whose runs is in this one: before anything runs.

        Raises:
            RunFolderError: it names the controllers that are in the baseline.
        """
        varied = comparison.varied
        there = set(_rows_by_key(self.table, varied))
        values = ({"scenario": job.controller.scenario.name, **job.controller.values, "seed": _seed_of(job)} for job in jobs)
        if not any(_key(_as_text(row), varied) in there for row in values):
            names = list(dict.fromkeys(map(_words, _controllers(self.table))))
            more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
            words = f"has no run of this comparison; it has {'; '.join(names[:MOST_NAMED])}{more}, seeds {_seeds(self.table)}"
            raise RunFolderError(self.place, words, "compare the same scenarios with the same --vary and --seeds")

    def changes(self, comparison: Comparison, table: pl.DataFrame, folder: Path) -> BaselineChanges:
        """What changed in the runs that both have.

        Args:
            comparison: the new one. table: of its runs. folder: its folder.
        """
        from vstestbed.report.comparison.baseline import BaselineChanges, change_of
        from vstestbed.report.comparison.columns import ComparisonResults, shown_by_default

        results = ComparisonResults(table, comparison.varied, comparison.metrics or shown_by_default(table))
        before = _rows_by_key(self.table, comparison.varied)
        left, only_now, found = dict(before), list[str](), []
        for controller in results.controllers:
            keys = [_key(row, comparison.varied) for row in controller.runs.iter_rows(named=True)]
            here = [i for i, key in enumerate(keys) if left.pop(key, None) is not None]
            if len(here) < len(keys):
                only_now.append(f"{controller.label}, {len(keys) - len(here)} of {len(keys)} runs")
            if here:
                now, then = controller.runs[here], self.table[[before[keys[i]] for i in here]]
                found.append(change_of(controller.label, then, now, _with_time(results.shown), self._settings(then, folder, now)))
        return BaselineChanges(str(self.place), sum(c.runs for c in found), tuple(only_now), self._named(left.values()), tuple(found))

    def _named(self, rows: Iterable[int]) -> tuple[str, ...]:
        """The controllers of some rows, each with how many there are."""
        counted = Counter(map(_words, _controllers(self.table[sorted(rows)])))
        return tuple(f"{name}, {n} run{'s' * (n != 1)}" for name, n in counted.items())

    def _settings(self, then: pl.DataFrame, folder: Path, now: pl.DataFrame) -> tuple[str, ...]:
        """Fields in which the scenario of the first matched run differs; none where one of the two files is not there."""
        from vstestbed.report.comparison.page import differing

        if "folder" not in then.columns:
            return ()
        return differing([self.file.parent / str(then["folder"][0]) / "scenario.yaml", folder / str(now["folder"][0]) / "scenario.yaml"])


def _table_in(file: Path) -> pl.DataFrame:
    import polars as pl

    content = io.BytesIO(read_file(file, WORKS))
    try:
        return pl.read_csv(content, infer_schema_length=None) if file.suffix == ".csv" else pl.read_parquet(content)
    except (pl.exceptions.PolarsError, OSError) as error:
        raise RunFolderError(file, f"is no table of a comparison ({str(error).splitlines()[0]})", WORKS) from None


def write_changes(folder: Path, changes: BaselineChanges) -> None:
    """Write `baseline.json`."""
    from vstestbed.report.comparison.baseline import FILE

    write_whole(folder / FILE, json.dumps(changes.plain(), indent=1) + "\n")


def _with_time(shown: Sequence[Metric]) -> list[Metric]:
    """The metrics that are shown, and the time to converge."""
    from vstestbed.report.comparison.pairs import TIME

    return list({m.name: m for m in (*shown, TIME)}.values())


def _rows_by_key(table: pl.DataFrame, varied: Sequence[str]) -> dict[Key, int]:
    """The row of each run; none where the two comparisons vary different fields."""
    if set(_named(table)) != {"scenario", *varied}:
        return {}
    rows = table.select("scenario", *varied, "seed").iter_rows(named=True)
    return {_key(row, varied): i for i, row in enumerate(rows)}


def _key(row: Mapping[str, Any], varied: Sequence[str]) -> Key:
    return (row["scenario"], *(_norm(row[name]) for name in varied), _norm(row["seed"]))


def _norm(value: object) -> object:
    """A value as tables compare it: a number is the same in a column of numbers and in one of texts."""
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    try:
        return float(str(value))
    except ValueError:
        return str(value)


def _as_text(row: Mapping[str, Any]) -> dict[str, Any]:
    """A planned run's values as in a table: blocks and lists as JSON."""
    return {name: value if isinstance(value, int | float | str) else json.dumps(value) for name, value in row.items()}


def _seed_of(job: Job) -> int:
    return job.controller.scenario.seed if job.seed is None else job.seed


def _named(table: pl.DataFrame) -> list[str]:
    """The columns that name a controller, which stand before the seed: the scenario and what is varied."""
    return table.columns[: table.columns.index("seed")]


def _controllers(table: pl.DataFrame) -> list[dict[str, Any]]:
    """The controller of each run."""
    return table.select(_named(table)).to_dicts()


def _words(row: Mapping[str, Any]) -> str:
    return ", ".join([str(row["scenario"]), *(f"{name}={value}" for name, value in row.items() if name != "scenario")])


def _seeds(table: pl.DataFrame) -> str:
    seeds = sorted(set(table["seed"].to_list()))
    return f"{seeds[0]} to {seeds[-1]}" if len(seeds) > 1 else ", ".join(map(str, seeds))
