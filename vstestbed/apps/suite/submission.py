"""A submission to the suite: one file with a law, its results and where they were flown; and a
drawn part of it flown again.
"""

from __future__ import annotations

import io
import json
import math
import secrets
import stat
import unicodedata
import zipfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np
import polars as pl

from vstestbed.apps.suite.scores import Score
from vstestbed.apps.suite.suite import (
    NAME,
    TO_GOAL,
    SuiteEntry,
    SuiteTask,
    fingerprint,
    opened,
    read_suite,
)
from vstestbed.core.errors import ParameterError, RunFolderError, short
from vstestbed.core.files import allowed, make_folder, write_whole
from vstestbed.core.foreign import foreign, plain_file
from vstestbed.core.geometry import Array
from vstestbed.loop.isolated import offered
from vstestbed.report.comparison.statistics import holm
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison.folder import table_of
from vstestbed.studies.comparison.plan import Job, Variants
from vstestbed.studies.comparison.record import LEAST, TOLERANCE, environment
from vstestbed.studies.comparison.runs import Runner
from vstestbed.studies.pools import pool_of, workers
from vstestbed.tasks.metrics import Metric

ABOUT, RUNS, SCORES, RECORD, LAW_FOLDER = (
    "suite.json",
    "runs.csv",
    "scores.csv",
    "environment.json",
    "law",
)
BESIDE = (ABOUT, RUNS, SCORES, RECORD)
KEYS = ["task", "law", "start"]
COLUMNS = [*KEYS, "success", "value"]
ONE_OF, MISSED = 10, 0.05
"""A task of whose runs one of so many is forged passes the drawing with this probability
at most.
"""
ROUNDING = 1e-6
"""Share by which numbers differ that are the same: of their last digits in text."""
UNLIKELY, EVERY, RANDOM = 0.005, 14, 10_000
"""Numbers that are better than those flown again with a probability under the first are no chance;
by shares or by the mean, so that an honest submission is suspected with at most twice that.
Most differences of which all signs are tried, and how many are drawn of more (`chance`).
"""
MOST_MEMBERS, MOST_DIRECTORY = 1000, 1 << 20
MOST_TEXT, MOST_UNPACKED = 1 << 20, 128 << 20
"""Largest sizes [B] of a file beside the law, and of all that a submission holds."""
WORKS = "`vstestbed submit DIR` makes one"
# of an archive: its last record, its first, and a record of larger archives
_END, _FIRST, _ZIP64 = b"PK\5\6", b"PK\3\4", b"PK\6\7"
# of a member: how hard it is packed, sizes behind it, name in UTF-8; others mean that it is
# encrypted
_FLAGS = 0x80E


class Asked(NamedTuple):
    """What a submission has to be of, as who checks it says: the archive decides none of it. See
    `suite.opened`.
    """

    suite: str = NAME
    quick: bool = False
    word: str | None = None


ALL_STARTS = Asked()


class Checked(NamedTuple):
    """Runs that were flown again: how many, and in words those that ended otherwise; the law's
    scores, beside the suite's own, as handed in. flattering: in words, where numbers that agree are
    better too often, or by too much, for chance.
    """

    runs: int
    otherwise: tuple[str, ...]
    scores: list[Score]
    flattering: tuple[str, ...] = ()


def pack(folder: Path, out: Path) -> Path:
    """Pack a suite's folder into one file: what was flown, the law's files, its runs, the scores,
    versions and machine.
    Raises RunFolderError: the folder has no finished suite, the law's file is not a law of one's
    own, or it is too large to be checked.
    """
    for name in (ABOUT, RUNS, SCORES):
        if not (folder / name).is_file():
            raise RunFolderError(
                folder, f"has no {name}", "`vstestbed suite LAW_FILE --out DIR` makes one"
            )
    law = sorted((folder / LAW_FOLDER).rglob("*")) if (folder / LAW_FOLDER).is_dir() else []
    if not law:
        raise RunFolderError(
            folder,
            "has the suite's own laws alone",
            "fly a law of your own: `vstestbed suite LAW_FILE --out DIR`",
        )
    with foreign(folder, "`vstestbed suite LAW_FILE --out DIR` makes one", RunFolderError):
        own = Path(json.loads((folder / ABOUT).read_bytes())["file"]).stem
        # the laws beside it are in the suite
        runs = pl.read_csv(folder / RUNS, infer_schema=False).filter(pl.col("law") == own)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr(RUNS, runs.write_csv())
        for path in (folder / ABOUT, folder / SCORES, *(path for path in law if path.is_file())):
            packed.write(path, path.relative_to(folder).as_posix())
        packed.writestr(RECORD, json.dumps(environment(), indent=1) + "\n")
    write_whole(out, content.getvalue())
    try:
        contents(out)
    except RunFolderError:
        out.unlink()
        raise
    return out


