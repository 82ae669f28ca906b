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
