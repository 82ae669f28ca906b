"""Cost of comparisons of ideal runs over their number, printed (`pytest -s -m study`); memory and page stay within their bounds.

VSTESTBED_SCALE is the largest number of runs, 10,000 by default; 100,000 take half an hour on two cores, and 3 GB.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

import polars as pl
import pytest

import vstestbed as vs
from vstestbed.studies.comparison import compare

pytestmark = pytest.mark.study
LARGEST = int(os.environ.get("VSTESTBED_SCALE", "10000"))
COMPARE = ("compare", "quick.yaml", "--jobs", "2", "--no-film", "--quiet", "--force", "--out", "out")
PROBES = 20


def ended(words: list[str], **more: Any) -> tuple[float, float, float]:
    """Wall time [s], processor time with that of its workers [s], and its own memory [MB] of a process that ended well."""
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


def test_the_cost_of_a_run_does_not_grow_with_their_number(tmp_path: Path, quick: Path, vstestbed_process: Any):
    words, environment = vstestbed_process
    print(f"\na run alone: {1e3 * run_alone_s(quick):.1f} ms of processor time")
    heads = ("runs", "wall [s]", "processor, a run [ms]", "resumed [s]", "memory [MB]", "page [MB]", "disk [MB]")
    print(" ".join(f"{head:>{len(head) + 2}}" for head in heads))
    n = 100
    while n <= LARGEST:
        wall_s, processor_s, memory_mb = ended([*words, *COMPARE, "--seeds", str(n)], cwd=tmp_path, env=environment)
        out, table = tmp_path / "out", pl.read_parquet(tmp_path / "out/comparison.parquet")
        assert table["seed"].to_list() == list(range(n)) and max(map(len, map(os.listdir, out.glob("runs/quick/as_it_is")))) <= 1000
        page_mb, disk_mb = (out / "report.html").stat().st_size / 1e6, sum(p.stat().st_size for p in out.rglob("*") if p.is_file()) / 1e6
        (out / table["folder"][n // 2] / "summary.json").unlink()
        began = time.process_time()
        assert compare([], out=out, resume=True, jobs=1, film=False, report=False).height == n
        resumed_s = time.process_time() - began
        row = (n, wall_s, 1e3 * processor_s / n, resumed_s, memory_mb, page_mb, disk_mb)
        print(" ".join(f"{value:{len(head) + 2}.{0 if value == int(value) else 1}f}" for head, value in zip(heads, row, strict=True)))
        assert memory_mb < 1000 and page_mb < 10
        shutil.rmtree(out)
        n *= 10
