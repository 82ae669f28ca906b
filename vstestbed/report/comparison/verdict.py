"""Which of two controllers is better: the rule, from the successes and costs of both on common
starts.

In words: one is better than another if it reaches the goal more often; or if it costs less on
average (less time, a failure counted at its limit) and reaches the goal at most a margin less
often. Both must hold even if one more start had gone as badly as can be: the better one fails, the
other arrives. If one reaches the goal more often and the other costs less, it is a trade, and no
verdict. "Sooner" is a second word: who arrives first from more starts.

Everything is in closed form: the same numbers give the same digits on every machine. How often the
rule is wrong, and how often it decides, is in docs/results/verdicts.md;
`tests/long/test_verdicts.py` counts it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vstestbed.core.geometry import Array
from vstestbed.report.comparison.statistics import MeanEstimate, holm, rounding, sign_test

ALPHA = 0.05  # of all verdicts together, and of all words on who is sooner together
MARGIN = 0.1  # share of the starts by which a better one may reach the goal less often
FEWEST_UNLIKE = 6
"""Fewest starts with different outcomes of which the exact test can be under ALPHA: 2 / 2^6 is, 2 /
2^5 is not. A test that can call nothing real does not count among those for which the others are
corrected (Tarone 1990, doi:10.2307/2531456).
"""
MOST_STARTS = 100_000  # numbers of starts beyond this are not named
# periods by which two times may differ and be equal: one picture, and rounding
ONE_PICTURE = 1 + 1e-6

Side = Literal["a", "b"]
Decision = Literal["better", "trade", "none"]
_OTHER: dict[Side | None, Side | None] = {"a": "b", "b": "a", None: None}


class Starts(NamedTuple):
    """What two controllers did on their n common starts; less cost is better, and a failure has the
    cost `worst`, or its own.

    reached_a, reached_b: whether each reached the goal, (n,). cost_a, cost_b: (n,). worst: the
    greatest cost that a start can have.
    period: times that differ by no more are equal in the sign test. strata: a number for each
    start, those of one task the same.
    time_a, time_b: times to the goal, where these are not the cost.
    """

    reached_a: NDArray[np.bool_]
    reached_b: NDArray[np.bool_]
    cost_a: Array
    cost_b: Array
    worst: float
    period: float = 0.0
    strata: NDArray[np.intp] | None = None
    time_a: Array | None = None
    time_b: Array | None = None


class MeanOfStarts(NamedTuple):
    """Mean of n values, their variance within strata, and its degrees of freedom."""

    n: int
    mean: float
    variance: float
    free: float

    def negative(self) -> MeanOfStarts:
        """That of the values with the other sign."""
        return self._replace(mean=0.0 - self.mean)

    def times(self, factor: float) -> MeanOfStarts:
        """As many values like these by a factor."""
        n = round(self.n * factor)
        return self._replace(n=n, free=max(n - (self.n - self.free), 1))

    def with_imagined(self, value: float) -> MeanEstimate:
        """The mean with one more, imagined value x_0.

            mean_0 = (n mean + x_0) / (n + 1),
            s_0^2  = ((n - 1) s^2 + n / (n + 1) (x_0 - mean)^2) / n

        is the mean and the variance of n + 1 values where there is one stratum; its standard error
        is s_0 / sqrt(n + 1).
        """
        mean = (self.n * self.mean + value) / (self.n + 1)
        spread = (self.n - 1) * self.variance + self.n / (self.n + 1) * (value - self.mean) ** 2
        return MeanEstimate(mean, math.sqrt(spread / self.n / (self.n + 1)), self.free + 1)


def sample_of(values: ArrayLike, strata: NDArray[np.intp] | None = None) -> MeanOfStarts:
    """Mean and variance of values; with strata (tasks, each with starts of its own) the variance is
    that within them.

        s^2 = sum_k n_k s_k^2 / sum_k n_k,      n - K degrees of freedom

    Each start counts the same, so that a stratum weighs as it has starts. Strata of one start are
    taken together as one, whose variance is then too large rather than too small. Reference:
    Cochran 1977, Sampling techniques, sec. 5.3 and 5A.12.
    """
    x = np.asarray(values, dtype=float)
    groups = [x] if strata is None else _strata(x, strata)
    several = [group for group in groups if len(group) > 1]
    variance = math.nan
    if several:
        variance = sum(len(group) * group.var(ddof=1) for group in several) / sum(map(len, several))
    return MeanOfStarts(
        len(x), float(x.mean()) if len(x) else math.nan, float(variance), len(x) - len(groups)
    )


def _strata(x: Array, strata: NDArray[np.intp]) -> list[Array]:
    groups = [x[strata == number] for number in np.unique(strata)]
    alone = [group for group in groups if len(group) == 1]
    several = [group for group in groups if len(group) > 1]
    return [*several, np.concatenate(alone)] if alone else several


@dataclass(frozen=True)
class PairTest:
    """The tests of one pair, each by itself.

    With x = (b reached) - (a reached) and d = cost of a - cost of b, both with an imagined start in
    which b fails and a arrives at its usual cost w_a, the claim that b is better by its cost has

        p_b = P(t_n > min(T_m, T_t)),
        T_m = (mean(x_1, ..., x_n, -1) + m) sqrt(n + 1) / sd(x_1, ..., x_n, -1)
        T_t = mean(d_1, ..., d_n, w_a - worst) sqrt(n + 1) / sd(d_1, ..., d_n, w_a - worst)

    and that of a the same with a and b exchanged. The imagined start is what lets no failure among
    n starts mean a rate of up to 3 / n, and no more (Learned-Miller & Thomas 2019,
    arXiv:1905.06208, for bounds of means of this kind).
    """

    only_a: int  # starts from which only a, only b, both, neither reached the goal
    only_b: int
    both: int
    neither: int
    wins_a: int  # starts from which a, and from which b arrived first
    wins_b: int
    margin: float
    worst: float
    usual_a: float  # mean cost where a, and where b arrived; `worst` where none did
    usual_b: float
    reached: MeanOfStarts  # of x
    saved: MeanOfStarts  # of d

    @property
    def n(self) -> int:
        """Number of common starts."""
        return self.only_a + self.only_b + self.both + self.neither

    @property
    def p_success(self) -> float:
        """Of the exact test of success; NaN where it cannot be under ALPHA."""
        return _sign_test(self.only_a, self.only_b)

    @property
    def p_sooner(self) -> float:
        """Of the exact test that both arrive first equally often; NaN where it cannot be under
        ALPHA.
        """
        return _sign_test(self.wins_a, self.wins_b)

    @property
    def has_cost(self) -> bool:
        """Whether the cost can be tested: of two starts or more, and where any run has it."""
        return self.n >= 2 and math.isfinite(self.saved.mean)

    def p_cost(self, side: Side, starts: float = 1.0) -> float:
        """One-sided, that `side` is better by its cost; of so many times more starts like these.
        NaN where there is no test.
        """
        if side == "a":
            return self.turned().p_cost("b", starts)
        if not self.has_cost:
            return math.nan
        reached = self.reached.times(starts).with_imagined(-1.0)
        saved = self.saved.times(starts).with_imagined(self.usual_a - self.worst)
        return max(reached.p_over(-self.margin), saved.p_over(0.0))

    @property
    def cheaper(self) -> Side:
        """Who is better by its cost, if one is."""
        return "a" if self.p_cost("a") < self.p_cost("b") else "b"

    @property
    def p_either(self) -> float:
        """Two-sided, that one of both is better by its cost."""
        return min(1.0, 2 * min(self.p_cost("a"), self.p_cost("b"))) if self.has_cost else math.nan

    @property
    def seen(self) -> tuple[float, float]:
        """Both ends of the interval of the mean cost of b - a as flown: Student's."""
        if not self.has_cost:
            return math.nan, math.nan
        costs = self.saved.negative()
        return MeanEstimate(costs.mean, math.sqrt(costs.variance / costs.n), costs.free).interval()

    @property
    def unseen(self) -> tuple[float, float]:
        """Both ends of the interval of the mean cost of b - a with a failure not yet seen: of b at
        the upper end, of a at the lower.
        """
        if not self.has_cost:
            return math.nan, math.nan
        costs = self.saved.negative()
        low, _ = costs.with_imagined(self.usual_b - self.worst).interval()
        _, high = costs.with_imagined(self.worst - self.usual_a).interval()
        return low, high

    def points_less(self, side: Side) -> float:
        """By which share of the starts `side` may reach the goal less often: the far end of the
        two-sided interval.
        """
        reached = self.reached if side == "b" else self.reached.negative()
        low, _ = reached.with_imagined(-1.0).interval()
        return -low

    def turned(self) -> PairTest:
        """The same with a and b exchanged."""
        return replace(
            self,
            only_a=self.only_b,
            only_b=self.only_a,
            wins_a=self.wins_b,
            wins_b=self.wins_a,
            usual_a=self.usual_b,
            usual_b=self.usual_a,
            reached=self.reached.negative(),
            saved=self.saved.negative(),
        )

    def needs(self, others: int = 0) -> int | None:
        """How many starts like these would decide the pair, where so many tests of other pairs are
        open; None: more than MOST_STARTS.
        """
        if not self.has_cost:
            return None

        def decided(n: int) -> bool:
            factor = n / self.n
            cost = 2 * min(self.p_cost("a", factor), self.p_cost("b", factor))
            only_a, only_b = (round(count * factor) for count in (self.only_a, self.only_b))
            own = 2 if only_a + only_b >= FEWEST_UNLIKE else 1
            return min(cost, sign_test(only_a, only_b)) * (own + others) <= ALPHA

        return least(decided, self.n)


