"""The one way in which files are written: whole, under a temporary name, then renamed; and the
errors of files that cannot be written or read.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shlex
import shutil
import unicodedata
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import IO, TYPE_CHECKING, Any

from vstestbed.core.errors import EnvironmentLackError, OutputError, RunFolderError
from vstestbed.core.foreign import foreign

if TYPE_CHECKING:
    import polars

__all__ = [
    "NO_SPACE",
    "PartFile",
    "allowed",
    "distinct",
    "file_word",
    "flush_entries",
    "linked",
    "make_folder",
    "make_parents",
    "must_be_new",
    "new_folder",
    "numbered",
    "only_writer",
    "read_file",
    "read_json",
    "remove_empty",
    "study_folder",
    "temporary",
    "unflushed",
    "whole_folder",
    "write_json",
    "write_table",
    "write_whole",
    "writing",
]

NO_SPACE = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  # disk full, quota exceeded, file too large


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn an OSError while something is written under `path` into EnvironmentLackError (no space
    left) or OutputError, with a remedy.
    """
    try:
        yield
    except OSError as error:
        if error.errno in NO_SPACE:
            lack = f"{path}: no space left on the disk"
            raise EnvironmentLackError(lack, "free some, or choose another place") from error
        reason = f"cannot be written ({error.strerror or error})"
        raise OutputError(path, reason, "choose another place") from error


_flushed: ContextVar[bool] = ContextVar("_flushed", default=True)


@contextmanager
def unflushed() -> Iterator[None]:
    """Files that are written meanwhile are not flushed to the disk: those of a temporary folder
    need not outlive a power failure.
    """
    before = _flushed.set(False)
    try:
        yield
    finally:
        _flushed.reset(before)


class PartFile:
    """A file that grows under a temporary name until `keep` gives it its own; a context manager,
    which keeps or, on an error, discards.
    """

    def __init__(self, path: Path, buffering: int = -1):
        self.path = path
        self.part = temporary(path)
        self.file: IO[bytes] = self.part.open("x+b", buffering)

    def keep(self) -> None:
        """Flush the file to the disk, and rename it: it appears whole or not at all, also if the
        machine loses power.
        """
        self.file.flush()
        if _flushed.get():
            os.fsync(self.file.fileno())  # else the rename could reach the disk before the content
        self.file.close()
        self.part.replace(self.path)

    def discard(self) -> None:
        """Remove the file; harmless after `keep`."""
        with contextlib.suppress(OSError):  # a full disk: what waits to be written is not needed
            self.file.close()
        self.part.unlink(missing_ok=True)

    def __enter__(self) -> PartFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Keep, or discard when an exception is on its way: also Ctrl-C leaves no partial file."""
        try:
            if kind is None:
                self.keep()
        finally:
            self.discard()


def temporary(path: Path) -> Path:
    """A name beside `path` that no other process uses, for what is renamed to `path` when it is
    complete.
    """
    # Cut, since file systems take names of up to 255 bytes.
    return path.with_name(f"{path.name[:50]}.{os.urandom(8).hex()}.part")


def write_whole(path: Path, content: str | bytes) -> Path:
    """Write a file atomically: it appears whole or not at all. Raises EnvironmentLackError,
    OutputError: see `writing`.
    """
    with writing(path), PartFile(path) as part:
        part.file.write(content.encode() if isinstance(content, str) else content)
    return path


def write_json(path: Path, plain: object) -> Path:
    """Write plain values as JSON; errors as of `write_whole`."""
    return write_whole(path, json.dumps(plain, indent=1) + "\n")


def write_table(path: Path, table: polars.DataFrame, row_group_size: int | None = None) -> None:
    """Write a table as PATH.parquet and PATH.csv; errors as of `write_whole`."""
    write_parquet = partial(table.write_parquet, row_group_size=row_group_size)
    for ending, write in (("parquet", write_parquet), ("csv", table.write_csv)):
        file = path.with_name(f"{path.name}.{ending}")
        with writing(file), PartFile(file) as part:
            write(part.file)


def flush_entries(folder: Path) -> None:
    """Flush a folder's directory entries to the disk, where the system supports it."""
    if os.name == "posix":
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def make_folder(folder: Path) -> Path:
    """Make a folder of results, or one inside it, unless it is there; returns it."""
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def make_parents(path: Path) -> Path:
    """Make the folders above a new file or folder that a person names, where they are not there;
    returns the path.
    """
    # where a file stands in the place of a folder, what writes there says so
    with writing(path), contextlib.suppress(FileExistsError, NotADirectoryError):
        path.parent.mkdir(parents=True, exist_ok=True)
    return path


