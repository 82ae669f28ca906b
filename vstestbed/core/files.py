"""The one way in which files are written: whole, never through a link; and the errors of files that cannot be written or read.

A file is written under a temporary name that cannot be guessed, opened exclusively (O_EXCL: a file or a link of that name is neither
written to nor followed; CWE-59), and renamed. The rename replaces a link that stands under the file's own name; its target stays as it is.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import IO

from vstestbed.core.errors import EnvironmentLackError, OutputError, RunFolderError

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


class PartFile:
    """A file that grows under a temporary name until `keep` gives it its own; a context manager, which keeps or, on an error, discards.

    Args:
        path: the file's own name; what is there is replaced by `keep`. buffering: as of `open`.

    Raises:
        OSError: it cannot be made (see `writing`).
    """

    def __init__(self, path: Path, buffering: int = -1):
        self.path, self.part = path, temporary(path)
        self.file: IO[bytes] = self.part.open("x+b", buffering)

    def keep(self) -> None:
        """Flush the file to the disk, and rename it: it appears whole or not at all, also if the machine loses power."""
        self.file.flush()
        os.fsync(self.file.fileno())  # else the rename could reach the disk before the content
        self.file.close()
        self.part.replace(self.path)

    def discard(self) -> None:
        """Remove the file; harmless after `keep`."""
        with contextlib.suppress(OSError):  # a full disk: what waits to be written is not needed
            self.file.close()
        self.part.unlink(missing_ok=True)

    def __enter__(self) -> PartFile:
        """The file itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Keep, or discard when an exception is on its way: also Ctrl-C leaves no partial file."""
        try:
            if kind is None:
                self.keep()
        finally:
            self.discard()


def temporary(path: Path) -> Path:
    """A name beside `path` that cannot be guessed (64 random bits), for what is renamed to `path` when it is complete."""
    # Cut, since file systems take names of up to 255 bytes.
    return path.with_name(f"{path.name[:50]}.{secrets.token_hex(8)}.part")


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write a file atomically: it appears whole or not at all.

    Raises:
        EnvironmentLackError, OutputError: see `writing`.
    """
    with writing(path), PartFile(path) as part:
        part.file.write(content.encode() if isinstance(content, str) else content)
    return path


def make_folder(folder: Path) -> Path:
    """Make a folder inside one of results, unless it is there.

    Raises:
        OutputError: it is a link, and what is written there would replace files elsewhere. EnvironmentLackError: see `writing`.
    """
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    if folder.is_symlink():
        raise OutputError(folder, "is a link to another folder, whose files would be replaced", "remove the link")
    return folder


def make_parents(path: Path) -> Path:
    """Make the folders above a new file or folder that a person names, where they are not there; returns the path.

    Raises:
        EnvironmentLackError, OutputError: see `writing`.
    """
    # where a file stands in the place of a folder, what writes there says so
    with writing(path), contextlib.suppress(FileExistsError, NotADirectoryError):
        path.parent.mkdir(parents=True, exist_ok=True)
    return path


def read_file(path: Path, works: str) -> bytes:
    """The content of a file of a results folder; `works`: what would work, for the message.

    Raises:
        RunFolderError: it is missing, is no plain file (a pipe would never end), or cannot be read.
    """
    try:
        if path.is_file():
            return path.read_bytes()
        found = "is not a plain file" if path.exists() else "is missing"
    except OSError as error:
        found = f"cannot be read ({error.strerror or error})"
    raise RunFolderError(path, found, works)
