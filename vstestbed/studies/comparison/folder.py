"""A comparison's folder: its runs, each stored complete or not at all, the table of all runs, its
results, an earlier one as baseline.
"""

from __future__ import annotations

import contextlib
import io
import itertools
import json
import os
import shlex
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import polars as pl

from vstestbed.core.errors import RunFolderError
from vstestbed.core.files import read_file
from vstestbed.core.foreign import foreign
from vstestbed.core.shares import Call, at_once
from vstestbed.loop.recording import read_summary
from vstestbed.report.comparison.baseline import BaselineChanges, ControllerChange, change_of
from vstestbed.report.comparison.results import TIME, ComparisonResults, shown_by_default
from vstestbed.scenario.dump import flow_text
from vstestbed.studies.comparison.plan import AMOUNT, TASK, Comparison, Job, Variant
from vstestbed.studies.comparison.record import moved_plugins
from vstestbed.studies.comparison.tuning_record import settings_of

__all__ = [
    "GROUP",
    "Baseline",
    "ComparisonTable",
    "finish",
    "finished",
    "must_have_reference",
    "stored_runs",
    "summary_of",
    "table_of",
]

GROUP = 10_000  # runs of a row group of the table, and rows that are in memory as dictionaries
# folders below `runs`: scenario, variant and seed, each of the last two in one of a thousand where
# there are more (`among`)
DEEPEST = 5


def summary_of(folder: Path, job: Job) -> dict[str, Any]:
    """The summary of a stored run. Raises RunFolderError: the run is missing, or its summary is
    damaged.
    """
    return read_summary(
        folder / job.folder, f"`vstestbed compare --resume --out {folder}` does the run again"
    )


def finished(
    folder: Path, jobs: Iterable[Job], damaged: bool = True
) -> Iterator[tuple[Job, dict[str, Any]]]:
    """The jobs that are done, with their summaries, in the order of the plan, in a time that
    depends on how many are done.

    folder: the comparison's. jobs: all of them. damaged: leave out runs whose summary cannot be
    read, which are done again. Raises
    RunFolderError: a summary cannot be read, and `damaged` is False.
    """
    there = stored_runs(folder)
    for job in jobs:
        if not there:
            return
        if job.folder in there:
            there.remove(job.folder)
            with contextlib.suppress(*([RunFolderError] if damaged else [])):
                yield job, summary_of(folder, job)


def stored_runs(folder: Path) -> set[str]:
    """The folders of all runs in a comparison's folder that have a summary."""
    return set(_with_summary(str(folder), "runs", DEEPEST)) if (folder / "runs").is_dir() else set()


def _with_summary(folder: str, place: str, depth: int) -> Iterator[str]:
    """The folders of runs with a summary below `place` in a comparison's folder,
    down to a depth.
    """
    with os.scandir(f"{folder}/{place}") as found:
        for entry in found:
            if Path(f"{entry.path}/summary.json").exists():  # faster than to list a run's folder
                if not entry.name.endswith(".part"):
                    yield f"{place}/{entry.name}"
            elif depth > 1 and entry.is_dir():
                yield from _with_summary(folder, f"{place}/{entry.name}", depth - 1)


def table_of(folder: Path, jobs: Iterable[Job], damaged: bool = True) -> pl.DataFrame:
    """A row per `finished` run, in the order of the plan: scenario, varied values, seed, folder,
    the summary's names, attempts.
    """
    # Some thousands of rows at a time: as dictionaries they take twenty times the memory of a
    # table.
    found, parts = finished(folder, jobs, damaged), list[pl.DataFrame]()
    while rows := [_row(job, summary) for job, summary in itertools.islice(found, GROUP)]:
        # in the order of the longest row: a crashed run has only a few of the summary's names
        names = list(
            dict.fromkeys(name for row in sorted(rows, key=len, reverse=True) for name in row)
        )
        filled = [dict(zip(names, map(row.get, names), strict=True)) for row in rows]
        parts.append(pl.DataFrame(filled, infer_schema_length=None, strict=False))
    if not parts:
        return pl.DataFrame()
    table = pl.concat(parts, how="diagonal_relaxed")
    longest = max(parts, key=lambda part: part.width).columns
    return table.select(
        *(name for name in dict.fromkeys([*longest, *table.columns]) if name != "attempts"),
        "attempts",
    )


