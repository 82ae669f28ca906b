"""HTML tables of what counts every run, also failed ones: interquartile means, and how probably one controller is better than another."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape

from vstestbed.report.comparison.columns import ComparisonResults, Metric
from vstestbed.report.comparison.interquartile import Interquartile
from vstestbed.report.comparison.pairs import Pair, against
from vstestbed.report.comparison.tables import Cell, below, corrected, labels_of, real, references, table
from vstestbed.report.run.numbers import number

FAILED = "A run that did not reach the goal counts as worse than any that did"
NEVER = "fails"
"""Stands for an infinite mean or end of an interval: so many runs failed."""


def interquartile_means(comparison: ComparisonResults, means: Sequence[Mapping[str, Interquartile]]) -> str:
    """One row per controller: the interquartile mean of each metric over all its runs, with its interval; means: `interquartiles`."""
    heads = ["Controller", *(f"{m.label} {_arrow(m)}" for m in comparison.shown)]
    every = zip(comparison.controllers, means, strict=True)
    lines = [[(c.label, escape(c.label)), *(_iqm(found[m.name], len(c.runs)) for m in comparison.shown)] for c, found in every]
    strata = ", resampled within each task" if any(any(c.tasks) for c in comparison.controllers) else ""
    note = (
        f"Mean of the middle half of all runs, with its 95 % bootstrap interval{strata}; ↓: less is better, ↑: more is better. "
        f"{FAILED}{_but(comparison)}: where more than a quarter of the runs failed, the mean “{NEVER}”, and where so many could have, "
        "an end of its interval does. A run that reached the goal without having the number is left out."
    )
    return f'<section><h2>Interquartile means</h2>{table(heads, lines)}<p class="soft">{note}</p></section>'


def improvements(comparison: ComparisonResults, all_pairs: list[Pair]) -> str:
    """Tables of the probability of improvement, one for each reference controller; empty for a single controller."""
    labels = labels_of(comparison)
    if len(labels) < 2:
        return ""
    parts = [_against(comparison, against(all_pairs, i), labels, i) for i in references(labels)]
    note = (
        "How probably the controller of the line is better than the other from the same start: the share of the common seeds on which it "
        f"is, with its 95 % interval (Wilson); equal numbers count one half. {FAILED}{_but(comparison)}; two failed runs are equal. "
        "Bold with a dot: p, of the sign test and corrected as above, is at most 0.05. This test is exact however skewed the numbers are."
    )
    return f'<section><h2>Probability of improvement</h2>{"".join(parts)}<p class="soft">{note}</p></section>'


def _but(comparison: ComparisonResults) -> str:
    """The metrics for which a failed run counts with its own number."""
    names = [m.title for m in comparison.shown if m.every_pair]
    return f" (but with its own number for {', '.join(names)})" if names else ""


def _arrow(metric: Metric) -> str:
    return "↑" if metric.higher else "↓"


def _iqm(found: Interquartile, runs: int) -> Cell:
    if not found.n:
        return None, "–"
    interval = "no interval" if math.isnan(found.low) else f"[{_end(found.low)}, {_end(found.high)}]"
    count = below(f"n = {found.n}") if found.n < runs else ""
    return found.mean if math.isfinite(found.mean) else None, f"{_end(found.mean)} {below(interval)}{count}"


def _end(value: float) -> str:
    return number(value) if math.isfinite(value) else NEVER


def _against(comparison: ComparisonResults, these: list[Pair], labels: list[str], reference: int) -> str:
    heads = [f"Better than {labels[reference]}", *(f"{m.label} {_arrow(m)}" for m in comparison.shown)]
    lines = [[(labels[p.b], escape(labels[p.b])), *(_improvement(p, m) for m in comparison.shown)] for p in these]
    return f'<div class="against" data-reference="{reference}">{table(heads, lines)}</div>'


def _improvement(pair: Pair, metric: Metric) -> Cell:
    found = pair.improvements[metric.name]
    if not found.n:
        return None, "–"
    count = below(f"n = {found.n}") if found.n < pair.seeds else ""
    text, interval = f"{100 * found.share:.0f} %", below(f"[{100 * found.low:.0f}, {100 * found.high:.0f}]")
    p = below(corrected(pair.adjusted[metric.name, "improvement"]))
    return found.share, f"{real(text) if pair.is_real(metric.name, 'improvement') else text} {interval}{p}{count}"
