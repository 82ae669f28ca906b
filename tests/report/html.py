"""A page as a test reads it."""

from __future__ import annotations

import re
from html.parser import HTMLParser


class Reader(HTMLParser):
    """Collects what a page holds: references, identifiers, figures, text outside of styles and
    scripts.
    """

    VOID = frozenset({"meta", "link", "br", "hr", "img", "input"})

    def __init__(self, page: str):
        super().__init__()
        self.references: list[str] = []
        self.ids: list[str] = []
        self.figures: list[str] = []
        self.open: list[str] = []
        self.words: list[str] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "poster", "data", "action", "srcset"):
                self.references.append(value or "")
            if name == "id":
                self.ids.append(value or "")
            if tag == "svg" and name == "aria-label":
                self.figures.append(value or "")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in self.VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag  # every element is closed, in order

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & set(self.open):
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def checked(page: str) -> Reader:
    """The page, read; it is well formed, refers to nothing outside, and no identifier stands twice
    or dangles.
    """
    reader = Reader(page)
    assert reader.open == []
    assert [r[:40] for r in reader.references if not r.startswith(("data:", "#"))] == []
    assert re.findall(r"(?:@import|url\((?!#))[^;]{0,40}", page) == []
    without_names = re.sub(r'xmlns(:\w+)?="[^"]*"', "", page)
    assert re.findall(r"https?://[^\"<\s]{0,60}", without_names) == []
    assert len(set(reader.ids)) == len(reader.ids)
    pointed = {r[1:] for r in reader.references if r.startswith("#")} | set(
        re.findall(r"url\(#([^)]+)\)", page)
    )
    assert pointed <= set(reader.ids)
    return reader
