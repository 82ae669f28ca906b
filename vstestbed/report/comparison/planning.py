"""How many starts a comparison needs, before it is flown."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.core.quantity import PositiveTime, Time
from vstestbed.core.spec import spec
from vstestbed.report.comparison.verdict import (
    ALPHA,
    FEWEST_UNLIKE,
    MARGIN,
    Starts,
    least,
    sign_test,
    test_of,
)

# comparisons drawn for each number of starts; a power of 90 % is then known to 1.3 %
SIMULATED = 500
# usual time to the goal as a share of the limit, which should be 3 to 5 times that time
USUAL = 0.25
GAINS = (0.02, 0.05, 0.1, 0.2)  # gains in time that a plan shows, as shares of the limit


@spec
class ExpectedPair:
    """Two laws as they are expected to fly; the second is the quicker one.

    Args:
        gain: by which its mean time is less, where both arrive [s]; e.g. `1`.
        sd: standard deviation of the difference of both times from the same start [s]; e.g. `1`.
        limit: of each run, the price of a failure [s]; e.g. `30`.
        slower: mean time of the slower one where it arrives [s]; e.g. `5`.
        pairs: number of pairs in the comparison [1].
        rate: share of the starts from which each arrives; no start fails for both [1].
        power: share of such comparisons that are to be decided; counts where the rate is under 1
            [1].
        margin: of the comparison [1].
    """

    gain: PositiveTime
    sd: Time
    limit: PositiveTime
    slower: PositiveTime
    pairs: Annotated[int, Ge(1), Le(1_000_000)] = 1
    rate: Annotated[float, Ge(0.5), Le(1)] = 1.0
    power: Annotated[float, Ge(0.01), Le(0.99)] = 0.9
    margin: Annotated[float, Ge(0), Le(0.5)] = MARGIN

    def __post_init__(self) -> None:
        """Refuse times that no law can have."""
        if self.slower >= self.limit:
            raise ParameterError.bound(
                "slower",
                "under",
                f"limit = {self.limit:g} s",
                self.slower,
                why="a run ends at its limit",
            )
        if self.gain >= self.slower:
            raise ParameterError.bound(
                "gain",
                "under",
                f"slower = {self.slower:g} s",
                self.gain,
                why="the quicker one takes some time",
            )

    def starts(self) -> int | None:
        """The least number of starts; None: more than MOST_STARTS."""
        if self.rate == 1:
            return least(self.decided_by, 2)
        return least(lambda n: self.power_with(n) >= self.power, FEWEST_UNLIKE)

    def decided_by(self, n: int) -> bool:
        """Whether n starts have a verdict of which none fails, and whose mean gain and standard
        deviation are just these.
        """
        ranks = np.arange(n) - (n - 1) / 2
        return self._decided(np.full(n, 0.5), ranks / ranks.std(ddof=1))

    def power_with(self, n: int) -> float:
        """The share of SIMULATED comparisons of n starts in which the quicker one is better; the
        same in each call.
        """
        rng = np.random.default_rng(n)
        decided = [self._decided(rng.random(n), rng.standard_normal(n)) for _ in range(SIMULATED)]
        return float(np.mean(decided))

    def _decided(self, luck: Array, noise: Array) -> bool:
        """Whether the second is better from starts with this luck, in [0, 1], and this noise of the
        gain, as multiples of its sd.

        Each pair has a test of cost, and where enough starts differ one of success.
        """
        reached_a = luck >= 1 - self.rate
        reached_b = luck < self.rate
        time_a = np.where(reached_a, self.slower, self.limit)
        time_b = np.where(reached_b, self.slower - self.gain - self.sd * noise, self.limit)
        test = test_of(Starts(reached_a, reached_b, time_a, time_b, self.limit), self.margin)
        more_often = test.p_success if test.only_b > test.only_a else math.nan
        tests = self.pairs * (1 if math.isnan(test.p_success) else 2)
        return float(np.fmin(2 * test.p_cost("b"), more_often)) * tests <= ALPHA


def starts_needed(
    *,
    gain: float,
    sd: float,
    limit: float,
    slower: float,
    pairs: int = 1,
    rate: float = 1.0,
    power: float = 0.9,
    margin: float = MARGIN,
) -> int | None:
    """How many common starts a comparison of two laws needs until the quicker one is called better
    by its time.

    Where nothing fails it is the least n with

        2 pairs P(t_n > min(T_m, T_t)) <= 0.05

    of starts whose mean gain and standard deviation are just these (`PairTest` has T_m and T_t).
    About one half of such comparisons are decided, since chance adds to the gain or takes from it.
    Where runs fail, the rule is simulated with normal times, a fixed seed and SIMULATED comparisons
    for each n, until the share `power` of them is decided.

    Args:
        gain: by which the mean time of the quicker law is less, where both arrive [s].
        sd: standard deviation of the difference of both times from the same start [s].
        limit: of each run, the price of a failure [s].
        slower: mean time of the slower law where it arrives [s].
        pairs: number of pairs in the comparison; each counts as a test of its own.
        rate: share of the starts from which each law arrives, 0.5 to 1; no start fails for both.
            The more do, the fewer starts are needed.
        power: share of such comparisons that are to be decided, where the rate is under 1.
        margin: of the comparison.

    Returns:
        The number of starts; None: more than 100,000.

    Raises:
        ParameterError: a value is out of its range.

    Reference: Colas et al. 2018, How many random seeds?, arXiv:1806.08295, for the choice before
    flying.
    """
    expected = ExpectedPair(
        gain=gain,
        sd=sd,
        limit=limit,
        slower=slower,
        pairs=pairs,
        rate=rate,
        power=power,
        margin=margin,
    )
    return expected.starts()


def fewest(pairs: int, margin: float) -> tuple[int | None, int | None, int | None]:
    """The fewest starts that can decide one of so many pairs: by success alone, by who is sooner,
    and by time where nothing fails.
    """
    success, sooner = (
        least(lambda n, tests=tests: sign_test(n, 0) * tests <= ALPHA, 1)
        for tests in (2 * pairs, pairs)
    )
    # the margin alone is left to show
    sure = ExpectedPair(gain=1, sd=0, limit=2.1, slower=2, pairs=pairs, margin=margin)
    return success, sooner, sure.starts()


def plan_lines(
    laws: int, pairs: int, limit: float, starts: int | None, margin: float
) -> Iterator[str]:
    """What a comparison can decide, in lines.

    laws, pairs: their numbers. limit: of its runs, the least where they differ [s]. starts: that it
    plans; None: the nominal one alone.
    """
    yield (
        f"controllers {laws}, pairs {pairs}, limit {limit:g} s, margin {margin:g},"
        f" starts {starts or 1}"
    )
    if starts is None:
        yield "it flies the nominal start: never a verdict; --seeds N draws random starts"
    if not pairs:
        return
    success, sooner, by_time = fewest(pairs, margin)
    yield "the fewest starts for a verdict on a pair"
    yield f"  {success:>8}  by success alone: one reaches the goal from all, the other from none"
    yield f"  {by_time or 'never':>8}  by time, where no run fails"
    yield f"  {sooner:>8}  for a word on who is sooner, where one is from all"
    if by_time is not None:
        yield from _starts_by_gain(ExpectedGain(pairs, limit, margin), starts)


@dataclass(frozen=True)
class ExpectedGain:
    """A comparison in which no run fails, the slower law takes its usual time, and the gain varies
    by itself.
    """

    pairs: int
    limit: float  # of its runs [s]
    margin: float

    @property
    def usual(self) -> float:
        """The usual time to the goal [s]."""
        return USUAL * self.limit

    def of(self, share: float) -> ExpectedPair:
        """The pair whose mean gain is a share of the limit."""
        gain = share * self.limit
        return ExpectedPair(
            gain=gain,
            sd=gain,
            limit=self.limit,
            slower=self.usual,
            pairs=self.pairs,
            margin=self.margin,
        )


def _starts_by_gain(expected: ExpectedGain, starts: int | None) -> Iterator[str]:
    """How many starts which gain in time needs, and which gain the planned starts can call."""
    limit = expected.limit
    yield (
        f"starts by gain in time, where no run fails, the usual time is {expected.usual:g} s,"
        " and the gain varies by itself (sd)"
    )
    for share in GAINS:
        yield f"  {expected.of(share).starts() or 'over 100,000':>8}  {share * limit:.3g} s"
    if starts is None:
        return
    shares = (k / 1000 for k in range(1, 250))
    least_share = next((s for s in shares if expected.of(s).decided_by(starts)), None)
    if least_share is None:
        yield f"{starts} starts cannot decide by time"
    else:
        yield f"{starts} starts can call a gain of {least_share * limit:.3g} s or more"