def _row(job: Job, summary: dict[str, Any]) -> dict[str, Any]:
    first = (
        {"scenario": job.controller.scenario.name}
        | _as_text(job.controller.values)
        | {"seed": summary.pop("seed", job.seed), "folder": job.folder}
    )
    if job.controller.amounts and job.seed is not None:
        first |= {AMOUNT: job.controller.amounts[job.seed]}
    return first | _flat(summary, "")


def _flat(block: Mapping[str, Any], before: str) -> dict[str, Any]:
    """A nested mapping flattened, its keys joined by dots."""
    flat: dict[str, Any] = {}
    for name, value in block.items():
        flat |= (
            _flat(value, f"{before}{name}.")
            if isinstance(value, dict)
            else {f"{before}{name}": value}
        )
    return flat


# The table of a comparison as its caller gets it; it shows its result in a notebook.
class ComparisonTable(pl.DataFrame):
    """A polars table, one row per run; what is computed from it is an ordinary table.

    Attributes:
        folder: of the comparison. comparison: what was compared.
        baseline: what changed against an earlier comparison; None where none was named.
    """

    folder: Path
    comparison: Comparison
    baseline: BaselineChanges | None

    @classmethod
    def of(
        cls,
        table: pl.DataFrame,
        folder: Path,
        comparison: Comparison,
        baseline: BaselineChanges | None = None,
    ) -> ComparisonTable:
        """The table of a comparison's folder."""
        made = cls(table)
        made.folder, made.comparison, made.baseline = folder, comparison, baseline
        return made

    def _repr_html_(self, **as_polars: bool) -> str:
        """Who is better, the controllers' numbers and their differences, where a Jupyter notebook
        shows the table.
        """
        from vstestbed.report.comparison.page import comparison_cell

        return comparison_cell(self.folder, results_of(self, self.comparison))


# Results of a comparison beside its runs: the side-by-side film of one seed, and the report.
FILM = "comparison.mp4"
FILMS = ("overview.mp4", "camera.mp4")  # films of a run, from top to bottom of its column


def finish(
    folder: Path,
    comparison: Comparison,
    table: pl.DataFrame,
    stage: Callable[[str], None],
    call: Call = at_once,
    paper: bool = False,
) -> None:
    """Make film and report of the finished runs; nothing if there is none.

    folder: the comparison's. comparison: its plan. table: of its runs. stage: called with what is
    being done. call: does shares of the work at the same time, in other processes. paper: whether
    to draw the figures for a paper as well. Raises OutputError, EnvironmentLackError: a file cannot
    be written.
    """
    from vstestbed.report.comparison.page import Drawing, write_comparison_report

    if table.is_empty():
        return
    drawing = Drawing(call, paper)
    if comparison.tasks:
        from vstestbed.report.comparison.tasks import write_task_report

        stage("writing the report")
        write_task_report(folder, results_of(table, comparison), command_of(comparison), drawing)
        return
    stage("joining the films")
    plugins = (*comparison.plugins, *moved_plugins(folder, comparison.plugins))
    film = call(_film, folder, table, comparison.varied)  # first: it takes longest
    stage("writing the report")
    write_comparison_report(
        folder, results_of(table, comparison), command_of(comparison), film, plugins, drawing
    )


def must_have_reference(comparison: Comparison, found: Iterable[Variant]) -> None:
    """Refuse a reference that is none of the controllers, before anything runs. Raises
    ParameterError: with their names.
    """
    if comparison.reference:
        rows = [
            {"scenario": variant.scenario.name, **_as_text(variant.values), "seed": 0}
            for variant in found
        ]
        axes = tuple(axis for axis in comparison.varied if axis != TASK)
        planned = ComparisonResults(
            pl.DataFrame(rows, infer_schema_length=None, strict=False),
            axes,
            reference=comparison.reference,
        )
        _ = planned.reference_index


def results_of(table: pl.DataFrame, comparison: Comparison) -> ComparisonResults:
    """The results of a comparison as its report shows them."""
    metrics = comparison.metrics or (() if comparison.tasks else shown_by_default(table))
    names = (
        comparison.varied,
        metrics,
        comparison.description,
        comparison.primary,
        comparison.reference,
    )
    return ComparisonResults(
        table, *names, margin=comparison.margin, settings=settings_of(comparison)
    )


