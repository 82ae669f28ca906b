"""Ten thousand files and two hundred runs, each under a limit of processor time that also ends a
loop in compiled code.

pytest -m study tests/long/test_fuzz.py -s
"""

from __future__ import annotations

import os
import pickle
import signal
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.scenario.fuzz import CPU_S, FAULT, cases, loading, running

FILES, RUNS = 10_000, 200
RUN_CPU_S = 60.0
BATCH = 250
"""Files that one child process works through."""

pytestmark = pytest.mark.study


def drawn(count: int) -> list[bytes]:
    """Different contents of files, always the same."""
    found: dict[bytes, None] = {}

    @seed(1)
    @settings(
        max_examples=count,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(raw=cases)
    def collect(raw: bytes) -> None:
        found[raw] = None

    collect()
    return list(found)


def in_children(
    work: Callable[[bytes, Path], str], files: Sequence[bytes], path: Path, cpu_s: float
) -> list[str]:
    """The finding of each file; a child process that takes more than cpu_s [s] for one is ended by
    the kernel.
    """
    found: list[str] = []
    while len(found) < len(files):
        reads, writes = os.pipe()
        child = os.fork()
        if child == 0:
            signal.signal(signal.SIGPROF, signal.SIG_DFL)
            with os.fdopen(writes, "wb") as out:
                for raw in files[len(found) : len(found) + BATCH]:
                    signal.setitimer(signal.ITIMER_PROF, cpu_s)
                    pickle.dump(work(raw, path), out)
                    out.flush()
            os._exit(0)
        os.close(writes)
        with os.fdopen(reads, "rb") as results:
            while True:
                try:
                    found.append(pickle.load(results))
                except EOFError:
                    break
        if status := os.waitpid(child, 0)[1]:
            found.append(f"{FAULT}ended by signal {status & 127}")
    return found


def faults(all_messages: Sequence[str], files: Sequence[bytes]) -> dict[str, bytes]:
    """An example of each fault."""
    return {
        what: raw for what, raw in zip(all_messages, files, strict=True) if what.startswith(FAULT)
    }


def test_a_child_that_hangs_is_ended(tmp_path: Path) -> None:
    def hangs(raw: bytes, path: Path) -> str:
        while raw == b"1":
            pass
        return "loads"

    assert in_children(hangs, [b"0", b"1", b"2"], tmp_path, 0.2) == [
        "loads",
        f"{FAULT}ended by signal {signal.SIGPROF}",
        "loads",
    ]


def test_ten_thousand_files_and_two_hundred_runs(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    files = drawn(FILES)
    loaded = in_children(loading, files, path, 2 * CPU_S)
    print(f"{len(files)} different of {FILES} files:", Counter(loaded))
    assert faults(loaded, files) == {}
    valid = [raw for raw, what in zip(files, loaded, strict=True) if what == "loads"]
    # Evenly over all: hypothesis draws similar ones in a row.
    chosen = valid[:: max(1, len(valid) // RUNS)][:RUNS]
    assert len(chosen) == RUNS
    ran = in_children(running, chosen, path, RUN_CPU_S)
    print(f"{len(chosen)} runs:", Counter(ran))
    assert faults(ran, chosen) == {}
