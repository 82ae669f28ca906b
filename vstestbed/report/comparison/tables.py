"""A comparison in sentences, as tables of its page, and in lines for the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import polars as pl

from vstestbed.report.comparison.results import (
    CENSORED,
    CHANCE,
    CONTROLLERS,
    MOST_CONTROLLERS,
    MOST_PAIRED,
    PAIRS,
    RESTRICTED,
    SUCCESS,
    ComparisonResults,
    ControllerResults,
    Means,
    Of,
    Pair,
    against,
)
from vstestbed.report.comparison.statistics import IntervalEstimate
from vstestbed.report.marks import counted, listed, number, signed
from vstestbed.report.pages import NO_CELL, Cell
from vstestbed.tasks.metrics import Metric

Section = tuple[str, list[tuple[str, list[str], list[list[Cell]]]]]
"""Of the page: title; tables, each with the name of the controller that it is against ("": none), heads and lines."""

# The result in sentences: the verdict on each pair, and what it rests on.

MOST_OTHERS = 4  # Exploratory differences that a sentence names; the table has all of them


def headline(comparison: ComparisonResults, all_pairs: list[Pair], gains: str = "") -> tuple[str, str, list[str], list[str]]:
    """Verdict, look of its box (`good` where one controller beats all others, else `open`), sentences on the best, and on the other pairs.

    `gains`: those in which controllers differ and in nothing else.
    """
    labels = [c.label for c in comparison.controllers]
    if len(labels) == 1:
        rate = comparison.controllers[0].rate
        interval = f"{100 * rate.mean:.0f} %, 95 % interval {100 * rate.low:.0f} to {100 * rate.high:.0f} %"
        reached = f"{int(comparison.controllers[0].success.sum())} of {counted(rate.n, 'run')}"
        return f"{labels[0]} reached the goal in {reached} ({interval}).", "open", [], []
    beaten = {i: [p.a + p.b - i for p in all_pairs if p.better == i] for i in range(len(labels))}  # a + b - i: the other one of the pair
    best = max(beaten, key=lambda i: len(beaten[i]))
    decided = len(beaten[best]) == len(labels) - 1
    verdict, cautions = _overall(labels, all_pairs, beaten), censoring(comparison)
    if gains:  # no controller is better than another for its gain
        verdict, decided = f"Only {gains} {'differ' if ' and ' in gains else 'differs'}. {verdict}", False
        cautions.append("This compares settings of one law: a larger gain converges sooner by itself, until delay or limits stop it.")
    # all pairs of up to three controllers; of more controllers the pairs of the one that wins most often
    shown = all_pairs if len(all_pairs) <= 3 else [p for p in all_pairs if best in (p.a, p.b)][:MOST_CONTROLLERS]
    sentences = [*cautions, *(pair_text(p, labels) for p in shown)]
    return verdict, "good" if decided else "open", sentences, [pair_text(p, labels) for p in all_pairs if p not in shown]


def _overall(labels: list[str], all_pairs: list[Pair], beaten: dict[int, list[int]]) -> str:
    """The verdicts on all pairs in one sentence, those with the most wins first."""
    runs = counted(max((p.seeds for p in all_pairs), default=0), "run")
    winners = sorted((i for i in beaten if beaten[i]), key=lambda i: -len(beaten[i]))
    if not winners:
        return f"No verdict: {runs} each show none of them better." if len(labels) > 2 else f"No verdict: {runs} each show neither better."
    words = [
        f"{labels[i]} is better than {'all others' if len(beaten[i]) == len(labels) - 1 > 1 else listed([labels[k] for k in beaten[i]])}"
        for i in winners[:MOST_CONTROLLERS]
    ]
    more = f"; {len(winners) - MOST_CONTROLLERS} more are better than some" if len(winners) > MOST_CONTROLLERS else ""
    open_pairs = sum(p.better is None for p in all_pairs)
    rest = f" Of {counted(open_pairs, 'other pair')} {runs} each do not tell." if open_pairs else ""
    return f"{'; '.join(words)}{more}.{rest}"


def censoring(comparison: ComparisonResults) -> list[str]:
    """A warning for each controller whose mean time depends on the limit, because more than CENSORED of its runs failed."""
    if comparison.primary_metric != RESTRICTED:
        return []
    return [
        f"Caution: {int((~c.success).sum())} of {counted(len(c.success), 'run')} of {c.label} failed and count with their limit of time: "
        "its mean time depends on this limit."
        for c in comparison.controllers
        if c.censored > CENSORED
    ]


def pair_text(pair: Pair, labels: list[str]) -> str:
    """One pair in a few sentences: the verdict, successes, the primary metric, exploratory differences that are beyond chance."""
    s, n, a, b = pair.success, pair.seeds, labels[pair.a], labels[pair.b]
    if n == 0:
        return f"{b} and {a} share no seed: they cannot be compared."
    better = pair.better
    verdict = f"{labels[better]} is better than {labels[pair.a + pair.b - better]}" if better is not None else f"{b} and {a}: no verdict"
    of_a, of_b = s.both + s.only_a, s.both + s.only_b
    test = f", {p_text(pair.adjusted[SUCCESS.name, 'difference'])}" if s.only_a + s.only_b else ""
    goal = f"{b} reached the goal on {of_b} of {counted(n, 'seed')}, {a} on {of_a}{test}"
    fewer = pair.sooner is not None and better is None
    words = [f"{verdict}: {goal}; {_primary_text(pair, b)}."]
    if fewer:
        words.append(f"{labels[pair.sooner or 0]} reached the goal on fewer seeds, so that it is not called better.")
    elif better is None and (d := pair.differences[pair.primary.name]).excludes_zero:
        alone = (
            f"the p-value is corrected for all pairs (alone {p_text(d.p)}); more seeds, or a `reference` to test fewer pairs, could tell"
        )
        words.append(f"The interval is of this pair alone, {alone if d.p <= CHANCE else 'and its test does not agree'}.")
    named = [f"{m.title.lower()} ({_by_how_much(pair, m)})" for m in _others(pair)]
    more = f", and {len(named) - MOST_OTHERS} more" if len(named) > MOST_OTHERS else ""
    return " ".join([*words, *([f"Exploratory: they also differ in {', '.join(named[:MOST_OTHERS])}{more}."] if named else [])])


def _primary_text(pair: Pair, b: str) -> str:
    """`time to the goal, a failure at its limit: pbvs -1.2 s (12 %), 95 % interval -2 to -0.4 s, p = 0.003`."""
    metric, d, mean = pair.primary, pair.differences[pair.primary.name], pair.means[pair.primary.name]
    title, unit = metric.title[0].lower() + metric.title[1:], f" {metric.unit}".rstrip()
    if d.n == 0:
        return f"{title}: no seed on which both have it"
    share = f" ({number(abs(100 * d.mean / mean))} %)" if mean > 0 else ""
    interval = f", 95 % interval {signed(d.low)} to {signed(d.high)}{unit}" if math.isfinite(d.low) else ""
    return f"{title}: {b} {signed(d.mean)}{unit}{share}{interval}, {p_text(pair.adjusted[metric.name, 'difference'])}"


def _by_how_much(pair: Pair, metric: Metric) -> str:
    """The mean difference `+1.2 px`; where that is not significant, from how many of the starts b is better, or worse."""
    if pair.is_real(metric.name):
        return f"{signed(pair.differences[metric.name].mean)} {metric.unit}".strip()
    share = pair.improvements[metric.name].mean
    return f"{'better' if share > 0.5 else 'worse'} from {100 * max(share, 1 - share):.0f} % of the starts"


def _others(pair: Pair) -> list[Metric]:
    """The exploratory metrics whose difference or improvement is significant."""
    return [Metric.named(name) for name in pair.improvements if pair.is_real(name) or pair.is_real(name, "improvement")]


def p_text(p: float) -> str:
    """`p = 0.012`."""
    return "no test" if math.isnan(p) else "p < 0.001" if p < 1e-3 else f"p = {p:.2g}"


# Tables; `section.html` says what their numbers are. Medians and differences count the runs that reached the goal; interquartile means
# and improvements count every run.
NEVER: Final = "fails"  # stands for an infinite mean or end of an interval: so many runs failed


def sections(comparison: ComparisonResults, means: Means, all_pairs: list[Pair], every: bool = True) -> dict[str, Any]:
    """The tables of the page, with what their notes need to know; with `every` also the controllers' medians. means: `interquartiles`."""
    shown, controllers = comparison.shown, comparison.controllers
    middle = [[_name(c.label), *(_iqm(f[m.name], len(c.runs)) for m in shown)] for c, f in zip(controllers, means, strict=True)]
    labels, arrows = [m.label for m in shown], [f"{m.label} {'↑' if m.better > 0 else '↓'}" for m in shown]
    found: list[Section] = []
    if len(controllers) > 1:
        found.append(("Verdicts", _verdicts(comparison, all_pairs)))
    if every:
        medians = [[_name(c.label), rate_cell(c), *(_spread(c, m) for m in shown)] for c in controllers]
        found.append(("Controllers", [("", ["Controller", "Reached the goal", *labels], medians)]))
    found.append(("Interquartile means", [("", ["Controller", *arrows], middle)]))
    if len(controllers) > 1:
        found += _exploratory(comparison, all_pairs)
    return {
        "sections": found,
        "primary": comparison.primary_metric.title.lower(),
        "strata": any(any(c.tasks) for c in controllers),
        "of_any_run": ", ".join(m.title for m in shown if m.every_pair),  # metrics for which a failed run counts with its own number
        # over how many tests the p-values of verdicts and the exploratory ones are adjusted
        "deciding": sum(not math.isnan(p) for pair in all_pairs for p in pair.deciding.values()),
        "tests": sum(not math.isnan(p) for pair in all_pairs for p in pair.exploratory.values()),
    }


