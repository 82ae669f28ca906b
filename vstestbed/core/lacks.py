"""Want of memory and of open files: told as a lack of this machine, whichever library met it and in whose words."""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import re
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from vstestbed.core.errors import EnvironmentLackError

MEMORY = re.compile(r"(?i)cannot allocate memory|could not allocate|insufficient memory|failed to map segment|bad_alloc|\bMemoryError\b")
"""What libraries say for want of memory: the loader of shared libraries, MuJoCo, OpenCV, C++, ctypes."""
FILES = re.compile(r"(?i)too ?many ?open ?files")
SPARE_BYTES, SPARE_FILES = 1 << 28, 8  # What a process that is not short can still have: the largest library takes less memory to load


def lack_of(error: BaseException) -> EnvironmentLackError | None:
    """The error for want of memory or of open files that an error, or one behind it, comes from; None where it comes from neither."""
    for one in reversed([*_chain(error)]):  # the first cause says what was wanted, without what later ones advise
        number = one.errno if isinstance(one, OSError) else None
        if isinstance(one, MemoryError) or number == errno.ENOMEM or MEMORY.search(str(one)):
            return _memory(one)
        if number in (errno.EMFILE, errno.ENFILE) or FILES.search(str(one)):
            return _files(one)
    return None


def shortage() -> EnvironmentLackError | None:
    """The error for what this process cannot have any more, for an error whose words do not tell; None where it is short of nothing."""
    with contextlib.ExitStack() as spare:
        try:
            for _ in range(SPARE_FILES):
                spare.enter_context(Path(os.devnull).open("rb"))
        except OSError as error:
            return _files(error)
    try:
        mmap.mmap(-1, SPARE_BYTES).close()
    except (OSError, MemoryError) as error:
        return _memory(error)
    return None


def take_early() -> None:
    """Under a limit of memory (`ulimit -v`) load the libraries with an OpenBLAS, and have each take its memory, while there is some. What
    OpenBLAS cannot have it asks for again without end, in C code that holds Python's lock: the process hangs, and serves no signal. One
    thread each: every further one would take 32 MiB.
    Raises OSError: there is too little; `lack_of` tells it.
    """
    if sys.platform == "win32":
        return
    import resource

    if resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # By name: core computes nothing with OpenCV. What each is asked for makes its BLAS take memory.
    for module, use in (("numpy.linalg", "inv"), ("scipy.linalg", "inv"), ("cv2", "SVDecomp")):
        mmap.mmap(-1, SPARE_BYTES).close()
        eye = import_module("numpy").eye(64)
        getattr(import_module(module), use)(eye @ eye)


def _chain(error: BaseException) -> Iterator[BaseException]:
    seen: set[int] = set()
    one: BaseException | None = error
    while one is not None and id(one) not in seen:
        seen.add(id(one))
        yield one
        one = one.__cause__ or one.__context__


def _memory(error: BaseException) -> EnvironmentLackError:
    words = "close other programs, raise the limit (ulimit -v), or make what is asked for smaller: fewer --jobs, starts or pixels"
    return EnvironmentLackError(f"not enough memory{_said(error)}", words)


def _files(error: BaseException) -> EnvironmentLackError:
    return EnvironmentLackError(f"too many open files{_said(error)}", "raise the limit (ulimit -n 1024), or use fewer --jobs")


def _said(error: BaseException) -> str:
    words = str(error).strip().split("\n")[0]
    return f" ({words})" if words else ""
