"""A comparison's folder: its plan, its runs, each stored complete or not at all, and the table of all runs."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shlex
import shutil
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.core.files import make_folder, temporary, write_whole, writing
from vstestbed.core.registry import to_mapping
from vstestbed.core.shares import Call, at_once
from vstestbed.loop.recording import read_summary
from vstestbed.report.comparison.baseline import BaselineChanges
from vstestbed.scenario.dump import as_yaml
from vstestbed.scenario.load import for_another_folder
from vstestbed.scenario.yaml_marks import read_value
from vstestbed.studies.comparison.plan import AMOUNT, Comparison, read_comparison
from vstestbed.studies.comparison.pools import Files
from vstestbed.studies.comparison.runs import Job
from vstestbed.studies.run_folder import ASSETS

if TYPE_CHECKING:
    import polars

PLAN = "comparison.yaml"
GROUP = 10_000
"""Runs of a row group of the table, and rows that are in memory as dictionaries."""
DEEPEST = 5
"""Folders below `runs`: scenario, variant and seed, each of the last two in one of a thousand where there are more (`among`)."""


def resumable(out: Path | None) -> Path:
    """The folder of a comparison that can be resumed.

    Raises:
        ParameterError: no folder is given. RunFolderError: the folder holds no comparison.
    """
    if out is None:
        raise ParameterError("--resume", "needs the comparison's folder: --out DIR")
    if not (out / PLAN).is_file():
        raise RunFolderError(out, "no comparison here" if out.is_dir() else "no such folder")
    return out


def write_plan(folder: Path, comparison: Comparison) -> None:
    """Write `comparison.yaml`, with which `vstestbed compare` repeats the comparison, and copies of its scenario files."""
    base = tuple(kept_base(folder, name) for name in comparison.base)
    write_whole(folder / PLAN, as_yaml(to_mapping(replace(comparison, base=base))))


def kept_base(folder: Path, name: str) -> str:
    """The name of a scenario for a plan in `folder`; one that is a file is copied there."""
    if not Path(name).is_file():
        return name
    write_whole(make_folder(folder / "scenarios") / Path(name).name, for_another_folder(Path(name)))
    return f"scenarios/{Path(name).name}"


def read_plan(folder: Path, plugins: Sequence[str] = ()) -> Comparison:
    """The comparison of a folder; `plugins`: see `read_comparison`."""
    return read_comparison(folder / PLAN, plugins)


def summary_of(folder: Path, job: Job) -> dict[str, Any]:
    """The summary of a stored run.

    Raises:
        RunFolderError: the run is missing, or its summary is damaged.
    """
    return read_summary(folder / job.folder, f"`vstestbed compare --resume --out {folder}` does the run again")


def store(folder: Path, job: Job, files: Files, attempts: int) -> dict[str, Any]:
    """Write a run's folder under a temporary name, flush it to the disk, and only then rename it. Returns the summary.

    Raises:
        EnvironmentLackError: no space left. OutputError: cannot be written.
    """
    place = folder / job.folder
    summary = json.loads(files["summary.json"]) | {"attempts": attempts}
    files = {**files, "summary.json": (json.dumps(summary, indent=1) + "\n").encode()}
    with writing(folder):
        for left in place.parent.glob(f"{place.name}.*.part"):  # over from a comparison that was killed
            shutil.rmtree(left, ignore_errors=True)
        part = temporary(place)
        part.mkdir(parents=True)
        for name, content in files.items():
            (part / name).parent.mkdir(parents=True, exist_ok=True)
            if not (name.startswith(f"{ASSETS}/") and _linked(folder, part / name, content)):
                write_whole(part / name, content)
        _sync(part)
        if place.is_symlink():
            place.unlink()
        elif place.exists():  # left incomplete: a complete one is never stored again
            shutil.rmtree(place)
        part.rename(place)
        _sync(place.parent)
    return summary


def _linked(folder: Path, path: Path, content: bytes) -> bool:
    """Whether a mesh or texture could be stored as a link to the comparison's only copy of it: those of one arm are some 10 MB a run."""
    kept = folder / ASSETS / f"{zlib.crc32(content):08x}_{path.name}"
    try:
        if not kept.exists():
            kept.parent.mkdir(exist_ok=True)
            write_whole(kept, content)
        os.link(kept, path)
    except OSError:  # a file system without hard links
        return False
    return True


