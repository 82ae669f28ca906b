"""What Jupyter shows of a recording and of a comparison: the page, whole, in a frame of its own."""

from __future__ import annotations

from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import polars as pl

import vstestbed as vs


class Frames(HTMLParser):
    """Collects the pages inside of frames."""

    def __init__(self) -> None:
        super().__init__()
        self.pages: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        assert tag == "iframe" and "allow-same-origin" not in (given["sandbox"] or "")
        self.pages.append(given["srcdoc"] or "")


def page_in(html: str) -> str:
    frames = Frames()
    frames.feed(html)
    (page,) = frames.pages
    return page


def test_a_recording_shows_its_report() -> None:
    recording = vs.run(vs.load("ibvs_book", {"stop.duration_s": 0.5, "description": 'a "quoted" <b>word</b>'}))
    page = page_in(recording._repr_html_())
    assert page.lstrip().lower().startswith("<!doctype html>") and page.count("<svg") >= 4 and "timed out" in page.lower()
    assert 'a "quoted" <b>word</b>' in unescape(page) and "<b>word</b>" not in page


def test_a_comparison_shows_who_is_better_and_is_a_table(tmp_path: Path, here: None) -> None:
    setting = {"stop.duration_s": 0.5, "detector": "oracle"}
    table = vs.compare(["ibvs_book", "pbvs_book"], jobs=1, set=setting, out=str(tmp_path / "two"), film=False, report=False)
    page = page_in(table._repr_html_())
    assert "ibvs_book" in page and "pbvs_book" in page and "Reached the goal" in page and str(tmp_path / "two") in page
    assert isinstance(table, pl.DataFrame) and table.height == 2
    assert type(table.filter(pl.col("success"))) is pl.DataFrame