def _verdicts(comparison: ComparisonResults, all_pairs: list[Pair]) -> list[tuple[str, list[str], list[list[Cell]]]]:
    """The table of pairs with both tests of each verdict, and, of three controllers or more, who is better than whom as a matrix."""
    labels = [c.label for c in comparison.controllers]
    heads = ["Pair", "Better", "Reached the goal", comparison.primary_metric.label]
    lines = []
    for p in all_pairs:
        better = ("", "–", False, []) if p.better is None else (labels[p.better], labels[p.better], True, [])
        lines.append([_name(f"{labels[p.b]} − {labels[p.a]}"), better, _goals(p), _difference(p, p.primary)])
    tables = [("", heads, lines)]
    if 2 < len(labels) <= MOST_PAIRED and not comparison.reference:
        won = {(p.a, p.b): p.better for p in all_pairs} | {(p.b, p.a): p.better for p in all_pairs}
        cells = [[(won[i, k] == i, *_won(won[i, k], i), []) if i != k else NO_CELL for k in range(len(labels))] for i in range(len(labels))]
        tables.append(("", ["Row is ... than column", *labels], [[_name(name), *line] for name, line in zip(labels, cells, strict=True)]))
    return tables


def _won(better: int | None, one: int) -> tuple[str, bool]:
    return ("·", False) if better is None else ("better", True) if better == one else ("worse", False)


