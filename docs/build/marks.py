"""What is rendered in a page stands between two of its comments, its marks, and is filled in place.

Values are named in a block, and stand by their names in sentences and tables:

<!-- values
arm = run("arm_ibvs")
time = arm.time_to_converge_s | n(1)
-->
The arm converges after <!--time-->17.3<!--/--> s.

Rows, whole tables and code are written by a template (Jinja) or by one expression:

<!-- build
{% for law in laws | each("law") %}
| `{{ law }}` | {{ laws | where(law=law) | reached }} |
{% endfor %}
-->
| `points` | 19 of 20 [76, 99] % |
<!-- end -->
<!-- build: under("compare arm_laws") -->
*Conditions: pictures; dynamics.*
<!-- end -->

What a block names, its macros too, is known to all marks after it.
"""

from __future__ import annotations

import difflib
import itertools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jinja2

BLOCK_END = "<!-- end -->\n"
VALUE_END = "<!--/-->"
MARK = re.compile(
    rf"(^<!-- (?:values|build)\b.*?-->\n|^{BLOCK_END}|<!--[a-z][\w.]*-->|{VALUE_END})",
    re.MULTILINE | re.DOTALL,
)
NAMED = re.compile(r"^(\w+) = (.+(?:\n +.+)*)", re.MULTILINE)
"""A line of `values`, with lines after it that are indented."""


def shown(text: str) -> str:
    """What a reader sees of a page: its text without the marks."""
    return "".join(MARK.split(text)[::2])


def filled(text: str, environment: jinja2.Environment) -> str:
    """The text of a page, filled as it is to be now."""
    return "".join(mark + behind for mark, behind in parts(text, environment))


def differences(page: Path, before: str, now: str) -> list[str]:
    """What differs between two texts of a page, line by line."""
    lines = before.splitlines(), now.splitlines()
    return [*difflib.unified_diff(*lines, str(page), str(page), lineterm="", n=0)]


def parts(text: str, environment: jinja2.Environment) -> Iterator[tuple[str, str]]:
    """The marks of a page, each with what stands behind it now; first what stands before them all.

    Args:
        text: of the page, as it was filled before. environment: what its marks may call.

    Raises:
        ValueError: a mark is not closed, closes nothing, or has another form.
    """
    first, *rest = MARK.split(text)
    marks = rest[::2]
    for mark, following in itertools.pairwise(["", *marks, ""]):
        closed_by = following if following in (BLOCK_END, VALUE_END) else ""
        if closed_by != _end_of(mark):
            raise ValueError(f"a mark is missing between {mark!r} and {following!r}")
    names: dict[str, Any] = {}
    yield "", first
    for mark, old in zip(marks, rest[1::2], strict=True):
        if mark in (BLOCK_END, VALUE_END):
            yield mark, old
            continue
        try:
            made = environment.from_string(_template(mark)).make_module(names)
        except Exception as error:  # of all that a page may call; raised again with its place
            error.add_note(mark)
            raise
        names |= {name: value for name, value in vars(made).items() if not name.startswith("_")}
        yield mark, _behind(mark, str(made), old)


def _end_of(mark: str) -> str:
    """The mark that must come next; "" where none closes this one."""
    if mark.startswith("<!-- build"):
        return BLOCK_END
    return VALUE_END if re.match(r"<!--\w", mark) else ""


def _template(mark: str) -> str:
    words = mark.strip().removeprefix("<!--").removesuffix("-->")
    if words.startswith(" values"):
        return NAMED.sub(r"{% set \1 = \2 %}", words.removeprefix(" values\n"))
    if words.startswith(" build\n"):
        return words.removeprefix(" build\n")
    return "{{" + words.removeprefix(" build:") + "}}"


def _behind(mark: str, result: str, old: str) -> str:
    """What stands behind a mark now."""
    if _end_of(mark) == BLOCK_END:
        return result.strip("\n") + "\n" if result.strip() else ""
    if _end_of(mark) == VALUE_END:  # at the beginning of a line, its mark is at the end of another
        return old[: len(old) - len(old.lstrip())] + result
    if result.strip():
        raise ValueError(f"no line `name = expression`: {result.strip()}")
    return old
