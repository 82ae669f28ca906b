"""A comparison in sentences, as tables of its page, and in lines for the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import polars as pl

from vstestbed.report.comparison.results import (
    CONTROLLERS,
    MOST_CONTROLLERS,
    PAIRS,
    SUCCESS,
    TIME,
    ComparisonResults,
    ControllerResults,
    Means,
    Of,
    Pair,
    against,
)
from vstestbed.report.comparison.statistics import IntervalEstimate
from vstestbed.report.marks import counted, number, signed
from vstestbed.report.pages import NO_CELL, Cell
from vstestbed.tasks.metrics import Metric

Section = tuple[str, list[tuple[str, list[str], list[list[Cell]]]]]
"""Of the page: title; tables, each with the name of the controller that it is against ("": none), heads and lines."""

# The result in sentences: which controller is better, by how much, and whether the difference is significant.

MOST_OTHERS = 4  # Other metrics with a significant difference that a sentence names; the table has all of them


def headline(comparison: ComparisonResults, all_pairs: list[Pair], gains: str = "") -> tuple[str, str, list[str], list[str]]:
    """Verdict, look of its box (`good` where one controller beats all others, else `open`), sentences on the best, and on the other pairs.

    `gains`: those in which controllers differ and in nothing else.
    """
    if len(comparison.controllers) == 1:
        (one,) = comparison.controllers
        rate = one.rate
        interval = f"{100 * rate.mean:.0f} %, 95 % interval {100 * rate.low:.0f} to {100 * rate.high:.0f} %"
        return f"{one.label} reached the goal in {int(one.success.sum())} of {counted(rate.n, 'run')} ({interval}).", "open", [], []
    labels = [c.label for c in comparison.controllers]
    verdict, decided = _overall(labels, all_pairs)
    caution = []
    if gains:  # no controller is better than another for its gain
        verdict, decided = f"Only {gains} {'differ' if ' and ' in gains else 'differs'}. {verdict}", False
        caution = ["This compares settings of one law: a larger gain converges sooner by itself, until delay or limits stop it."]
    # all pairs of up to three controllers; of more controllers the pairs of the one that wins most often
    wins = _wins(labels, all_pairs)
    best = wins.index(max(wins))
    shown = all_pairs if len(all_pairs) <= 3 else [p for p in all_pairs if best in (p.a, p.b)][:MOST_CONTROLLERS]
    sentences = [*caution, *(pair_text(p, labels) for p in shown)]
    return verdict, "good" if decided else "open", sentences, [pair_text(p, labels) for p in all_pairs if p not in shown]


def _overall(labels: list[str], all_pairs: list[Pair]) -> tuple[str, bool]:
    """The sentence on all controllers, and whether one is better than every other."""
    if len(labels) == 2:
        return _of_two(labels, all_pairs[0])
    if len(labels) > MOST_CONTROLLERS:
        return _against_first(labels, all_pairs), False
    wins, others = _wins(labels, all_pairs), len(labels) - 1
    first = wins.index(max(wins))
    if wins[first] == others:  # by how much is said of the runner-up, the other with the most wins
        closest = max(against(all_pairs, first), key=lambda p: wins[p.b])
        n = {2: "two", 3: "three", 4: "four", 5: "five"}[others]
        words = f"{labels[first]} is better than each of the other {n}: than {labels[closest.b]}, it"
        return f"{words} {_advantages(closest.turned())}.", True
    if wins[first]:
        return _leading_group(labels, all_pairs, wins), False
    if any(p.is_real(SUCCESS) or p.is_real(TIME.name) for p in all_pairs):
        return "None of them is better: who reaches the goal more often does so later.", False
    what = "of success or of time" if any(map(_others, all_pairs)) else "between them"
    return f"No difference {what} that {counted(max(p.seeds for p in all_pairs), 'run')} each could show.", False


def _wins(labels: list[str], all_pairs: list[Pair]) -> list[int]:
    """How many other controllers each controller is better than."""
    return [sum(p.better == i for p in all_pairs) for i in range(len(labels))]


def _leading_group(labels: list[str], all_pairs: list[Pair], wins: list[int]) -> str:
    """The undefeated controllers, if each of them beats all the defeated ones."""
    defeated = {p.a + p.b - p.better for p in all_pairs if p.better is not None}  # a + b - better: the other one of the pair
    ahead = [i for i in range(len(labels)) if i not in defeated]
    if not ahead or any(wins[i] != len(labels) - len(ahead) for i in ahead):
        return "None of them is better than all the others."
    which = "neither" if len(ahead) == 2 else "none"
    seeds = max(p.seeds for p in all_pairs)
    return f"{listed([labels[i] for i in ahead])} are better than the rest; {counted(seeds, 'run')} each show {which} of them ahead."


def _of_two(labels: list[str], pair: Pair) -> tuple[str, bool]:
    if pair.better is None:
        if pair.is_real(SUCCESS) or pair.is_real(TIME.name):
            often = pair.b if pair.success.only_b > pair.success.only_a else pair.a
            other = pair.a + pair.b - often
            return f"{labels[often]} reaches the goal more often, {labels[other]} sooner.", False
        if others := [m.title.lower() for m in _others(pair)][:MOST_OTHERS]:
            words = f"Neither reaches the goal more often or sooner, as far as {counted(pair.seeds, 'run')} each could show"
            return f"{words}; they differ in {listed(others)}.", False
        return f"No difference between {labels[pair.a]} and {labels[pair.b]} that {counted(pair.seeds, 'run')} each could show.", False
    pair = pair if pair.better == pair.b else pair.turned()
    return f"{labels[pair.b]} is better than {labels[pair.a]}: it {_advantages(pair)}.", True


def _advantages(pair: Pair) -> str:
    """In what b is significantly better than a, and by how much."""
    time, advantages = pair.differences[TIME.name], []
    if pair.is_real(SUCCESS):
        advantages.append(f"reaches the goal on {pair.success.only_b - pair.success.only_a} more of {pair.seeds} seeds")
    if pair.is_real(TIME.name):
        advantages.append(f"converges {number(-time.mean)} s{_share(pair)} sooner")
    return " and ".join(advantages)


def _against_first(labels: list[str], all_pairs: list[Pair]) -> str:
    """Of very many controllers only the first is the reference: how many are better than it, how many worse."""
    better = [labels[p.b] for p in all_pairs if p.better == p.b]
    worse = sum(p.better == p.a for p in all_pairs)
    seeds = max(p.seeds for p in all_pairs)
    named = f" ({listed(better)})" if 0 < len(better) <= 4 else ""
    rest = len(all_pairs) - len(better) - worse
    counts = f"{len(better)} of {len(all_pairs)} are better{named}, {worse} worse"
    return f"Against {labels[0]}: {counts}; for {rest}, {counted(seeds, 'run')} each do not tell."


def pair_text(pair: Pair, labels: list[str]) -> str:
    """One pair in a few sentences: successes, times to converge on the seeds where both did, other significant differences."""
    s, n, a, b = pair.success, pair.seeds, labels[pair.a], labels[pair.b]
    of_a, of_b = s.both + s.only_a, s.both + s.only_b
    if n == 0:
        return f"{b} and {a} share no seed: they cannot be compared."
    if s.only_a == s.only_b == 0:
        every = "on the only seed" if n == 1 else f"on all {n} seeds"
        where = {0: "on no seed", n: every}.get(s.both, f"on the same {s.both} of {n} seeds")
        goal = f"{b} and {a} reached the goal {where}."
    else:
        p = p_text(pair.adjusted[SUCCESS, "difference"])
        proof = f"a real difference ({p})" if pair.is_real(SUCCESS) else f"no difference that {counted(n, 'run')} could show ({p})"
        goal = f"{b} reached the goal on {of_b} of {n} seeds, {a} on {of_a}: {proof}."
    named = [f"{m.title.lower()} ({_by_how_much(pair, m)})" for m in _others(pair)]
    more = f", and {len(named) - MOST_OTHERS} more" if len(named) > MOST_OTHERS else ""
    others = f"They really differ in {', '.join(named[:MOST_OTHERS])}{more}." if named else ""
    return " ".join(filter(None, (goal, _time_text(pair, a, b), others)))


def _time_text(pair: Pair, a: str, b: str) -> str:
    time = pair.differences[TIME.name]
    if time.n == 0:
        return "Never on the same seed, so that times cannot be compared." if pair.success.only_a and pair.success.only_b else ""
    if not math.isfinite(time.low):
        return f"{b} took {signed(time.mean)} s against {a} on the only seed that both did: one pair shows nothing."
    interval = (
        f"95 % interval {signed(time.low)} to {signed(time.high)} s, {time.n} seeds, {p_text(pair.adjusted[TIME.name, 'difference'])}"
    )
    if pair.is_real(TIME.name):
        way = "sooner" if time.mean < 0 else "later"
        return f"{b} converged {number(abs(time.mean))} s{_share(pair)} {way} than {a}, a real difference ({interval})."
    alone = " after correction for all tests" if time.real else ""
    return f"Their times to converge show no difference that {time.n} seeds could show (mean {signed(time.mean)} s, {interval}{alone})."


def _by_how_much(pair: Pair, metric: Metric) -> str:
    """The mean difference `+1.2 px`; where that is not significant, from how many of the starts b is better, or worse."""
    if pair.is_real(metric.name):
        return f"{signed(pair.differences[metric.name].mean)} {metric.unit}".strip()
    share = pair.improvements[metric.name].mean
    return f"{'better' if share > 0.5 else 'worse'} from {100 * max(share, 1 - share):.0f} % of the starts"


def _others(pair: Pair) -> list[Metric]:
    """The metrics other than time whose difference or improvement is significant."""
    return [
        Metric.named(name) for name in pair.differences if name != TIME.name and (pair.is_real(name) or pair.is_real(name, "improvement"))
    ]


def _share(pair: Pair) -> str:
    """The difference of times relative to the mean of a: ` (12 %)`."""
    mean, time = pair.means[TIME.name], pair.differences[TIME.name].mean
    return f" ({number(abs(100 * time / mean))} %)" if mean > 0 else ""


def p_text(p: float) -> str:
    """`p = 0.012`."""
    return "p < 0.001" if p < 1e-3 else f"p = {p:.2g}"


def listed(words: list[str]) -> str:
    """Words in a sentence: `a, b and c`."""
    # a label with commas (several varied fields) is bracketed, or one could not see where it ends
    quoted = words if not any("," in w for w in words) else [f"({w})" for w in words]
    return " and ".join(quoted) if len(quoted) < 3 else ", ".join(quoted[:-1]) + f" and {quoted[-1]}"


# Tables; `section.html` says what their numbers are. Medians and differences count the runs that reached the goal; interquartile means
# and improvements count every run.
NEVER: Final = "fails"  # stands for an infinite mean or end of an interval: so many runs failed


def sections(comparison: ComparisonResults, means: Means, all_pairs: list[Pair], every: bool = True) -> dict[str, Any]:
    """The tables of the page, with what their notes need to know; with `every` also the controllers' medians. means: `interquartiles`."""
    shown, controllers = comparison.shown, comparison.controllers
    medians = [[_name(c.label), rate_cell(c), *(_spread(c, m) for m in shown)] for c in controllers]
    middle = [[_name(c.label), *(_iqm(f[m.name], len(c.runs)) for m in shown)] for c, f in zip(controllers, means, strict=True)]
    labels, arrows = [m.label for m in shown], [f"{m.label} {'↑' if m.better > 0 else '↓'}" for m in shown]
    found: list[Section] = [("Controllers", [("", ["Controller", "Reached the goal", *labels], medians)])] if every else []
    found.append(("Interquartile means", [("", ["Controller", *arrows], middle)]))
    if len(controllers) > 1:
        differences = _against_each(comparison, all_pairs, lambda p: [_goals(p), *(_difference(p, m) for m in shown)])
        improvements = _against_each(comparison, all_pairs, lambda p: [_improvement(p, m) for m in shown])
        heads = ["Reached the goal", *labels]
        found.append(("Paired differences", [(name, [f"Against {name}", *heads], lines) for name, lines in differences]))
        found.append(("Probability of improvement", [(name, [f"Better than {name}", *arrows], lines) for name, lines in improvements]))
    return {
        "sections": found,
        "strata": any(any(c.tasks) for c in controllers),
        "of_any_run": ", ".join(m.title for m in shown if m.every_pair),  # metrics for which a failed run counts with its own number
        "tests": sum(not math.isnan(p) for pair in all_pairs for p in pair.tests.values()),  # over which the p-values are corrected
        "skewed": any(p.differences[m.name].skewed for p in all_pairs for m in shown),
    }


