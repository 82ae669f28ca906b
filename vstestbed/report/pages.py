"""Pages from the templates in `templates/` (jinja2); a page loads nothing from outside: the same
without network and years later.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from functools import cache
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from vstestbed.core.files import write_whole
from vstestbed.report.marks import counted, number

if TYPE_CHECKING:
    from jinja2 import Environment

__all__ = [
    "NO_CELL",
    "Cell",
    "Film",
    "cell",
    "data_url",
    "film_of",
    "page",
    "text_of",
    "write_page",
]


class Cell(NamedTuple):
    """A cell of a table that sorts."""

    key: float | str | None  # to sort by; None sorts last
    words: str
    real: bool = False  # whether the number differs significantly
    small: Sequence[str] = ()  # lines below it

    @classmethod
    def named(cls, words: str) -> Cell:
        """One that sorts by its words."""
        return cls(words, words)


NO_CELL = Cell(None, "–")
# Title, source, and the name of the file beside the page, "" of an embedded one
Film = tuple[str, str, str]


def write_page(folder: Path, template: str, heading: str, **content: Any) -> Path:
    """Write a page as `report.html` into a folder; returns its path."""
    return write_whole(folder / "report.html", page(template, heading, **content))


def text_of(template: str, **content: Any) -> str:
    """A text from a template that is no page: Markdown, LaTeX."""
    return _environment().get_template(template).render(**content)


def page(template: str, heading: str, title: str = "", **content: Any) -> str:
    """A whole page; all text in its content is escaped. `title`: of the browser's window, as a rule
    the heading.
    """
    return (
        _environment()
        .get_template(template)
        .render(heading=heading, title=title or heading, **content)
    )


def cell(page: str, height_px: int) -> str:
    """A whole page as the output of a notebook's cell, in a frame of its own: its style sheet
    touches nothing of the notebook.
    """
    look = f"width:100%;height:{height_px}px;border:0;border-radius:10px"
    return (
        f'<iframe srcdoc="{escape(page)}" style="{look}"'
        ' sandbox="allow-scripts allow-popups"></iframe>'
    )


def film_of(title: str, path: Path, embedded: bool) -> Film:
    """A film, embedded in the page or linked to the file beside it."""
    if not embedded:
        return title, path.name, path.name
    return title, data_url("video/mp4", path.read_bytes()), ""


def data_url(kind: str, content: bytes) -> str:
    """The content of a file as a `data:` URL of the given MIME type."""
    return f"data:{kind};base64," + base64.b64encode(content).decode("ascii")


@cache
def _environment() -> Environment:
    from jinja2 import (  # here: a command that writes no page starts without it
        Environment,
        PackageLoader,
        StrictUndefined,
        select_autoescape,
    )
    from markupsafe import Markup

    def powers(words: str) -> Markup:
        """Words in which powers of ten, `10^-7`, are raised."""
        return Markup(re.sub(r"10\^(-?\d+)", r"10<sup>\1</sup>", escape(words)))

    def sort_key(key: float | str | None) -> str:
        if key is None:
            return ""
        # nine digits: values that differ only beyond the shown ones still sort
        return f"{key:.9g}" if isinstance(key, float) else str(key)

    found = Environment(
        loader=PackageLoader("vstestbed.report"),
        autoescape=select_autoescape(["html"]),
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    found.filters |= {
        "number": number,
        "powers": powers,
        "sort_key": sort_key,
        "counted": counted,
        "tex": _tex,
    }
    return found


def _tex(words: str) -> str:
    """Words for LaTeX: its special characters escaped, signs that its fonts lack as mathematics."""
    return str(words).translate(_TEX)


_TEX = str.maketrans(
    {c: f"\\{c}" for c in "&%$#_{}"}
    | {
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "\N{MINUS SIGN}": "$-$",
        "\N{EN DASH}": "--",
    }
    | {
        "↑": r"$\uparrow$",
        "↓": r"$\downarrow$",
        "×": r"$\times$",
        "°": r"$^\circ$",
        "²": "$^2$",
        "·": r"$\cdot$",
    }
)
