"""A comparison's folder: its plan, its runs, each stored complete or not at all, and the table of all runs."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.core.files import write_whole, writing
from vstestbed.experiments.comparison.plan import AMOUNT, Comparison, read_comparison
from vstestbed.experiments.comparison.runs import Job
from vstestbed.experiments.comparison.worker import Files
from vstestbed.scenario.load import dump_mapping, text_of

if TYPE_CHECKING:
    import polars

PLAN = "comparison.yaml"
PART = ".part"
"""Suffix of the name of a folder that is being written."""


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
    base = []
    for name in comparison.base:
        if Path(name).is_file():
            with writing(folder):
                (folder / "scenarios").mkdir(exist_ok=True)
            write_whole(folder / "scenarios" / Path(name).name, text_of(Path(name)))
            name = f"scenarios/{Path(name).name}"
        base.append(name)
    write_whole(folder / PLAN, dump_mapping(replace(comparison, base=tuple(base))))


def read_plan(folder: Path) -> Comparison:
    """The comparison of a folder."""
    return read_comparison(folder / PLAN)


def is_done(folder: Path, job: Job) -> bool:
    """Whether a run is stored with a readable summary."""
    try:
        return bool(json.loads((folder / job.folder / "summary.json").read_text(encoding="utf-8")))
    except (OSError, ValueError):
        return False


def store(folder: Path, job: Job, files: Files, attempts: int) -> dict[str, Any]:
    """Write a run's folder under a temporary name, flush it to the disk, and only then rename it. Returns the summary.

    Raises:
        EnvironmentLackError: no space left. OutputError: cannot be written.
    """
    place = folder / job.folder
    part = place.with_name(place.name + PART)
    summary = json.loads(files["summary.json"]) | {"attempts": attempts}
    files = {**files, "summary.json": (json.dumps(summary, indent=1) + "\n").encode()}
    with writing(folder):
        shutil.rmtree(part, ignore_errors=True)  # left over from a comparison that was killed
        for name, content in files.items():
            (part / name).parent.mkdir(parents=True, exist_ok=True)
            with (part / name).open("wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())  # else a power failure could leave a renamed folder with empty files
        _sync(part)
        if place.exists():  # left incomplete: a complete one is never stored again
            shutil.rmtree(place)
        part.rename(place)
        _sync(place.parent)
    return summary


def _sync(folder: Path) -> None:
    """Flush a folder's directory entries to the disk, where the system supports it."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def finished(folder: Path, jobs: Sequence[Job]) -> Iterator[Job]:
    """The jobs that are done, in the order of the plan; the time that it takes depends on how many are done, not on how many there are."""
    there = {p.parent.relative_to(folder).as_posix() for p in folder.glob("runs/*/*/*/summary.json") if p.parent.suffix != PART}
    for job in jobs:
        if not there:
            return
        if job.folder in there:
            there.remove(job.folder)
            if is_done(folder, job):
                yield job


def table_of(folder: Path, jobs: Sequence[Job]) -> polars.DataFrame:
    """One row per finished run, in the order of the plan: scenario, varied values, seed, folder, the summary's names, attempts."""
    import polars as pl

    rows = [_row(folder, job) for job in finished(folder, jobs)]
    # columns in the order of the longest row: a crashed run has only a few of the summary's names
    names = list(dict.fromkeys(name for row in sorted(rows, key=len, reverse=True) for name in row))
    names = [name for name in names if name != "attempts"] + ["attempts"]
    return pl.DataFrame([{name: row.get(name) for name in names} for row in rows], infer_schema_length=None, strict=False)


def _row(folder: Path, job: Job) -> dict[str, Any]:
    summary = json.loads((folder / job.folder / "summary.json").read_text(encoding="utf-8"))
    # a table column holds numbers or text: blocks and lists go in as JSON
    values = {path: value if isinstance(value, int | float | str) else json.dumps(value) for path, value in job.controller.values.items()}
    first = {"scenario": job.controller.scenario.name} | values | {"seed": summary.pop("seed"), "folder": job.folder}
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
    """Write `comparison.csv` and `comparison.parquet`."""
    import io

    parquet = io.BytesIO()
    table.write_parquet(parquet)
    write_whole(folder / "comparison.parquet", parquet.getvalue())
    write_whole(folder / "comparison.csv", table.write_csv())
