"""Statistics of many runs: published intervals, known effects, and how often two equal controllers
are told apart.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from tests.shortcuts import one_quick
from vstestbed.report.comparison.statistics import (
    holm,
    improvement,
    paired_difference,
    quartiles,
    sign_test,
    success_rate,
    wilson,
)

SEEDS = 20


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
        (29, 29, 0.8830, 1.0),
    ],
)
def test_wilson_intervals_are_those_of_newcombe_1998_table_1(
    successes: int, n: int, low: float, high: float
) -> None:
    rate = success_rate(successes, n)
    assert (rate.mean, rate.n) == (successes / n, n)
    assert (rate.low, rate.high) == pytest.approx((low, high), abs=6e-5)  # four digits are printed


def test_a_rate_of_nothing_says_nothing() -> None:
    rate = success_rate(0, 0)
    assert math.isnan(rate.mean) and (rate.low, rate.high, rate.n) == (0.0, 1.0, 0)


def test_quartiles_leave_out_what_is_unknown() -> None:
    assert quartiles([4.0, None, 1.0, math.nan, 2.0, 3.0, math.inf, 5.0]) == (2.0, 3.0, 4.0, 5)
    assert quartiles([7.0]) == (7.0, 7.0, 7.0, 1)
    assert quartiles([None, math.nan])[3] == 0 and math.isnan(quartiles([])[1])


def test_a_known_effect_is_recovered() -> None:
    """Two gains: time to converge goes with 1 / gain, so 10 s against 8 s; what a start costs is
    common to both.
    """
    rng = np.random.default_rng(1)
    start = rng.exponential(5.0, SEEDS)
    slow, fast = (10.0 + start + rng.normal(0, 0.5, SEEDS) for _ in range(2))
    found = paired_difference(slow, fast - 2.0)
    assert found.p <= 0.001 and found.low < 2.0 < found.high
    # 4 standard errors of 0.5 sqrt(2 / 20): the starts have fallen out
    assert found.high - found.low < 1.2
    assert (found.n, found.mean) == (SEEDS, pytest.approx(np.mean(slow - fast) + 2.0))


def equal_controllers(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Results of one controller, flown twice over the same 20 starts with other noise."""
    start = rng.uniform(0, 10, SEEDS)
    draw = {
        "normal": lambda: rng.normal(0, 1, SEEDS),
        "exponential": lambda: rng.exponential(1, SEEDS),
        "lognormal": lambda: rng.lognormal(0, 1, SEEDS),
        "student_2": lambda: rng.standard_t(2, SEEDS),
        "one_in_ten_wild": lambda: (
            rng.normal(0, 1, SEEDS) * np.where(rng.random(SEEDS) < 0.1, 10, 1)
        ),
    }[kind]
    return start + draw(), start + draw()


NULLS = {  # differences of mean zero: symmetric and skewed ones, heavy tails, ties
    "normal": lambda rng, n: rng.normal(0, 1, n),
    "uniform": lambda rng, n: rng.uniform(-1, 1, n),
    "student_2": lambda rng, n: rng.standard_t(2, n),
    "one_in_ten_wild": lambda rng, n: rng.normal(0, 1, n) * np.where(rng.random(n) < 0.1, 10, 1),
    "half_ties": lambda rng, n: np.where(rng.random(n) < 0.5, 0.0, rng.normal(0, 1, n)),
    "two_humps": lambda rng, n: rng.choice([-1.0, 1.0], n) + rng.normal(0, 0.2, n),
    "exponential": lambda rng, n: rng.exponential(1, n) - 1,
    "lognormal": lambda rng, n: rng.lognormal(0, 1, n) - math.exp(0.5),
}
# false alarms at n = 10, 20, 50; of others 5 %
SKEWED = {"exponential": (0.099, 0.079, 0.067), "lognormal": (0.162, 0.131, 0.102)}


def real(d: np.ndarray) -> bool:
    return paired_difference(d, np.zeros(len(d))).p <= 0.05