def _sign_test(one: int, other: int) -> float:
    """Of two counts; NaN where it cannot be under ALPHA."""
    return sign_test(one, other) if one + other >= FEWEST_UNLIKE else math.nan


def least(decided: Callable[[int], bool], n: int) -> int | None:
    """The least number of starts from n on with which `decided`, by doubling and bisection; None:
    more than MOST_STARTS.
    """
    low, high = n, n
    while not decided(high):
        if high >= MOST_STARTS:
            return None
        low, high = high, 2 * high
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if decided(middle) else (middle, high)
    return high


@dataclass(frozen=True)
class Verdict:
    """What the tests of all pairs together say of one pair."""

    decision: Decision
    better: Side | None  # who is better, None without a verdict
    by_success: bool  # whether success, and whether cost called one better
    by_cost: bool
    sooner: Side | None  # who arrives first from more starts
    p_success: float  # adjusted; that of success as it is where it is no test
    p_cost: float
    p_sooner: float
    # starts like these that would decide an open pair; None of a decided one, and where they are
    # too many
    needs: int | None

    def turned(self) -> Verdict:
        """The same with a and b exchanged."""
        return replace(self, better=_OTHER[self.better], sooner=_OTHER[self.sooner])


def test_of(starts: Starts, margin: float = MARGIN) -> PairTest:
    """The tests of one pair."""
    a, b = starts.reached_a, starts.reached_b
    saved = np.asarray(starts.cost_a - starts.cost_b, dtype=float)
    saved[np.abs(saved) <= rounding(starts.cost_a, starts.cost_b)] = 0.0
    # a than b
    later = saved
    if starts.time_a is not None and starts.time_b is not None:
        later = starts.time_a - starts.time_b
    tied = (~a & ~b) | (a & b & (np.abs(later) <= starts.period * ONE_PICTURE))
    first_b = ~tied & np.where(a == b, later > 0, b)
    return PairTest(
        only_a=int((a & ~b).sum()),
        only_b=int((~a & b).sum()),
        both=int((a & b).sum()),
        neither=int((~a & ~b).sum()),
        wins_a=int((~tied & ~first_b).sum()),
        wins_b=int(first_b.sum()),
        margin=margin,
        worst=starts.worst,
        usual_a=_usual(a, starts.cost_a, starts.worst),
        usual_b=_usual(b, starts.cost_b, starts.worst),
        reached=sample_of(b.astype(float) - a, starts.strata),
        saved=sample_of(saved, starts.strata),
    )


