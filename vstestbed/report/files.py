"""Files that are whole or not there."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path

from vstestbed.errors import OutputError


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write under another name first: what stands under its name is always whole.

    Raises:
        OutputError: it cannot be written; exit code 4 where the disk is full.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(content.encode() if isinstance(content, str) else content)
        part.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        raise OutputError(path, os.strerror(error.errno or 0), "free some space or give another folder", 4 if full else 2) from error
    return path
