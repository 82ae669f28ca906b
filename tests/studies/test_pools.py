"""Pools of workers: how they end when the study is interrupted or killed, and when a cluster's
scheduler dies.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from vstestbed.studies.pools import LocalPool, WorkerLostError

pytestmark = pytest.mark.process
ENDS_S = 10.0
"""A study ends this soon after Ctrl-C, also on a machine with much else to do; alone it takes a
second.
"""
AXES = ("--vary", "law.gain=3,6", "--vary", "camera.rate_hz=20,25")
LONG = (
    "--set",
    "stop.converged.error_px=1e-9",
    "--set",
    "noise.pixel_sigma_px=0.1",
    "--set",
    "stop.duration_s=3000",
)
"""Runs of minutes."""
STUDIES = {
    "compare": ("compare", "quick.yaml", *AXES, "--seeds", "8", "--no-film"),
    "sweep": ("sweep", "quick.yaml", *AXES, "--seeds", "8"),
    "tune": ("tune", "quick.yaml", "--vary", "law.gain=3:6", "--seeds", "4"),
}
MAP = ("--x", "x=-0.3:0.3", "--y", "y=-0.3:0.3", "--n", "40", "--check", "30")
Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start(tmp_path: Path, quick: Path, vstestbed_process: Any) -> Iterator[Start]:
    """Starts `vstestbed WORDS` in the folder of `quick.yaml`, in a group of processes of its own,
    as a terminal does.
    """
    words, environment = vstestbed_process
    going: list[subprocess.Popen[str]] = []

    def call(*more: str) -> subprocess.Popen[str]:
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        going.append(
            subprocess.Popen(
                [*words, *more], cwd=tmp_path, env=environment, start_new_session=True, **streams
            )
        )
        return going[-1]

    yield call
    for process in going:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)  # with what a test that fails has left
        process.communicate()


def workers_of(process: subprocess.Popen[str]) -> list[int]:
    """Its child processes that are workers (the others: multiprocessing's tracker of resources)."""
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    found = map(int, children.read_text().split()) if children.exists() else ()
    return [pid for pid in found if b"spawn_main" in command_of(pid)]


def command_of(pid: int) -> bytes:
    """The command line of a process; empty if it has ended."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except (FileNotFoundError, ProcessLookupError):
        return b""


def wait_for(true: Callable[[], object], seconds: float = 60) -> float:
    """Wait until something is true; returns the time that it took [s]."""
    began = time.monotonic()
    while not true():
        assert time.monotonic() - began < seconds
        time.sleep(0.02)
    return time.monotonic() - began


def interrupted(process: subprocess.Popen[str]) -> tuple[float, str]:
    """Ctrl-C, which a terminal sends to the process and to its workers: the time until it ends [s],
    and what it says.
    """
    os.killpg(process.pid, signal.SIGINT)
    began = time.monotonic()
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    return time.monotonic() - began, err


@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="workers are found in /proc")
@pytest.mark.parametrize(
    "study",
    [
        pytest.param("sweep", marks=pytest.mark.app("maps")),
        pytest.param("compare", marks=pytest.mark.study),
        pytest.param("tune", marks=[pytest.mark.app("tune"), pytest.mark.study]),
    ],
)
@pytest.mark.parametrize(
    "later_s", [0.4, *(pytest.param(s, marks=pytest.mark.study) for s in (0.0, 0.8, 5.0))]
)
def test_ctrl_c_ends_a_study_at_once(start: Start, tmp_path: Path, study: str, later_s: float):
    """Also while its workers start, which then end without a word, and in the middle of runs that
    take minutes.
    """
    process = start(*STUDIES[study], *LONG, "--jobs", "2", "--out", "out")
    wait_for(lambda: len(workers_of(process)) == 2)
    time.sleep(later_s)
    workers = workers_of(process)
    took_s, err = interrupted(process)
    assert took_s < ENDS_S
    assert err.splitlines()[0].startswith("interrupted: 0 of ") and len(err.splitlines()) == 1
    wait_for(lambda: not any(map(command_of, workers)), ENDS_S)
    assert not (tmp_path / "out" / ".running").exists()


@pytest.mark.app("maps", "bench")
@pytest.mark.parametrize(
    ("words", "said", "kept"),
    [
        (
            ("gain-limit", "quick.yaml", "--out", "out"),
            "interrupted: 1 of 6 delays are done; results in out (open report.html)",
            "delay",
        ),
        (
            ("basin", "quick.yaml", "--vary", "law.gain=3,6", *MAP, "--out", "out"),
            "interrupted: 1 of 2 maps are done; results in out (open report.html)",
            "basin",
        ),
        pytest.param(("bench", "--all"), "interrupted", "", marks=pytest.mark.study),
    ],
)
def test_ctrl_c_in_a_run_ends_the_study_around_it(
    start: Start, tmp_path: Path, words: tuple[str, ...], said: str, kept: str
):
    """Not that run alone, after which the study went on with the next one; what is done is kept."""
    process = start(*words)
    assert process.stderr is not None
    assert process.stderr.readline().strip()  # the first result, or what is measured first
    if not kept:
        time.sleep(0.5)
    took_s, err = interrupted(process)
    assert took_s < ENDS_S
    assert err.splitlines()[-1] == said
    if kept:
        assert (
            len(pl.read_parquet(tmp_path / f"out/{kept}.parquet"))
            == len(pl.read_csv(tmp_path / f"out/{kept}.csv"))
            > 0
        )
        assert (tmp_path / "out/report.html").exists()


@pytest.mark.app("maps")
def test_an_interrupted_sweep_keeps_what_is_done(start: Start, tmp_path: Path):
    process = start(
        "sweep",
        "quick.yaml",
        *AXES,
        "--seeds",
        "100",
        "--jobs",
        "2",
        "--out",
        "out",
        "--set",
        "stop.duration_s=0.4",
    )
    assert process.stderr is not None
    assert process.stderr.readline() == "100 of 400 runs\n"
    took_s, err = interrupted(process)
    assert took_s < 2 * ENDS_S  # it draws the map
    table = pl.read_parquet(tmp_path / "out" / "convergence.parquet")
    assert 100 <= len(table) < 400
    assert (
        f"interrupted: {len(table)} of 400 runs are done; results in out (open report.html)\n"
        in err
    )
    # in the order of the plan, whichever worker was first
    assert table["seed"].to_list() == sorted(table["seed"].to_list())
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert f"Interrupted: {400 - len(table)} of 400 runs are missing" in page


@pytest.mark.app("maps")
@pytest.mark.skipif(not Path("/proc/self/task").exists(), reason="workers are found in /proc")
@pytest.mark.parametrize("later_s", [0.0, pytest.param(5.0, marks=pytest.mark.study)])
def test_workers_end_with_a_killed_study(start: Start, later_s: float):
    process = start(*STUDIES["sweep"], *LONG, "--jobs", "2", "--out", "out")
    wait_for(lambda: len(workers_of(process)) == 2)
    time.sleep(later_s)
    workers = workers_of(process)
    process.kill()
    wait_for(lambda: not any(map(command_of, workers)), 2 * ENDS_S)


def test_shares_of_a_closed_pool_are_not_done_here(tmp_path: Path):
    """An interrupted report: the process waited at its end for the figures that its killed workers
    had begun.
    """
    with closing(LocalPool(2, tmp_path)) as pool:
        pool._start()
        [slot.pid.result() for slot in pool._slots]
        share = pool.call(time.sleep, 60)
        wait_for(lambda: len(pool._free) < 2)
    assert isinstance(share.exception(timeout=10), WorkerLostError)


@contextmanager
def dask(kind: str, port: int, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """`dask scheduler` or `dask worker` as a process of its own."""
    line = [
        sys.executable,
        "-m",
        f"distributed.cli.dask_{kind}",
        "--host",
        "127.0.0.1",
        "--no-dashboard",
        *words,
    ]
    process = subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.mark.study
def test_a_scheduler_that_dies_is_told_and_resume_goes_on(start: Start, tmp_path: Path):
    pytest.importorskip("distributed")
    port = free_port()
    scheduler, worker = (
        ("scheduler", port, "--port", str(port)),
        ("worker", port, f"127.0.0.1:{port}", "--nthreads", "1"),
    )
    where = ("--executor", f"dask://127.0.0.1:{port}", "--out", "out", "--no-film")
    words = (
        "compare",
        "quick.yaml",
        *AXES,
        "--seeds",
        "40",
        "--set",
        "noise.pixel_sigma_px=0.1",
        *where,
    )
    with dask(*scheduler) as dies, dask(*worker):
        wait_for(lambda: answers(port))
        process = start(*words)
        wait_for(lambda: done_in(tmp_path) >= 8 or process.poll() is not None, 180)
        dies.kill()
        _, err = process.communicate(timeout=60)
    assert process.returncode == 4, err
    assert (
        err.splitlines()[-1]
        == "the dask scheduler is gone; start it again, then go on with --resume"
    )
    assert "Traceback" not in err
    kept = done_in(tmp_path)
    assert 8 <= kept < 160
    assert len(pl.read_parquet(tmp_path / "out/comparison.parquet")) == kept
    with dask(*scheduler), dask(*worker):
        wait_for(lambda: answers(port))
        again = start("compare", "--resume", *where)
        _, err = again.communicate(timeout=300)
    assert again.returncode == 0, err
    assert len(pl.read_parquet(tmp_path / "out/comparison.parquet")) == 160


def done_in(folder: Path) -> int:
    """Stored runs of a comparison."""
    return len(list(folder.glob("out/runs/*/*/*[0-9]/summary.json")))


def free_port() -> int:
    """A port of this machine that nobody listens at."""
    import socket

    with socket.create_server(("127.0.0.1", 0)) as found:
        return found.getsockname()[1]


def answers(port: int) -> bool:
    """Whether somebody listens at a port of this machine."""
    import socket

    with socket.socket() as one:
        return one.connect_ex(("127.0.0.1", port)) == 0
