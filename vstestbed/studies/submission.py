"""A submission to the suite: one file with a law, its results and where they were flown; and a drawn part of it flown again."""

from __future__ import annotations

import io
import json
import secrets
import zipfile
from contextlib import closing
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
import polars as pl

from vstestbed.core.errors import RunFolderError
from vstestbed.core.files import make_folder, write_whole
from vstestbed.loop.isolated import offered
from vstestbed.report.scores import Score
from vstestbed.studies.comparison.folder import table_of
from vstestbed.studies.comparison.plan import Job, Jobs, controllers
from vstestbed.studies.comparison.record import LEAST, TOLERANCE, environment
from vstestbed.studies.comparison.runs import Runner
from vstestbed.studies.pools import pool_of, workers
from vstestbed.studies.suite import SuiteEntry, opened

ABOUT, RUNS, LAW_FOLDER = "suite.json", "runs.csv", "law"
SHARE = 0.1  # of the runs of the law that is checked


class Checked(NamedTuple):
    """Runs that were flown again: how many, and in words those that ended otherwise; the law's scores, beside the suite's own, as handed
    in.
    """

    runs: int
    otherwise: tuple[str, ...]
    scores: list[Score]


def pack(folder: Path, out: Path) -> Path:
    """Pack a suite's folder into one file: what was flown, the law's files, each run, the scores, versions and machine.
    Raises RunFolderError: the folder has no finished suite, or the law's file is not a law of one's own.
    """
    for name in (ABOUT, RUNS, "scores.csv"):
        if not (folder / name).is_file():
            raise RunFolderError(folder, f"has no {name}", "`vstestbed suite LAW_FILE --out DIR` makes one")
    law = sorted((folder / LAW_FOLDER).rglob("*")) if (folder / LAW_FOLDER).is_dir() else []
    if not law:
        raise RunFolderError(folder, "has the suite's own laws alone", "fly a law of your own: `vstestbed suite LAW_FILE --out DIR`")
    files = [folder / ABOUT, folder / RUNS, folder / "scores.csv", *(path for path in law if path.is_file())]
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as packed:
        for path in files:
            packed.write(path, path.relative_to(folder).as_posix())
        packed.writestr("environment.json", json.dumps(environment(), indent=1) + "\n")
    write_whole(out, content.getvalue())
    return out


def unpacked(file: Path, into: Path) -> tuple[SuiteEntry, pl.DataFrame]:
    """The suite of a submission with its law alone, and its runs as they were handed in. Its code is not run here.
    Raises RunFolderError: it is no submission, or of another suite than this one.
    """
    try:
        with zipfile.ZipFile(file) as packed:
            names = [PurePosixPath(name) for name in packed.namelist() if name.startswith(f"{LAW_FOLDER}/")]
            if away := [name for name in names if ".." in name.parts or not name.name or "\\" in str(name)]:
                raise ValueError(f"{away[0]} leads out of its folder")
            about, given = json.loads(packed.read(ABOUT)), pl.read_csv(packed.read(RUNS))
            named = Path(about["file"]).name, about["suite"], about["quick"], about["word"], about["sha256"]
            for name in names:
                place = into / name.relative_to(LAW_FOLDER)
                write_whole(make_folder(place.parent) / place.name, packed.read(str(name)))
    except (OSError, KeyError, TypeError, ValueError, zipfile.BadZipFile, pl.exceptions.PolarsError) as error:
        raise RunFolderError(file, f"is no submission ({error})", "`vstestbed submit DIR` makes one") from error
    main, suite, quick, word, sha256 = named
    entry = opened(str(into / main), suite, quick, word, alone=True, apart=True)
    if entry.about["sha256"] != sha256:
        raise RunFolderError(file, f"is of another {suite} than this version has", "check it with the version that it names")
    return entry, given.filter(pl.col("law").is_in(list(entry.laws)))


def check(file: Path, folder: Path, jobs: int | None = None, seed: int | None = None) -> Checked:
    """Fly a drawn tenth of a submission's runs again, at least one of each task, and compare them: outcome, and the task's number. Writes
    the page of the runs as they were handed in.

    folder: where they are flown; the law's files are elsewhere, and its code runs in processes of its own. seed: of what is drawn; None:
    nobody knows it before. Errors: as of `unpacked` and `compare`.
    """
    with offered(), TemporaryDirectory(prefix="law_") as place:
        return _checked(*unpacked(file, Path(place)), folder, jobs, seed)


def _checked(entry: SuiteEntry, given: pl.DataFrame, folder: Path, jobs: int | None, seed: int | None) -> Checked:
    rng, otherwise, n = np.random.default_rng(secrets.randbits(63) if seed is None else seed), list[str](), 0
    for task, plan in entry.plans.items():
        every = list(Jobs(controllers(plan), plan.seeds, plan.first_seed))
        drawn = [every[i] for i in sorted(rng.choice(len(every), max(1, round(SHARE * len(every))), replace=False).tolist())]
        again = entry.rows_of(_flown(make_folder(folder / task), drawn, jobs), plan, task)
        n += len(again)
        both = again.join(given.cast({"start": pl.String}), on=["task", "start"], how="left", suffix="_given")
        otherwise += [_words(row) for row in both.iter_rows(named=True) if not _agrees(row)]
    shown = given.cast({"start": pl.String, "value": pl.Float64})
    return Checked(n, tuple(otherwise), entry.write(folder, shown) if len(shown) else [])


def _flown(folder: Path, drawn: list[Job], jobs: int | None) -> pl.DataFrame:
    with closing(pool_of("local", workers(jobs, len(drawn)), folder)) as pool:
        Runner(folder, drawn).run(pool)
    return table_of(folder, drawn)


def _agrees(row: dict[str, object]) -> bool:
    """Whether a run that was flown again has the outcome and, within the tolerance of `compare --again`, the number that was handed in."""
    given, again = row["value_given"], row["value"]
    if row["success_given"] is None or row["success"] != row["success_given"]:
        return False
    if not isinstance(given, float) or not isinstance(again, float):
        return given == again
    return abs(given - again) <= max(LEAST, TOLERANCE * max(abs(given), abs(again)))


def _words(row: dict[str, object]) -> str:
    def said(success: object, value: object) -> str:
        return "is not there" if success is None else f"{'reached' if success else 'failed'} ({value})"

    given, again = said(row["success_given"], row["value_given"]), said(row["success"], row["value"])
    return f"{row['task']} {row['start']}: handed in {given}, flown again {again}"
