"""How a comparison differs from an earlier one, in words for the terminal and as a section of the page."""

from __future__ import annotations

import math
from html import escape
from pathlib import Path
from typing import Final

from vstestbed.report.comparison.baseline import TOLERANCE, BaselineChanges, ControllerChange, MetricChange, difference_text, read_changes
from vstestbed.report.comparison.summary_text import signed
from vstestbed.report.comparison.tables import Cell, table
from vstestbed.report.run.numbers import number

MOST: Final = 4
"""Differing metrics, and lost runs, that a line of the terminal names; the page has all of them."""


def text(changes: BaselineChanges) -> str:
    """The differences in a few lines: each controller's successes and its metrics that differ most surely."""
    lines = [f"against {changes.place}: {changes.matched} runs in both"]
    lines += [f"  only now: {words}" for words in changes.only_now] + [f"  only then: {words}" for words in changes.only_before]
    return "\n".join([*lines, *(line for c in changes.controllers for line in _lines(c))])


def _lines(c: ControllerChange) -> list[str]:
    if not c.changed:
        return [f"  {c.label}: {c.runs} runs without any difference{_settings(c)}"]
    reached = f"{c.reached_now} of {c.runs} reached the goal, before {c.reached_before}{_named('lost', c.lost)}{_named('gained', c.gained)}"
    differ = sorted((m for m in c.metrics if m.n and m.difference), key=lambda m: (not m.real, -abs(m.share)))
    more = [f"    {len(differ) - MOST} more numbers differ (report.html)"] if len(differ) > MOST else []
    return [f"  {c.label}: {reached}{_settings(c)}", *(f"    {m.title.lower()} {difference_text(m)}" for m in differ[:MOST]), *more]


def _named(what: str, runs: tuple[str, ...]) -> str:
    more = f" and {len(runs) - MOST} more" if len(runs) > MOST else ""
    return f" ({what}: {', '.join(runs[:MOST])}{more})" if runs else ""


def _settings(c: ControllerChange) -> str:
    more = f" and {len(c.settings) - MOST} more" if len(c.settings) > MOST else ""
    return f"; its scenario differs in {', '.join(c.settings[:MOST])}{more}" if c.settings else ""


def section(folder: Path) -> str:
    """The section of a comparison's page; empty where it was not compared with an earlier one.

    Args:
        folder: the comparison's, with `baseline.json`.
    """
    changes = read_changes(folder)
    if changes is None:
        return ""
    note = (
        f"{changes.matched} runs are in both. The numbers: the mean now minus the mean then over the runs that reached the goal both "
        "times (what a run has on its way: over all runs), its 95 % interval below. Bold with a dot: the interval excludes zero. "
        "An unchanged program gives 0 everywhere on the same machine."
    )
    verdict = "".join(f"<li>{escape(words)}</li>" for words in changes.regressions() or ["Nothing got worse."])
    notes = "".join(f'<p class="soft">{escape(words)}</p>' for words in [note, *_notes(changes)])
    head = f"<h2>Against {escape(changes.place)}</h2><p>With a tolerance of {100 * TOLERANCE:g} %:</p><ul>{verdict}</ul>"
    return f"<section>{head}{_table(changes)}{notes}</section>"


def _table(changes: BaselineChanges) -> str:
    names = dict.fromkeys((m.title, m.unit) for c in changes.controllers for m in c.metrics)
    heads = ["Controller", "Reached the goal", *(f"{title} [{unit}]" if unit else title for title, unit in names)]
    return table(heads, [[(c.label, escape(c.label)), _goals(c), *map(_cell, c.metrics)] for c in changes.controllers])


def _notes(changes: BaselineChanges) -> list[str]:
    """What cannot be compared, and where the scenarios differ."""
    notes = [f"Only now: {words}." for words in changes.only_now] + [f"Only then: {words}." for words in changes.only_before]
    return notes + [f"{c.label}: its scenario differs in {', '.join(c.settings)}." for c in changes.controllers if c.settings]


def _goals(c: ControllerChange) -> Cell:
    change = c.reached_now - c.reached_before
    below = [f"{c.reached_now} of {c.runs}, before {c.reached_before}", *(f"lost {run}" for run in c.lost)]
    shown = f'<b class="real">● {signed(change)}</b>' if c.fails_more else signed(change)
    return change, shown + "".join(f"<small>{escape(words)}</small>" for words in [*below, *(f"gained {run}" for run in c.gained)])


def _cell(m: MetricChange) -> Cell:
    if not m.n:
        return None, "–"
    mean = f'<b class="real">● {signed(m.difference)}</b>' if m.real and m.difference else signed(m.difference)
    interval = f"<small>[{signed(m.low)},<br>{signed(m.high)}]</small>" if math.isfinite(m.low) else ""
    return m.difference, f"{mean} {interval}<small>before {number(m.before)}</small>"
