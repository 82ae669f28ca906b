"""How many starts a comparison needs, before it is flown."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Final

import numpy as np
from annotated_types import Ge, Gt, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.spec import spec
from vstestbed.report.comparison.verdict import ALPHA, FEWEST_UNLIKE, MARGIN, PairTest, Sample, least, sign_test

SIMULATED: Final = 1000  # comparisons drawn for each number of starts; the power is then known to 1 %
USUAL: Final = 0.25  # usual time to the goal as a share of the limit, which should be 3 to 5 times that time
GAINS: Final = (0.02, 0.05, 0.1, 0.2)  # gains in time that a plan shows, as shares of the limit


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
        power: share of such comparisons that are to be decided; counts where the rate is under 1 [1].
        margin: of the comparison [1].
    """

    gain: Annotated[float, Gt(0), Le(1e6)]
    sd: Annotated[float, Ge(0), Le(1e6)]
    limit: Annotated[float, Gt(0), Le(1e6)]
    slower: Annotated[float, Gt(0), Le(1e6)]
    pairs: Annotated[int, Ge(1), Le(1_000_000)] = 1
    rate: Annotated[float, Ge(0.5), Le(1)] = 1.0
    power: Annotated[float, Ge(0.01), Le(0.99)] = 0.9
    margin: Annotated[float, Ge(0), Le(0.5)] = MARGIN

    def __post_init__(self) -> None:
        """Refuse times that no law can have."""
        if self.slower >= self.limit:
            raise ParameterError.bound("slower", "under", f"limit = {self.limit:g} s", self.slower, why="a run ends at its limit")
        if self.gain >= self.slower:
            raise ParameterError.bound("gain", "under", f"slower = {self.slower:g} s", self.gain, why="the quicker one takes some time")

    def starts(self) -> int | None:
        """The least number of starts; None: more than MOST_STARTS."""
        if self.rate == 1:
            return least(self.decided_by, 2)
        return least(lambda n: self.power_with(n) >= self.power, FEWEST_UNLIKE)

    def decided_by(self, n: int) -> bool:
        """Whether n starts like these, none of which fails, have a verdict."""
        nothing_failed, saved = Sample(n, 0.0, 0.0, n - 1), Sample(n, self.gain, self.sd**2, n - 1)
        return self._decided(self._test((0, 0, n), nothing_failed, saved))

    def power_with(self, n: int) -> float:
        """The share of SIMULATED comparisons of n starts in which the quicker one is better; the same in each call."""
        rng = np.random.default_rng(n)
        fails = 1 - self.rate
        only_a, only_b, _ = counts = rng.multinomial(n, (fails, fails, 1 - 2 * fails), SIMULATED).T
        more_often = (only_b - only_a) / n
        squares = only_a + only_b - n * more_often**2
        reached = map(Sample, [n] * SIMULATED, more_often.tolist(), (squares / (n - 1)).tolist(), [n - 1] * SIMULATED)
        tests = map(self._test, zip(*counts.tolist(), strict=True), reached, self._saved(rng, counts, n))
        return float(np.mean(list(map(self._decided, tests))))

    def _saved(self, rng: np.random.Generator, counts: np.ndarray, n: int) -> list[Sample]:
        """Drawn times that the quicker one saves; counts (3, draws): starts from which only the slower, only the quicker, both arrived.

        The mean and the sum of squares of normal values are drawn, and not each of them.
        """
        quicker = self.slower - self.gain
        centres = np.array([[self.slower - self.limit], [self.limit - quicker], [self.gain]])
        spreads = self.sd * np.sqrt([[0.5], [0.5], [1.0]])  # of one time, and of the difference of two
        means = centres + spreads * rng.standard_normal(counts.shape) / np.sqrt(np.maximum(counts, 1))
        inside = spreads**2 * rng.chisquare(np.maximum(counts - 1, 1)) * (counts > 1)
        mean = (counts * means).sum(axis=0) / n
        squares = (inside + counts * (means - mean) ** 2).sum(axis=0)
        return [Sample(n, one, variance, n - 1) for one, variance in zip(mean.tolist(), (squares / (n - 1)).tolist(), strict=True)]

    def _test(self, counts: Sequence[int], reached: Sample, saved: Sample) -> PairTest:
        only_a, only_b, both = counts
        usual = self.slower, self.slower - self.gain
        return PairTest(only_a, only_b, both, 0, 0, 0, self.margin, self.limit, *usual, reached, saved)

    def _decided(self, test: PairTest) -> bool:
        """Whether the second is better, with a test of cost for each pair, and one of success where starts differ enough."""
        cost = 2 * test.p_cost("b")
        success = test.p_success if test.only_b > test.only_a else math.nan
        tests = self.pairs if math.isnan(test.p_success) else 2 * self.pairs
        return np.fmin(cost, success) * tests <= ALPHA


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
    """How many common starts a comparison of two laws needs until the quicker one is called better by its time.

    Where nothing fails it is the least n with

        2 pairs P(t_n > min(T_m, T_t)) <= 0.05

    of starts whose mean gain and standard deviation are just these (`PairTest` has T_m and T_t). Such starts are decided in about one half
    of all comparisons where the imagined failure is what they lack, and chance adds to the gain or takes from it. Where runs fail, the
    rule is simulated with normal times, a fixed seed and SIMULATED comparisons for each n, until the share `power` of them is decided.

    Args:
        gain: by which the mean time of the quicker law is less, where both arrive [s].
        sd: standard deviation of the difference of both times from the same start [s].
        limit: of each run, the price of a failure [s].
        slower: mean time of the slower law where it arrives [s].
        pairs: number of pairs in the comparison; each counts as a test of its own.
        rate: share of the starts from which each law arrives, 0.5 to 1; no start fails for both. The more do, the fewer starts are needed.
        power: share of such comparisons that are to be decided, where the rate is under 1.
        margin: of the comparison.

    Returns:
        The number of starts; None: more than 100,000.

    Raises:
        ParameterError: a value is out of its range.

    Reference: Colas et al. 2018, How many random seeds?, arXiv:1806.08295, for the choice before flying.
    """
    expected = ExpectedPair(gain=gain, sd=sd, limit=limit, slower=slower, pairs=pairs, rate=rate, power=power, margin=margin)
    return expected.starts()