def read_file(path: Path, works: str) -> bytes:
    """The content of a file of a results folder; RunFolderError with `works`, what would work,
    where it cannot be read.
    """
    try:
        if path.is_file():
            return path.read_bytes()
        found = "is not a plain file" if path.exists() else "is missing"
    except OSError as error:
        found = f"cannot be read ({error.strerror or error})"
    raise RunFolderError(path, found, works)


def read_json(path: Path, works: str = "a file that this program wrote") -> Any:
    """What a JSON file of a results folder holds; errors as of `read_file`."""
    content = read_file(path, works)
    with foreign(path, works, RunFolderError):
        return json.loads(content)


# Folders of results: new ones never over older ones, and one writing process at a time.
try:
    import fcntl
except ImportError:  # Windows has no flock
    fcntl = None

DEVICES = {"con", "prn", "aux", "nul"}
for _number in "123456789¹²³":
    DEVICES |= {f"com{_number}", f"lpt{_number}"}
# how many nested holds this process has on each folder, by its device and inode
_held: dict[tuple[int, int], int] = {}


@contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Hold an existing folder as the only process that writes into it, by flock(2) where there is
    one; holds of one process may be nested.
    Raises OutputError: another process holds the folder, which the message names; or there is no
    such folder.
    """
    with writing(folder):
        found = folder.stat()
    identity = (found.st_dev, found.st_ino)
    handle = None if identity in _held else _lock(folder)
    _held[identity] = _held.get(identity, 0) + 1
    try:
        yield
    finally:
        _held[identity] -= 1
        if not _held[identity]:
            del _held[identity]
        if handle is not None:
            os.close(handle)  # releases the lock


def _lock(folder: Path) -> int | None:
    if fcntl is None:
        return None
    with writing(folder):
        # not inherited by worker processes, which would keep the lock
        handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        found = f"is in use by {_holder(os.fstat(handle).st_ino)}"
        os.close(handle)
        remedy = "wait until it ends, or choose another folder"
        raise OutputError(folder, found, remedy) from None
    except OSError:  # NFS locks only files that are open for writing
        os.close(handle)
        return None
    return handle


def _holder(inode: int) -> str:
    """The process that holds the lock on a file, as far as the kernel tells: its number and its
    command line.
    """
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/locks").read_text(encoding="ascii").splitlines():
            _, kind, _, _, pid, place, *_ = line.split()
            if kind == "FLOCK" and place.endswith(f":{inode}") and int(pid) > 0:
                command = Path(f"/proc/{pid}/cmdline").read_text("utf-8", "replace")
                *words, _ = command.split("\0")
                line = " ".join(shlex.join(words).split())
                return f"process {pid} ({line[:120]})"
    return "another process"


def must_be_new(out: Path, remedy: str) -> None:
    """OutputError for a file, or a folder that holds something; where another process is at work
    there, the message names it.
    """
    with writing(out):
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            if out.is_dir():
                with only_writer(out):  # raises if another process is writing
                    pass
            raise OutputError(out, "exists and is not an empty folder", remedy)


def file_word(text: str, most: int = 60) -> str:
    """Any text, such as a scenario's name, as the name of a folder or a part of one: without
    separators, never `..`, not over `most` bytes; a checksum keeps different long texts distinct.
    """
    word = re.sub(r"[^\w.+-]+", "_", unicodedata.normalize("NFC", text)).strip("._") or "value"
    if len(word.encode()) > most:
        word = f"{_cut(word, most - 12)}_{zlib.crc32(text.encode(errors='replace')):08x}"
    return allowed(word)


def allowed(name: str, most: int = 150) -> str:
    """The name of a folder as every system allows it: file systems take 255 bytes, and Windows
    keeps some words for devices (`con.x`).
    """
    if name.partition(".")[0].casefold() in DEVICES:
        name = f"_{name}"
    if len(name.encode()) > most:
        import hashlib  # here: it takes longer to import than all the rest

        name = f"{_cut(name, most - 17)}_{hashlib.sha256(name.encode()).hexdigest()[:16]}"
    return name


def _cut(name: str, most: int) -> str:
    return name.encode()[:most].decode(errors="ignore")


def distinct(words: Sequence[str]) -> list[str]:
    """The words, with `_` at the end of those that stand there before; small and large letters
    count as equal, as on Windows and macOS.
    """
    seen: dict[str, str] = {}
    for word in words:
        while (known := unicodedata.normalize("NFKC", word).casefold()) in seen:
            word += "_"
        seen[known] = word
    return list(seen.values())


def numbered(parent: Path) -> Path:
    """Make the folder with the next free number in `parent`."""
    with writing(parent):
        parent.mkdir(parents=True, exist_ok=True)
        number = max((int(p.name) for p in parent.iterdir() if p.name.isdecimal()), default=0) + 1
        while True:
            folder = parent / f"{number:03d}"
            try:
                folder.mkdir()
            except FileExistsError:  # taken meanwhile by a process that started at the same time
                number += 1
            else:
                return folder


def new_folder(parent: Path, out: Path | None, remedy: str = "give a new one") -> Path:
    """Make a folder for results: `out`, or the next free number in `parent`. Raises OutputError:
    see `must_be_new` and `writing`.
    """
    if out is None:
        return numbered(parent)
    must_be_new(out, remedy)
    return make_folder(out)


@contextmanager
def study_folder(kind: str, out: Path | None, remedy: str = "give a new one") -> Iterator[Path]:
    """Make and hold the folder of a new study: `out`, or the next free number in runs/KIND.

    It is removed again if an error leaves it empty.

    kind: the command, such as `basin`. out: the folder. remedy: what would work where it holds
    something already. Raises OutputError: it holds something already, another process writes into
    it, or it cannot be made.
    """
    folder = new_folder(Path("runs") / kind, out, remedy)
    with only_writer(folder):
        # again: another process may have finished there before this one held it
        must_be_new(folder, remedy)
        try:
            yield folder
        except BaseException:
            remove_empty(folder)
            raise


@contextmanager
def whole_folder(out: Path, remedy: str = "give a new one") -> Iterator[Path]:
    """Make a folder that appears under its name when it is complete, or not at all; what it is
    given to be filled has a temporary name.
    Raises OutputError, EnvironmentLackError: see `must_be_new` and `writing`.
    """
    must_be_new(out, remedy)
    part = temporary(out)
    with writing(out):
        part.mkdir(parents=True)
    try:
        yield part
        with writing(out):
            if out.is_dir():
                # empty, as `must_be_new` has found; where it is not any more, this refuses
                out.rmdir()
            part.rename(out)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def linked(sources: Iterable[Path], target: Path) -> None:
    """Make a folder of what several others hold, whole or not at all: links to their files where
    the file system has them, else copies. Of files of one name in several it has the first. Raises
    EnvironmentLackError, OutputError: see `writing`.
    """
    part = temporary(target)
    with writing(target):
        try:
            for source in sources:
                shutil.copytree(source, part, copy_function=_link, dirs_exist_ok=True)
            part.rename(target)
        finally:
            shutil.rmtree(part, ignore_errors=True)


def _link(source: str, target: str) -> str:
    try:
        os.link(source, target)
    except FileExistsError:  # a mesh that several of the folders share
        pass
    except OSError:  # a file system without hard links, or another one
        shutil.copy2(source, target)
    return target


def remove_empty(folder: Path) -> None:
    """Remove a folder if it is empty; of one in `runs` also `runs/<kind>` and `runs`."""
    with contextlib.suppress(OSError):  # a folder that is not empty stays
        folder.rmdir()
        if folder.parts[0] == "runs":
            for parent in folder.parents[:2]:
                parent.rmdir()
