"""What others wrote: files that are plain and of a size that can be read, keys that are known,
exceptions that become sentences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from vstestbed.core.errors import ParameterError, VstestbedError, lack_of, nearest, short

__all__ = ["MOST_BYTES", "foreign", "of_field", "only_known", "plain_file", "reason"]

Refusal = Callable[[object, str, str], VstestbedError]
"""Makes an error of the name of what cannot be read, the reason, and what would work:
`ParameterError.unreadable`, `RunFolderError`.
"""
MOST_BYTES = 64 << 20
"""A larger file is none of those that are read whole: calibrations, records, models without their
meshes.
"""


def of_field(field: str, file: str = "") -> Refusal:
    """Refuses a file that a field names: the error tells both. file: as the field names it; by
    default its path.
    """
    return lambda name, why, works: ParameterError.unreadable(field, why, works, file or str(name))


@contextmanager
def foreign(
    name: object, works: str, refusal: Refusal = ParameterError.unreadable
) -> Iterator[None]:
    """Turn whatever a library raises, while it reads what others wrote, into one sentence. Stands
    round the library's call alone, so that a fault of this program stays one. Errors of this
    program pass; so does Ctrl-C.

    name: the file, or what else was read. works: what it should be. Raises EnvironmentLackError for
    want of memory or of open files.
    """
    try:
        yield
    except VstestbedError:
        raise
    except BaseException as error:
        # polars panics with an exception that is no Exception
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        if (lack := lack_of(error)) is not None:
            raise lack from error
        raise refusal(name, reason(error), works) from error


def reason(error: BaseException) -> str:
    """What an exception of a library says, in one line of at most 200 characters; its class where
    it says nothing.
    """
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if isinstance(error, SystemError) and error.__cause__:  # of OpenCV's FileStorage
        error = error.__cause__
    words = " ".join(str(error).split())
    words = words.partition(": error: ")[2] or words  # of OpenCV's without the place in its source
    if len(words) > 200:
        return f"{words[:197]}..."
    return words or type(error).__name__


def plain_file(
    path: Path,
    works: str,
    most_bytes: int = MOST_BYTES,
    refusal: Refusal = ParameterError.unreadable,
) -> Path:
    """The path of a regular file of at most `most_bytes`: a pipe would wait for ever, a huge file
    fill the memory.
    """
    with foreign(path, works, refusal):
        found = path.stat()
        regular = path.is_file()
    if not regular:
        raise refusal(path, "it is not a regular file", works)
    if found.st_size > most_bytes:
        size_mib = found.st_size / 2**20
        words = f"it has {size_mib:.0f} MiB, at most {most_bytes / 2**20:.0f} are read"
        raise refusal(path, words, works)
    return path


def only_known(
    found: Mapping[str, object], used: Iterable[str], harmless: Iterable[str] = (), field: str = ""
) -> None:
    """Refuse keys of a foreign file that are neither used nor known to change nothing: what is not
    read could change the meaning.

    harmless: keys that mean nothing for what is read, such as a frame's sequence number. field:
    where they stand, for messages.
    Raises ParameterError: it names the first such key, and the nearest ones that are read.
    """
    known = [*used]
    passed = {*known, *harmless}
    for key, value in found.items():
        if key not in passed:
            word = " ".join(str(key).split())[:60]
            name = f"{field}.{word}" if field else word
            shown = value if isinstance(value, int | float) else short(value)
            words = f"is not read here, and may change the meaning; {nearest(word, known)}"
            raise ParameterError(name, words, shown)
