"""A comparison as tables of its page, and in lines for the terminal."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import polars as pl

from vstestbed.report.comparison.pairs import Of, Pair, against, has_every_pair
from vstestbed.report.comparison.records import CONTROLLERS, VERDICTS
from vstestbed.report.comparison.results import ComparisonResults, ControllerResults, Means
from vstestbed.report.comparison.sentences import p_text
from vstestbed.report.comparison.statistics import IntervalEstimate
from vstestbed.report.marks import number, signed
from vstestbed.report.pages import NO_CELL, Cell
from vstestbed.tasks.metrics import Metric

Section = tuple[str, list[tuple[str, list[str], list[list[Cell]]]]]
"""Of the page: title; tables, each with the name of the controller that it is against ("": none),
heads and lines.
"""

# Tables; `section.html` says what their numbers are. Medians and differences count the runs that
# reached the goal; interquartile means and improvements count every run.
NEVER = "fails"  # stands for an infinite mean or end of an interval: so many runs failed


def sections(
    comparison: ComparisonResults, means: Means, all_pairs: list[Pair], every: bool = True
) -> dict[str, Any]:
    """The tables of the page, with what their notes need to know; with `every` also the
    controllers' medians. means: `interquartiles`.
    """
    shown, controllers = comparison.shown, comparison.controllers
    middle = [
        [_name(c.label), *(_iqm(f[m.name], len(c.runs)) for m in shown)]
        for c, f in zip(controllers, means, strict=True)
    ]
    labels, arrows = (
        [m.label for m in shown],
        [f"{m.label} {'↑' if m.better > 0 else '↓'}" for m in shown],
    )
    found: list[Section] = []
    if len(controllers) > 1:
        found.append(("Verdicts", _verdicts(comparison, all_pairs)))
    if every:
        medians = [
            [_name(c.label), rate_cell(c), *(_spread(c, m) for m in shown)] for c in controllers
        ]
        found.append(("Controllers", [("", ["Controller", "Reached the goal", *labels], medians)]))
    found.append(("Interquartile means", [("", ["Controller", *arrows], middle)]))
    if len(controllers) > 1:
        found += _exploratory(comparison, all_pairs)
    return {
        "sections": found,
        "primary": comparison.primary_metric.title.lower(),
        # metrics for which a failed run counts with its own number
        "of_any_run": ", ".join(m.title for m in shown if m.every_pair),
        "margin": f"{100 * comparison.margin:g}",
        # over how many tests the p-values of verdicts and the exploratory ones are adjusted
        "deciding": sum(
            not math.isnan(p)
            for pair in all_pairs
            for p in (pair.test.p_success, pair.test.p_either)
        ),
        "tests": sum(not math.isnan(p) for pair in all_pairs for p in pair.exploratory.values()),
    }


def _verdicts(
    comparison: ComparisonResults, all_pairs: list[Pair]
) -> list[tuple[str, list[str], list[list[Cell]]]]:
    """The table of pairs with both tests of each verdict, and, of three controllers or more, who is
    better than whom as a matrix.
    """
    labels = [c.label for c in comparison.controllers]
    heads = [
        "Pair",
        "Better",
        "Reached the goal",
        comparison.primary_metric.label,
        "Arrives first",
        "Starts that would settle it",
    ]
    lines = [_verdict_line(pair, labels) for pair in all_pairs]
    tables = [("", heads, lines)]
    if len(labels) > 2 and has_every_pair(len(labels), comparison.reference):
        of = {(p.a, p.b): p for p in all_pairs} | {(p.b, p.a): p for p in all_pairs}
        cells = [
            [_won(of[i, k], i) if i != k else NO_CELL for k in range(len(labels))]
            for i in range(len(labels))
        ]
        tables.append(
            (
                "",
                ["Row is ... than column", *labels],
                [[_name(name), *line] for name, line in zip(labels, cells, strict=True)],
            )
        )
    return tables


def _verdict_line(p: Pair, labels: list[str]) -> list[Cell]:
    better: Cell = ("", "trade" if p.verdict.decision == "trade" else "–", False, [])
    if p.better is not None:
        better = (labels[p.better], labels[p.better], True, [])
    more = p.test.wins_b - p.test.wins_a
    wins = [p_text(p.verdict.p_sooner), f"this {p.test.wins_b}, other {p.test.wins_a}"]
    sooner: Cell = (more, signed(more), p.sooner is not None, wins)
    needs: Cell = (
        NO_CELL if p.verdict.needs is None else (p.verdict.needs, str(p.verdict.needs), False, [])
    )
    return [_name(f"{labels[p.b]} − {labels[p.a]}"), better, _goals(p), _primary(p), sooner, needs]


def _won(pair: Pair, one: int) -> Cell:
    """Of the row `one`: better, worse, a trade; where the runs do not tell, who is sooner."""
    words = "·"
    if pair.better is not None:
        words = "better" if pair.better == one else "worse"
    elif pair.verdict.decision == "trade":
        words = "trade"
    elif pair.sooner is not None:
        words = "sooner" if pair.sooner == one else "later"
    return words == "better", words, words in ("better", "worse"), []


def _exploratory(comparison: ComparisonResults, all_pairs: list[Pair]) -> list[Section]:
    shown = [m for m in comparison.shown if m != comparison.primary_metric]
    labels, arrows = (
        [m.label for m in shown],
        [f"{m.label} {'↑' if m.better > 0 else '↓'}" for m in shown],
    )
    explored = [p for p in all_pairs if p.improvements]
    differences = _against_each(comparison, explored, lambda p: [_difference(p, m) for m in shown])
    improvements = _against_each(
        comparison, explored, lambda p: [_improvement(p, m) for m in shown]
    )
    return [
        (
            "Paired differences",
            [(name, [f"Against {name}", *labels], lines) for name, lines in differences if lines],
        ),
        (
            "Probability of improvement",
            [
                (name, [f"Better than {name}", *arrows], lines)
                for name, lines in improvements
                if lines
            ],
        ),
    ]


def _against_each(
    comparison: ComparisonResults, all_pairs: list[Pair], cells: Callable[[Pair], Sequence[Cell]]
) -> list[tuple[str, list[list[Cell]]]]:
    """For each controller its name, and a line for each of the others with which it was paired."""
    labels = [c.label for c in comparison.controllers]
    return [
        (name, [[_name(labels[p.b]), *cells(p)] for p in against(all_pairs, i)])
        for i, name in enumerate(labels)
    ]


def _name(label: str) -> Cell:
    return label, label, False, []


def rate_cell(controller: ControllerResults) -> Cell:
    """The success rate with its interval."""
    rate = controller.rate
    small = [
        f"[{100 * rate.low:.0f}, {100 * rate.high:.0f}]",
        f"{int(controller.success.sum())} of {rate.n}",
    ]
    return (rate.mean, f"{100 * rate.mean:.0f} %", False, small) if rate.n else NO_CELL


def _spread(controller: ControllerResults, metric: Metric) -> Cell:
    q1, median, q3, n = controller.quartiles(metric)
    small = [f"[{number(q1)}, {number(q3)}]", *_count(n, len(controller.runs))]
    return (median, number(median), False, small) if n else NO_CELL


def _iqm(found: IntervalEstimate, n: int) -> Cell:
    interval = (
        "no interval" if math.isnan(found.low) else f"[{_bound(found.low)}, {_bound(found.high)}]"
    )
    key = found.mean if math.isfinite(found.mean) else None
    return (key, _bound(found.mean), False, [interval, *_count(found.n, n)]) if found.n else NO_CELL


def _goals(pair: Pair) -> Cell:
    t, more = pair.test, pair.test.only_b - pair.test.only_a
    counts = [f"only this {t.only_b}, only other {t.only_a}, both {t.both}, neither {t.neither}"]
    return more, signed(more), pair.verdict.by_success, [p_text(pair.verdict.p_success), *counts]


def _primary(pair: Pair) -> Cell:
    """The difference of the primary metric as flown, and with failures not yet seen,
    which decides.
    """
    d, (low, high) = pair.differences[pair.primary.name], pair.deciding
    small = (
        [f"[{signed(d.low)}, {signed(d.high)}] as flown"]
        if math.isfinite(d.low)
        else ["no interval"]
    )
    small += [f"[{signed(low)}, {signed(high)}] unseen"] if math.isfinite(low) else []
    return (
        (d.mean, signed(d.mean), pair.verdict.by_cost, [*small, p_text(pair.verdict.p_cost)])
        if d.n
        else NO_CELL
    )


def _difference(pair: Pair, metric: Metric) -> Cell:
    d = pair.differences[metric.name]
    # in two lines, since columns are narrow
    small = (
        [f"[{signed(d.low)},", f"{signed(d.high)}]"] if math.isfinite(d.low) else ["no interval"]
    )
    small += [_corrected(pair, metric.name)] if math.isfinite(d.p) else []
    small += _count(d.n, pair.seeds if metric.every_pair else pair.test.both)
    return (d.mean, signed(d.mean), pair.is_real(metric.name), small) if d.n else NO_CELL


def _improvement(pair: Pair, metric: Metric) -> Cell:
    found = pair.improvements[metric.name]
    small = [
        f"[{_percent(found.low)}, {_percent(found.high)}]",
        _corrected(pair, metric.name, "improvement"),
    ]
    words, real = f"{_percent(found.mean)} %", pair.is_real(metric.name, "improvement")
    return (found.mean, words, real, [*small, *_count(found.n, pair.seeds)]) if found.n else NO_CELL


def _percent(share: float) -> str:
    return f"{100 * share:.0f}"


def _count(n: int, of: int) -> list[str]:
    return [f"n = {n}"] if n < of else []


def _bound(value: float) -> str:
    return number(value) if math.isfinite(value) else NEVER


def _corrected(pair: Pair, name: str, of: Of = "difference") -> str:
    return p_text(pair.adjusted[name, of])


# The verdicts in a few lines for the terminal.
MOST = 12  # controllers, and pairs, that are listed
FEW = 3  # pairs of which also those without a verdict are


def statistics_text(folder: Path) -> str:
    """The verdict on all, how often each controller reached the goal, and every decided pair, in
    the page's own sentences.

    "" for a single controller, or without a report.
    """
    if not (folder / VERDICTS).is_file():
        return ""
    found = json.loads((folder / VERDICTS).read_text(encoding="utf-8"))
    if not found["pairs"]:
        return ""
    every = pl.read_parquet(folder / f"{CONTROLLERS}.parquet").unique(
        "controller", keep="first", maintain_order=True
    )
    counts = [
        (row["controller"], f"{row['succeeded']} of {row['runs']}")
        for row in every.rows(named=True)
    ]
    width = max(len(name) for name, _ in counts[:MOST])
    lines = [
        found["overall"],
        *found["cautions"],
        *_most([f"  {name:<{width}}  {reached}" for name, reached in counts]),
    ]
    # of two or three pairs the open ones, too: they say what is missing
    told = [
        pair["sentence"]
        for pair in found["pairs"]
        if pair["verdict"] != "none" or len(found["pairs"]) <= FEW
    ]
    return "\n".join([*lines, *_most(told)])


def _most(lines: list[str]) -> list[str]:
    """The first MOST of them, and how many more there are."""
    return (
        lines
        if len(lines) <= MOST
        else [*lines[:MOST], f"  and {len(lines) - MOST} more in report.html"]
    )
