"""Names of the folders of a comparison's runs."""

from __future__ import annotations

import re
import zlib

SIDE_BY_SIDE = 1000
"""Most folders in one: file browsers, and some file systems, are slow with more."""


def among(number: int, of: int, name: str = "") -> str:
    """The name of a folder with a number; of more than SIDE_BY_SIDE, in one that holds as many: `12000/12345`."""
    name = name or str(number)
    return name if of <= SIDE_BY_SIDE else f"{number // SIDE_BY_SIDE * SIDE_BY_SIDE}/{name}"


def file_word(text: str) -> str:
    """A text as part of a file name, short enough for file systems (a checksum keeps shortened ones distinct)."""
    word = re.sub(r"[^\w.+-]+", "_", text).strip("._") or "value"
    return word if len(word) <= 60 else f"{word[:48]}_{zlib.crc32(text.encode()):08x}"


def distinct(words: list[str]) -> list[str]:
    """The words, with `_` at the end of those that stand there before: values may differ in what a file name cannot hold alone."""
    seen: dict[str, None] = {}
    for word in words:
        while word in seen:
            word += "_"
        seen[word] = None
    return list(seen)
