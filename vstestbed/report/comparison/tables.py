"""HTML tables of a comparison: the controllers' metrics and their paired differences; a click on a column's head sorts by it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any, Final

import polars as pl

from vstestbed.report.comparison.columns import ComparisonResults, ControllerResults, Metric
from vstestbed.report.comparison.pairs import CONTROLLERS, MOST_CONTROLLERS, PAIRS, SUCCESS, Pair, against, tests
from vstestbed.report.comparison.statistics import Interquartile, spread, success_rate
from vstestbed.report.comparison.summary_text import p_text, signed
from vstestbed.report.run.numbers import number, plain

Cell = tuple[float | str | None, str]
"""Sort key of a table cell (None sorts last), and its HTML."""


def controllers(comparison: ComparisonResults) -> str:
    """One row per controller: success rate with its interval, and each metric's median with its quartiles."""
    heads = ["Controller", "Reached the goal", *(m.label for m in comparison.shown)]
    lines = [[(c.label, escape(c.label)), _rate(c), *(_spread(c, m) for m in comparison.shown)] for c in comparison.controllers]
    note = (
        "Success rate with its 95 % interval (Wilson). Of each number the median and, below it, the quartiles: final errors of "
        "every run that has one, and what a run has on its way whatever its end (overshoot, tracking), the others of the runs that "
        "reached the goal. A count stands below where it is not all runs."
    )
    return f'<section><h2>Controllers</h2>{table(heads, lines)}<p class="soft">{note} Click on a head to sort.</p></section>'


def _rate(controller: ControllerResults) -> Cell:
    if not len(controller.success):
        return None, "–"
    rate = success_rate(int(controller.success.sum()), len(controller.success))
    interval = f"[{100 * rate.low:.0f}, {100 * rate.high:.0f}]"
    return rate.rate, f"{100 * rate.rate:.0f} % {below(interval)}{below(f'{rate.successes} of {rate.n}')}"


def _spread(controller: ControllerResults, metric: Metric) -> Cell:
    summary = spread(controller.counted(metric))
    if summary.n == 0:
        return None, "–"
    # the number of runs only where it is not all of them
    count = below(f"n = {summary.n}") if summary.n < len(controller.runs) else ""
    return summary.median, f"{number(summary.median)} {below(f'[{number(summary.q1)}, {number(summary.q3)}]')}{count}"


def differences(comparison: ComparisonResults, all_pairs: list[Pair]) -> str:
    """Tables of paired differences, one for each reference controller, of which the page shows one; empty for a single controller."""
    labels = labels_of(comparison)
    if len(labels) < 2:
        return ""
    parts = [_against(comparison, against(all_pairs, i), labels, i) for i in references(labels)]
    note = (
        "Reached the goal: on how many more seeds (McNemar's test). The numbers: the mean of this line minus the other over the seeds on "
        f"which both reached the goal{_all_seeds_note(comparison)}, its 95 % bootstrap interval and the p-value below. "
        f"All p-values are corrected for the {tests(all_pairs)} tests of this page (Holm). Bold with a dot: p is at most 0.05, the "
        "difference is real. An interval that excludes zero without a dot is what chance gives in one of twenty tests. "
        f"{_skewed_note(comparison, all_pairs)}"
    )
    return f'<section><h2>Paired differences</h2>{_chooser(labels, len(parts))}{"".join(parts)}<p class="soft">{note}</p></section>'


def labels_of(comparison: ComparisonResults) -> list[str]:
    """The controllers' labels."""
    return [c.label for c in comparison.controllers]


def references(labels: Sequence[str]) -> range:
    """The controllers with which the others are compared: each of few, the first of many."""
    return range(len(labels) if len(labels) <= MOST_CONTROLLERS else 1)


def _skewed_note(comparison: ComparisonResults, all_pairs: list[Pair]) -> str:
    """What `skewed` means, where it is written."""
    if not any(p.differences[m.name].skewed for p in all_pairs for m in comparison.shown):
        return ""
    return (
        "Skewed: a few seeds make the mean. The probability of improvement counts every seed alike, and its test is exact for skewed "
        "numbers, too."
    )