@pytest.mark.study
@pytest.mark.parametrize("kind", NULLS)
def test_false_alarms_power_and_coverage_are_those_of_the_page(kind: str) -> None:
    """docs/results/verdicts.md; 3 standard errors of 1000 comparisons of a 5 % test are 2.1 %."""
    rng = np.random.default_rng(77)
    for n, most in zip((10, 20, 50), SKEWED.get(kind, (0.05,) * 3), strict=True):
        draws = [NULLS[kind](rng, n) for _ in range(1000)]
        sigma = float(np.std(np.concatenate(draws)))
        covered = np.mean(
            [(e := paired_difference(d, np.zeros(n))).low <= 0 <= e.high for d in draws]
        )
        alarms, power = (np.mean([real(d + shift) for d in draws]) for shift in (0.0, sigma))
        print(f"{kind} | {n} | {100 * alarms:.1f} | {100 * power:.0f} | {100 * covered:.0f}")
        assert alarms <= most + 0.021
        assert kind == "student_2" or power > {10: 0.5, 20: 0.85, 50: 0.99}[n]


@pytest.mark.parametrize(
    "kind", one_quick("lognormal", "normal", "exponential", "student_2", "one_in_ten_wild")
)
def test_two_equal_controllers_come_out_as_no_difference(kind: str) -> None:
    """At most 17 false alarms of a 5 % test in 200 comparisons: 10 are expected, 17 is the 99 %
    point of that.
    """
    rng = np.random.default_rng(11)
    assert sum(real(np.subtract(*equal_controllers(kind, rng))) for _ in range(200)) <= 17


def test_test_and_interval_are_students() -> None:
    d = np.random.default_rng(8).normal(0.4, 1, 10)
    found, scipys = paired_difference(d, np.zeros(10)), stats.ttest_1samp(d, 0.0)
    assert found.p == pytest.approx(scipys.pvalue)
    assert (found.low, found.high) == pytest.approx(tuple(scipys.confidence_interval(0.95)))


def test_only_pairs_with_two_values_count() -> None:
    a = [5.0, None, 7.0, math.nan, 9.0, 8.0, 7.5, 6.0]
    b = [4.0, 1.0, None, math.nan, 7.0, 7.5, 6.0, math.inf]
    found = paired_difference(a, b)
    assert (found.n, found.mean) == (4, pytest.approx((1 + 2 + 0.5 + 1.5) / 4))
    assert found == paired_difference([5.0, 9.0, 8.0, 7.5], [4.0, 7.0, 7.5, 6.0])


def test_order_does_not_matter_and_the_sign_turns() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.lognormal(0, 1, (2, SEEDS))
    found, order = paired_difference(a, b), rng.permutation(SEEDS)
    # and again the same
    assert paired_difference(a[order], b[order]) == found == paired_difference(a, b)
    turned = paired_difference(b, a)
    assert (turned.mean, turned.low, turned.high) == pytest.approx(
        (-found.mean, -found.high, -found.low)
    )
    assert found.turned().turned() == found and found.turned().high == -found.low


@pytest.mark.parametrize("shift", [0.0, 0.1, -3.0])
def test_equal_differences_have_an_interval_of_one_point(shift: float) -> None:
    b = np.random.default_rng(0).uniform(1, 100, SEEDS)
    # 0.1 comes back with another rounding error from every pair
    found = paired_difference(b + shift, b)
    assert found.low == found.mean == found.high == pytest.approx(shift, abs=1e-12)
    assert found.p == (shift == 0)


def test_rounding_is_no_difference() -> None:
    b = np.random.default_rng(0).uniform(1, 100, SEEDS)
    # also as a closed loop has amplified it
    for same in (np.nextafter(b, np.inf), b * (1 + np.linspace(-1e-12, 2e-12, SEEDS))):
        found = paired_difference(same, b)
        assert (found.mean, found.low, found.high, found.p) == (0, 0, 0, 1)
    assert paired_difference(1e-14 * b, np.zeros(SEEDS)).mean == 0


def test_few_pairs() -> None:
    nothing, one = paired_difference([], []), paired_difference([3.0], [1.0])
    assert (nothing.n, one.n, one.mean) == (0, 1, 2.0)
    assert all(math.isnan(v) for v in (nothing.mean, one.low, one.high, one.p))
    for n in range(2, 9):
        found = paired_difference(np.arange(1.0, n + 1), np.zeros(n))
        assert found.p == pytest.approx(stats.ttest_1samp(np.arange(1.0, n + 1), 0.0).pvalue)


