"""The rule of a verdict: its numbers in closed form, by scipy, by hand; its symmetries; and the
edges of its domain.

How often it is wrong is counted in `tests/long/test_verdicts.py`.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy import special, stats

from vstestbed.report.comparison import verdict as rule
from vstestbed.report.comparison.verdict import PairTest, Starts, holm, judge, sample_of, sign_test

LIMIT = 30.0


def starts(n: int, fails: tuple[float, float] = (0.0, 0.0), seed: int = 0, **fields: Any) -> Starts:
    """Two laws from n starts, of which a takes about 6 s and b 5 s."""
    rng = np.random.default_rng(seed)
    a, b = (rng.random(n) >= share for share in fails)
    difficulty = rng.uniform(-1, 1, n)
    time_a, time_b = (mean + difficulty + rng.normal(0, 0.7, n) for mean in (6.0, 5.0))
    return Starts(a, b, np.where(a, time_a, LIMIT), np.where(b, time_b, LIMIT), LIMIT)._replace(
        **fields
    )


def pair(
    n: int,
    fails: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
    margin: float = 0.1,
    **fields: Any,
) -> PairTest:
    return rule.test_of(starts(n, fails, seed, **fields), margin)


def turned(one: Starts) -> Starts:
    return one._replace(
        reached_a=one.reached_b, reached_b=one.reached_a, cost_a=one.cost_b, cost_b=one.cost_a
    )


def nothing_fails(
    n: int,
    gain: float = 1.0,
    sd: float = 1.0,
    limit: float = LIMIT,
    slower: float = 5.0,
    margin: float = 0.1,
) -> PairTest:
    """Starts whose gain has just this mean and standard deviation."""
    noise = np.arange(n) - (n - 1) / 2
    noise = noise / noise.std(ddof=1) if n > 1 else noise
    all_reached = np.ones(n, dtype=bool)
    quicker = np.asarray(slower - gain - sd * noise, dtype=float)
    return rule.test_of(
        Starts(all_reached, all_reached, np.full(n, slower), quicker, limit), margin
    )


def fewest(decided: Any) -> int:
    return next(n for n in range(2, 400) if decided(n))


def test_the_fewest_starts_are_those_of_the_closed_form() -> None:
    for laws, needed in ((2, 30), (3, 35), (6, 41), (12, 46), (24, 50)):
        pairs = laws * (laws - 1) // 2
        assert (
            fewest(
                lambda n, pairs=pairs: nothing_fails(n, sd=0, limit=5.1).p_either * pairs <= 0.05
            )
            == needed
        )
    for margin, needed in ((0.05, 60), (0.15, 20), (0.2, 15)):
        assert (
            fewest(
                lambda n, margin=margin: (
                    nothing_fails(n, sd=0, limit=5.1, margin=margin).p_either <= 0.05
                )
            )
            == needed
        )
    for gain, numbers in ((1.0, (30, 80, 169, 287)), (2.0, (30, 41, 85, 145))):
        for limit, needed in zip((12.0, 30.0, 60.0, 100.0), numbers, strict=True):
            assert (
                fewest(
                    lambda n, gain=gain, limit=limit: (
                        judge([nothing_fails(n, gain, limit=limit)])[0].better == "b"
                    )
                )
                == needed
            )


def test_an_open_pair_says_how_many_starts_like_these_it_needs() -> None:
    assert judge([nothing_fails(20)])[0].needs == 80
    assert judge([nothing_fails(79)])[0].needs == 80
    assert judge([nothing_fails(80)])[0].needs is None
    assert judge([nothing_fails(20, gain=1e-9)])[0].needs is None  # too many


def test_so_many_starts_decide_also_where_a_test_of_success_joins_that_of_time() -> None:
    """Of 20 starts 3 and 2 differ, too few for a test of success; of the starts that are needed
    there is one.
    """
    a, b = np.ones(20, dtype=bool), np.ones(20, dtype=bool)
    a[:2] = b[2:5] = False

    def decided(times: int) -> rule.Verdict:
        found = rule.test_of(
            Starts(
                *(
                    np.tile(x, times)
                    for x in (a, b, np.where(a, 5.0, 12.0), np.where(b, 5.0, 12.0))
                ),
                12.0,
            )
        )
        return judge([found])[0]

    needs = decided(1).needs
    assert needs is not None
    assert [decided(times).decision for times in (needs // 20 - 1, needs // 20 + 2)] == [
        "none",
        "better",
    ]


def test_the_sign_test_is_scipys() -> None:
    for one in range(12):
        for other in range(12):
            expected = stats.binomtest(one, one + other).pvalue if one + other else 1.0
            assert sign_test(one, other) == pytest.approx(expected, rel=1e-12)
    assert sign_test(90, 60) == pytest.approx(stats.binomtest(90, 150).pvalue, rel=1e-10)


def test_the_interval_as_flown_is_scipys() -> None:
    for seed in range(5):
        one = starts(25, (0.1, 0.2), seed)
        expected = stats.ttest_1samp(one.cost_b - one.cost_a, 0.0).confidence_interval(0.95)
        assert rule.test_of(one).seen == pytest.approx(tuple(expected), rel=1e-10)


def one_sided(values: list[float], bound: float) -> float:
    found: Any = stats.ttest_1samp(values, bound, alternative="greater")
    return found.pvalue


def test_the_imagined_start_is_a_start_more() -> None:
    """Its p-values and interval are scipy's of n + 1 values, the last of them written by hand."""
    for seed in range(8):
        one = starts(30, (0.1, 0.05), seed)
        test = rule.test_of(one)
        usual_a, usual_b = one.cost_a[one.reached_a].mean(), one.cost_b[one.reached_b].mean()
        x = one.reached_b.astype(float) - one.reached_a
        d = one.cost_a - one.cost_b
        for found, sign, other in (
            (test.p_cost("b"), 1.0, usual_a),
            (test.p_cost("a"), -1.0, usual_b),
        ):
            margin, time = (
                one_sided([*(sign * x), -1.0], -0.1),
                one_sided([*(sign * d), other - LIMIT], 0.0),
            )
            assert found == pytest.approx(max(margin, time), rel=1e-9)
        low = stats.ttest_1samp([*-d, usual_b - LIMIT], 0.0).confidence_interval().low
        high = stats.ttest_1samp([*-d, LIMIT - usual_a], 0.0).confidence_interval().high
        assert test.unseen == pytest.approx((low, high), rel=1e-10)
        assert test.unseen[0] < test.seen[0] and test.unseen[1] > test.seen[1]
        assert test.p_either == min(1, 2 * min(test.p_cost("a"), test.p_cost("b")))