def _exploratory(comparison: ComparisonResults, all_pairs: list[Pair]) -> list[Section]:
    shown = [m for m in comparison.shown if m != comparison.primary_metric]
    labels, arrows = [m.label for m in shown], [f"{m.label} {'↑' if m.better > 0 else '↓'}" for m in shown]
    explored = [p for p in all_pairs if p.improvements]
    differences = _against_each(comparison, explored, lambda p: [_difference(p, m) for m in shown])
    improvements = _against_each(comparison, explored, lambda p: [_improvement(p, m) for m in shown])
    return [
        ("Paired differences", [(name, [f"Against {name}", *labels], lines) for name, lines in differences if lines]),
        ("Probability of improvement", [(name, [f"Better than {name}", *arrows], lines) for name, lines in improvements if lines]),
    ]


def _against_each(
    comparison: ComparisonResults, all_pairs: list[Pair], cells: Callable[[Pair], Sequence[Cell]]
) -> list[tuple[str, list[list[Cell]]]]:
    """For each controller its name, and a line for each of the others with which it was paired."""
    labels = [c.label for c in comparison.controllers]
    return [(name, [[_name(labels[p.b]), *cells(p)] for p in against(all_pairs, i)]) for i, name in enumerate(labels)]


def _name(label: str) -> Cell:
    return label, label, False, []