def contents(file: Path) -> dict[str, bytes]:
    """What a submission holds, by the names of its members, all of which are validated before any
    is unpacked.

    Raises RunFolderError: it is not a plain archive within the limits above, of files that a
    submission has, with names that mean the same on every system. Sizes that the archive states are
    limits of what is unpacked, so that those that lie gain nothing.
    """
    packed = plain_file(file, WORKS, refusal=_refused).read_bytes()
    counted = _members_counted(file, packed)
    with foreign(file, WORKS, _refused), zipfile.ZipFile(io.BytesIO(packed)) as archive:
        members = archive.infolist()
        if wrong := _unfit(members):
            raise _refused(file, wrong)
        if counted != len(members):
            raise _refused(file, f"it has {len(members)} files and counts {counted}")
        # to a number of bytes: without one the whole of what is packed would be unpacked at once,
        # whatever its stated size
        return {one.filename: archive.open(one).read(one.file_size + 1) for one in members}


def _members_counted(file: Path, packed: bytes) -> int:
    """How many members an archive counts in its last record, which every zip file has.

    Raises RunFolderError: it is more or less than one plain zip file, or its directory is too large
    to be read.
    """
    end = packed[-22:]
    size = int.from_bytes(end[12:16], "little")
    start = int.from_bytes(end[16:20], "little")
    whole = (
        packed.startswith(_FIRST)
        and end.startswith(_END)
        and start + size + len(end) == len(packed)
    )
    if not whole or size > MOST_DIRECTORY or packed[-42:].startswith(_ZIP64):
        raise _refused(file, "it is no plain zip file, from its first byte to its last")
    return int.from_bytes(end[10:12], "little")


def _refused(file: object, why: str, works: str = WORKS) -> RunFolderError:
    return RunFolderError(file, f"is no submission ({why})", works)


def _unfit(members: list[zipfile.ZipInfo]) -> str:
    """Why an archive of these members is no submission, in words; "" where it may be one."""
    total = sum(one.file_size for one in members)
    if len(members) > MOST_MEMBERS or total > MOST_UNPACKED:
        most = f"at most {MOST_MEMBERS} and {MOST_UNPACKED >> 20} MiB are unpacked"
        return f"it has {len(members)} files of {total / 2**20:.0f} MiB, {most}"
    if wrong := next(filter(None, map(_unfit_member, members)), ""):
        return wrong
    names = Counter(unicodedata.normalize("NFKC", one.filename).casefold() for one in members)
    lacking = next((f"it has no {name}" for name in (ABOUT, RUNS) if name not in names), "")
    return _held_twice(names) or lacking


def _held_twice(names: Counter[str]) -> str:
    """What names of files, by their numbers, have twice, also as a folder, in words; "" where
    nothing.
    """
    folders = {str(above) for name in names for above in PurePosixPath(name).parents}
    twice = next((name for name, times in (names + Counter(folders)).items() if times > 1), "")
    return twice and f"it holds {short(twice)} twice"


def _unfit_member(one: zipfile.ZipInfo) -> str:
    """Why a member is none of a submission, in words; "" where it may be one."""
    name = short(one.orig_filename)
    if not _belongs(one.filename):
        return f"{name} is no file of one"
    if not _readable(one):
        return f"{name} is a link, encrypted, or packed in a way that is not read"
    if one.filename in BESIDE and one.file_size > MOST_TEXT:
        return f"{name} has {one.file_size / 2**20:.0f} MiB, at most {MOST_TEXT >> 20} are read"
    return ""


def _belongs(name: str) -> bool:
    """Whether a submission has a file of this name, which is the same on every system."""
    return name in BESIDE or (
        name.startswith(f"{LAW_FOLDER}/") and all(map(_portable, name.split("/")))
    )


def _portable(part: str) -> bool:
    """Whether a part of a path is: nothing hidden, no device, no letter that can be written
    otherwise.
    """
    plain = part.isprintable() and not set(part) & set('<>:"|?*\\') and part.strip(". ") == part
    return (
        bool(part)
        and plain
        and unicodedata.normalize("NFC", part) == part
        and allowed(part) == part
    )