def _against_each(
    comparison: ComparisonResults, all_pairs: list[Pair], cells: Callable[[Pair], Sequence[Cell]]
) -> list[tuple[str, list[list[Cell]]]]:
    """For each reference controller (each of few, the first of many) its name, and a line for each of the others."""
    labels = [c.label for c in comparison.controllers]
    shown = labels if len(labels) <= MOST_CONTROLLERS else labels[:1]
    return [(name, [[_name(labels[p.b]), *cells(p)] for p in against(all_pairs, i)]) for i, name in enumerate(shown)]


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
    counts = (f"only this: {s.only_b}", f"only other: {s.only_a}", f"both: {s.both}", f"neither: {s.neither}")
    return more, signed(more), pair.is_real(SUCCESS), [_corrected(pair, SUCCESS), *counts]


def _difference(pair: Pair, metric: Metric) -> Cell:
    d = pair.differences[metric.name]
    # in two lines, since columns are narrow
    small = [f"[{signed(d.low)},", f"{signed(d.high)}]"] if math.isfinite(d.low) else ["no interval"]
    small += [_corrected(pair, metric.name)] if math.isfinite(d.p) else []
    small += [*_count(d.n, pair.success.both), *["skewed"] * d.skewed]
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
    p = pair.adjusted[name, of]
    return "no test" if math.isnan(p) else p_text(p)


