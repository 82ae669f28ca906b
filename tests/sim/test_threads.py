"""Pictures by OpenGL in any thread, in any order, several at once: the same bytes, no words, a
clean end of the process.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

RUN = """
import hashlib, os, pathlib, signal, sys, threading, time
import vstestbed as vs

def scenario(width=160):
    small = {
        "camera.width": width,
        "camera.height": 120,
        "target.marker.radius": 0.06,
        "stop.duration_s": 0.12,
    }
    return vs.load("arm_ibvs", small)

def log(width=160):
    recording = vs.run(scenario(width))
    by = "rays" if recording.versions["renderer"].startswith("rays") else "gl"
    return by + hashlib.sha256(recording.table.tobytes()).hexdigest()

def in_threads(*widths):
    logs = {}
    def work(i, width): logs[i] = log(width)
    threads = [threading.Thread(target=work, args=item) for item in enumerate(widths)]
    for thread in threads: thread.start()
    for thread in threads: thread.join()
    return [logs.get(i) for i in range(len(widths))]
"""
ANY_ORDER = """
first, main, again = *in_threads(160), log(), *in_threads(160)
wide = log(200)  # of another size: a rendering context of its own
rising = in_threads(160, 200) == [main, wide]
mixed = in_threads(200, 160, 200) == [wide, main, wide]
print(main[:2], {first, main, again} == {main}, rising, mixed)
"""
INTERRUPTED = """
class Interrupts:
    def frame(self, frame):
        if frame.timing.number == 1:
            threading.Timer(0.01, os.kill, (os.getpid(), signal.SIGINT)).start()
endless = vs.load("arm_ibvs", {"stop.duration_s": 1000, "stop.converged.error_px": 1e-9})
print(vs.run(endless, [Interrupts()]).outcome.name, log() == log())
"""
FORKED = """
import vstestbed.sim.render.opengl
from vstestbed.core.errors import EnvironmentLackError
def child(work):
    if (pid := os.fork()) == 0:
        work()
        sys.exit(0)
    return os.waitpid(pid, 0)[1]
def drawn(): pathlib.Path(sys.argv[1]).write_text(log())
def refused():
    try: vs.run(vs.load("arm_ibvs", {"camera.renderer": "gl"}))
    except EnvironmentLackError as error: print(error, flush=True)
before = child(drawn)
same = log() == pathlib.Path(sys.argv[1]).read_text()
print(before, same, flush=True)
print(child(refused), log() == log())
"""
REFUSED = (
    "no OpenGL: this process is a fork of one that has drawn with it;"
    " start processes with multiprocessing's method spawn"
)


@pytest.mark.process
@pytest.mark.parametrize(
    ("code", "said"),
    [
        (ANY_ORDER + INTERRUPTED, "gl True True True\ninterrupted True\n"),
        pytest.param(FORKED, f"0 True\n{REFUSED}\n0 True\n", marks=pytest.mark.study),
    ],
    ids=["thread, main, thread, several at once, Ctrl-C", "forks"],
)
@pytest.mark.opengl
def test_any_thread_draws(code: str, said: str, tmp_path: Path):
    """A process for each: how it ends, and what it says then, is a part of the test."""
    done = subprocess.run(
        [sys.executable, "-c", RUN + code, str(tmp_path / "log")],
        env=os.environ | {"LP_NUM_THREADS": "2"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert (done.stdout, done.stderr, done.returncode) == (said, "", 0)