def test_holm_is_its_steps_by_hand() -> None:
    # 3 x .01, 2 x .03, then not less than before
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.6]) == [1.0, 1.0]
    with_none = holm([math.nan, 0.02, 0.01])
    assert math.isnan(with_none[0]) and with_none[1:] == pytest.approx([0.02, 0.02])


def test_a_verdict_is_corrected_for_all_pairs() -> None:
    """30 starts without a failure decide alone, and not among three pairs."""
    clear = nothing_fails(30, sd=0, limit=5.1)
    assert judge([clear])[0].better == "b"
    assert [one.better for one in judge([clear] * 3)] == [None] * 3
    found = judge([clear, nothing_fails(80), pair(50, (0.9, 0.1))])
    tests = [clear, nothing_fails(80), pair(50, (0.9, 0.1))]
    by_hand = holm([*(t.p_success for t in tests), *(t.p_either for t in tests)])
    assert [one.p_cost for one in found] == by_hand[3:]


def test_who_is_named_first_changes_nothing() -> None:
    other = {"a": "b", "b": "a", None: None}
    for seed in range(60):
        one = starts(
            (5, 20, 60, 150)[seed % 4],
            ((0.0, 0.3, 0.6)[seed % 3], 0.05 * (seed % 7)),
            seed,
            period=0.04,
        )
        (forth,), (back,) = judge([rule.test_of(one)]), judge([rule.test_of(turned(one))])
        assert (back.decision, other[back.better], other[back.sooner]) == (
            forth.decision,
            forth.better,
            forth.sooner,
        )
        assert (back.p_success, back.p_cost) == pytest.approx(
            (forth.p_success, forth.p_cost), rel=1e-9
        )
        assert back.needs == forth.needs
        test, exchanged = rule.test_of(one), rule.test_of(turned(one))
        assert test.seen == pytest.approx(tuple(-end for end in exchanged.seen[::-1]), rel=1e-9)
        assert test.unseen == pytest.approx(tuple(-end for end in exchanged.unseen[::-1]), rel=1e-9)


