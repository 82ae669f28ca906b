"""Standard output and standard error that may be closed, full, or left by their reader: none of that ends a command."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO, cast


class Stream:
    """A standard stream that drops its text from the first error on.

    Args:
        stream: the stream; None where the process was started without it (`>&-`).
    """

    def __init__(self, stream: TextIO | None):
        self._closed = stream is None
        self._stream: Any = open(os.devnull, "w", encoding="utf-8") if stream is None else stream  # noqa: SIM115, PTH123 - open to the end
        if hasattr(self._stream, "reconfigure"):
            self._stream.reconfigure(errors="backslashreplace")  # in a locale without the degree sign it is \xb0
        self.lack: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        if name == "buffer":  # else click writes past this class where the encoding is ASCII
            raise AttributeError(name)
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text, or drop it."""
        if self._closed and text:
            self.lack = self.lack or OSError(errno.EBADF, "it is closed")
        self._tried(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush what was written, or drop it."""
        self._tried(self._stream.flush)

    def _tried(self, action: Callable[[], object]) -> None:
        try:
            action()
        except OSError as error:  # EPIPE: the reader has gone; ENOSPC: `> /dev/full`; EIO: the terminal has gone
            self.lack = self.lack or error
            with contextlib.suppress(OSError), open(os.devnull, "w", encoding="utf-8") as nowhere:  # noqa: PTH123 - os.devnull is no path on Windows
                os.dup2(nowhere.fileno(), self._stream.fileno())  # for the rest of the buffer, which Python flushes at its end

    @property
    def failed(self) -> str:
        """Why text was lost; empty where nothing was, or where the reader chose to read no further (`| head`)."""
        self.flush()
        return "" if self.lack is None or self.lack.errno == errno.EPIPE else self.lack.strerror or str(self.lack)


@contextmanager
def standard_streams() -> Iterator[Stream]:
    """Make both streams safe to write to while a command runs; yields standard output."""
    _fill_descriptors()
    before = sys.stdout, sys.stderr
    out, err = Stream(sys.stdout), Stream(sys.stderr)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, err)
    try:
        yield out
    finally:
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = before


def _fill_descriptors() -> None:
    """Open /dev/null in place of closed standard streams: else the next file that is opened, such as a log, would get what is printed."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
