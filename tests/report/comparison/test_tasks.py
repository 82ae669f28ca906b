"""The report of a comparison with tasks: every law is found in the figure, also in grey; tables say
which runs they are of.
"""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from tests.report.html import checked
from vstestbed.report.canvas import style
from vstestbed.report.comparison import tasks
from vstestbed.report.comparison.results import ComparisonResults

LAWS = [f"law_{i}" for i in range(11)]


def table() -> pl.DataFrame:
    rows = [
        {
            "scenario": "canonical",
            "law": law,
            "task": task,
            "amount": f"{amount}{unit}",
            "seed": amount,
            "folder": f"runs/{law}/{task}/{amount}",
            "outcome": "converged" if amount else "diverged",
            "success": amount > 0,
            "time_to_converge_s": 10.0 + i if amount else None,
            "max_retreat_m": 0.1 * i,
        }
        for i, law in enumerate(LAWS)
        for task, unit in (("turned", " deg"), ("random", ""))
        for amount in range(4)
    ]
    return pl.DataFrame(rows)


def test_eleven_laws_have_eleven_marks_and_each_point_its_value() -> None:
    with style():
        figure = tasks.draw(
            tasks.cells(tasks.over_all_tasks(ComparisonResults(table(), ("law", "task")))), (), 8.2
        )
    assert [text.get_text() for text in figure.legends[0].get_texts()] == LAWS
    for axes in figure.axes:
        curves = [line for line in axes.get_lines() if line.get_label() in LAWS]
        assert len({line.get_marker() for line in curves}) == len(LAWS)
    for i, line in enumerate(
        line for line in figure.axes[0].get_lines() if line.get_label() in LAWS
    ):
        assert line.get_ydata()[1:].tolist() == [10.0 + i] * 3


def test_each_table_says_which_runs_its_numbers_are_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Errors at the end are those of all runs, also where none arrived; lengths of paths those of
    the runs that did.
    """
    metrics = ("final_position_error_m", "path_ratio")
    none = (
        table()
        .filter(pl.col("law").is_in(LAWS[:2]))
        .with_columns(success=False, final_position_error_m=1.037, path_ratio=1.5)
    )
    page = checked(
        tasks.write_task_report(
            tmp_path, ComparisonResults(none, ("law", "task"), metrics), ""
        ).read_text(encoding="utf-8")
    ).text
    for text in (page, (tmp_path / "tasks.md").read_text()):
        assert (
            "True position error [mm]: median and largest of all runs" in text
            and "1037, 1037" in text
        )
        assert (
            "Path over straight line [×]: median and largest of the runs that reached the goal"
            in text
            and "1.5, 1.5" not in text
        )