def _usual(reached: NDArray[np.bool_], cost: Array, worst: float) -> float:
    return float(cost[reached].mean()) if reached.any() else worst


def judge(tests: Sequence[PairTest]) -> list[Verdict]:
    """The verdicts on all pairs: Holm over the tests of success and of cost together, and over who
    is sooner.
    """
    n = len(tests)
    adjusted = holm([*(test.p_success for test in tests), *(test.p_either for test in tests)])
    sooner = holm([test.p_sooner for test in tests])
    still_open = _open(adjusted)
    return [
        _verdict(test, success, cost, first, still_open - _open([success, cost]))
        for test, success, cost, first in zip(
            tests, adjusted[:n], adjusted[n:], sooner, strict=True
        )
    ]


def _open(adjusted: Sequence[float]) -> int:
    """How many tests have decided nothing; NaN is no test."""
    return sum(p > ALPHA for p in adjusted)


def _called(p: float, side: Side) -> Side | None:
    """The side, where its test has decided."""
    return side if p <= ALPHA else None


def _side(a: int, b: int) -> Side:
    """The side with more."""
    return "b" if b > a else "a"


def _verdict(
    test: PairTest, success: float, cost: float, sooner: float, others_open: int
) -> Verdict:
    """The verdict on a pair by its adjusted p-values; others_open: tests of other pairs that have
    decided nothing.
    """
    more_often = _called(success, _side(test.only_a, test.only_b))
    cheaper = _called(cost, test.cheaper)
    decision: Decision = "better"
    better = more_often or cheaper
    if better is None:
        decision = "none"
    elif cheaper not in (None, better):
        decision = "trade"
        better = None
    return Verdict(
        decision,
        better,
        by_success=more_often is not None,
        by_cost=cheaper is not None,
        sooner=_called(sooner, _side(test.wins_a, test.wins_b)),
        p_success=sign_test(test.only_a, test.only_b) if math.isnan(success) else success,
        p_cost=cost,
        p_sooner=sign_test(test.wins_a, test.wins_b) if math.isnan(sooner) else sooner,
        needs=test.needs(others_open) if decision == "none" else None,
    )
