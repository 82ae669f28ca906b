"""What a comparison has found, in sentences: made once, and printed as they are by terminal, page,
Markdown, LaTeX and JSON.

They have no character that one of these would have to escape: plain hyphens, and words for
relations.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from vstestbed.report.comparison.pairs import Pair
from vstestbed.report.comparison.results import CENSORED, RESTRICTED, ComparisonResults
from vstestbed.report.comparison.verdict import ALPHA, FEWEST_UNLIKE, MOST_STARTS, Side
from vstestbed.report.marks import counted, listed, signed
from vstestbed.tasks.metrics import Metric

# Controllers that win against some, and controllers that arrive first, that the overall sentence
# names
MOST_NAMED = 6
MOST_SHOWN = 6  # Pairs in words at the top of the page; the others can be unfolded


@dataclass(frozen=True)
class Findings:
    """The result of a comparison in words.

    overall: the verdict on all. look: of its box, `good` where one controller is better than all
    others. cautions: what limits it.
    sentences: one for each pair, in the order of the pairs. shown: which of them stand at the top
    of a page.
    """

    overall: str
    look: Literal["good", "open"] = "open"
    cautions: tuple[str, ...] = ()
    sentences: tuple[str, ...] = ()
    shown: tuple[int, ...] = ()

    @property
    def first(self) -> list[str]:
        """Cautions, and the sentences at the top of a page."""
        return [*self.cautions, *(self.sentences[i] for i in self.shown)]

    @property
    def others(self) -> list[str]:
        """The sentences on the other pairs."""
        return [words for i, words in enumerate(self.sentences) if i not in self.shown]


def findings(comparison: ComparisonResults, all_pairs: Sequence[Pair]) -> Findings:
    """The result in words; first that it is one of settings, where no search has found each law's
    values.
    """
    labels = comparison.labels
    if len(labels) == 1:
        return Findings(_alone(comparison))
    standing = _Standing(labels, list(all_pairs))
    overall, cautions = standing.overall(bool(comparison.reference)), censoring(comparison)
    if comparison.settings:
        overall = f"{comparison.settings} {overall}"
    shown = range(len(all_pairs))
    if len(all_pairs) > MOST_SHOWN // 2:
        most = max(standing.beaten, key=lambda i: len(standing.beaten[i]))
        shown = [i for i, p in enumerate(all_pairs) if most in (p.a, p.b)][:MOST_SHOWN]
    sentences = tuple(pair_text(pair, labels) for pair in all_pairs)
    return Findings(
        overall,
        "good" if standing.best is not None and not comparison.settings else "open",
        tuple(cautions),
        sentences,
        tuple(shown),
    )


def _alone(comparison: ComparisonResults) -> str:
    (one,) = comparison.controllers
    interval = (
        f"{100 * one.rate.mean:.0f} %,"
        f" 95 % interval {100 * one.rate.low:.0f} to {100 * one.rate.high:.0f} %"
    )
    return (
        f"{one.label} reached the goal in {int(one.success.sum())} of"
        f" {counted(one.rate.n, 'run')} ({interval})."
    )


class _Standing:
    """Who beats whom."""

    def __init__(self, labels: list[str], all_pairs: list[Pair]):
        self.labels, self.pairs = labels, all_pairs
        self.most = max((p.seeds for p in all_pairs), default=0)
        everybody = range(len(labels))
        # a + b - i: the other of the pair
        self.beaten = {i: [p.a + p.b - i for p in all_pairs if p.better == i] for i in everybody}
        self.losers = {i for those in self.beaten.values() for i in those}

    @property
    def best(self) -> int | None:
        """The one that beats all others; None without one."""
        return next(
            (i for i, those in self.beaten.items() if len(those) == len(self.labels) - 1), None
        )

    def overall(self, reference: bool) -> str:
        """All verdicts in one sentence, then who is sooner, then the trades."""
        words = [self._verdicts(reference), self._sooner(), self._trades()]
        return " ".join(filter(None, words))

    def _verdicts(self, reference: bool) -> str:
        if self.best is not None:
            others = "all others" if len(self.labels) > 2 else self._named(self.beaten[self.best])
            return f"{self.labels[self.best]} is better than {others}."
        if not self.losers:
            return self._undecided()
        if reference or len(self.pairs) < len(self.labels) * (len(self.labels) - 1) // 2:
            return self._against()
        unbeaten = [i for i in self.beaten if i not in self.losers]
        if not unbeaten:
            return "No verdict on the best: they beat each other in a circle."
        if len(unbeaten) == 1:
            return (
                f"The best is {self._named(unbeaten)}:"
                " each other one is beaten, though not each by it."
            )
        return f"The best is among {self._named(unbeaten)}: each other one is beaten."

    def _undecided(self) -> str:
        if self.most == 0:
            return "No verdict: they share no start."
        shown = "none of them" if len(self.labels) > 2 else "neither"
        return f"No verdict: {self._starts(f'show {shown} better', f'shows {shown} better')}."

    def _starts(self, several: str, one: str) -> str:
        """What the starts say: `50 starts each ...`, of pairs with different numbers of starts
        `20 to 50 starts ...`, `one start ...`.
        """
        if self.most == 1:
            return f"one start {one}"
        least = min(p.seeds for p in self.pairs)
        return (
            f"{self.most} starts each {several}"
            if least == self.most
            else f"{least} to {self.most} starts {several}"
        )

    def _against(self) -> str:
        """Where each is compared with a reference alone."""
        a = self.pairs[0].a
        better, worse = [p.b for p in self.pairs if p.better == p.b], self.beaten[a]
        words = (
            [
                f"{self._named(better)} {'is' if len(better) == 1 else 'are'} better"
                f" than {self.labels[a]}"
            ]
            if better
            else []
        )
        words += [f"{self.labels[a]} is better than {self._named(worse)}"] if worse else []
        left = len(self.pairs) - len(better) - len(worse)
        rest = (
            f" Of {counted(left, 'other pair')} {self._starts('do not tell', 'does not tell')}."
            if left
            else ""
        )
        return f"{'; '.join(words)}.{rest}"

    def _sooner(self) -> str:
        """Who arrives first from more starts than another, where the verdict does not say so
        already.
        """
        first: dict[int, list[int]] = {}
        for p in self.pairs:
            if p.sooner is not None and p.sooner != p.better:
                first.setdefault(p.sooner, []).append(p.a + p.b - p.sooner)
        words = [f"{self.labels[i]} than {self._named(those)}" for i, those in first.items()]
        more = f", and {len(words) - MOST_NAMED} more than some" if len(words) > MOST_NAMED else ""
        return (
            f"Sooner from more starts, which is no verdict: {'; '.join(words[:MOST_NAMED])}{more}."
            if words
            else ""
        )

    def _trades(self) -> str:
        traded = [
            f"{self.labels[p.a]} and {self.labels[p.b]}"
            for p in self.pairs
            if p.verdict.decision == "trade"
        ]
        return (
            f"A trade, one more often and the other at less cost: {'; '.join(traded[:MOST_NAMED])}."
            if traded
            else ""
        )

    def _named(self, those: Sequence[int]) -> str:
        more = [f"{len(those) - MOST_NAMED} more"] if len(those) > MOST_NAMED else []
        return listed([*(self.labels[i] for i in those[:MOST_NAMED]), *more])


def censoring(comparison: ComparisonResults) -> list[str]:
    """A warning for each controller whose mean time depends on the limit, because more than
    CENSORED of its runs failed.
    """
    if comparison.primary_metric != RESTRICTED:
        return []
    return [
        f"Caution: {int((~c.success).sum())} of {counted(len(c.success), 'run')} of {c.label}"
        " failed and count with their limit of time: its mean time depends on this limit."
        for c in comparison.controllers
        if c.censored > CENSORED
    ]


def pair_text(pair: Pair, labels: Sequence[str]) -> str:
    """One pair: the verdict, successes, the primary metric as flown and with failures not yet seen,
    what would settle it.
    """
    a, b = labels[pair.a], labels[pair.b]
    if pair.seeds == 0:
        return f"{b} and {a} share no seed: they cannot be compared."
    words = f"{_lead(pair, a, b)}: {_goals(pair, a, b)}; {_costs(pair, b)}"
    return " ".join(
        filter(None, (f"{words}.", _late(pair), _sooner(pair, labels), _why_open(pair, labels)))
    )


def _lead(pair: Pair, a: str, b: str) -> str:
    """`pbvs is better than ibvs by its time`."""
    verdict, cost = pair.verdict, short_title(pair.primary)
    if verdict.decision == "none":
        return f"{b} and {a}, no verdict"
    if verdict.decision == "trade":
        often, other = (b, a) if pair.test.only_b > pair.test.only_a else (a, b)
        return (
            f"{b} and {a} are a trade, no verdict,"
            f" since {often} reaches the goal more often and {other} is better in {cost}"
        )
    better, other = (b, a) if verdict.better == "b" else (a, b)
    by = listed(
        [
            name
            for name, called in (("successes", verdict.by_success), (cost, verdict.by_cost))
            if called
        ]
    )
    return f"{better} is better than {other} by its {by}"


def _goals(pair: Pair, a: str, b: str) -> str:
    t, n = pair.test, counted(pair.seeds, "start")
    if t.both == t.n:
        return f"both reached the goal from {'the same ' * (t.n > 1)}{n}"
    p = f" ({p_text(pair.verdict.p_success)})" if t.only_a + t.only_b else ""
    return f"{b} reached the goal from {t.both + t.only_b} of {n}, {a} from {t.both + t.only_a}{p}"


def short_title(metric: Metric) -> str:
    """The primary metric in a sentence."""
    return "time" if metric == RESTRICTED else metric.title[0].lower() + metric.title[1:]


def _costs(pair: Pair, b: str) -> str:
    """`mean time of pbvs -1.01 s [-1.16, -0.86] as flown, [-1.77,
    -0.22] with failures not yet seen (p = 0.006)`.
    """
    d = pair.differences[pair.primary.name]
    unit = f" {pair.primary.unit}" if pair.primary.unit and math.isfinite(d.mean) else ""
    seen = f" {bracket(d.low, d.high)} as flown" if math.isfinite(d.low) else ""
    low, high = pair.deciding
    unseen = f", {bracket(low, high)} with failures not yet seen" if math.isfinite(low) else ""
    p = f" ({p_text(pair.verdict.p_cost)})" if pair.verdict.by_cost else ""
    return f"mean {short_title(pair.primary)} of {b} {plain(d.mean)}{unit}{seen}{unseen}{p}"


def plain(value: float) -> str:
    """A signed number with a plain hyphen."""
    return signed(value).replace("\N{MINUS SIGN}", "-") if math.isfinite(value) else "unknown"


def bracket(low: float, high: float) -> str:
    """An interval: `[-1.16, -0.86]`."""
    return f"[{plain(low)}, {plain(high)}]"


def _late(pair: Pair) -> str:
    if not pair.late:
        return ""
    failures = "counts as a failure" if pair.late == 1 else "count as failures"
    return f"{counted(pair.late, 'arrival')} later than the other one may fly {failures}."


def _sooner(pair: Pair, labels: Sequence[str]) -> str:
    if pair.sooner is None or pair.sooner == pair.better:
        return ""
    wins = pair.test.wins_b if pair.sooner == pair.b else pair.test.wins_a
    return (
        f"{labels[pair.sooner]} arrives first from {wins} of {counted(pair.seeds, 'start')}"
        f" ({p_text(pair.verdict.p_sooner)})."
    )


def _why_open(pair: Pair, labels: Sequence[str]) -> str:
    """What keeps an open pair from a verdict, and how many starts would settle it."""
    if pair.verdict.decision != "none":
        return ""
    if pair.seeds < FEWEST_UNLIKE:
        return (
            f"{'One start' if pair.seeds == 1 else f'{pair.seeds} starts'} cannot"
            f" decide.{_needs(pair)}"
        )
    side = pair.test.cheaper
    return f"{_reason(pair, side, labels)}{_needs(pair)}"


def _reason(pair: Pair, side: Side, labels: Sequence[str]) -> str:
    """Which of both conditions the one that did better does not hold."""
    test, cost = pair.test, short_title(pair.primary)
    if not test.has_cost:
        return f"No run has a number for {cost}."
    saved = test.saved.mean if side == "b" else -test.saved.mean
    if saved <= 0 or not pair.differences[pair.primary.name].excludes_zero:
        return f"Such a difference in {cost} can be chance."
    less = test.points_less(side)
    if less > test.margin:
        name = labels[pair.a if side == "a" else pair.b]
        return (
            f"{name} may fail up to {math.ceil(100 * less)} points more often"
            f" (margin {100 * test.margin:g})."
        )
    if test.p_either > ALPHA:
        return "A failure not yet seen could cost more than is gained."
    return (
        f"Alone the test of {cost} would decide ({p_text(test.p_either)});"
        " among all tests of the comparison it does not."
    )


def _needs(pair: Pair) -> str:
    needs = pair.verdict.needs
    if not pair.test.has_cost:
        return ""
    if needs is None:
        return f" More than {MOST_STARTS} starts like these would be needed."
    return f" About {needs} starts like these would settle it."


def p_text(p: float) -> str:
    """`p = 0.012`."""
    return "no test" if math.isnan(p) else "p under 0.001" if p < 1e-3 else f"p = {p:.2g}"
