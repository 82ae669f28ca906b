"""Shards of a comparison: jobs of an array fly one each, and no process waits for all; merged they
are what one process leaves.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.core.files import linked, read_json, write_json, write_whole
from vstestbed.studies.comparison.folder import stored_runs
from vstestbed.studies.comparison.plan import Job, Jobs
from vstestbed.studies.comparison.record import FILES, PLAN, RECORD, SCENARIOS
from vstestbed.studies.run_folder import ASSETS

__all__ = ["Shard", "Share", "gather", "must_be_done", "must_be_whole"]

SHARD = "shard.json"  # in the folder of a shard: which of how many it is
FORM = "I/N with I from 1 to N, e.g. 3/64"


class Shard(NamedTuple):
    """One of some equal shares of a comparison's runs, which follow each other in its order: all
    controllers from some of the seeds.

    number: of the share, from 1. of: how many there are.
    """

    number: int = 1
    of: int = 1

    @classmethod
    def read(cls, text: str) -> Shard:
        """`3/64`. Raises ParameterError: it is something else."""
        if (found := re.fullmatch(r"(\d{1,6})/(\d{1,6})", text)) is None or not 1 <= int(
            found[1]
        ) <= int(found[2]):
            raise ParameterError.form("--shard", FORM, text)
        return cls(int(found[1]), int(found[2]))

    @classmethod
    def in_folder(cls, folder: Path) -> Shard:
        """The shard of a comparison's folder; the whole where it has no other."""
        return cls(**read_json(folder / SHARD)) if (folder / SHARD).exists() else cls()

    def keep(self, folder: Path) -> None:
        """Write it into a comparison's folder, which then goes on as this shard."""
        if self.of > 1:
            write_json(folder / SHARD, self._asdict())

    def __str__(self) -> str:
        return f"{self.number}/{self.of}"


class Share:
    """The runs of a shard."""

    def __init__(self, jobs: Jobs, shard: Shard):
        if shard.of > (n := len(jobs)):
            raise ParameterError.bound(
                "--shard", "of at most", f"{n} shards, as many as there are runs", str(shard)
            )
        self._jobs, self._begin, self._end = (
            jobs,
            (shard.number - 1) * n // shard.of,
            shard.number * n // shard.of,
        )

    def __len__(self) -> int:
        return self._end - self._begin

    def __iter__(self) -> Iterator[Job]:
        return islice(iter(self._jobs), self._begin, self._end)


def must_be_whole(places: Sequence[Path]) -> None:
    """Refuse folders that are not all shards of one comparison, with the same files, each once.
    Raises RunFolderError: which is not.
    """
    shards = dict[int, Path]()
    for place in places:
        for name in (PLAN, SHARD):
            if not (place / name).is_file():
                raise RunFolderError(
                    place,
                    f"has no {name}, so that it is no shard",
                    "`vstestbed compare ... --shard I/N --out DIR` makes one",
                )
        shard, first = Shard.in_folder(place), Shard.in_folder(places[0])
        if (shard.of, _plan(place)) != (first.of, _plan(places[0])):
            raise RunFolderError(
                place,
                f"is not of the comparison of {places[0]}, with the same files and version",
                "merge shards of one",
            )
        if (other := shards.setdefault(shard.number, place)) != place:
            raise RunFolderError(
                place, f"is shard {shard}, and so is {other}", "name one of the two"
            )
    first = Shard.in_folder(places[0])
    if missing := [str(Shard(i, first.of)) for i in range(1, first.of + 1) if i not in shards]:
        words = (
            f"{len(missing)} of {first.of} shards are missing:"
            f" {', '.join(missing[:20])}{', ...' if len(missing) > 20 else ''}"
        )
        raise RunFolderError(places[0].parent, words, "name their folders, too, or fly them")


def must_be_done(places: Iterable[Path], jobs: Jobs) -> None:
    """Refuse shards, of which there are all, with runs that are not there. Raises RunFolderError:
    in which how many are missing.
    """
    lacking, left = dict[Path, str](), iter(jobs)
    for place in sorted(places, key=lambda place: Shard.in_folder(place).number):
        n, there = len(Share(jobs, Shard.in_folder(place))), stored_runs(place)
        if missing := sum(job.folder not in there for job in islice(left, n)):
            lacking[place] = f"{missing} of {n} runs of shard {Shard.in_folder(place)} ({place})"
    if lacking:
        words = (
            "not there are"
            f" {'; '.join(list(lacking.values())[:20])}{'; ...' if len(lacking) > 20 else ''}"
        )
        raise RunFolderError(
            next(iter(lacking)).parent,
            words,
            f"`vstestbed compare --resume --out {next(iter(lacking))}` does what is missing",
        )


def gather(places: Iterable[Path], folder: Path) -> None:
    """Put plan, files and runs of all shards into a folder; runs are links to the shards' files
    where the file system has them.
    """
    first, *_ = places = list(places)
    for name, of in (("runs", places), (ASSETS, places), (SCENARIOS, [first]), (FILES, [first])):
        if there := [place / name for place in of if (place / name).is_dir()]:
            linked(there, folder / name)
    for name in (RECORD, PLAN):  # with its plan it is a comparison
        write_whole(folder / name, (first / name).read_bytes())


def _plan(place: Path) -> object:
    """What must be equal in all shards: plan, scenarios, hashes of the files, version."""
    record = read_json(place / RECORD)
    texts = [
        (path.name, path.read_bytes())
        for path in (place / PLAN, *sorted((place / SCENARIOS).glob("*.yaml")))
    ]
    files = {name: said["sha256"] for name, said in record["files"].items()}
    return texts, files, record["environment"]["versions"]["vstestbed"]