def _all_seeds_note(comparison: ComparisonResults) -> str:
    """The metrics that are compared over all seeds, in brackets."""
    names = [m.title for m in comparison.shown if m.every_pair]
    return f" ({', '.join(names)}: over all seeds)" if names else ""


def _chooser(labels: Sequence[str], n: int) -> str:
    """The list in which the reader picks the reference controller, of n; SCRIPT shows the table of that one."""
    if n < 2:
        return ""
    options = "".join(f'<option value="{i}">{escape(label)}</option>' for i, label in enumerate(labels[:n]))
    return f'<p><label>Compared with <select id="reference">{options}</select></label></p>'


def _against(comparison: ComparisonResults, against_reference: list[Pair], labels: Sequence[str], reference: int) -> str:
    heads = [f"Against {labels[reference]}", "Reached the goal", *(m.label for m in comparison.shown)]
    lines = [[(labels[p.b], escape(labels[p.b])), _goals(p), *(_difference(p, m) for m in comparison.shown)] for p in against_reference]
    return f'<div class="against" data-reference="{reference}">{table(heads, lines)}</div>'


def _goals(pair: Pair) -> Cell:
    s = pair.success
    more = signed(s.only_b - s.only_a)
    counts = (f"only this: {s.only_b}", f"only other: {s.only_a}", f"both: {s.both}", f"neither: {s.neither}")
    lines = "".join(map(below, (corrected(pair.adjusted[SUCCESS, "difference"]), *counts)))
    return s.only_b - s.only_a, f"{real(more) if pair.is_real(SUCCESS) else more} {lines}"


def _difference(pair: Pair, metric: Metric) -> Cell:
    d = pair.differences[metric.name]
    if d.n == 0:
        return None, "–"
    interval = f"[{signed(d.low)},<br>{signed(d.high)}]" if math.isfinite(d.low) else "no interval"
    mean = signed(d.mean)
    p = below(corrected(pair.adjusted[metric.name, "difference"])) if math.isfinite(d.p) else ""
    count = below(f"n = {d.n}") if d.n < pair.success.both else ""
    skewed = below("skewed") if d.skewed else ""
    return d.mean, f"{real(mean) if pair.is_real(metric.name) else mean} {below(interval)}{p}{count}{skewed}"


def corrected(p: float) -> str:
    """A p-value as HTML."""
    return "no test" if math.isnan(p) else escape(p_text(p))


def real(text: str) -> str:
    """A number that differs significantly."""
    return f'<b class="real">● {text}</b>'


def below(text: str) -> str:
    """Small print below a cell's number."""
    return f"<small>{text}</small>"


def table(heads: Sequence[str], lines: Sequence[Sequence[Cell]]) -> str:
    """A table whose column heads are buttons that sort it; each cell carries its sort key as `data-value`."""
    top = "".join(f'<th scope="col" aria-sort="none"><button type="button">{escape(h)}</button></th>' for h in heads)
    body = "".join(f"<tr>{''.join(_cell(c, i) for i, c in enumerate(line))}</tr>" for line in lines)
    return f'<div class="wide"><table class="sortable"><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


def _cell(cell: Cell, place: int) -> str:
    key, content = cell
    # nine digits: values that differ only beyond the shown ones still sort
    value = "" if key is None else escape(str(key) if isinstance(key, str | int) else f"{key:.9g}")
    return f'<th scope="row" data-value="{value}">{content}</th>' if place == 0 else f'<td data-value="{value}">{content}</td>'


