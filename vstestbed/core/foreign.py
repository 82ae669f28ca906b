"""What others wrote: files that are plain and of a size that can be read, keys that are known, exceptions that become sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from vstestbed.core.errors import ParameterError, VstestbedError, lack_of, nearest, short
from vstestbed.core.named_files import absolute_file, place_of_file

Refusal = Callable[[object, str, str], VstestbedError]
"""Makes an error of the name of what cannot be read, the reason, and what would work: `ParameterError.unreadable`, `RunFolderError`."""
MOST_BYTES = 64 << 20
"""A larger file is none of those that are read whole: calibrations, records, models without their meshes."""


@contextmanager
def foreign(name: object, works: str, refusal: Refusal = ParameterError.unreadable) -> Iterator[None]:
    """Turn whatever a library raises, while it reads what others wrote, into one sentence. Stands round the library's call alone, so that
    a fault of this program stays one. Errors of this program pass; so does Ctrl-C.

    name: the file, or what else was read. works: what it should be. Raises EnvironmentLackError for want of memory or of open files.
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
    """What an exception of a library says, in one line of at most 200 characters; its class where it says nothing."""
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    words = " ".join(str(error).split())
    return f"{words[:197]}..." if len(words) > 200 else words or type(error).__name__


def plain_file(path: Path, works: str, most_bytes: int = MOST_BYTES, refusal: Refusal = ParameterError.unreadable) -> Path:
    """The path of a regular file of at most `most_bytes`: a pipe would wait for ever, a huge file fill the memory."""
    with foreign(path, works, refusal):
        found = path.stat()
        regular = path.is_file()
    if not regular:
        raise refusal(path, "it is not a regular file", works)
    if found.st_size > most_bytes:
        raise refusal(path, f"it has {found.st_size / 2**20:.0f} MiB, at most {most_bytes / 2**20:.0f} are read", works)
    return path


def only_known(found: Mapping[str, object], used: Iterable[str], harmless: Iterable[str] = (), field: str = "") -> None:
    """Refuse keys of a foreign file that are neither used nor known to change nothing: what is not read could change the meaning.

    harmless: keys that mean nothing for what is read, such as a frame's sequence number. field: where they stand, for messages.
    Raises ParameterError: it names the first such key, and the nearest ones that are read.
    """
    known = [*used]
    passed = {*known, *harmless}
    for key, value in found.items():
        if key not in passed:
            word = " ".join(str(key).split())[:60]
            name = f"{field}.{word}" if field else word
            shown = value if isinstance(value, int | float) else short(value)
            raise ParameterError(name, f"is not read here, and may change the meaning; {nearest(word, known)}", shown)


@contextmanager
def named_file(field: str, file: str, works: str, most_bytes: int = MOST_BYTES) -> Iterator[Path]:
    """The path of a plain file that a field names. Whatever is wrong with it, and whatever a library raises that reads
    it in the block, is a ParameterError of the field.
    """

    def refusal(name: object, why: str, works: str) -> ParameterError:
        return ParameterError.unreadable(field, why, works, file)

    try:
        path = place_of_file(absolute_file(file, Path.cwd()))
    except ParameterError as error:
        raise ParameterError(field, error.problem, file) from None
    plain_file(path, works, most_bytes, refusal)
    with foreign(path, works, refusal):
        yield path


class _Loader(yaml.SafeLoader):
    """YAML without aliases, of which a short file can hold millions of values, and without fields that come twice."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise ValueError("it has aliases; write their values out")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        return once(self.construct_pairs(node, deep))


def plain_documents(text: str) -> list[Any]:
    """The documents of a YAML text that hold anything. ValueError, yaml.YAMLError, RecursionError: for `foreign`."""
    documents = yaml.load_all(text, _Loader)
    return [document for document in documents if document is not None]


def once(pairs: Sequence[tuple[Any, Any]]) -> dict[Any, Any]:
    """The mapping of these pairs; ValueError where a field comes twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("it has a field twice")
    return found
