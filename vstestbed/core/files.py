"""Atomic writing of files, and the errors of files that cannot be written."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from vstestbed.core.errors import EnvironmentLackError, OutputError

NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  # disk full, quota exceeded, file too large


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an OSError raised while something is written under `path` into an error with a remedy.

    Raises:
        EnvironmentLackError: no space left. OutputError: any other reason, such as a lack of permission.
    """
    try:
        yield
    except OSError as error:
        if error.errno in NO_SPACE:
            raise EnvironmentLackError(f"{path}: no space left on the disk", "free some, or choose another place") from error
        raise OutputError(path, f"cannot be written ({error.strerror or error})", "choose another place") from error


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write a file atomically: it appears whole or not at all, also if the machine loses power.

    Raises:
        EnvironmentLackError, OutputError: see `writing`.
    """
    part = path.with_name(path.name + ".part")
    try:
        with writing(path):
            with part.open("wb") as file:
                file.write(content.encode() if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())  # else the rename could reach the disk before the content
            part.replace(path)
    except BaseException:  # also Ctrl-C leaves no partial file
        part.unlink(missing_ok=True)
        raise
    return path


def new_study_folder(kind: str, out: Path | None, remedy: str = "give a new one") -> Path:
    """The folder for a study (basin, compare, ...), which is not created here: `out`, or the next free number in runs/KIND.

    Raises:
        OutputError: the folder is not empty, or cannot be read.
    """
    if out is None:
        parent = Path("runs") / kind
        taken = [int(p.name) for p in parent.iterdir() if p.name.isdecimal()] if parent.is_dir() else []
        return parent / f"{max(taken, default=0) + 1:03d}"
    with writing(out):
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise OutputError(out, "exists and is not an empty folder", remedy)
    return out