def _sync(folder: Path) -> None:
    """Flush a folder's directory entries to the disk, where the system supports it."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def finished(folder: Path, jobs: Iterable[Job], damaged: bool = True) -> Iterator[Job]:
    """The jobs that are done, in the order of the plan; the time that it takes depends on how many are done, not on how many there are.

    Args:
        folder: the comparison's. jobs: all of them. damaged: leave out runs whose summary cannot be read, which are done again.

    Raises:
        RunFolderError: a summary cannot be read, and `damaged` is False.
    """
    yield from (job for job, _ in _summaries(folder, jobs, damaged))


def _summaries(folder: Path, jobs: Iterable[Job], damaged: bool) -> Iterator[tuple[Job, dict[str, Any]]]:
    """As `finished`, with the summaries."""
    there = set(_with_summary(str(folder), "runs", DEEPEST)) if (folder / "runs").is_dir() else set[str]()
    for job in jobs:
        if not there:
            return
        if job.folder in there:
            there.remove(job.folder)
            with contextlib.suppress(*([RunFolderError] if damaged else [])):
                yield job, summary_of(folder, job)


def _with_summary(folder: str, place: str, depth: int) -> Iterator[str]:
    """The folders of runs with a summary below `place` in a comparison's folder, down to a depth."""
    with os.scandir(f"{folder}/{place}") as found:
        for entry in found:
            if Path(f"{entry.path}/summary.json").exists():  # faster than to list a run's folder
                if not entry.name.endswith(".part"):
                    yield f"{place}/{entry.name}"
            elif depth > 1 and entry.is_dir():
                yield from _with_summary(folder, f"{place}/{entry.name}", depth - 1)


def table_of(folder: Path, jobs: Iterable[Job], damaged: bool = True) -> polars.DataFrame:
    """One row per finished run, in the order of the plan: scenario, varied values, seed, folder, the summary's names, attempts.

    `damaged`: see `finished`.
    """
    import polars as pl

    # Some thousands of rows at a time: as dictionaries they take twenty times the memory of a table.
    found, parts = _summaries(folder, jobs, damaged), list[pl.DataFrame]()
    while rows := [_row(job, summary) for job, summary in itertools.islice(found, GROUP)]:
        names = _names(rows)
        filled = [dict(zip(names, map(row.get, names), strict=True)) for row in rows]
        parts.append(pl.DataFrame(filled, infer_schema_length=None, strict=False))
    if not parts:
        return pl.DataFrame()
    table = pl.concat(parts, how="diagonal_relaxed")
    longest = max(parts, key=lambda part: part.width).columns
    return table.select(*(name for name in dict.fromkeys([*longest, *table.columns]) if name != "attempts"), "attempts")


def _names(rows: list[dict[str, Any]]) -> list[str]:
    """Columns in the order of the longest row: a crashed run has only a few of the summary's names."""
    return list(dict.fromkeys(name for row in sorted(rows, key=len, reverse=True) for name in row))


def _row(job: Job, summary: dict[str, Any]) -> dict[str, Any]:
    # a table column holds numbers or text: blocks and lists go in as JSON
    values = {path: value if isinstance(value, int | float | str) else json.dumps(value) for path, value in job.controller.values.items()}
    first = {"scenario": job.controller.scenario.name} | values | {"seed": summary.pop("seed", job.seed), "folder": job.folder}
    if job.controller.amounts and job.seed is not None:
        first |= {AMOUNT: job.controller.amounts[job.seed]}
    return first | _flat(summary, "")


def _flat(block: Mapping[str, Any], before: str) -> dict[str, Any]:
    """A nested mapping flattened, its keys joined by dots."""
    flat: dict[str, Any] = {}
    for name, value in block.items():
        flat |= _flat(value, f"{before}{name}.") if isinstance(value, dict) else {f"{before}{name}": value}
    return flat