def _readable(one: zipfile.ZipInfo) -> bool:
    """Whether a member is a regular file, not encrypted, packed in one of two ways, with a name
    that ends where it says.
    """
    plain = (
        stat.S_IFMT(one.external_attr >> 16) in (0, stat.S_IFREG) and not one.flag_bits & ~_FLAGS
    )
    return (
        plain
        and one.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
        and one.orig_filename == one.filename
    )


def unpacked(file: Path, into: Path, asked: Asked = ALL_STARTS) -> tuple[SuiteEntry, pl.DataFrame]:
    """The suite of a submission with its law alone, and its runs as they were handed in: those of
    the plan. Its code is not run here.
    Raises RunFolderError: it is no submission, of another suite or of other starts than what is
    asked, or its runs are not the plan's.
    """
    found = contents(file)
    about, main = _about(file, found)
    flown, ours = about.get("sha256"), fingerprint(*read_suite(asked.suite))
    if flown != ours:
        why = (
            f"was flown on another {asked.suite},"
            f" of the files {str(flown)[:12]!r} and not {ours[:12]!r}"
        )
        again = (
            "fly the law again: `vstestbed suite LAW_FILE --alone --out DIR`,"
            " then `vstestbed submit DIR`"
        )
        raise RunFolderError(file, why, again)
    for name in found:
        if name.startswith(f"{LAW_FOLDER}/"):
            place = into / PurePosixPath(name).relative_to(LAW_FOLDER)
            write_whole(make_folder(place.parent) / place.name, found[name])
    try:
        entry = opened(str(into / main), *asked, alone=True, apart=True)
        entry.must_stay()
    except ParameterError as error:
        raise _refused(file, str(error)) from error
    here = entry.about | {"laws": about.get("laws")}  # what the law is, its files say
    for name in (*here, *about):
        if name not in here or about.get(name) != here[name]:
            asked_for = short(here.get(name))
            said = f"{short(name)} in its {ABOUT} is not what is asked for, {asked_for}"
            raise _refused(file, said, "say --suite, --quick and --word as it was to be flown")
    return entry, _handed_in(file, found[RUNS], entry)


def _about(file: Path, found: Mapping[str, bytes]) -> tuple[dict[str, Any], str]:
    """What a submission says of itself, and the name of its law's file, which it holds."""
    with foreign(file, WORKS, _refused):
        about = json.loads(found[ABOUT])
    main = about.get("file") if isinstance(about, dict) else None
    if not isinstance(main, str):
        main = ""
    if f"{LAW_FOLDER}/{main}" not in found or not main.endswith((".py", ".yaml", ".yml")):
        raise _refused(file, f"its {ABOUT} names no file of a law that it holds")
    return about, main


def _handed_in(file: Path, text: bytes, entry: SuiteEntry) -> pl.DataFrame:
    """The runs of a submission, which must be those of the plan: each once, and no other, with a
    result that a run can have.
    """
    planned = Counter(
        (task, law, start)
        for task in entry.plans
        for law in entry.laws
        for start in entry.jobs(task)
    )
    works = f"{RUNS} holds each run of the plan once: {WORKS}"
    if not planned:
        raise _refused(file, f"its law takes part in no task: {next(iter(entry.blank.values()))}")
    with foreign(file, works, _refused):
        # one more tells that there are more
        cells = pl.read_csv(text, infer_schema=False, n_rows=planned.total() + 1)
        if cells.columns != COLUMNS:
            raise _refused(
                file, f"its {RUNS} has the columns {short(cells.columns)}, not {COLUMNS}", works
            )
        value = pl.col("value").cast(pl.Float64, strict=False)
        no_number = value.is_null() & pl.col("value").is_not_null()
        odd = cells.filter(no_number | ~pl.col("success").is_in(["true", "false"]))
        for _, _, start, reached, said in odd.iter_rows():
            raise _refused(
                file,
                (
                    f"its {RUNS} says success {short(reached)}"
                    f" and value {short(said)} of {short(start)}"
                ),
                works,
            )
        success = pl.col("success").replace_strict(
            {"true": True, "false": False}, return_dtype=pl.Boolean
        )
        runs = cells.with_columns(success, value)
    there = Counter(runs.select(KEYS).rows())
    if lacking := planned - there:
        raise _refused(
            file, f"its {RUNS} lacks {short(next(iter(lacking)))}, of {len(lacking)} runs", works
        )
    if other := there - planned:
        raise _refused(
            file,
            (
                f"its {RUNS} holds {short(next(iter(other)))},"
                " which is not of the plan, or there twice"
            ),
            works,
        )
    for task, _, start, reached, value in _impossible(runs, entry):
        raise _refused(
            file,
            f"its {RUNS} says success {reached} and value {value} of {task} {start}",
            works,
        )
    return runs


