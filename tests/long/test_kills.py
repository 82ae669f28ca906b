"""Kill studies: a run or a comparison ended at random moments, by every signal, on a full disk, in
poor environments.

Each ends with the right exit code and without a traceback, and leaves no file that looks finished
and is not. VSTESTBED_KILLS limits the number of kills of `run`; four tenths of it are those of
`compare`.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from vstestbed.core.errors import RunFolderError
from vstestbed.loop.log_file import open_log

pytestmark = pytest.mark.study
KILLS = int(os.environ.get("VSTESTBED_KILLS", "100"))
LAST_S = 4.0
"""Moments of kills are drawn from 0 to this [s]: start-up, run, log, report."""
RUN = ("run", "quick.yaml", "--video", "none")
COMPARE = (
    "compare",
    "quick.yaml",
    "--vary",
    "law.gain=3.0,6.0",
    "--seeds",
    "12",
    "--no-film",
    "--jobs",
    "2",
    "--quiet",
)
ENDLESS = (
    "--set",
    "stop.duration_s=1000",
    "--set",
    "stop.converged.error_px=1e-9",
    "--set",
    "noise.pixel_sigma_px=0.1",
)
MOODS = ("time_ms.", "wall_time_s", "real_time_factor", "attempts")

Start = Callable[..., "subprocess.Popen[str]"]


@pytest.fixture
def start(tmp_path: Path, quick: Path, vstestbed_process: Any) -> Start:
    """Starts `vstestbed WORDS` in the folder of `quick.yaml`."""

    def call(*words: str, **more: Any) -> subprocess.Popen[str]:
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        options = (
            {
                "cwd": tmp_path,
                "env": vstestbed_process[1],
                "text": True,
                "preexec_fn": _heed_hang_up,
            }
            | streams
            | more
        )
        return subprocess.Popen([*vstestbed_process[0], *words], **options)

    return call


def _heed_hang_up() -> None:
    """A study that was started by `nohup` ignores SIGHUP, and so would its children."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def must_be_sound(folder: Path) -> None:
    """Whatever has the name of a finished file can be read to its end."""
    for path in folder.rglob("*.parquet"):
        # of a comparison without a finished run
        assert pl.read_parquet(path).width or path.name == "comparison.parquet"
    for path in folder.rglob("summary.json"):
        assert json.loads(path.read_text(encoding="utf-8"))["outcome"]
        if ".part" not in str(path) and ".running" not in str(path):
            assert (path.parent / "log.parquet").is_file()
    for path in folder.rglob("report.html"):
        assert path.read_text(encoding="utf-8").rstrip().endswith("</html>")


def lasting(folder: Path) -> dict[str, bytes]:
    """The content of a comparison apart from its times: logs and scenarios as bytes, tables without
    what depends on the machine.
    """
    kept = {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in folder.rglob("*")
        if p.name in ("log.parquet", "scenario.yaml")
    }
    kept["comparison.yaml"] = (folder / "comparison.yaml").read_bytes()
    table = pl.read_parquet(folder / "comparison.parquet")
    kept["table"] = (
        table.drop([c for c in table.columns if c.startswith(MOODS)]).write_csv().encode()
    )
    return kept


def wait_for(true: Callable[[], bool], seconds: float = 120) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_runs_killed_at_any_moment(start: Start, tmp_path: Path):
    rng = np.random.default_rng(1)
    ended = 0
    for i in range(KILLS):
        process = start(*RUN, "--quiet", "--out", f"out/{i}")
        time.sleep(float(rng.uniform(0, LAST_S)))
        process.kill()
        _, err = process.communicate()
        assert process.returncode in (0, -signal.SIGKILL), err
        ended += process.returncode == 0
        folder = tmp_path / "out" / str(i)
        must_be_sound(folder)
        if process.returncode == 0:
            assert (folder / "report.html").is_file()
        elif (folder / "log.part").exists():
            try:
                log = open_log(folder).frame()
            except RunFolderError as error:
                # killed before its head was written
                assert "before its first line does" in str(error)
            else:
                assert log["frame"].to_list() == list(range(log.height))
    assert ended < KILLS