def rate_cell(controller: ControllerResults) -> Cell:
    """The success rate with its interval."""
    rate = controller.rate
    small = [f"[{100 * rate.low:.0f}, {100 * rate.high:.0f}]", f"{int(controller.success.sum())} of {rate.n}"]
    return (rate.mean, f"{100 * rate.mean:.0f} %", False, small) if rate.n else NO_CELL


def _spread(controller: ControllerResults, metric: Metric) -> Cell:
    q1, median, q3, n = controller.quartiles(metric)
    small = [f"[{number(q1)}, {number(q3)}]", *_count(n, len(controller.runs))]
    return (median, number(median), False, small) if n else NO_CELL


def _iqm(found: IntervalEstimate, n: int) -> Cell:
    interval = "no interval" if math.isnan(found.low) else f"[{_bound(found.low)}, {_bound(found.high)}]"
    key = found.mean if math.isfinite(found.mean) else None
    return (key, _bound(found.mean), False, [interval, *_count(found.n, n)]) if found.n else NO_CELL


def _goals(pair: Pair) -> Cell:
    s, more = pair.success, pair.success.only_b - pair.success.only_a
    counts = [f"only this {s.only_b}, only other {s.only_a}, both {s.both}, neither {s.neither}"]
    return more, signed(more), pair.is_real(SUCCESS.name), [_corrected(pair, SUCCESS.name), *counts]


def _difference(pair: Pair, metric: Metric) -> Cell:
    d = pair.differences[metric.name]
    # in two lines, since columns are narrow
    small = [f"[{signed(d.low)},", f"{signed(d.high)}]"] if math.isfinite(d.low) else ["no interval"]
    small += [_corrected(pair, metric.name)] if math.isfinite(d.p) else []
    small += _count(d.n, pair.seeds if metric.every_pair else pair.success.both)
    return (d.mean, signed(d.mean), pair.is_real(metric.name), small) if d.n else NO_CELL


def _improvement(pair: Pair, metric: Metric) -> Cell:
    found = pair.improvements[metric.name]
    small = [f"[{_percent(found.low)}, {_percent(found.high)}]", _corrected(pair, metric.name, "improvement")]
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
MOST: Final = 12  # controllers that are listed


def statistics_text(folder: Path) -> str:
    """A line for each controller with its primary metric, against the reference; "" for a single controller, or without a report."""
    if not (folder / f"{CONTROLLERS}.parquet").is_file():
        return ""
    every, pairs = (pl.read_parquet(folder / f"{name}.parquet") for name in (CONTROLLERS, PAIRS))
    if not len(pairs):
        return ""
    (_, primary), reference = pairs.filter(pl.col("role") == "primary").rows(named=True)[:2], pairs["against"][0]
    unit = f" [{primary['unit']}]" if primary["unit"] else ""
    lines = [("", "reached", f"{primary['title'].lower()}{unit}, against {reference}", "verdict")]
    of = {
        row["controller"]: row
        for row in pairs.filter((pl.col("against") == reference) & (pl.col("metric") == primary["metric"])).rows(named=True)
    }
    for row in every.unique("controller", keep="first", maintain_order=True).rows(named=True):
        name, found = row["controller"], of.get(row["controller"])
        undecided = f"no verdict, {p_text(math.nan if found['p_holm'] is None else found['p_holm'])}" if found else ""
        better = "" if not found else {None: undecided, name: "better"}.get(found["better_one"], "worse")
        lines.append((name, f"{row['succeeded']} of {row['runs']}", _plain_difference(found), better))
    widths = [max(map(len, column)) for column in zip(*lines[: MOST + 1], strict=True)]
    text = ["  " + "  ".join(map(str.ljust, line, widths)).rstrip() for line in lines[: MOST + 1]]
    if (more := len(lines) - 1 - MOST) > 0:
        text.append(f"  and {more} more in report.html")
    return "\n".join(text)


def _plain_difference(row: dict[str, Any] | None) -> str:
    if row is None or row["difference"] is None:
        return ""
    interval = "" if row["low"] is None else f" [{signed(row['low'])}, {signed(row['high'])}]"
    # a hyphen: not every terminal has the minus sign
    return (signed(row["difference"]) + interval).replace("\N{MINUS SIGN}", "-")
