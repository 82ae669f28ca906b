"""The result of a comparison in sentences: which controller is better, by how much, and whether the difference is significant."""

from __future__ import annotations

import math
from html import escape

from vstestbed.report.comparison.columns import ComparisonResults, ControllerResults, Metric
from vstestbed.report.comparison.pairs import MOST_CONTROLLERS, SUCCESS, TIME, Pair, against
from vstestbed.report.comparison.statistics import success_rate
from vstestbed.report.run.numbers import number, plain

MOST_OTHERS = 4
"""Other metrics with a significant difference that a sentence names; the table has all of them."""
MOST_SENTENCES = 3
"""Up to this many pairs have their sentence in the box itself: those of three controllers."""


def headline(comparison: ComparisonResults, all_pairs: list[Pair], gains: str = "") -> str:
    """The result as a box, green where one controller is better than all others, with a sentence for each pair.

    Args:
        comparison: the runs. all_pairs: their paired differences.
        gains: the gains in which the controllers differ, where they differ in nothing else.
    """
    if len(comparison.controllers) == 1:
        return _box(_alone(comparison.controllers[0]), [], decided=False)
    labels = [c.label for c in comparison.controllers]
    verdict, decided = _overall(labels, all_pairs)
    caution = []
    if gains:  # no controller is better than another for its gain
        verdict, decided = f"Only {gains} {'differ' if ' and ' in gains else 'differs'}. {verdict}", False
        caution = ["This compares settings of one law: a larger gain converges sooner by itself, until delay or limits stop it."]
    shown = _pairs_in_the_box(labels, all_pairs)
    rest = "".join(f"<li>{escape(pair_text(p, labels))}</li>" for p in all_pairs if p not in shown)
    folded = f"<details><summary>The other pairs in words</summary><ul>{rest}</ul></details>" if rest else ""
    return _box(verdict, [*caution, *(pair_text(p, labels) for p in shown)], decided) + folded


def _pairs_in_the_box(labels: list[str], all_pairs: list[Pair]) -> list[Pair]:
    """All pairs of up to three controllers; of more controllers the pairs of the one that wins most often."""
    if len(all_pairs) <= MOST_SENTENCES:
        return all_pairs
    wins = _wins(labels, all_pairs)
    best = wins.index(max(wins))
    return [p for p in all_pairs if best in (p.a, p.b)][:MOST_CONTROLLERS]


def _box(verdict: str, sentences: list[str], decided: bool) -> str:
    listed = "".join(f"<li>{escape(s)}</li>" for s in sentences)
    below = f"<ul>{listed}</ul>" if listed else ""
    return f'<div class="outcome {"good" if decided else "open"}"><strong>{escape(verdict)}</strong>{below}</div>'


def _alone(controller: ControllerResults) -> str:
    rate = success_rate(int(controller.success.sum()), len(controller.success))
    interval = f"{100 * rate.rate:.0f} %, 95 % interval {100 * rate.low:.0f} to {100 * rate.high:.0f} %"
    return f"{controller.label} reached the goal in {rate.successes} of {runs(rate.n)} ({interval})."


def _overall(labels: list[str], all_pairs: list[Pair]) -> tuple[str, bool]:
    """The sentence on all controllers, and whether one is better than every other."""
    if len(labels) == 2:
        return _of_two(labels, all_pairs[0])
    if len(labels) > MOST_CONTROLLERS:
        return _against_first(labels, all_pairs), False
    wins = _wins(labels, all_pairs)
    if max(wins) == len(labels) - 1:
        return _best_of_all(labels, all_pairs, wins), True
    if max(wins) == 0:
        return _no_winner(all_pairs), False
    return _leading_group(labels, all_pairs, wins), False


def _wins(labels: list[str], all_pairs: list[Pair]) -> list[int]:
    """Number of other controllers that each controller is better than."""
    return [sum(p.better == i for p in all_pairs) for i in range(len(labels))]


def _best_of_all(labels: list[str], all_pairs: list[Pair], wins: list[int]) -> str:
    """One controller beats every other; by how much is said of the runner-up, the other with the most wins."""
    first = wins.index(max(wins))
    closest = max(against(all_pairs, first), key=lambda p: wins[p.b])
    words = f"{labels[first]} is better than each of the other {_count(len(labels) - 1)}: than {labels[closest.b]}, it"
    return f"{words} {_advantages(closest.turned())}."


def _no_winner(all_pairs: list[Pair]) -> str:
    """No controller is better than any other: either nothing is significant, or success and time contradict each other."""
    if any(p.is_real(SUCCESS) or p.is_real(TIME.name) for p in all_pairs):
        return "None of them is better: who reaches the goal more often does so later."
    what = "of success or of time" if any(map(_others, all_pairs)) else "between them"
    return f"No difference {what} that {runs(max(p.seeds for p in all_pairs))} each could show."


