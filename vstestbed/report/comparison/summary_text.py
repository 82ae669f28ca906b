"""The answer in words: which controller is better, by how much, and whether that is more than chance."""

from __future__ import annotations

import math
from html import escape

from vstestbed.report.comparison.columns import ComparisonResults, ControllerResults, Metric
from vstestbed.report.comparison.pairs import MOST_CONTROLLERS, TIME, Pair, against
from vstestbed.report.comparison.statistics import success_rate
from vstestbed.report.run.numbers import number

MOST_OTHERS = 4
"""So many other numbers in which two controllers differ are named in the answer; the table has all."""


def headline(comparison: ComparisonResults, made: list[Pair]) -> str:
    """The answer in large letters, green where one controller is better than all others, with a sentence for each pair."""
    if len(comparison.controllers) == 1:
        return _box(_alone(comparison.controllers[0]), [], decided=False)
    labels = [c.label for c in comparison.controllers]
    strong, decided = _overall(labels, made)
    wins = [sum(p.better == i for p in made) for i in range(len(labels))]
    best = wins.index(max(wins))
    first = made if len(made) <= 3 else [p for p in made if best in (p.a, p.b)][:MOST_CONTROLLERS]
    rest = "".join(f"<li>{escape(pair_text(p, labels))}</li>" for p in made if p not in first)
    folded = f"<details><summary>The other pairs in words</summary><ul>{rest}</ul></details>" if rest else ""
    return _box(strong, [pair_text(p, labels) for p in first], decided) + folded


def _box(strong: str, sentences: list[str], decided: bool) -> str:
    listed = "".join(f"<li>{escape(s)}</li>" for s in sentences)
    below = f"<ul>{listed}</ul>" if listed else ""
    return f'<div class="outcome {"good" if decided else "open"}"><strong>{escape(strong)}</strong>{below}</div>'


def _alone(controller: ControllerResults) -> str:
    rate = success_rate(int(controller.success.sum()), len(controller.success))
    interval = f"{100 * rate.rate:.0f} %, 95 % interval {100 * rate.low:.0f} to {100 * rate.high:.0f} %"
    return f"{controller.label} reached the goal in {rate.successes} of {runs(rate.n)} ({interval})."


def _overall(labels: list[str], made: list[Pair]) -> tuple[str, bool]:
    """The sentence for all, and whether one controller is better than every other."""
    if len(labels) == 2:
        return _of_two(labels, made[0])
    if len(labels) > MOST_CONTROLLERS:
        return _against_first(labels, made), False
    seeds = max(p.seeds for p in made)
    beaten = {p.a + p.b - p.better for p in made if p.better is not None}
    wins = [sum(p.better == i for p in made) for i in range(len(labels))]
    if max(wins) == len(labels) - 1:
        first = wins.index(max(wins))
        closest = max(against(made, first), key=lambda p: wins[p.b])
        words = f"{labels[first]} is better than each of the other {_count(len(labels) - 1)}: than {labels[closest.b]}, it"
        return f"{words} {_ways(closest.turned())}.", True
    if max(wins) == 0:
        real = any(p.success_is_real or p.differences[TIME.name].real for p in made)
        if real:
            return "None of them is better: who reaches the goal more often does so later.", False
        what = "of success or of time" if any(map(_others, made)) else "between them"
        return f"No difference {what} that {runs(seeds)} each could show.", False
    ahead = [i for i in range(len(labels)) if i not in beaten]
    if ahead and all(wins[i] == len(labels) - len(ahead) for i in ahead):
        words = f"{_list([labels[i] for i in ahead])} are better than the rest; {runs(seeds)} each show neither of them ahead."
        return words.replace("neither", "neither" if len(ahead) == 2 else "none"), False
    return "None of them is better than all the others.", False


def _of_two(labels: list[str], pair: Pair) -> tuple[str, bool]:
    if pair.better is None:
        if pair.success_is_real or pair.differences[TIME.name].real:
            often = pair.b if pair.success.only_b > pair.success.only_a else pair.a
            other = pair.a + pair.b - often
            return f"{labels[often]} reaches the goal more often, {labels[other]} sooner.", False
        if others := [m.title.lower() for m in _others(pair)][:MOST_OTHERS]:
            words = f"Neither reaches the goal more often or sooner, as far as {runs(pair.seeds)} each could show"
            return f"{words}; they differ in {_list(others)}.", False
        return f"No difference between {labels[pair.a]} and {labels[pair.b]} that {runs(pair.seeds)} each could show.", False
    pair = pair if pair.better == pair.b else pair.turned()
    return f"{labels[pair.b]} is better than {labels[pair.a]}: it {_ways(pair)}.", True


