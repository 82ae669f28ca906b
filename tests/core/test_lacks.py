"""Want of memory and of open files: told with exit 4 and one sentence, never as a bug, a wrong file
or missing OpenGL.
"""

from __future__ import annotations

import errno
import os
import resource
import subprocess
from pathlib import Path
from typing import Any

import pytest

from vstestbed.core.errors import EnvironmentLackError, OutputError, lack_of, shortage
from vstestbed.core.files import writing

LIMITED = (
    "import resource, runpy, sys; resource.setrlimit(resource.{name}, ({value}, {value}));"
    " sys.argv = sys.argv[1:]; "
)


def limited(
    process: Any, folder: Path, name: str, value: int, *words: str
) -> subprocess.CompletedProcess[str]:
    """A command in a process with a limit."""
    (python, *_), environment = process
    start = (
        LIMITED.format(name=name, value=value)
        + "runpy.run_module('vstestbed', run_name='__main__', alter_sys=True)"
    )
    command = [python, "-c", start, "vstestbed", *words]
    own = {"RUST_BACKTRACE": "0"}
    return subprocess.run(
        command,
        cwd=folder,
        env=environment | own,
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )


def told(ended: subprocess.CompletedProcess[str]) -> str:
    """The last line of an ending by a lack."""
    assert (
        ended.returncode == 4
        and "a bug of vstestbed" not in ended.stderr
        and "Traceback" not in ended.stderr
    ), ended.stderr
    # printed from C
    return [
        line for line in ended.stderr.strip().splitlines() if not line.startswith("<jemalloc>")
    ][-1]


@pytest.mark.process
@pytest.mark.parametrize(
    "megabytes",
    [
        200,
        *(
            pytest.param(n, marks=pytest.mark.study)
            for n in (400, 600, 800, 1300, 1350, 1400, 1600, 1800)
        ),
    ],
)
def test_want_of_memory(tmp_path: Path, vstestbed_process: Any, megabytes: int) -> None:
    ended = limited(
        vstestbed_process,
        tmp_path,
        "RLIMIT_AS",
        megabytes * 1_000_000,
        "run",
        "arm_ibvs",
        "--set",
        "stop.duration_s=0.1",
    )
    assert told(ended).startswith("not enough memory")


@pytest.mark.process
@pytest.mark.parametrize(
    "files", [5, pytest.param(7, marks=pytest.mark.study), pytest.param(9, marks=pytest.mark.study)]
)
def test_want_of_open_files(tmp_path: Path, vstestbed_process: Any, files: int) -> None:
    ended = limited(
        vstestbed_process,
        tmp_path,
        "RLIMIT_NOFILE",
        files,
        "run",
        "arm_ibvs",
        "--set",
        "stop.duration_s=0.1",
    )
    line = told(ended)
    assert line.startswith("too many open files (") and "raise the limit (ulimit -n 1024)" in line


def test_the_first_cause_is_told_and_what_later_ones_advise_is_not() -> None:
    with pytest.raises(OutputError) as refused, writing(Path("log.part")):
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE), "log.part")
    lack = lack_of(refused.value)
    assert isinstance(lack, EnvironmentLackError) and "another place" not in str(lack)
    assert str(lack).startswith(
        "too many open files ([Errno 24] Too many open files: 'log.part'); raise the limit"
    )


def test_whichever_library_says_it() -> None:
    for error, words in (
        (
            MemoryError("Unable to allocate 9 TiB for an array"),
            "not enough memory (Unable to allocate 9 TiB for an array); close other",
        ),
        (OSError(errno.ENOMEM, "Cannot allocate memory"), "not enough memory ("),
        (
            ImportError("libx.so: failed to map segment from shared object"),
            "not enough memory (libx.so",
        ),
        (OSError(errno.ENFILE, "Too many open files in system"), "too many open files ("),
    ):
        assert str(lack_of(error)).startswith(words)


def test_other_errors_are_no_such_lack() -> None:
    for error in (
        ValueError("x"),
        OSError(errno.EACCES, "Permission denied"),
        EnvironmentLackError("no OpenGL", "install it"),
    ):
        assert lack_of(error) is None and shortage() is None


def test_a_process_that_can_open_nothing_more_is_short() -> None:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    held = os.open(os.devnull, os.O_RDONLY)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (held + 1, before[1]))
        assert str(shortage()).startswith("too many open files")
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
        os.close(held)