def _leading_group(labels: list[str], all_pairs: list[Pair], wins: list[int]) -> str:
    """The undefeated controllers, if each of them beats all the defeated ones."""
    ahead = _undefeated(labels, all_pairs)
    if not ahead or any(wins[i] != len(labels) - len(ahead) for i in ahead):
        return "None of them is better than all the others."
    which = "neither" if len(ahead) == 2 else "none"
    seeds = max(p.seeds for p in all_pairs)
    return f"{_list([labels[i] for i in ahead])} are better than the rest; {runs(seeds)} each show {which} of them ahead."


def _undefeated(labels: list[str], all_pairs: list[Pair]) -> list[int]:
    defeated = {p.a + p.b - p.better for p in all_pairs if p.better is not None}  # a + b - better: the other one of the pair
    return [i for i in range(len(labels)) if i not in defeated]


def _of_two(labels: list[str], pair: Pair) -> tuple[str, bool]:
    if pair.better is None:
        if pair.is_real(SUCCESS) or pair.is_real(TIME.name):
            often = pair.b if pair.success.only_b > pair.success.only_a else pair.a
            other = pair.a + pair.b - often
            return f"{labels[often]} reaches the goal more often, {labels[other]} sooner.", False
        if others := [m.title.lower() for m in _others(pair)][:MOST_OTHERS]:
            words = f"Neither reaches the goal more often or sooner, as far as {runs(pair.seeds)} each could show"
            return f"{words}; they differ in {_list(others)}.", False
        return f"No difference between {labels[pair.a]} and {labels[pair.b]} that {runs(pair.seeds)} each could show.", False
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
    named = f" ({_list(better)})" if 0 < len(better) <= 4 else ""
    rest = len(all_pairs) - len(better) - worse
    counts = f"{len(better)} of {len(all_pairs)} are better{named}, {worse} worse"
    return f"Against {labels[0]}: {counts}; for {rest}, {runs(seeds)} each do not tell."


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
        proof = f"a real difference ({p})" if pair.is_real(SUCCESS) else f"no difference that {runs(n)} could show ({p})"
        goal = f"{b} reached the goal on {of_b} of {n} seeds, {a} on {of_a}: {proof}."
    return " ".join(filter(None, (goal, _time_text(pair, a, b), _other_text(pair))))


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


def _other_text(pair: Pair) -> str:
    """The other metrics with a significant difference."""
    named = [f"{m.title.lower()} ({_by_how_much(pair, m)})" for m in _others(pair)]
    more = f", and {len(named) - MOST_OTHERS} more" if len(named) > MOST_OTHERS else ""
    return f"They really differ in {', '.join(named[:MOST_OTHERS])}{more}." if named else ""


def _by_how_much(pair: Pair, metric: Metric) -> str:
    """The mean difference `+1.2 px`; where that is not significant, from how many of the starts b is better, or worse."""
    if pair.is_real(metric.name):
        return f"{signed(pair.differences[metric.name].mean)} {metric.unit}".strip()
    share = pair.improvements[metric.name].share
    return f"{'better' if share > 0.5 else 'worse'} from {100 * max(share, 1 - share):.0f} % of the starts"


def _others(pair: Pair) -> list[Metric]:
    """The metrics other than time whose difference or improvement is significant."""
    return [Metric.of(name) for name in pair.differences if name != TIME.name and (pair.is_real(name) or pair.is_real(name, "improvement"))]


def _share(pair: Pair) -> str:
    """The difference of times relative to the mean of a: ` (12 %)`."""
    mean, time = pair.means[TIME.name], pair.differences[TIME.name].mean
    return f" ({number(abs(100 * time / mean))} %)" if mean > 0 else ""


def signed(value: float) -> str:
    """A difference with its sign and three significant figures."""
    return ("+" if value > 0 else "\N{MINUS SIGN}" if value < 0 else "") + plain(abs(value))


def runs(n: int) -> str:
    """`1 run`, `20 runs`."""
    return f"{n} run" if n == 1 else f"{n} runs"


def _count(n: int) -> str:
    return {2: "two", 3: "three", 4: "four", 5: "five"}.get(n, str(n))


def p_text(p: float) -> str:
    """`p = 0.012`."""
    return "p < 0.001" if p < 1e-3 else f"p = {p:.2g}"


def _list(words: list[str]) -> str:
    # a label with commas (several varied fields) is bracketed, or one could not see where it ends
    quoted = words if not any("," in w for w in words) else [f"({w})" for w in words]
    return " and ".join(quoted) if len(quoted) < 3 else ", ".join(quoted[:-1]) + f" and {quoted[-1]}"
