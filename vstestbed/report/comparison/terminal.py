"""The statistics of a comparison in a few lines for the terminal: success, interquartile mean, difference from the first controller."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

import polars as pl

from vstestbed.report.comparison.pairs import SUCCESS
from vstestbed.report.comparison.records import CONTROLLERS, PAIRS
from vstestbed.report.comparison.robust_tables import NEVER
from vstestbed.report.comparison.summary_text import signed
from vstestbed.report.run.numbers import plain

MOST: Final = 12
"""Most controllers that are listed."""


def statistics_text(folder: Path) -> str:
    """A line for each controller, of the first metric that is shown; "" for a single controller, or without a report.

    A star: significant after Holm's correction for all tests of the report.
    """
    if not (folder / f"{CONTROLLERS}.parquet").is_file():
        return ""
    every, pairs = (pl.read_parquet(folder / f"{name}.parquet") for name in (CONTROLLERS, PAIRS))
    if not len(pairs):
        return ""
    lines = _lines(every, pairs)
    widths = [max(map(len, column)) for column in zip(*lines[: MOST + 1], strict=True)]
    text = ["  " + "  ".join(map(str.ljust, line, widths)).rstrip() for line in lines[: MOST + 1]]
    if (more := len(lines) - 1 - MOST) > 0:
        text.append(f"  and {more} more in report.html")
    if any(line.endswith("*") or "* " in line for line in text):
        text.append("  *: differs from the first, p <= 0.05 after Holm's correction")
    return "\n".join(text)


def _lines(every: pl.DataFrame, pairs: pl.DataFrame) -> list[tuple[str, str, str, str]]:
    """Head and a line for each controller."""
    first = every.row(0, named=True)
    rows = every.filter(pl.col("metric") == first["metric"]).rows(named=True)
    of = {(row["controller"], row["metric"]): row for row in pairs.filter(pl.col("against") == first["controller"]).rows(named=True)}
    head = ("", "reached", _title(first), f"against {first['controller']}")
    return [head, *(_line(row, of.get((row["controller"], first["metric"])), of.get((row["controller"], SUCCESS))) for row in rows)]


def _line(row: dict[str, Any], difference: dict[str, Any] | None, success: dict[str, Any] | None) -> tuple[str, str, str, str]:
    """Label, successes, interquartile mean, difference from the first controller."""
    return row["controller"], f"{row['succeeded']} of {row['runs']}{_star(success)}", _mean(row), _difference(difference)


def _title(row: dict[str, Any]) -> str:
    unit = f" [{row['unit']}]" if row["unit"] else ""
    return f"{row['title'].lower()}{unit}, IQM"


def _star(row: dict[str, Any] | None) -> str:
    return "*" if row and row["significant"] else ""


def _mean(row: dict[str, Any]) -> str:
    if row["iqm"] is None:
        return "-"
    interval = "" if row["iqm_low"] is None else f" [{_end(row['iqm_low'])}, {_end(row['iqm_high'])}]"
    return _end(row["iqm"]) + interval


def _end(value: float) -> str:
    return plain(value) if math.isfinite(value) else NEVER


def _difference(row: dict[str, Any] | None) -> str:
    if row is None or row["difference"] is None:
        return ""
    interval = "" if row["low"] is None else f" [{signed(row['low'])}, {signed(row['high'])}]"
    # a hyphen: not every terminal has the minus sign
    return (signed(row["difference"]) + interval + _star(row)).replace("\N{MINUS SIGN}", "-")