PACED = """
import sys, time, vstestbed as vs
from pathlib import Path
class Paced:
    def frame(self, frame):
        print(frame.timing.number, time.time(), flush=True)
        time.sleep(float(sys.argv[1]))  # a loop as slow as that
Path("out").mkdir()
settings = {a.split("=")[0]: float(a.split("=")[1]) for a in sys.argv[2:]}
vs.run_into(Path("out"), vs.load("quick.yaml", settings), "none", [Paced()], report=False)
"""
LEAST_LOSS_S, CONGESTION_S = 0.1, 0.1
"""What a kill may lose of a run's log; how late a process on a busy machine may be beside it."""


@pytest.mark.parametrize("pause_s", [0.0, 0.02, 0.04, 0.15])
def test_a_killed_run_loses_a_tenth_of_a_second_at_most(
    tmp_path: Path, quick: Path, vstestbed_process: Any, pause_s: float
):
    words = [
        vstestbed_process[0][0],
        "-c",
        PACED,
        str(pause_s),
        *(w for w in ENDLESS if w != "--set"),
    ]
    lost, printed = [], tmp_path / "printed"
    for i in range(5):
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        with printed.open("w") as sink:
            process = subprocess.Popen(words, cwd=tmp_path, env=vstestbed_process[1], stdout=sink)
            wait_for(lambda: printed.read_text().count("\n") > 10)
            time.sleep(0.3 + 0.03 * i)  # killed at another moment of its flushing each time
            process.kill()
            killed = time.time()
            process.wait()
        came = [
            float(line.split()[1])
            for line in printed.read_text().splitlines()
            if line.count(".") == 1
        ]
        kept = open_log(tmp_path / "out").frame()
        assert kept["frame"].to_list() == list(range(kept.height))
        lost.append(killed - came[kept.height] if kept.height < len(came) else 0.0)
    print(f"a frame each {pause_s} s: lost {max(lost):.3f} s")
    assert max(lost) < LEAST_LOSS_S + CONGESTION_S