def _film(folder: Path, table: pl.DataFrame, axes: tuple[str, ...]) -> Path | None:
    """Make `comparison.mp4`: the first filmed run of each controller, up to six controllers; None
    if there are no films.
    """
    from vstestbed.report.video.side_by_side import MOST, Column, side_by_side

    columns = []
    for controller in ComparisonResults(table, axes).controllers[:MOST]:
        # crashed runs have no films
        run = next(
            (
                row
                for row in controller.runs.iter_rows(named=True)
                if _films(folder / row["folder"])
            ),
            None,
        )
        if run is not None:
            # the time to converge, as everywhere; a run that does not has the time at which it
            # ended
            time_s = (
                run["sim_time_s"]
                if run["time_to_converge_s"] is None
                else run["time_to_converge_s"]
            )
            ending = run["outcome"] if time_s is None else f"{run['outcome']} {time_s:.1f} s"
            columns.append(
                Column(
                    controller.label, _films(folder / run["folder"]), ending, bool(run["success"])
                )
            )
    return side_by_side(columns, folder / FILM) if columns else None


def _films(run: Path) -> tuple[Path, ...]:
    return tuple(run / name for name in FILMS if (run / name).is_file())


def command_of(comparison: Comparison) -> str:
    """The command line that repeats a comparison; cases and tasks have no options, so that they
    need the plan in its folder.
    """
    if comparison.cases or comparison.tasks:
        return "vstestbed compare comparison.yaml"
    names = [
        Path(name).stem if Path(name).suffix != ".yaml" else Path(name).name
        for name in comparison.base
    ]
    words = ["vstestbed", "compare", *names, *(f"--plugin={name}" for name in comparison.plugins)]
    options = [("--set", f"{path}={flow_text(value)}") for path, value in comparison.set.items()]
    options += [
        ("--vary", f"{path}={flow_text(list(values))[1:-1]}")
        for path, values in comparison.axes.items()
    ]
    single = {
        "--seeds": comparison.seeds,
        "--first-seed": comparison.first_seed,
        "--primary": comparison.primary,
        "--reference": comparison.reference,
    }
    options += [(option, str(value)) for option, value in single.items() if value]
    return shlex.join(chain(words, *options))


# An earlier comparison as the baseline of a new one: which of its runs are the same, and what
# changed in them.
TABLES = ("comparison.parquet", "comparison.csv")
NEEDED = ("scenario", "seed", "outcome", "success")
MOST_NAMED = 6  # most controllers of an earlier comparison that a message names
WORKS = "give the folder of a comparison, or its comparison.parquet or comparison.csv"
Key = tuple[object, ...]