def write_table(folder: Path, table: polars.DataFrame) -> None:
    """Write `comparison.csv` and `comparison.parquet`, the latter in row groups of GROUP runs."""
    import io

    parquet = io.BytesIO()
    table.write_parquet(parquet, row_group_size=GROUP)
    write_whole(folder / "comparison.parquet", parquet.getvalue())
    write_whole(folder / "comparison.csv", table.write_csv())


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
    def of(cls, table: pl.DataFrame, folder: Path, comparison: Comparison, baseline: BaselineChanges | None = None) -> ComparisonTable:
        """The table of a comparison's folder."""
        made = cls(table)
        made.folder, made.comparison, made.baseline = folder, comparison, baseline
        return made

    def _repr_html_(self, **as_polars: bool) -> str:
        """Who is better, the controllers' numbers and their differences, where a Jupyter notebook shows the table."""
        from vstestbed.report.comparison.page import comparison_cell

        return comparison_cell(self.folder, self, self.comparison.varied, self.comparison.metrics)


# Results of a comparison beside its runs: the side-by-side film of one seed, and the report.
FILM = "comparison.mp4"
FILMS = ("overview.mp4", "camera.mp4")
"""Films of a run, from top to bottom of its column."""


def finish(folder: Path, comparison: Comparison, table: polars.DataFrame, stage: Callable[[str], None], call: Call | None = None) -> None:
    """Make film and report of the finished runs; nothing if there is none.

    Args:
        folder: the comparison's. comparison: its plan. table: of its runs. stage: called with what is being done.
        call: does shares of the work at the same time, in other processes.

    Raises:
        OutputError, EnvironmentLackError: a file cannot be written.
    """
    from vstestbed.report.comparison.columns import shown_by_default
    from vstestbed.report.comparison.page import write_comparison_report

    call = call or at_once
    if table.is_empty():
        return
    axes = comparison.varied
    if comparison.tasks:
        from vstestbed.report.comparison.tasks import write_task_report

        stage("writing the report")
        write_task_report(folder, table, axes, comparison.metrics, comparison.description, command_of(comparison), call)
        return
    stage("joining the films")
    film = call(_film, folder, table, axes)  # first: it takes longest
    stage("writing the report")
    metrics, command = comparison.metrics or shown_by_default(table), command_of(comparison)
    write_comparison_report(folder, table, axes, metrics, comparison.description, command, film, comparison.plugins, call)


def _film(folder: Path, table: polars.DataFrame, axes: tuple[str, ...]) -> Path | None:
    """Make `comparison.mp4`: the first filmed run of each controller, up to six controllers; None if there are no films."""
    from vstestbed.report.comparison.columns import ComparisonResults
    from vstestbed.report.video.side_by_side import MOST, Column, side_by_side

    columns = []
    for controller in ComparisonResults(table, axes).controllers[:MOST]:
        # crashed runs have no films
        run = next((row for row in controller.runs.iter_rows(named=True) if _films(folder / row["folder"])), None)
        if run is not None:
            # the time to converge, as everywhere; a run that does not has the time at which it ended
            time_s = run["sim_time_s"] if run["time_to_converge_s"] is None else run["time_to_converge_s"]
            ending = run["outcome"] if time_s is None else f"{run['outcome']} {time_s:.1f} s"
            columns.append(Column(controller.label, _films(folder / run["folder"]), ending, bool(run["success"])))
    return side_by_side(columns, folder / FILM) if columns else None


def _films(run: Path) -> tuple[Path, ...]:
    return tuple(run / name for name in FILMS if (run / name).is_file())


def command_of(comparison: Comparison) -> str:
    """The command line that repeats a comparison; cases and tasks have no options, so that they need the plan in its folder."""
    if comparison.cases or comparison.tasks:
        return "vstestbed compare comparison.yaml"
    names = [Path(name).stem if Path(name).suffix != ".yaml" else Path(name).name for name in comparison.base]
    words = ["vstestbed", "compare", *names, *(f"--plugin={name}" for name in comparison.plugins)]
    options = [("--set", f"{path}={_value(value)}") for path, value in comparison.set.items()]
    options += [("--vary", f"{path}={','.join(map(_value, values))}") for path, values in comparison.axes.items()]
    options += [] if comparison.seeds is None else [("--seeds", str(comparison.seeds))]
    return shlex.join(chain(words, *options))


def _value(value: object) -> str:
    """A value in YAML's flow style."""
    if isinstance(value, bool) or value is None:  # before numbers: bool is an int
        return {True: "true", False: "false", None: "null"}[value]
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    plain = str(value)  # quoted only where YAML would read it as something else, such as `on` or `1`
    return json.dumps(value) if isinstance(value, str) and read_value(f"[{plain}]") != [value] else plain
