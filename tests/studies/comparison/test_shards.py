"""Shards of a comparison: together they are all its runs once; merged they are what one process
leaves; what is missing is named.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.studies.comparison import Jobs, Shard, chosen, compare, controllers, merge
from vstestbed.studies.comparison.shards import Share

OF_THE_CLOCK = ("wall_time_s", "real_time_factor")
SEEDS, SHARDS = 5, 3


def fly(quick: Path, out: Path, **more: Any) -> pl.DataFrame:
    return compare(
        [quick], {"law.gain": (3, 6)}, SEEDS, 1, out=out, film=False, figures=False, **more
    )


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The scenario, and the folder of its shards."""
    from tests.conftest import QUICK

    place = tmp_path_factory.mktemp("shards")
    quick = place / "quick.yaml"
    quick.write_text(QUICK, encoding="utf-8")
    for i in range(1, SHARDS + 1):
        fly(quick, place / f"shards/{i}", shard=f"{i}/{SHARDS}")
    return quick, place / "shards"


@pytest.fixture
def shards(flown: tuple[Path, Path], tmp_path: Path) -> list[Path]:
    """Copies of the shards."""
    shutil.copytree(flown[1], tmp_path / "shards")
    return sorted((tmp_path / "shards").iterdir())


@pytest.mark.parametrize("of", [1, 2, 7, 10])
def test_together_they_are_all_runs_once_in_their_order(quick: Path, of: int) -> None:
    plan = chosen([str(quick)], {}, {"law.gain": (3, 6)}, seeds=SEEDS)
    jobs = Jobs(controllers(plan), SEEDS)
    shares = [Share(jobs, Shard(i, of)) for i in range(1, of + 1)]
    assert [job.folder for share in shares for job in share] == [job.folder for job in jobs]
    assert all(
        len(share) == len(list(share)) and 10 // of <= len(share) <= -(-10 // of)
        for share in shares
    )


def test_merged_they_are_what_one_process_leaves(
    shards: list[Path], flown: tuple[Path, Path], tmp_path: Path
) -> None:
    alone, together = (
        fly(flown[0], tmp_path / "one"),
        merge(shards[::-1], tmp_path / "all", figures=False),
    )
    columns = [
        name
        for name in alone.columns
        if name not in OF_THE_CLOCK and not name.startswith("time_ms")
    ]
    assert together.columns == alone.columns
    assert together.select(columns).equals(alone.select(columns), null_equal=True)
    assert {p.name for p in (tmp_path / "all").iterdir()} == {
        p.name for p in (tmp_path / "one").iterdir()
    }
    run = str(together["folder"][0])
    # no second copy on the disk
    assert (tmp_path / "all" / run / "log.parquet").samefile(shards[0] / run / "log.parquet")
    # a folder like any other
    assert compare([], out=tmp_path / "all", resume=True, report=False).height == 2 * SEEDS


def test_a_shard_has_its_own_runs_and_a_table_but_no_page(shards: list[Path]) -> None:
    rows = [pl.read_parquet(place / "comparison.parquet") for place in shards]
    assert [len(table) for table in rows] == [3, 3, 4]
    assert not any((place / "report.html").exists() for place in shards)


def test_missing_shards_and_runs_are_named(shards: list[Path], tmp_path: Path) -> None:
    with pytest.raises(RunFolderError, match=r"1 of 3 shards are missing: 2/3"):
        merge([shards[0], shards[2]], tmp_path / "all")
    killed = shards[1] / str(pl.read_parquet(shards[1] / "comparison.parquet")["folder"][0])
    shutil.rmtree(killed)
    with pytest.raises(
        RunFolderError, match=r"1 of 3 runs of shard 2/3 .*--resume --out .*shards/2"
    ):
        merge(shards, tmp_path / "all")
    assert not (tmp_path / "all").exists()
    assert compare([], out=shards[1], resume=True).height == 3  # it goes on as the shard that it is
    assert killed.exists() and merge(shards, tmp_path / "all", figures=False).height == 2 * SEEDS


def test_a_killed_shard_goes_on_as_the_shard_that_it_is(shards: list[Path]) -> None:
    with pytest.raises(ParameterError, match="goes on with shard 2/3"):
        compare([], out=shards[1], resume=True, shard="1/3")


