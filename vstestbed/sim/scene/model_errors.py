"""MuJoCo's errors about a model's file, for people: the place in the file, what is wrong there, and what would work."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

from vstestbed.core.errors import ParameterError

PARSING = re.compile(r"XML parse error \d+:\s*Error=(?:XML_)?(?:ERROR_)?(\w+).*?Line number=(\d+)(?:.*?XMLElement name=(\w+))?", re.DOTALL)
LINE = re.compile(r",?\s*line (\d+)\s*$")
ELEMENT = re.compile(r"\s*Element '(\w*)'(?:, id \d+)?\s*$|\s*Element name '([^']*)', id \d+\s*$")
BEGINS = re.compile(r"^(?:XML )?Error:\s*(?:Schema violation:\s*)?")
FOREIGN = "could not find decoder", "Unrecognized XML model type"
"""How MuJoCo says that a file is of another format, such as SDF."""
MISSING = re.compile(r"Error opening file '([^']*)'")


def cannot_compile(error: Exception, path: Path, works: str) -> ParameterError:
    """The error for a file that MuJoCo does not compile.

    Args:
        error: MuJoCo's. path: of the file. works: what would work, such as `an MJCF file`.

    Returns a ParameterError of `file`: FILE:LINE, where MuJoCo knows it, what is wrong, what would work.
    """
    text = " ".join(str(error).split()).rstrip(".")
    if parsed := PARSING.search(text):
        what, line, element = parsed.groups()
        near = f", near the element {element}" if element else ""
        words = f"it is not well-formed XML ({what.replace('_', ' ').lower()}{near})"
        return _told(_place(path, _ends_at(path) if what == "PARSING" else int(line)), words, f"works: {works}")
    text = BEGINS.sub("", text)
    line = int(found[1]) if (found := LINE.search(text)) else 0
    text = LINE.sub("", text)
    element = next(filter(None, found.groups()), "") if (found := ELEMENT.search(text)) else ""
    words = (f"{element}: " if element else "") + ELEMENT.sub("", text).replace("attribute: '", "attribute '")
    if named := MISSING.search(text):
        line = line or _line_with(path, named[1])
        return _told(_place(path, line), f"it names the file {named[1]}, which is not there", "correct its name, or the folder it is in")
    return _told(_place(path, line), words, f"works: {works}" if words.startswith(FOREIGN) else "correct it there")


def _ends_at(path: Path) -> int:
    """The line where a file stops being XML, such as its last one where an element is not closed; MuJoCo tells the element's first."""
    try:
        ElementTree.parse(path)
    except ElementTree.ParseError as error:
        return error.position[0]
    return 1


def _told(place: str, words: str, remedy: str) -> ParameterError:
    return ParameterError("file", f"cannot be compiled by MuJoCo ({place}: {words}); {remedy}")


def _place(path: Path, line: int) -> str:
    """FILE:LINE; 0 for a line that is not known. A line may be that of an included file, which MuJoCo does not name."""
    if line and "<include" in path.read_text(errors="replace"):
        return f"{path}, line {line} there or in a file that it includes"
    return f"{path}:{line}" if line else str(path)


def _line_with(path: Path, word: str) -> int:
    """The first line of a file with a word; 0 where it is in none."""
    lines = path.read_text(errors="replace").splitlines()
    return next((number for number, text in enumerate(lines, start=1) if word in text), 0)
