"""What Jupyter shows of a recording and of a comparison: the page, whole, in a frame of its own."""

from __future__ import annotations

from html import unescape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import polars as pl
import pytest

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
    recording = vs.run(
        vs.load("ibvs_book", {"stop.duration_s": 0.5, "description": 'a "quoted" <b>word</b>'})
    )
    page = page_in(recording._repr_html_())
    assert (
        page.lstrip().lower().startswith("<!doctype html>")
        and page.count("<svg") >= 4
        and "timed out" in page.lower()
    )
    assert 'a "quoted" <b>word</b>' in unescape(page) and "<b>word</b>" not in page


def test_a_comparison_shows_who_is_better_and_is_a_table(tmp_path: Path, here: None) -> None:
    setting = {"stop.duration_s": 0.5, "detector": "oracle"}
    table = vs.compare(
        ["ibvs_book", "pbvs_book"],
        jobs=1,
        set=setting,
        out=str(tmp_path / "two"),
        film=False,
        report=False,
    )
    page = page_in(table._repr_html_())
    assert (
        "ibvs_book" in page
        and "pbvs_book" in page
        and "Reached the goal" in page
        and str(tmp_path / "two") in page
    )
    assert isinstance(table, pl.DataFrame) and table.height == 2
    assert type(table.filter(pl.col("success"))) is pl.DataFrame


def test_its_figures_are_those_of_the_report_for_matplotlib() -> None:
    recording = vs.run(vs.load("ibvs_book", {"stop.duration_s": 2, "detector": "oracle"}))
    (axes,) = recording.plot_error().axes
    assert axes.get_yscale() == "log" and axes.get_ylabel() == "RMS error [px]"
    assert np.array_equal(axes.get_lines()[0].get_ydata(), recording["error_px"])
    twist = recording.plot_twist()
    assert [axes.get_ylabel() for axes in twist.axes] == ["translation [m/s]", "rotation [rad/s]"]
    assert [words.get_text() for words in twist.legends[0].get_texts()] == [
        "vx",
        "vy",
        "vz",
        "wx",
        "wy",
        "wz",
    ]
    for figure in (
        recording.plot_features(),
        recording.plot_camera(),
        recording.plot_depth(),
        recording.plot("pose_error"),
    ):
        assert figure._repr_png_().startswith(b"\x89PNG")
        assert any(axes.get_lines() for axes in figure.axes)
    with pytest.raises(
        vs.errors.ParameterError, match=r"plot must be one of features, error, .* got 'rotors'"
    ):
        recording.plot("rotors")