@pytest.mark.parametrize("what", ["plan", "scenario", "version", "twice", "whole"])
def test_what_does_not_belong_together_is_not_merged(
    shards: list[Path], tmp_path: Path, what: str
) -> None:
    other, words = shards[2], "is not of the comparison of"
    if what == "plan":
        (other / "comparison.yaml").write_text(
            (other / "comparison.yaml").read_text().replace("seeds: 5", "seeds: 6")
        )
    elif what == "scenario":
        with (other / "scenarios/quick.yaml").open("a") as file:
            file.write("# changed\n")
    elif what == "version":
        record = json.loads((other / "record.json").read_text())
        record["environment"]["versions"]["vstestbed"] = "0.0.1"
        (other / "record.json").write_text(json.dumps(record))
    elif what == "twice":
        shutil.copy(shards[0] / "shard.json", other)
        words = "is shard 1/3, and so is"
    else:
        (other / "shard.json").unlink()
        words = r"has no shard\.json"
    with pytest.raises(RunFolderError, match=words):
        merge(shards, tmp_path / "all")
    assert not (tmp_path / "all").exists()


@pytest.mark.parametrize("text", ["0/3", "4/3", "3", "1/0", "-1/3", "a/b", "1/3/5"])
def test_other_words_are_refused(text: str) -> None:
    with pytest.raises(ParameterError, match="I/N"):
        Shard.read(text)


def test_more_shards_than_runs_are_refused_and_one_needs_a_folder_of_its_own(
    quick: Path, tmp_path: Path
) -> None:
    with pytest.raises(ParameterError, match="10 shards"):
        fly(quick, tmp_path / "one", shard="1/11")
    assert not (tmp_path / "one").exists()
    with pytest.raises(ParameterError, match="--out DIR"):
        compare([quick], seeds=3, shard="1/2")


def test_a_job_of_an_array_and_the_merge_as_commands(command: Any, quick: Path) -> None:
    for i in (1, 2):
        job = command(
            "compare",
            quick,
            "--seeds",
            4,
            "--no-film",
            "--jobs",
            1,
            "--shard",
            f"{i}/2",
            "--out",
            f"shards/{i}",
        )
        assert (
            job.code == 0
            and "2 of 2 runs reached the goal" in job.err
            and "report.html" not in job.err
        )
    ended = command("compare", "--merge", "shards/1", "shards/2", "--out", "all", "--no-figures")
    assert (
        ended.code == 0
        and "4 of 4 runs reached the goal" in ended.err
        and "all (open report.html)" in ended.err
    )
    assert command("compare", "--merge").code == 2


SBATCH = """#!/bin/bash
# As Slurm does with an array, one job after the other, and the second one twice (--requeue).
last=$(sed -n 's/^#SBATCH --array=1-//p' "$1")
for SLURM_ARRAY_TASK_ID in $(seq "$last") 2; do
    export SLURM_ARRAY_TASK_ID
    bash -e "$1" || exit 1
done
"""


@pytest.mark.process
def test_the_guides_job_script_with_a_scheduler_that_runs_it(
    quick: Path, tmp_path: Path, vstestbed_process: Any
) -> None:
    words, environment = vstestbed_process
    guide = (Path(__file__).parents[3] / "docs/guides/cluster.md").read_text(encoding="utf-8")
    found = re.search(r"```bash\n(.*?)```", guide, re.S)
    assert found is not None
    script = (
        found[1]
        .replace("64", "2")
        .replace("arm_laws --seeds 1000", "quick.yaml --seeds 4 --no-film")
    )
    (tmp_path / "array.sh").write_text(script)
    tools = {"sbatch": SBATCH, "vstestbed": f'#!/bin/bash\nexec {" ".join(words)} "$@"\n'}
    (tmp_path / "bin").mkdir()
    for name, text in tools.items():
        (tmp_path / "bin" / name).write_text(text)
        (tmp_path / "bin" / name).chmod(0o755)
    place = {
        "cwd": tmp_path,
        "env": environment | {"PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"},
    }
    subprocess.run(["sbatch", "array.sh"], **place, check=True)
    subprocess.run(
        "vstestbed compare --merge shards/* --out runs/arm_laws --no-figures",
        **place,
        shell=True,
        check=True,
    )
    assert pl.read_parquet(tmp_path / "runs/arm_laws/comparison.parquet")["seed"].to_list() == [
        0,
        1,
        2,
        3,
    ]