def _ways(pair: Pair) -> str:
    """In what b is better than a, and by how much."""
    time, ways = pair.differences[TIME.name], []
    if pair.success_is_real:
        ways.append(f"reaches the goal on {pair.success.only_b - pair.success.only_a} more of {pair.seeds} seeds")
    if time.real:
        ways.append(f"converges {number(-time.mean)} s{_share(pair)} sooner")
    return " and ".join(ways)


def _against_first(labels: list[str], made: list[Pair]) -> str:
    better = [labels[p.b] for p in made if p.better == p.b]
    worse = sum(p.better == p.a for p in made)
    seeds = max(p.seeds for p in made)
    named = f" ({_list(better)})" if 0 < len(better) <= 4 else ""
    rest = len(made) - len(better) - worse
    return (
        f"Against {labels[0]}: {len(better)} of {len(made)} are better{named}, {worse} worse; for {rest}, {runs(seeds)} each do not tell."
    )


def pair_text(pair: Pair, labels: list[str]) -> str:
    """One pair in a sentence or two: how often each reached the goal, and how long it took where both did."""
    s, n, a, b = pair.success, pair.seeds, labels[pair.a], labels[pair.b]
    of_a, of_b = s.both + s.only_a, s.both + s.only_b
    if n == 0:
        return f"{b} and {a} share no seed: they cannot be compared."
    if s.only_a == s.only_b == 0:
        every = "on the only seed" if n == 1 else f"on all {n} seeds"
        where = {0: "on no seed", n: every}.get(s.both, f"on the same {s.both} of {n} seeds")
        goal = f"{b} and {a} reached the goal {where}."
    else:
        proof = f"a real difference ({_p(s.p)})" if pair.success_is_real else f"no difference that {runs(n)} could show ({_p(s.p)})"
        goal = f"{b} reached the goal on {of_b} of {n} seeds, {a} on {of_a}: {proof}."
    return " ".join(filter(None, (goal, _time_words(pair, a, b), _other_words(pair))))


def _time_words(pair: Pair, a: str, b: str) -> str:
    time = pair.differences[TIME.name]
    if time.n == 0:
        return "Never on the same seed, so that times cannot be compared." if pair.success.only_a and pair.success.only_b else ""
    if not math.isfinite(time.low):
        return f"{b} took {signed(time.mean)} s against {a} on the only seed that both did: one pair shows nothing."
    interval = f"95 % interval {signed(time.low)} to {signed(time.high)} s, {time.n} seeds"
    if time.real:
        way = "sooner" if time.mean < 0 else "later"
        return f"{b} converged {number(abs(time.mean))} s{_share(pair)} {way} than {a}, a real difference ({interval})."
    return f"Their times to converge show no difference that {time.n} seeds could show (mean {signed(time.mean)} s, {interval})."


def _other_words(pair: Pair) -> str:
    """In what else they differ."""
    told = [f"{m.title.lower()} ({f'{signed(pair.differences[m.name].mean)} {m.unit}'.strip()})" for m in _others(pair)]
    more = f", and {len(told) - MOST_OTHERS} more" if len(told) > MOST_OTHERS else ""
    return f"They really differ in {', '.join(told[:MOST_OTHERS])}{more}." if told else ""


def _others(pair: Pair) -> list[Metric]:
    """The metrics but time in which the two really differ."""
    return [Metric.of(name) for name, d in pair.differences.items() if d.real and name != TIME.name]


def _share(pair: Pair) -> str:
    """The difference of times as a share of the reference's mean: ` (12 %)`."""
    mean, time = pair.means[TIME.name], pair.differences[TIME.name].mean
    return f" ({number(abs(100 * time / mean))} %)" if mean > 0 else ""


def signed(value: float) -> str:
    """A difference with its sign and three significant figures."""
    return ("+" if value > 0 else "\N{MINUS SIGN}" if value < 0 else "") + number(abs(value)).replace("<sup>", "^").replace("</sup>", "")


def runs(n: int) -> str:
    """`1 run`, `20 runs`."""
    return f"{n} run" if n == 1 else f"{n} runs"


def _count(n: int) -> str:
    return {2: "two", 3: "three", 4: "four", 5: "five"}.get(n, str(n))


def _p(p: float) -> str:
    return "p < 0.001" if p < 1e-3 else f"p = {p:.2g}"


def _list(words: list[str]) -> str:
    quoted = words if not any("," in w for w in words) else [f"({w})" for w in words]
    return " and ".join(quoted) if len(quoted) < 3 else ", ".join(quoted[:-1]) + f" and {quoted[-1]}"