# The statistics in a few lines for the terminal: success, interquartile mean, difference from the first controller.
MOST: Final = 12  # controllers that are listed


def statistics_text(folder: Path) -> str:
    """A line for each controller, of the first metric that is shown; "" for a single controller, or without a report."""
    if not (folder / f"{CONTROLLERS}.parquet").is_file():
        return ""
    every, pairs = (pl.read_parquet(folder / f"{name}.parquet") for name in (CONTROLLERS, PAIRS))
    if not len(pairs):
        return ""
    first = every.row(0, named=True)
    unit = f" [{first['unit']}]" if first["unit"] else ""
    lines = [("", "reached", f"{first['title'].lower()}{unit}, IQM", f"against {first['controller']}")]
    of = {(row["controller"], row["metric"]): row for row in pairs.filter(pl.col("against") == first["controller"]).rows(named=True)}
    for row in every.filter(pl.col("metric") == first["metric"]).rows(named=True):
        name, reached = row["controller"], f"{row['succeeded']} of {row['runs']}"
        found = of.get((name, first["metric"])), of.get((name, SUCCESS))
        lines.append((name, reached + _star(found[1]), _plain_mean(row), _plain_difference(found[0])))
    widths = [max(map(len, column)) for column in zip(*lines[: MOST + 1], strict=True)]
    text = ["  " + "  ".join(map(str.ljust, line, widths)).rstrip() for line in lines[: MOST + 1]]
    if (more := len(lines) - 1 - MOST) > 0:
        text.append(f"  and {more} more in report.html")
    if any(line.endswith("*") or "* " in line for line in text):
        text.append("  *: differs from the first, p <= 0.05 after Holm's correction")
    return "\n".join(text)


def _star(row: dict[str, Any] | None) -> str:
    return "*" if row and row["significant"] else ""


def _plain_mean(row: dict[str, Any]) -> str:
    if row["iqm"] is None:
        return "-"
    mean, low, high = (number(v) if v is not None and math.isfinite(v) else NEVER for v in (row["iqm"], row["iqm_low"], row["iqm_high"]))
    return mean if row["iqm_low"] is None else f"{mean} [{low}, {high}]"


def _plain_difference(row: dict[str, Any] | None) -> str:
    if row is None or row["difference"] is None:
        return ""
    interval = "" if row["low"] is None else f" [{signed(row['low'])}, {signed(row['high'])}]"
    # a hyphen: not every terminal has the minus sign
    return (signed(row["difference"]) + interval + _star(row)).replace("\N{MINUS SIGN}", "-")