def _impossible(runs: pl.DataFrame, entry: SuiteEntry) -> Iterator[tuple[Any, ...]]:
    """The rows with a result that their run cannot have."""
    for task, plan in entry.plans.items():
        asked, jobs = entry.suite.tasks[task], entry.jobs(task)
        limit_s = max(each.scenario.stop.duration_s for each in Variants(plan))
        for row in runs.filter(pl.col("task") == task).iter_rows():
            _, _, start, reached, value = row
            if not _can_be(reached, value, asked, jobs[start].controller.scenario, limit_s):
                yield row


def _can_be(
    reached: bool | None, value: float | None, task: SuiteTask, flown: Scenario, limit_s: float
) -> bool:
    """Whether a run can have a result, as `SuiteEntry.rows_of` makes it: one that crashed alone has
    no number, where the task says none for it. A success has a number that the metric can be, at
    most the task's worst; a time is at most the limit, and a picture more, with which a run ends.
    A failure's time to the goal is the limit, or the task's worst.

    value: in the unit of display. flown: from this start. limit_s: the largest of the task [s],
    which a run that crashed has.
    """
    if value is None or reached is None:
        blank = (reached, value) == (False, None)
        return blank and task.worst is None and task.metric != TO_GOAL
    metric, own_s = Metric.named(task.metric), flown.stop.duration_s
    worst = math.inf if task.worst is None else task.worst * metric.scale
    if task.metric == TO_GOAL and not reached:
        early_s = limit_s if task.worst is None else worst  # of a run that ended early
        lasted_s = min(own_s, worst)
        return min(abs(value - lasted_s), abs(value - early_s)) <= 2 * ROUNDING * early_s
    return math.isfinite(value) and _within(value, metric, worst, reached, flown)


def _within(value: float, metric: Metric, worst: float, reached: bool, flown: Scenario) -> bool:
    """Whether a number is within what the metric can be, and at most the task's worst."""
    low, high = (bound * metric.scale for bound in metric.within)
    if metric.of_flight:
        high = flown.stop.duration_s + flown.camera.period
    # a run that ended early has the worst, which may be beyond what one that lasted has
    high = worst if not reached and worst < math.inf else min(high, worst)
    return low <= value <= high * (1 + 2 * ROUNDING)


def draws(n: int) -> int:
    """How many of n runs are drawn, without replacement, so that of K = ceil(n / ONE_OF) forged
    ones one is among them but for a probability of MISSED: the least k with C(n - K, k) / C(n,
    k) <= MISSED, the hypergeometric distribution at 0.
    """
    true = n - math.ceil(n / ONE_OF)
    return next(k for k in range(n + 1) if math.comb(true, k) <= MISSED * math.comb(n, k))


def check(
    file: Path,
    folder: Path,
    jobs: int | None = None,
    seed: int | None = None,
    asked: Asked = ALL_STARTS,
) -> Checked:
    """Fly drawn runs of each task of a submission again, as many as `draws` says, and compare them:
    outcome, and the task's number. Within the tolerance of each they may not all be better either
    (`chance`). Writes the page of the runs as they were handed in, with scores computed here.

    folder: where they are flown; the law's files are elsewhere, and its code runs in processes of
    its own. seed: of what is drawn; None: nobody knows it before. asked: see there. Errors: as of
    `unpacked` and `compare`.
    """
    with offered(), TemporaryDirectory(prefix="law_") as place:
        return _checked(*unpacked(file, Path(place), asked), folder, jobs, seed)


def _checked(
    entry: SuiteEntry, given: pl.DataFrame, folder: Path, jobs: int | None, seed: int | None
) -> Checked:
    rng, otherwise, n = (
        np.random.default_rng(secrets.randbits(63) if seed is None else seed),
        list[str](),
        0,
    )
    gains = dict[str, Array]()
    for task, plan in entry.plans.items():
        every = list(entry.jobs(task).items())
        drawn = [
            every[i]
            for i in sorted(rng.choice(len(every), draws(len(every)), replace=False).tolist())
        ]
        again = entry.rows_of(
            _flown(make_folder(folder / task), [job for _, job in drawn], jobs), plan, task
        )
        n += len(drawn)
        asked_for = given.filter(
            (pl.col("task") == task) & pl.col("start").is_in([start for start, _ in drawn])
        )
        # one that leaves no run here is otherwise, too
        both = asked_for.join(again, on=["task", "start"], how="left", suffix="_again")
        metric = Metric.named(entry.suite.tasks[task].metric)
        least = LEAST if metric.unit == "s" else 0.0
        alike = [_agrees(row, least) for row in both.iter_rows(named=True)]
        otherwise += map(_words, both.filter(pl.Series(alike).not_()).iter_rows(named=True))
        gains[task] = _gains(both.filter(pl.Series(alike)), metric.better == 1)
    return Checked(n, tuple(otherwise), entry.write(folder, given), tuple(_flattering(gains)))