def test_comparisons_killed_and_resumed_equal_one_that_was_not(start: Start, tmp_path: Path):
    rng, kills, number = np.random.default_rng(2), 0, 0
    assert start(*COMPARE, "--out", "whole").wait() == 0
    while kills < 4 * KILLS // 10:
        out = tmp_path / f"c{number}"
        number += 1
        for _ in range(min(5, 4 * KILLS // 10 - kills)):
            process = start(*going_on(out), "--out", out.name)
            time.sleep(float(rng.uniform(0, 2 * LAST_S)))
            process.kill()
            process.communicate()
            kills += 1
            must_be_sound(out)
        last = start(*going_on(out), "--out", out.name)
        _, err = last.communicate()
        assert last.returncode == 0, err
        assert lasting(out) == lasting(tmp_path / "whole")
        assert [p.name for p in (*out.glob("runs/*/*/*.part"), *out.glob(".running"))] == []


def going_on(out: Path) -> tuple[str, ...]:
    """The words that begin a comparison, or go on with it; one that was killed before its plan was
    there begins again.
    """
    if (out / "comparison.yaml").exists():
        return ("compare", "--resume", "--no-film", "--jobs", "2", "--quiet")
    shutil.rmtree(out, ignore_errors=True)
    return COMPARE


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("words", [RUN, COMPARE])
def test_signals_interrupt_and_keep_what_was_done(
    start: Start, tmp_path: Path, number: signal.Signals, words: tuple[str, ...]
):
    if words is RUN:
        process = start(*RUN, *ENDLESS, "--out", "out")
        wait_for(lambda: (tmp_path / "out/log.part").exists())
    else:
        process = start(*COMPARE, "--set", "stop.converged.hold_s=2", "--out", "out")
        wait_for(lambda: len(list((tmp_path / "out").glob("runs/*/*/*[0-9]/summary.json"))) > 2)
    process.send_signal(number)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130, err
    assert err.startswith("interrupted: ")
    assert "Traceback" not in err
    must_be_sound(tmp_path / "out")
    kept = tmp_path / "out" / ("log.parquet" if words is RUN else "comparison.parquet")
    assert pl.read_parquet(kept).height >= (0 if words is RUN else 3)
    assert not (tmp_path / "out" / ".running").exists()


def test_an_ignored_hang_up_is_ignored(start: Start, tmp_path: Path):
    """As under `nohup`."""
    process = start(
        *RUN,
        "--quiet",
        "--out",
        "out",
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    wait_for(lambda: (tmp_path / "out").exists())
    process.send_signal(signal.SIGHUP)
    assert process.wait() == 0


@pytest.mark.parametrize("words", [RUN, COMPARE])
@pytest.mark.parametrize("kilobytes", [2, 20, 60])
def test_files_that_may_not_grow(
    start: Start, tmp_path: Path, words: tuple[str, ...], kilobytes: int
):
    limit = (1000 * kilobytes, 1000 * kilobytes)
    process = start(
        *words,
        *ENDLESS,
        "--out",
        "out",
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, limit),
    )
    _, err = process.communicate(timeout=300)
    assert process.returncode == 4, err
    assert "no space left on the disk; free some, or choose another place" in err
    assert "Traceback" not in err
    must_be_sound(tmp_path / "out")


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Callable[[int], Path]]:
    """Mounts a small disk of so many kilobytes."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def mount(kilobytes: int) -> Path:
        words = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "tmpfs", str(folder)]
        if not shutil.which("mount") or subprocess.run(words, capture_output=True).returncode:
            pytest.skip("no disk can be mounted here")
        return folder

    yield mount
    if os.path.ismount(folder):
        subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize("words", [RUN, ("run", "quick.yaml"), COMPARE])
@pytest.mark.parametrize("kilobytes", [8, 48, 52, 64, 400])
def test_a_full_disk(
    start: Start, disk: Callable[[int], Path], words: tuple[str, ...], kilobytes: int
):
    out = disk(kilobytes) / "out"
    process = start(*words, *ENDLESS, "--out", str(out))
    # at once: not after runs of minutes, done in vain where another disk has space
    _, err = process.communicate(timeout=120)
    assert process.returncode == 4, err
    assert "free some" in err
    assert "Traceback" not in err
    must_be_sound(out)


@pytest.mark.parametrize(
    ("changes", "detector"),
    [
        ({}, "oracle"),  # `env -i`: neither HOME nor a locale
        (
            {"HOME": "/proc/none", "XDG_CACHE_HOME": "/proc/none", "MPLCONFIGDIR": "/proc/none"},
            "oracle",
        ),
        ({"LC_ALL": "C", "PYTHONIOENCODING": "ascii"}, "oracle"),
        ({"MUJOCO_GL": "osmesa"}, "blobs"),
        ({"MUJOCO_GL": "glfw"}, "blobs"),
        ({"MUJOCO_GL": "nonsense"}, "blobs"),
    ],
)
def test_poor_environments(
    start: Start, tmp_path: Path, vstestbed_process: Any, changes: dict[str, str], detector: str
):
    environment = {"PYTHONPATH": vstestbed_process[1]["PYTHONPATH"]} | changes
    process = start(
        *RUN,
        "--set",
        f"detector={detector}",
        "--set",
        "stop.duration_s=0.4",
        "--out",
        "out",
        env=environment,
    )
    _, err = process.communicate(timeout=300)
    assert process.returncode in (3, 4) and (process.returncode == 3 or detector == "blobs"), err
    assert "Traceback" not in err
    if process.returncode == 3:
        must_be_sound(tmp_path / "out")
        assert (tmp_path / "out/report.html").is_file()
