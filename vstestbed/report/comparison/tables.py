"""A comparison as tables of its page, and in lines for the terminal."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from vstestbed.report.comparison.pairs import Pair, against, has_every_pair
from vstestbed.report.comparison.records import CONTROLLERS, VERDICTS
from vstestbed.report.comparison.results import ComparisonResults, ControllerResults, Means
from vstestbed.report.comparison.sentences import p_text
from vstestbed.report.comparison.statistics import IntervalEstimate
from vstestbed.report.marks import number, signed
from vstestbed.report.pages import NO_CELL, Cell
from vstestbed.tasks.metrics import Metric

__all__ = ["Section", "sections", "statistics_text"]

# Of the page: the name of the controller that a table is against ("": none), its heads and lines
Table = tuple[str, list[str], list[list[Cell]]]
Section = tuple[str, list[Table]]  # title and tables

# Tables; `section.html` says what their numbers are. Medians and differences count the runs that
# reached the goal; interquartile means and improvements count every run.
NEVER = "fails"  # stands for an infinite mean or end of an interval: so many runs failed


def sections(
    comparison: ComparisonResults, means: Means, all_pairs: list[Pair], every: bool = True
) -> dict[str, Any]:
    """The tables of the page, with what their notes need to know; with `every` also the
    controllers' medians. means: `interquartiles`.
    """
    several = len(comparison.controllers) > 1
    found = []
    if several:
        found.append(("Verdicts", _verdicts(comparison, all_pairs)))
    if every:
        found.append(("Controllers", [_medians(comparison)]))
    found.append(("Interquartile means", [_middle_means(comparison, means)]))
    if several:
        found += _exploratory(comparison, all_pairs)
    deciding = [p for pair in all_pairs for p in (pair.test.p_success, pair.test.p_either)]
    exploring = [p for pair in all_pairs for p in pair.exploratory.values()]
    return {
        "sections": found,
        "primary": comparison.primary_metric.title.lower(),
        # metrics for which a failed run counts with its own number
        "of_any_run": ", ".join(m.title for m in comparison.shown if m.every_pair),
        "margin": f"{100 * comparison.margin:g}",
        # over how many tests the p-values of verdicts and the exploratory ones are adjusted
        "deciding": np.count_nonzero(np.isfinite(deciding)),
        "tests": np.count_nonzero(np.isfinite(exploring)),
    }


def _medians(comparison: ComparisonResults) -> Table:
    shown = comparison.shown
    heads = ["Controller", "Reached the goal", *(m.label for m in shown)]
    lines = [
        [Cell.named(c.label), rate_cell(c), *(_spread(c, m) for m in shown)]
        for c in comparison.controllers
    ]
    return "", heads, lines


def _middle_means(comparison: ComparisonResults, means: Means) -> Table:
    lines = []
    for c, found in zip(comparison.controllers, means, strict=True):
        cells = [_iqm(found[m.name], len(c.runs)) for m in comparison.shown]
        lines.append([Cell.named(c.label), *cells])
    return "", ["Controller", *_arrows(comparison.shown)], lines


def _arrows(metrics: Iterable[Metric]) -> list[str]:
    """Labels that say whether more is better."""
    return [f"{m.label} {'↑' if m.better > 0 else '↓'}" for m in metrics]


def _verdicts(comparison: ComparisonResults, all_pairs: list[Pair]) -> list[Table]:
    """The table of pairs with both tests of each verdict, and, of three controllers or more, who is
    better than whom as a matrix.
    """
    labels = comparison.labels
    heads = [
        "Pair",
        "Better",
        "Reached the goal",
        comparison.primary_metric.label,
        "Arrives first",
        "Starts that would settle it",
    ]
    found: list[Table] = [("", heads, [_verdict_line(pair, labels) for pair in all_pairs])]
    if len(labels) > 2 and has_every_pair(len(labels), comparison.reference):
        found.append(("", ["Row is ... than column", *labels], _matrix(all_pairs, labels)))
    return found


def _matrix(all_pairs: list[Pair], labels: list[str]) -> list[list[Cell]]:
    cells: dict[tuple[int, int], Cell] = {}
    for p in all_pairs:
        cells[p.a, p.b] = _won(p, p.a)
        cells[p.b, p.a] = _won(p, p.b)
    lines = []
    for i, name in enumerate(labels):
        against_each = [cells.get((i, k), NO_CELL) for k in range(len(labels))]
        lines.append([Cell.named(name), *against_each])
    return lines


def _verdict_line(p: Pair, labels: list[str]) -> list[Cell]:
    better = Cell("", "trade" if p.verdict.decision == "trade" else "–")
    if p.better is not None:
        better = Cell(labels[p.better], labels[p.better], True)
    more = p.test.wins_b - p.test.wins_a
    wins = [p_text(p.verdict.p_sooner), f"this {p.test.wins_b}, other {p.test.wins_a}"]
    sooner = Cell(more, signed(more), p.sooner is not None, wins)
    needed = p.verdict.needs
    needs = NO_CELL if needed is None else Cell(needed, str(needed))
    name = Cell.named(f"{labels[p.b]} − {labels[p.a]}")
    return [name, better, _goals(p), _primary(p), sooner, needs]


def _won(pair: Pair, one: int) -> Cell:
    """Of the row `one`: better, worse, a trade; where the runs do not tell, who is sooner."""
    words = "·"
    if pair.better is not None:
        words = "better" if pair.better == one else "worse"
    elif pair.verdict.decision == "trade":
        words = "trade"
    elif pair.sooner is not None:
        words = "sooner" if pair.sooner == one else "later"
    return Cell(words == "better", words, words in ("better", "worse"))


def _exploratory(comparison: ComparisonResults, all_pairs: list[Pair]) -> list[Section]:
    """The differences of all other metrics, and who is better more often, against each controller
    in turn.
    """
    labels = comparison.labels
    metrics = comparison.exploratory
    differences = []
    improvements = []
    for i, name in enumerate(labels):
        differ = []
        improve = []
        for p in against([p for p in all_pairs if p.improvements], i):
            first = Cell.named(labels[p.b])
            differ.append([first, *(_difference(p, m) for m in metrics)])
            improve.append([first, *(_improvement(p, m) for m in metrics)])
        if differ:
            differences.append((name, [f"Against {name}", *(m.label for m in metrics)], differ))
            improvements.append((name, [f"Better than {name}", *_arrows(metrics)], improve))
    return [("Paired differences", differences), ("Probability of improvement", improvements)]


def rate_cell(controller: ControllerResults) -> Cell:
    """The success rate with its interval."""
    rate = controller.rate
    if not rate.n:
        return NO_CELL
    interval = f"[{_percent(rate.low)}, {_percent(rate.high)}]"
    small = [interval, f"{int(controller.success.sum())} of {rate.n}"]
    return Cell(rate.mean, f"{_percent(rate.mean)} %", small=small)


def _spread(controller: ControllerResults, metric: Metric) -> Cell:
    q1, median, q3, n = controller.quartiles(metric)
    small = [f"[{number(q1)}, {number(q3)}]", *_count(n, len(controller.runs))]
    return Cell(median, number(median), small=small) if n else NO_CELL


def _iqm(found: IntervalEstimate, n: int) -> Cell:
    if not found.n:
        return NO_CELL
    interval = "no interval"
    if not math.isnan(found.low):
        interval = f"[{_bound(found.low)}, {_bound(found.high)}]"
    key = found.mean if math.isfinite(found.mean) else None
    return Cell(key, _bound(found.mean), small=[interval, *_count(found.n, n)])


def _goals(pair: Pair) -> Cell:
    t = pair.test
    more = t.only_b - t.only_a
    counts = f"only this {t.only_b}, only other {t.only_a}, both {t.both}, neither {t.neither}"
    verdict = pair.verdict
    return Cell(more, signed(more), verdict.by_success, [p_text(verdict.p_success), counts])


def _primary(pair: Pair) -> Cell:
    """The difference of the primary metric as flown, and with failures not yet seen,
    which decides.
    """
    d = pair.differences[pair.primary.name]
    if not d.n:
        return NO_CELL
    low, high = pair.deciding
    small = ["no interval"]
    if math.isfinite(d.low):
        small = [f"[{signed(d.low)}, {signed(d.high)}] as flown"]
    if math.isfinite(low):
        small.append(f"[{signed(low)}, {signed(high)}] unseen")
    small.append(p_text(pair.verdict.p_cost))
    return Cell(d.mean, signed(d.mean), pair.verdict.by_cost, small)


def _difference(pair: Pair, metric: Metric) -> Cell:
    d = pair.differences[metric.name]
    if not d.n:
        return NO_CELL
    small = ["no interval"]
    if math.isfinite(d.low):  # in two lines, since columns are narrow
        small = [f"[{signed(d.low)},", f"{signed(d.high)}]"]
    if math.isfinite(d.p):
        small.append(p_text(pair.adjusted[metric.name, "difference"]))
    small += _count(d.n, pair.seeds if metric.every_pair else pair.test.both)
    return Cell(d.mean, signed(d.mean), pair.is_real(metric.name), small)


def _improvement(pair: Pair, metric: Metric) -> Cell:
    found = pair.improvements[metric.name]
    if not found.n:
        return NO_CELL
    interval = f"[{_percent(found.low)}, {_percent(found.high)}]"
    p = p_text(pair.adjusted[metric.name, "improvement"])
    small = [interval, p, *_count(found.n, pair.seeds)]
    real = pair.is_real(metric.name, "improvement")
    return Cell(found.mean, f"{_percent(found.mean)} %", real, small)


def _percent(share: float) -> str:
    return f"{100 * share:.0f}"


def _count(n: int, of: int) -> list[str]:
    return [f"n = {n}"] if n < of else []


def _bound(value: float) -> str:
    return number(value) if math.isfinite(value) else NEVER


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
    width = max(map(len, every["controller"].head(MOST)))
    reached = [
        f"  {row['controller']:<{width}}  {row['succeeded']} of {row['runs']}"
        for row in every.rows(named=True)
    ]
    told = found["pairs"]
    # of two or three pairs the open ones, too: they say what is missing
    if len(told) > FEW:
        told = [pair for pair in told if pair["verdict"] != "none"]
    sentences = _most([pair["sentence"] for pair in told])
    return "\n".join([found["overall"], *found["cautions"], *_most(reached), *sentences])


def _most(lines: list[str]) -> list[str]:
    """The first MOST of them, and how many more there are."""
    more = len(lines) - MOST
    return lines if more <= 0 else [*lines[:MOST], f"  and {more} more in report.html"]