def test_the_unit_of_the_cost_and_the_order_of_the_starts_change_nothing() -> None:
    for seed in range(10):
        one = starts(40, (0.1, 0.1), seed, period=0.04)
        order = np.random.default_rng(seed).permutation(40)
        in_ms = one._replace(
            cost_a=1000 * one.cost_a, cost_b=1000 * one.cost_b, worst=1000 * LIMIT, period=40.0
        )
        mixed = Starts(
            one.reached_a[order],
            one.reached_b[order],
            one.cost_a[order],
            one.cost_b[order],
            LIMIT,
            0.04,
        )
        expected = judge([rule.test_of(one)])[0]
        for other in (in_ms, mixed):
            found = judge([rule.test_of(other)])[0]
            assert (found.decision, found.better, found.sooner) == (
                expected.decision,
                expected.better,
                expected.sooner,
            )
            assert (found.p_success, found.p_cost, found.p_sooner) == pytest.approx(
                (expected.p_success, expected.p_cost, expected.p_sooner), rel=1e-9
            )


def test_success_comes_first_and_a_trade_is_none() -> None:
    often = pair(50, (0.8, 0.0))
    assert (often.only_a, often.only_b) == (0, 50 - often.both)
    found = judge([often])[0]
    assert (found.decision, found.better, found.by_success) == ("better", "b", True)
    # b fails in a tenth, and is 20 s quicker: both are beyond chance at 400 starts with a margin of
    # a half
    one = starts(400, (0.0, 0.1), 1)
    slow = one._replace(cost_a=one.cost_a + 20)
    trade = judge([rule.test_of(slow, 0.5)])[0]
    assert (trade.decision, trade.better, trade.by_success, trade.by_cost, trade.needs) == (
        "trade",
        None,
        True,
        True,
        None,
    )
    assert trade.sooner == "b"


