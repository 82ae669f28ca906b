"""The figure of a comparison with tasks: every law is found in it, also in grey."""

from __future__ import annotations

import polars as pl

from vstestbed.report.comparison import tasks
from vstestbed.report.html.canvas import style

LAWS = [f"law_{i}" for i in range(11)]


def table() -> pl.DataFrame:
    rows = [
        {
            "scenario": "canonical",
            "law": law,
            "task": task,
            "amount": f"{amount}{unit}",
            "seed": amount,
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
    with style(paper=True):
        figure = tasks.draw(tasks.cells(table(), ("law", "task")), (), 8.2)
    assert [text.get_text() for text in figure.legends[0].get_texts()] == LAWS
    for axes in figure.axes:
        curves = [line for line in axes.get_lines() if line.get_label() in LAWS]
        assert len({line.get_marker() for line in curves}) == len(LAWS)
    for i, line in enumerate(line for line in figure.axes[0].get_lines() if line.get_label() in LAWS):
        assert line.get_ydata()[1:].tolist() == [10.0 + i] * 3