def _gains(both: pl.DataFrame, more: bool) -> Array:
    """By how much numbers that were handed in are better than those of the same runs flown again,
    (n, 2): as shares of the larger of the two, and of the mean of all that were flown again, which
    is what a score goes by; of those that differ by more than rounding.

    more: whether more is better.
    """
    pairs = both.select("value", "value_again").drop_nulls().to_numpy()
    better = pairs[:, 1] - pairs[:, 0]
    if more:
        better = -better
    larger = np.abs(pairs).max(axis=1, initial=0.0)
    mean = abs(pairs[:, 1].mean()) if len(pairs) else 0.0
    differ = np.abs(better) > ROUNDING * larger
    return np.column_stack([better[differ] / larger[differ], better[differ] / (mean or 1.0)])


def _flattering(gains: Mapping[str, Array]) -> Iterator[str]:
    """Sentences that say where gains, by task, are no chance: over all, and in tasks of several. By
    shares, and by what they make of the mean: much off few long runs, with a little put on many
    short ones, is seen in the mean alone, and the other way round.
    """
    asked = {"": np.concatenate([np.empty((0, 2)), *gains.values()])}
    if len(gains) > 1:
        asked |= gains
    p = {task: min(map(chance, each.T)) for task, each in asked.items()}
    adjusted = {"": p[""]} | dict(
        zip(gains, holm([p.get(task, 1.0) for task in gains]), strict=True)
    )
    for task, each in asked.items():
        if adjusted[task] < UNLIKELY:
            better = int((each[:, 0] > 0).sum())
            yield (
                f"{task and f'{task}: '}its numbers are better than those flown here in {better}"
                f" of {len(each)} runs that differ, by {each[:, 1].mean():.1%} of their mean,"
                f" which chance does not do: p = {p[task]:.1g}, by differences of either sign"
            )


def chance(gains: Sequence[float] | Array) -> float:
    """How often gains of these sizes, of either sign alike, are together as large as they are: the
    one-sided randomisation test of signs. Of n that are all above 0 that is 2^-n.

    All signs are tried of up to EVERY gains, RANDOM drawn ones of more, which with those that are
    there are never under 1 / (RANDOM + 1).

    Reference: Fisher 1935, The design of experiments, section 21.
    """
    sizes, n = np.abs(gains), len(gains)
    if n <= EVERY:
        signs = 1 - 2 * (np.arange(2**n)[:, None] >> np.arange(n) & 1)
    else:
        drawn = np.random.default_rng(0).choice((-1, 1), (RANDOM, n))
        signs = np.vstack([np.sign(gains)[None], drawn])
    least = math.fsum(gains) - 1e-9 * float(sizes.sum())  # sums differ by their order
    return float(np.mean(signs @ sizes >= least))


def _flown(folder: Path, drawn: list[Job], jobs: int | None) -> pl.DataFrame:
    with closing(pool_of("local", workers(jobs, len(drawn)), folder)) as pool:
        Runner(folder, drawn).run(pool)
    return table_of(folder, drawn)


def _agrees(row: dict[str, Any], least: float) -> bool:
    """Whether a run that was flown again has the outcome and, within the tolerance of
    `compare --again`, the number that was handed in.

    least: that tolerance in the number's unit, of times; distances and pixels of a task have it by
    their share alone.
    """
    given, again = row["value"], row["value_again"]
    if row["success"] != row["success_again"]:
        return False
    if given is None or again is None:
        return given is again
    return abs(given - again) <= max(least, TOLERANCE * max(abs(given), abs(again)))


def _words(row: dict[str, Any]) -> str:
    def said(success: object, value: object) -> str:
        return (
            "left no run" if success is None else f"{'reached' if success else 'failed'} ({value})"
        )

    given, again = (
        said(row["success"], row["value"]),
        said(row["success_again"], row["value_again"]),
    )
    return f"{row['task']} {row['start']}: handed in {given}, flown again {again}"