def test_with_a_margin_of_nothing_time_alone_decides_nothing() -> None:
    assert judge([nothing_fails(100_000 // 300, gain=4.0, sd=0.1, margin=0.0)])[0].better is None
    assert judge([nothing_fails(300, gain=4.0, sd=0.1, margin=0.05)])[0].better == "b"


def test_the_limit_is_the_price_of_a_failure() -> None:
    """The same times under three limits: the longer it is, the wider what is not yet seen; as flown
    nothing changes.
    """
    tests = [nothing_fails(50, limit=limit) for limit in (12.0, 30.0, 60.0)]
    assert [judge([test])[0].better for test in tests] == ["b", None, None]
    widths = [test.unseen[1] - test.unseen[0] for test in tests]
    assert widths == sorted(widths)
    assert len({test.seen for test in tests}) == 1


def test_equal_values() -> None:
    """Nothing is left to chance in the values, and the imagined start alone decides."""
    reached = np.ones(40, dtype=bool)
    same = rule.test_of(Starts(reached, reached, np.full(40, 5.0), np.full(40, 5.0), 12.0))
    assert (same.p_either, same.wins_a, same.wins_b) == (1.0, 0, 0)
    assert same.seen == (0.0, 0.0) and same.unseen[0] < 0 < same.unseen[1]
    assert judge([same])[0].decision == "none"
    shifted = rule.test_of(Starts(reached, reached, np.full(40, 5.0), np.full(40, 4.0), 12.0))
    assert shifted.seen == (-1.0, -1.0) and judge([shifted])[0].better == "b"


def test_no_start_and_one_have_no_verdict() -> None:
    for n in (0, 1):
        test = pair(n)
        found = judge([test])[0]
        assert (test.n, found.decision, found.sooner, found.needs) == (n, "none", None, None)
        assert all(map(math.isnan, (*test.seen, *test.unseen, test.p_either)))


def test_where_none_arrives_there_is_no_verdict() -> None:
    test = pair(50, (1.0, 1.0))
    assert (test.neither, test.usual_a, test.usual_b, test.p_either) == (50, LIMIT, LIMIT, 1.0)
    assert judge([test])[0].decision == "none" and judge([test])[0].sooner is None


def test_five_starts_never_have_a_verdict() -> None:
    """Whatever their outcomes, with the margins up to .15; with .2 "all against none" is one, by
    time.
    """
    for n in range(2, 6):
        for only_a in range(n + 1):
            a = np.arange(n) < only_a
            for b in (~a, np.ones(n, dtype=bool), a):
                one = Starts(a, b, np.where(a, 11.9, 12.0), np.where(b, 0.1, 12.0), 12.0)
                for margin in (0.0, 0.1, 0.15):
                    assert judge([rule.test_of(one, margin)])[0].decision == "none", (
                        n,
                        only_a,
                        margin,
                    )
    none, every = np.zeros(5, dtype=bool), np.ones(5, dtype=bool)
    assert (
        judge([rule.test_of(Starts(none, every, np.full(5, 12.0), np.full(5, 1.0), 12.0), 0.2)])[
            0
        ].better
        == "b"
    )


def test_success_alone_takes_seven_starts_and_sooner_six() -> None:
    """Six against none are under 5 %, but in one family with the test of time they are not."""

    def of(n: int) -> rule.Verdict:
        none, every = np.zeros(n, dtype=bool), np.ones(n, dtype=bool)
        starts = Starts(none, every, np.full(n, 12.0), np.full(n, 1.0), 12.0)
        return judge([rule.test_of(starts)])[0]

    assert [of(n).better for n in (6, 7)] == [None, "b"]
    assert [judge([nothing_fails(n, sd=0)])[0].sooner for n in (5, 6)] == [None, "b"]


def test_times_within_a_picture_are_a_tie() -> None:
    reached = np.ones(6, dtype=bool)
    times = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    others = times + np.array([0.04, -0.04, 0.08, -0.08, 0.0, 0.12])
    test = rule.test_of(Starts(reached, reached, times, others, 12.0, period=0.04))
    assert (test.wins_a, test.wins_b) == (2, 1)
    late = np.array([True] * 5 + [False])  # whoever fails loses, and two that fail tie
    failed = rule.test_of(
        Starts(reached, late, times, np.where(late, times, 12.0), 12.0, period=0.04)
    )
    assert (failed.wins_a, failed.wins_b) == (1, 0)
    assert rule.test_of(Starts(~reached, ~reached, times, others, 12.0)).wins_b == 0


def test_the_variance_within_strata_is_that_of_the_mean_over_many_draws() -> None:
    """Tasks of 12, 6 and 2 starts with unequal means and spreads; 4 % is 3 standard errors of a
    variance of 20,000 draws, and the rest of the tolerance that of the mean variance.
    """
    rng = np.random.default_rng(5)
    strata = np.repeat([0, 1, 2], (12, 6, 2))
    means, sds = np.array([0.0, 5.0, -20.0])[strata], np.array([1.0, 3.0, 2.0])[strata]
    draws = means + sds * rng.normal(size=(20_000, 20))
    found = [sample_of(draw, strata) for draw in draws[:4000]]
    assert found[0].free == 17
    said = np.mean([one.variance for one in found]) / 20
    assert said == pytest.approx(draws.mean(axis=1).var(), rel=0.06)
    # as one stratum it has the means, too
    assert sample_of(draws[0]).variance > 5 * found[0].variance


def test_strata_of_one_start_are_together() -> None:
    x = np.array([1.0, 2.0, 4.0, 8.0])
    alone = sample_of(x, np.arange(4))
    assert (alone.variance, alone.free) == (pytest.approx(x.var(ddof=1)), 3)
    mixed = sample_of(x, np.array([0, 0, 1, 2]))
    assert (mixed.variance, mixed.free) == (pytest.approx((2 * 0.5 + 2 * 8.0) / 4), 2)
    assert sample_of(x, np.zeros(4, dtype=int)) == sample_of(x)


def size_of(n: int, margin: float, share: float) -> float:
    """Probability that the second law is crowned, which fails by the margin more often and is much
    quicker, from n starts.

    Exact, by all numbers of starts from which only one arrives. share: of the starts from which
    only the second does.
    """
    only_a, only_b = (
        counts.ravel() for counts in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij")
    )
    possible = only_a + only_b <= n
    only_a, only_b = only_a[possible], only_b[possible]
    unlike = only_a + only_b
    gained = (only_b - only_a) / n
    squares = unlike - n * gained**2 + n / (n + 1) * (-1 - gained) ** 2
    # where the second law never arrives, nothing is left to chance
    with np.errstate(divide="ignore"):
        t = ((n * gained - 1) / (n + 1) + margin) / np.sqrt(squares / n / (n + 1))
    by_time = 2 * special.stdtr(n, -t)
    by_success = np.where(
        unlike >= 6,
        np.minimum(1, 2 * special.bdtr(np.minimum(only_a, only_b), unlike, 0.5)),
        np.nan,
    )
    first, second = np.fmin(by_time, by_success), np.fmax(by_time, by_success)
    tests = np.where(unlike >= 6, 2, 1)
    time_decides = np.where(
        by_time == first, first * tests <= 0.05, (first * tests <= 0.05) & (second <= 0.05)
    )
    success_decides = np.where(
        by_success == first, first * tests <= 0.05, (first * tests <= 0.05) & (second <= 0.05)
    )
    crowned = (time_decides & ~(success_decides & (only_a > only_b))) | (
        success_decides & (only_b > only_a)
    )
    chances = (
        special.gammaln(n + 1)
        - special.gammaln(only_a + 1)
        - special.gammaln(only_b + 1)
        - special.gammaln(n - unlike + 1)
    )
    chances += (
        special.xlogy(only_a, share + margin)
        + special.xlogy(only_b, share)
        + special.xlogy(n - unlike, 1 - 2 * share - margin)
    )
    return float(np.exp(chances)[crowned].sum())


def test_a_law_that_is_worse_by_the_margin_is_crowned_in_at_most_5_percent_exactly() -> None:
    """Over all n to 200 the largest is .9^30 = 4.2 %,
    at 30 starts where the first law never fails.
    """
    numbers = (30, 31, 48, 64, 93, 150, 200)
    sizes = {
        (n, share): size_of(n, 0.1, share) for n in numbers for share in (0.0, 0.01, 0.05, 0.2, 0.4)
    }
    assert max(sizes.values()) == sizes[30, 0.0] == pytest.approx(0.9**30)
    assert max(size_of(n, 0.05, 0.0) for n in (60, 61, 95)) == pytest.approx(0.95**60)
    assert size_of(29, 0.1, 0.0) == 0.0


@pytest.mark.study
def test_the_exact_size_over_all_numbers_of_starts() -> None:
    shares = [*np.arange(0, 0.05, 0.005), *np.arange(0.05, 0.45, 0.05)]
    most = max(size_of(n, 0.1, share) for n in range(5, 201) for share in shares)
    assert most == pytest.approx(0.9**30)