def test_one_pair_of_many_that_differs_is_no_real_difference() -> None:
    found = paired_difference([1.0] + [0.0] * 19, np.zeros(20))
    assert found.mean == 0.05 and found.p > 0.3 and found.low <= 0


def test_success_is_compared_on_the_seeds_where_two_controllers_disagree() -> None:
    # 0 or 1 of 7, or 6 or 7
    assert sign_test(6, 1) == sign_test(1, 6) == pytest.approx(2 * (1 + 7) / 2**7)
    assert sign_test(6, 1, "greater") == pytest.approx((1 + 7) / 2**7)
    assert sign_test(0, 0) == 1.0


def test_the_exact_test_of_success_never_alarms_too_often() -> None:
    """Over all ways in which 8 seeds can disagree: P(p < 0.05) is at most 5 %."""
    alarms = [
        sign_test(sum(split), 8 - sum(split)) < 0.05
        for split in itertools.product((False, True), repeat=8)
    ]
    assert 0 < np.mean(alarms) <= 0.05


def test_wilson_intervals_are_scipys() -> None:
    n, k = np.repeat([1, 7, 20, 400], 3), np.array([0, 1, 1, 0, 3, 7, 0, 19, 20, 0, 37, 400])
    low, high = wilson(k / n, n)
    scipys = [
        stats.binomtest(int(a), int(b)).proportion_ci(0.95, "wilson")
        for a, b in zip(k, n, strict=True)
    ]
    np.testing.assert_allclose(low, [i.low for i in scipys], atol=1e-12)
    np.testing.assert_allclose(high, [i.high for i in scipys], atol=1e-12)


def test_holm_rejects_what_its_steps_reject() -> None:
    """Step by step, as printed: from the smallest on, until one is over alpha over the number of
    those left.
    """
    rng = np.random.default_rng(0)
    for _ in range(50):
        p = rng.random(7) ** 3
        adjusted = np.array(holm(p.tolist()))
        for alpha in (0.01, 0.05, 0.3):
            rejected, left = set(), list(np.argsort(p))
            while left and p[left[0]] <= alpha / len(left):
                rejected.add(left.pop(0))
            assert rejected == set(np.flatnonzero(adjusted <= alpha))
    assert holm([0.01, 0.04, math.nan, 0.03])[:2] == pytest.approx([0.03, 0.06])
    assert math.isnan(holm([0.01, math.nan])[1])
    assert holm([]) == [] and holm([0.9, 0.8]) == [1.0, 1.0]


def test_the_probability_of_improvement_counts_seeds() -> None:
    a = [5.0, 5.0, math.inf, math.inf, 3.0, math.nan, 2.0, 1.0]
    b = [4.0, 5.0 + 1e-12, 9.0, math.inf, 4.0, 1.0, 1.0, 0.5]
    found = improvement(a, b)  # better, tied, better, tied, worse, unknown, better, better
    assert (found.mean, found.n) == (5 / 7, 7)
    assert found.p == stats.binomtest(4, 5).pvalue
    assert (found.low, found.high) == pytest.approx([float(end) for end in wilson(5 / 7, 7)])
    turned = improvement(b, a)
    assert (turned.mean, turned.low, turned.p) == pytest.approx(
        (1 - found.mean, 1 - found.high, found.p)
    )
    assert math.isnan(improvement([], []).mean) and improvement([1.0], [1.0]).p == 1.0


def test_the_sign_test_holds_for_skewed_times_and_holm_for_many() -> None:
    """Of ten equal controllers against one, in at most 17 of 200 comparisons any is called better:
    99 % point of 5 %.
    """
    rng, alarms = np.random.default_rng(4), 0
    for _ in range(200):
        times = rng.lognormal(0, 1, (11, SEEDS))
        alarms += min(holm([improvement(times[0], t).p for t in times[1:]])) <= 0.05
    assert alarms <= 17