@dataclass(frozen=True)
class Baseline:
    """The table of an earlier comparison.

    Attributes:
        place: the folder or the file that was given. file: the table's file. table: one row per
            run.
    """

    place: Path
    file: Path
    table: pl.DataFrame

    @classmethod
    def read(cls, place: str | Path) -> Baseline:
        """The table of a comparison's folder, or of its file."""
        place = Path(place)
        file = next((place / name for name in TABLES if (place / name).is_file()), place)
        if file.is_dir() or not file.exists():
            raise RunFolderError(
                place,
                "holds no comparison's results" if file.is_dir() else "no such folder or file",
                WORKS,
            )
        content = io.BytesIO(read_file(file, WORKS))
        with foreign(file, WORKS, RunFolderError):
            table = (
                pl.read_csv(content, infer_schema_length=None)
                if file.suffix == ".csv"
                else pl.read_parquet(content)
            )
        if missing := [name for name in NEEDED if name not in table.columns]:
            raise RunFolderError(
                file, f"is no table of a comparison (it has no column {missing[0]})", WORKS
            )
        return cls(place, file, table)

    def must_match(self, comparison: Comparison, jobs: Iterable[Job]) -> None:
        """Refuse a comparison none of whose runs is in this one: before anything runs."""
        varied = comparison.varied
        there = set(_rows_by_key(self.table, varied))
        planned = ((job.controller, job.controller.scenario, job.seed) for job in jobs)
        rows = (
            {"scenario": s.name, **c.values, "seed": s.seed if seed is None else seed}
            for c, s, seed in planned
        )
        if not any(_key(_as_text(row), varied) in there for row in rows):
            names = list(dict.fromkeys(map(_words, _controllers(self.table))))
            more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
            seeds = sorted(set(self.table["seed"].to_list()))
            of = f"{seeds[0]} to {seeds[-1]}" if len(seeds) > 1 else ", ".join(map(str, seeds))
            words = (
                "has no run of this comparison;"
                f" it has {'; '.join(names[:MOST_NAMED])}{more}, seeds {of}"
            )
            raise RunFolderError(
                self.place, words, "compare the same scenarios with the same --vary and --seeds"
            )

    def changes(self, comparison: Comparison, table: pl.DataFrame, folder: Path) -> BaselineChanges:
        """What changed in the runs that both have. comparison: the new one. table: of its runs.
        folder: its folder.
        """
        shown = comparison.metrics or shown_by_default(table)
        results = ComparisonResults(table, comparison.varied, shown)
        metrics = list({m.name: m for m in (*results.shown, TIME)}.values())
        before = _rows_by_key(self.table, comparison.varied)
        left = dict(before)
        only_now, found = list[str](), list[ControllerChange]()
        for controller in results.controllers:
            keys = [_key(row, comparison.varied) for row in controller.runs.iter_rows(named=True)]
            here = [i for i, key in enumerate(keys) if left.pop(key, None) is not None]
            if len(here) < len(keys):
                only_now.append(f"{controller.label}, {len(keys) - len(here)} of {len(keys)} runs")
            if not here:
                continue
            now = controller.runs[here]
            then = self.table[[before[keys[i]] for i in here]]
            settings = self._settings(then, folder, now)
            found.append(change_of(controller.label, then, now, metrics, settings))
        gone = self._named(left.values())
        total = sum(each.runs for each in found)
        return BaselineChanges(str(self.place), total, tuple(only_now), gone, tuple(found))

    def _named(self, rows: Iterable[int]) -> tuple[str, ...]:
        """The controllers of some rows, each with how many there are."""
        counted = Counter(map(_words, _controllers(self.table[sorted(rows)])))
        return tuple(f"{name}, {n} run{'s' * (n != 1)}" for name, n in counted.items())

    def _settings(self, then: pl.DataFrame, folder: Path, now: pl.DataFrame) -> tuple[str, ...]:
        """Fields in which the scenario of the first matched run differs; none where one of the two
        files is not there.
        """
        from vstestbed.report.comparison.page import differing

        if "folder" not in then.columns:
            return ()
        return differing(
            [self.file.parent / str(then["folder"][0]), folder / str(now["folder"][0])]
        )


def _rows_by_key(table: pl.DataFrame, varied: Sequence[str]) -> dict[Key, int]:
    """The row of each run; none where the two comparisons vary different fields."""
    if set(_named(table)) != {"scenario", *varied}:
        return {}
    rows = table.select("scenario", *varied, "seed").iter_rows(named=True)
    return {_key(row, varied): i for i, row in enumerate(rows)}


def _key(row: Mapping[str, Any], varied: Sequence[str]) -> Key:
    return (row["scenario"], *(_norm(row[name]) for name in varied), _norm(row["seed"]))


def _norm(value: object) -> object:
    """A value as tables compare it: a number is the same in a column of numbers and in one of
    texts.
    """
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    try:
        return float(str(value))
    except ValueError:
        return str(value)


def _as_text(row: Mapping[str, Any]) -> dict[str, Any]:
    """A planned run's values as in a table, whose columns hold numbers or text: blocks and lists as
    JSON.
    """
    return {
        name: value if isinstance(value, int | float | str) else json.dumps(value)
        for name, value in row.items()
    }


def _named(table: pl.DataFrame) -> list[str]:
    """The columns that name a controller, which stand before the seed: the scenario and what is
    varied.
    """
    return table.columns[: table.columns.index("seed")]


def _controllers(table: pl.DataFrame) -> list[dict[str, Any]]:
    return table.select(_named(table)).to_dicts()


def _words(row: Mapping[str, Any]) -> str:
    return ", ".join(
        [
            str(row["scenario"]),
            *(f"{name}={value}" for name, value in row.items() if name != "scenario"),
        ]
    )