STYLE = """
.outcome.open { background: #55606c; }
.outcome ul { margin: 8px 0 0; padding-left: 1.2em; }
.wide { overflow-x: auto; background: var(--card); border: 1px solid var(--rule); border-radius: 10px; margin: 8px 0; }
table { border-collapse: collapse; width: 100%; font-size: .84rem; font-variant-numeric: tabular-nums; }
th, td { padding: 6px 7px; text-align: right; vertical-align: top; border-top: 1px solid var(--rule); font-weight: 400; }
thead th { border-top: 0; vertical-align: bottom; font-size: .78rem; }
th:first-child { text-align: left; min-width: 9.5em; overflow-wrap: break-word; }
tbody th { font-weight: 600; }
td small { font-size: .76rem; display: block; color: var(--soft); white-space: nowrap; }
td { white-space: nowrap; }
.real { color: var(--accent); }
th button { all: unset; cursor: pointer; color: var(--soft); line-height: 1.25; }
th button:hover, th button:focus-visible { text-decoration: underline; }
th[aria-sort=ascending] button::after { content: " ▲"; } th[aria-sort=descending] button::after { content: " ▼"; }
select { font: inherit; }
.plan { display: grid; grid-template-columns: max-content 1fr; gap: 2px 18px; }
.plan dt { color: var(--soft); } .plan dd { margin: 0; overflow-wrap: anywhere; }
.failure summary .soft { font-weight: 400; }
.broad { margin-top: 14px; }
.gallery { display: grid; grid-template-columns: repeat(auto-fill, minmax(200px, 1fr)); gap: 10px; margin-top: 10px; }
.gallery img { display: block; width: 100%; height: auto; border-radius: 6px; }
.runs { margin: 6px 0; padding-left: 1.2em; font-size: .88rem; }
code { font: .82rem/1.45 ui-monospace, SFMono-Regular, Menlo, Consolas, monospace; overflow-wrap: anywhere; }
@media print { .outcome.open { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  .wide { overflow: visible; } table { font-size: 7pt; } }
"""

# The page must work from a file:// address without network: the script is inline and uses no library.
SCRIPT = """<script>
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  heads.forEach((head, column) => head.querySelector("button").addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending", key = row => row.cells[column].dataset.value;
    const number = text => text !== "" && isFinite(text);
    heads.forEach(other => other.setAttribute("aria-sort", other !== head ? "none" : down ? "descending" : "ascending"));
    const order = (a, b) => number(a) && number(b) ? a - b : a.localeCompare(b, undefined, { numeric: true });
    [...body.rows].sort((one, two) => {
      const a = key(one), b = key(two);
      return a === "" || b === "" ? (a === "") - (b === "") : (down ? -1 : 1) * order(a, b);
    }).forEach(row => body.append(row));
  }));
}
const reference = document.getElementById("reference");
if (reference) {
  const show = () => document.querySelectorAll(".against").forEach(part => { part.hidden = part.dataset.reference !== reference.value; });
  reference.addEventListener("change", show);
  show();
}
</script>"""


# HTML tables of what counts every run, also failed ones: interquartile means, and how probably one controller is better than another.
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
    parts = [_improvements(comparison, against(all_pairs, i), labels, i) for i in references(labels)]
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
    interval = "no interval" if math.isnan(found.low) else f"[{_bound(found.low)}, {_bound(found.high)}]"
    count = below(f"n = {found.n}") if found.n < runs else ""
    return found.mean if math.isfinite(found.mean) else None, f"{_bound(found.mean)} {below(interval)}{count}"


def _bound(value: float) -> str:
    return number(value) if math.isfinite(value) else NEVER


def _improvements(comparison: ComparisonResults, these: list[Pair], labels: list[str], reference: int) -> str:
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


# The statistics of a comparison in a few lines for the terminal: success, interquartile mean, difference from the first controller.
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
    return row["controller"], f"{row['succeeded']} of {row['runs']}{_star(success)}", _mean(row), _plain_difference(difference)


def _title(row: dict[str, Any]) -> str:
    unit = f" [{row['unit']}]" if row["unit"] else ""
    return f"{row['title'].lower()}{unit}, IQM"


def _star(row: dict[str, Any] | None) -> str:
    return "*" if row and row["significant"] else ""


def _mean(row: dict[str, Any]) -> str:
    if row["iqm"] is None:
        return "-"
    interval = "" if row["iqm_low"] is None else f" [{_plain_bound(row['iqm_low'])}, {_plain_bound(row['iqm_high'])}]"
    return _plain_bound(row["iqm"]) + interval


def _plain_bound(value: float) -> str:
    return plain(value) if math.isfinite(value) else NEVER


def _plain_difference(row: dict[str, Any] | None) -> str:
    if row is None or row["difference"] is None:
        return ""
    interval = "" if row["low"] is None else f" [{signed(row['low'])}, {signed(row['high'])}]"
    # a hyphen: not every terminal has the minus sign
    return (signed(row["difference"]) + interval + _star(row)).replace("\N{MINUS SIGN}", "-")