def fewest(pairs: int, margin: float) -> tuple[int, int, int | None]:
    """The fewest starts that can decide one of so many pairs: by success alone, by who is sooner, and by time where nothing fails."""
    success = least(lambda n: sign_test(n, 0) * 2 * pairs <= ALPHA, 1)
    sooner = least(lambda n: sign_test(n, 0) * pairs <= ALPHA, 1)
    sure = ExpectedPair(gain=1, sd=0, limit=2.1, slower=2, pairs=pairs, margin=margin)  # the margin alone is left to show
    return success or 0, sooner or 0, sure.starts()


def plan_lines(laws: int, pairs: int, limits: tuple[float, float], starts: int | None, margin: float) -> Iterator[str]:
    """What a comparison can decide, in lines.

    laws, pairs: their numbers. limits: the least and the greatest of its runs [s]. starts: that it plans; None: the nominal one alone.
    """
    low, high = limits
    limit = f"limit {low:g} s" if low == high else f"limits {low:g} to {high:g} s"
    yield f"controllers {laws}, pairs {pairs}, {limit}, margin {margin:g}, starts {starts or 1}"
    if starts is None:
        yield "it flies the nominal start: never a verdict; --seeds N draws random starts"
    if not pairs:
        return
    success, sooner, by_time = fewest(pairs, margin)
    yield "the fewest starts for a verdict on a pair"
    yield f"  {success:>8}  by success alone: one reaches the goal from all, the other from none"
    yield f"  {by_time or 'never':>8}  by time, where no run fails"
    yield f"  {sooner:>8}  for a word on who is sooner, where one is from all"
    if by_time is None:
        return
    yield f"starts by gain in time, where no run fails, the usual time is {USUAL * low:g} s, and the gain has itself as standard deviation"
    for share in GAINS:
        needed = _expected(share * low, low, pairs, margin).starts()
        yield f"  {needed or 'over 100,000':>8}  {share * low:.3g} s"
    if starts is not None:
        yield _least_gain(starts, low, pairs, margin)


def _expected(gain: float, limit: float, pairs: int, margin: float) -> ExpectedPair:
    return ExpectedPair(gain=gain, sd=gain, limit=limit, slower=USUAL * limit, pairs=pairs, margin=margin)


def _least_gain(starts: int, limit: float, pairs: int, margin: float) -> str:
    """The least gain that the planned starts can call, to a thousandth of the limit."""

    def called(thousandths: int) -> bool:
        gain = min(thousandths / 1000, 0.999 * USUAL) * limit
        return _expected(gain, limit, pairs, margin).decided_by(starts)

    if not called(1000):
        return f"{starts} starts cannot decide by time"
    return f"{starts} starts can call a gain of {(least(called, 1) or 0) * limit / 1000:.3g} s or more"
