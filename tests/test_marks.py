"""Marks of the pages: what stands between them is filled, and what is wrong with one is said."""

from __future__ import annotations

import re

import jinja2
import pytest

from docs.build.marks import filled, shown

KNOWN = jinja2.Environment(undefined=jinja2.StrictUndefined, trim_blocks=True)
VALUES = """<!-- values
half = 1.25
time = (2 *
  half) | round(1)
{% macro row(i) %}
| {{ i }} | {{ time }} |
{% endmacro %}
-->
"""
ROWS = """<!-- build
{% for i in [1, 2] %}
{{ row(i) }}
{% endfor %}
-->
"""


@pytest.mark.parametrize(
    ("page", "now", "seen"),
    [
        (
            "It takes <!--time-->9<!--/--> s.",
            "It takes <!--time-->2.5<!--/--> s.",
            "It takes 2.5 s.",
        ),
        (
            "It takes<!--time-->\n  <!--/--> s.",
            "It takes<!--time-->\n  2.5<!--/--> s.",
            "It takes\n  2.5 s.",
        ),
        (
            "<!-- build: 2 * half -->\n9\n9\n<!-- end -->\n",
            "<!-- build: 2 * half -->\n2.5\n<!-- end -->\n",
            "2.5\n",
        ),
        (
            f"{ROWS}<!-- end -->\nIt stops.",
            f"{ROWS}| 1 | 2.5 |\n\n| 2 | 2.5 |\n<!-- end -->\nIt stops.",
            "| 1 | 2.5 |\n\n| 2 | 2.5 |\nIt stops.",
        ),
        (
            "<!-- build: '' -->\n9\n<!-- end -->\n<!-- given: inputs -->",
            "<!-- build: '' -->\n<!-- end -->\n<!-- given: inputs -->",
            "<!-- given: inputs -->",
        ),
    ],
)
def test_what_stands_between_two_marks_is_filled(page: str, now: str, seen: str) -> None:
    assert filled(VALUES + page, KNOWN) == VALUES + now
    assert filled(VALUES + now, KNOWN) == VALUES + now
    assert shown(VALUES + now) == seen


def test_what_is_wrong_with_a_mark_is_said() -> None:
    for page, words in (
        ("<!--time-->9 s.\n<!--other-->1<!--/-->", "missing between '<!--time-->'"),
        ("<!-- build: 1 -->\n1\n", "missing between '<!-- build: 1 -->"),
        ("9<!--/--> s.\n", "missing between '' and '<!--/-->'"),
        ("<!-- values\ntime: 9\n-->\n", "no line `name = expression`: time: 9"),
    ):
        with pytest.raises(ValueError, match=re.escape(words)):
            filled(page, KNOWN)
    with pytest.raises(jinja2.UndefinedError, match="'time' is undefined") as told:
        filled("It takes <!--time-->9<!--/--> s.", KNOWN)
    assert told.value.__notes__ == ["<!--time-->"]
