"""Cost of comparisons of ideal runs over their number, printed (`pytest -s -m study`); memory and
page stay within their bounds.

VSTESTBED_SCALE is the largest number of runs, 10,000 by default; 100,000 take half an hour on two
cores, and 3 GB.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import vstestbed as vs
from vstestbed.studies.comparison import Jobs, Shard, compare, controllers
from vstestbed.studies.comparison.plan import read_comparison
from vstestbed.studies.comparison.shards import Share

pytestmark = pytest.mark.study
LARGEST = int(os.environ.get("VSTESTBED_SCALE", "10000"))
COMPARE = (
    "compare",
    "quick.yaml",
    "--jobs",
    "2",
    "--no-film",
    "--quiet",
    "--force",
    "--out",
    "out",
)
PROBES = 20


def ended(words: list[str], **more: Any) -> tuple[float, float, float]:
    """Wall time [s], processor time with that of its workers [s], and its own memory [MB] of a
    process that ended well.
    """
    began = time.monotonic()
    process = subprocess.Popen(words, **more)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    return time.monotonic() - began, used.ru_utime + used.ru_stime, used.ru_maxrss / 1e3


def run_alone_s(quick: Path) -> float:
    """Processor time of a run without a folder [s]."""
    scenarios = [vs.load(quick, seed=seed) for seed in range(PROBES + 1)]
    vs.run(scenarios[0])
    began = time.process_time()
    for scenario in scenarios[1:]:
        vs.run(scenario)
    return (time.process_time() - began) / PROBES


def test_the_cost_of_a_run_does_not_grow_with_their_number(
    tmp_path: Path, quick: Path, vstestbed_process: Any
):
    words, environment = vstestbed_process
    print(f"\na run alone: {1e3 * run_alone_s(quick):.1f} ms of processor time")
    heads = (
        "runs",
        "wall [s]",
        "processor, a run [ms]",
        "resumed [s]",
        "memory [MB]",
        "page [MB]",
        "disk [MB]",
    )
    print(" ".join(f"{head:>{len(head) + 2}}" for head in heads))
    n = 100
    while n <= LARGEST:
        wall_s, processor_s, memory_mb = ended(
            [*words, *COMPARE, "--seeds", str(n)], cwd=tmp_path, env=environment
        )
        out, table = tmp_path / "out", pl.read_parquet(tmp_path / "out/comparison.parquet")
        assert (
            table["seed"].to_list() == list(range(n))
            and max(map(len, map(os.listdir, out.glob("runs/quick/as_it_is")))) <= 1000
        )
        page_mb, disk_mb = (
            (out / "report.html").stat().st_size / 1e6,
            sum(p.stat().st_size for p in out.rglob("*") if p.is_file()) / 1e6,
        )
        (out / table["folder"][n // 2] / "summary.json").unlink()
        began = time.process_time()
        assert compare([], out=out, resume=True, jobs=1, film=False, report=False).height == n
        resumed_s = time.process_time() - began
        row = (n, wall_s, 1e3 * processor_s / n, resumed_s, memory_mb, page_mb, disk_mb)
        print(
            " ".join(
                f"{value:{len(head) + 2}.{0 if value == int(value) else 1}f}"
                for head, value in zip(heads, row, strict=True)
            )
        )
        assert memory_mb < 1000 and page_mb < 10
        shutil.rmtree(out)
        n *= 10


SHARDS = 64


def test_64_shards_of_a_thousand_runs_two_of_them_killed(
    tmp_path: Path, quick: Path, vstestbed_process: Any
):
    words, environment = vstestbed_process
    common = [
        *words,
        "compare",
        "quick.yaml",
        "--jobs",
        "1",
        "--no-film",
        "--no-figures",
        "--quiet",
        "--seeds",
        "1000",
    ]
    place: dict[str, Any] = {"cwd": tmp_path, "env": environment}
    for i in range(1, SHARDS + 1):
        job = subprocess.Popen(
            [*common, "--shard", f"{i}/{SHARDS}", "--out", f"shards/{i}"], **place
        )
        if i in (7, 40):
            while len(list(tmp_path.glob(f"shards/{i}/runs/**/summary.json"))) < 3:
                time.sleep(0.01)  # until it has stored some
            job.kill()
        assert (job.wait() == 0) == (i not in (7, 40))
    merging = [
        *words,
        "compare",
        "--merge",
        *(f"shards/{i}" for i in range(1, SHARDS + 1)),
        "--out",
        "all",
        "--no-figures",
        "--quiet",
    ]
    refused = subprocess.run(merging, **place, capture_output=True, text=True, check=False)
    assert (
        refused.returncode != 0
        and "shard 7/64" in refused.stderr
        and "shard 40/64" in refused.stderr
    ), refused.stderr
    for i in (7, 40):
        ended([*words, "compare", "--resume", "--out", f"shards/{i}", "--quiet"], **place)
    ended(merging, **place)
    ended([*common, "--out", "one"], **place)
    merged, one = (
        pl.read_parquet(tmp_path / name / "comparison.parquet") for name in ("all", "one")
    )
    columns = [
        c
        for c in one.columns
        if c not in ("wall_time_s", "real_time_factor", "attempts") and not c.startswith("time_ms")
    ]
    assert merged.columns == one.columns
    assert merged.select(columns).equals(one.select(columns), null_equal=True)


def test_a_hundred_thousand_runs_are_merged_within_a_gigabyte(
    tmp_path: Path, quick: Path, vstestbed_process: Any
):
    # One run flies; the others are links to its log, each with a summary of its own seed.
    words, environment = vstestbed_process
    n, place = 100_000, {"cwd": tmp_path, "env": environment}
    common = [
        "compare",
        "quick.yaml",
        "--jobs",
        "1",
        "--no-film",
        "--quiet",
        "--seeds",
        str(n),
        "--force",
    ]
    compare([quick], seeds=SHARDS, out=tmp_path / "few", film=False, report=False)
    model = tmp_path / "few/runs/quick/as_it_is/0"
    summary = json.loads((model / "summary.json").read_text())
    planned = subprocess.Popen(
        [*words, *common, "--shard", f"1/{SHARDS}", "--out", "first"], **place
    )
    while not (tmp_path / "first/record.json").exists():
        time.sleep(0.1)  # its plan is written before its runs
    planned.kill()
    planned.wait()
    plan = read_comparison(tmp_path / "first/comparison.yaml")
    jobs = Jobs(controllers(plan, force=True), plan.seeds)
    for i in range(1, SHARDS + 1):
        folder = tmp_path / f"shards/{i}"
        shutil.copytree(tmp_path / "first", folder, ignore=shutil.ignore_patterns("runs"))
        Shard(i, SHARDS).keep(folder)
        # a file has at most 65,000 links
        own = Path(shutil.copytree(model, tmp_path / f"models/{i}"))
        for job in Share(jobs, Shard(i, SHARDS)):
            run = folder / job.folder
            run.mkdir(parents=True)
            for file in own.iterdir():
                if file.name != "summary.json":
                    os.link(file, run / file.name)
            (run / "summary.json").write_text(json.dumps(summary | {"seed": job.seed}))
    merging = [
        *words,
        "compare",
        "--merge",
        *(f"shards/{i}" for i in range(1, SHARDS + 1)),
        "--out",
        "all",
        "--no-figures",
        "--quiet",
    ]
    wall_s, processor_s, memory_mb = ended(merging, **place)
    table = pl.read_parquet(tmp_path / "all/comparison.parquet")
    print(
        f"\nmerged {n:,} runs of {SHARDS} shards:"
        f" {wall_s:.0f} s, {processor_s:.0f} s of processor time, {memory_mb:.0f} MB"
    )
    assert table["seed"].to_list() == list(range(n)) and memory_mb < 1000
