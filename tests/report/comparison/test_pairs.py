"""What a pair of controllers counts: limits, costs, tasks; which one the verdict names; the same
strings in every output.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.report.comparison.comparisons import build
from vstestbed.report.comparison.page import write_comparison_report
from vstestbed.report.comparison.pairs import pairs
from vstestbed.report.comparison.records import pair_records
from vstestbed.report.comparison.results import RESTRICTED, TIME, ComparisonResults
from vstestbed.report.comparison.sentences import censoring, findings
from vstestbed.report.comparison.tables import statistics_text

LIMIT_S = 30.0


def flown(
    a: list[float | None],
    b: list[float | None],
    limit: float = LIMIT_S,
    limit_b: float | None = None,
) -> ComparisonResults:
    """Two controllers, A and B, with these times to the goal; None is a run that failed at its
    limit.
    """
    limits = [limit] * len(a) + [limit_b or limit] * len(b)
    rows = {
        "scenario": ["A"] * len(a) + ["B"] * len(b),
        "seed": [*range(len(a)), *range(len(b))],
        "success": [time is not None for time in a + b],
        "time_to_converge_s": a + b,
        "time_to_goal_s": [
            most if time is None else time for time, most in zip(a + b, limits, strict=True)
        ],
        "limit_s": limits,
    }
    return ComparisonResults(pl.DataFrame(rows, strict=False), (), ("time_to_converge_s",))


def said(comparison: ComparisonResults) -> str:
    found = findings(comparison, pairs(comparison))
    return " ".join([found.overall, f"outcome {found.look}", *found.first, *found.others])


WAVE = [10 + 0.1 * math.sin(k) for k in range(50)]
"""Times of fifty starts [s]."""


def test_the_quicker_one_is_better_from_starts_enough_and_no_verdict_from_few() -> None:
    """It gains 5 of 25 s: a failure not yet seen would cost 25 s, so that some 30 starts are
    needed, and 29 cannot.
    """
    for n, decided in ((50, True), (30, True), (29, False), (20, False)):
        text = said(flown([*WAVE[:n]], [0.5 * t for t in WAVE[:n]]))
        assert ("B is better than A." in text) == ("outcome good" in text) == decided
        # what the verdict says is not said twice
        assert ("B arrives first from" in text) != decided
    assert (
        "B may fail up to 15 points more often (margin 10)."
        " About 30 starts like these would settle it." in text
    )
    assert "B is better" not in said(flown([0.5 * t for t in WAVE], [*WAVE]))


def test_five_starts_and_one_cannot_decide() -> None:
    assert "5 starts cannot decide." in said(flown([*WAVE[:5]], [0.1 * t for t in WAVE[:5]]))
    assert "One start cannot decide." in said(flown([5.0], [4.0]))
    (none,) = pairs(flown([None], [None]))
    assert none.better is None and none.verdict.needs is None


def test_just_over_the_margin_is_told_as_more_than_the_margin() -> None:
    text = said(flown([*WAVE[:29]], [t - 9 for t in WAVE[:29]]))
    assert "B may fail up to 11 points more often (margin 10)." in text


def test_one_pair_has_two_tests() -> None:
    """Six starts, from which B alone arrives: each test has a p of .03, and both together .06."""
    text = said(flown([None] * 6, WAVE[:6]))
    assert (
        "Alone the test of time would decide (p = 0.029);"
        " among all tests of the comparison it does not." in text
    )


def test_controllers_with_other_starts() -> None:
    rows = [
        (n, k, True, WAVE[k], 12.0)
        for n, most in (("a", 50), ("b", 20), ("c", 30))
        for k in range(most)
    ]
    frame = pl.DataFrame(
        rows, schema=["scenario", "seed", "success", "time_to_converge_s", "limit_s"], orient="row"
    )
    assert "No verdict: 20 to 30 starts show none of them better." in said(
        ComparisonResults(frame, (), ("time_to_converge_s",))
    )
    apart = frame.filter(
        (pl.col("scenario") == "a") & (pl.col("seed") < 5)
        | (pl.col("scenario") == "b") & (pl.col("seed") > 5)
    )
    assert "No verdict: they share no start." in said(
        ComparisonResults(apart, (), ("time_to_converge_s",))
    )


def test_no_difference_is_told_with_the_number_of_starts() -> None:
    rng = np.random.default_rng(1)
    a = rng.normal(10, 1, 20)
    text = said(flown(a.tolist(), (a + rng.permutation(np.tile([-0.5, 0.5], 10))).tolist()))
    assert "No verdict: 20 starts each show neither better." in text and "outcome open" in text
    assert "Such a difference in time can be chance." in text


def test_the_one_that_reaches_the_goal_more_often_is_better() -> None:
    text = said(flown([None] * 12 + [5.0] * 8, [5.0] * 20))
    assert (
        "B is better than A by its successes and time:"
        " B reached the goal from 20 of 20 starts, A from 8 (p under 0.001);" in text
    )
    assert "Caution: 12 of 20 runs of A failed and count with their limit of time" in text
    assert "no verdict" in said(flown([None, None, *[5.0] * 18], [5.0] * 20))


def test_more_often_against_quicker_is_a_trade() -> None:
    """Of 300 starts B loses 8, and gains 3 s from all others: within the margin it is better by its
    time, and A by its successes.
    """
    a = [10 + 0.1 * math.sin(k) for k in range(300)]
    b = [None if k % 40 == 0 else t - 3 for k, t in enumerate(a)]
    (pair,) = pairs(flown([*a], [*b], limit=12.0))
    assert pair.verdict.decision == "trade" and pair.better is None and pair.sooner == 1
    text = said(flown([*a], [*b], limit=12.0))
    assert (
        "are a trade, no verdict, since A reaches the goal more often and B is better in time"
        in text
        and "outcome open" in text
    )


def test_one_that_fails_more_often_is_never_better_for_its_time() -> None:
    """A reaches 50 of 50, B 33 and is 1 s faster where both arrive:
    A is better, by its successes.
    """
    b = [None if k % 3 == 0 else t - 1.0 for k, t in enumerate(WAVE)]
    (pair,) = pairs(flown([*WAVE], [*b]))
    assert b.count(None) == 17 and pair.better == 0
    # too few failures for a test of success, and a limit that hardly costs: B is sooner from most
    # starts, and still not better
    fast = [None if k < 5 else t - 3.0 for k, t in enumerate(WAVE)]
    (pair,) = pairs(flown([*WAVE], [*fast], limit=10.5))
    assert pair.sooner == 1 and pair.better is None


def test_time_outs_do_not_hide_a_slow_law() -> None:
    """A takes 2 s, B 2 to 26 s with a limit of 10 s: where both arrive B seems 4 s slower, up to
    the limit it is 6.7 s slower.
    """
    b = np.random.default_rng(3).uniform(2, 26, 60)
    comparison = flown(
        [2.0 + 0.01 * k for k in range(60)],
        [t if t <= 10 else None for t in b.tolist()],
        limit=10.0,
    )
    (pair,) = pairs(comparison)
    arrived, restricted = pair.differences[TIME.name].mean, pair.differences[RESTRICTED.name].mean
    assert (
        restricted == pytest.approx(np.mean(np.minimum(b, 10) - 2.295))
        and arrived < 0.7 * restricted
    )
    assert (
        any("failed and count with their limit" in words for words in censoring(comparison))
        and pair.better == 0
    )


def test_both_are_counted_up_to_the_earlier_limit() -> None:
    """A may fly 10 s, B 20 s: B's 15 s count as 10."""
    (pair,) = pairs(flown([None, 5.0], [15.0, 5.0], limit=10.0, limit_b=20.0))
    assert pair.differences[RESTRICTED.name].mean == 0.0 and pair.test.worst == 10.0


def test_an_arrival_after_the_limit_of_the_other_one_is_a_failure() -> None:
    """A may fly 60 s and needs 25; B may fly 20 s, and reaches the goal from every other start."""
    comparison = flown(
        [25.0] * 40, [18.0 if k % 2 else None for k in range(40)], limit=60.0, limit_b=20.0
    )
    (pair,) = pairs(comparison)
    assert (pair.test.only_a, pair.test.only_b, pair.better) == (0, 20, 1)
    assert "A from 0 (p under 0.001)" in said(
        comparison
    ) and "40 arrivals later than the other one may fly count as failures." in said(comparison)


def test_a_metric_that_no_run_has_decides_nothing() -> None:
    (pair,) = pairs(
        comparison := ComparisonResults(
            flown([*WAVE], [*WAVE]).table, (), (), primary="insertion_m"
        )
    )
    assert math.isnan(pair.test.p_either) and pair.verdict.decision == "none"
    assert "of B unknown. No run has a number for depth of the plug in its socket." in said(
        comparison
    )


def test_the_worst_of_a_metric_of_which_more_is_better_has_its_own_sign() -> None:
    margins = [40.0 - 0.1 * k for k in range(50)] + [-5.0 - 0.1 * k for k in range(50)]
    frame = flown([*WAVE], [*WAVE]).table.with_columns(min_border_margin_px=pl.Series(margins))
    comparison = ComparisonResults(frame, (), (), primary="min_border_margin_px")
    (pair,) = pairs(comparison)
    row = (
        pair_records(comparison, [pair], ["words"])
        .filter(metric="min_border_margin_px")
        .row(0, named=True)
    )
    assert pair.better == 0 and row["limit"] == pytest.approx(-9.9)
    assert (
        row["difference"] == pytest.approx(-45.0)
        and row["low"] <= row["seen_low"] <= -45.0 <= row["seen_high"] < row["high"] < 0
    )


def test_a_limit_prices_a_failure_that_nobody_has_seen() -> None:
    """The same times are a verdict with a limit of 12 s, and none with one of 100 s; a table that
    does not tell takes the failures'.
    """
    quicker = [t - 1 for t in WAVE]
    assert pairs(flown([*WAVE], [*quicker], limit=12.0))[0].better == 1
    (far,) = pairs(flown([*WAVE], [*quicker], limit=100.0))
    assert far.better is None and far.verdict.needs is not None and far.verdict.needs > 200
    old = flown([None, *WAVE[1:]], [*quicker], limit=77.0)
    (pair,) = pairs(ComparisonResults(old.table.drop("limit_s"), (), ("time_to_converge_s",)))
    assert pair.test.worst == 77.0


def test_a_primary_metric_of_ones_own_decides_and_the_others_are_exploratory() -> None:
    """A failure counts with the worst path of all; a start from which nobody fails costs what it
    shows.
    """
    frame = flown([5.0] * 50, [6.0] * 50).table.with_columns(
        path_ratio=pl.Series([1.5] * 50 + [1.1] * 50) + pl.col("seed") * 1e-3
    )
    comparison = ComparisonResults(frame, (), ("time_to_converge_s",), primary="path_ratio")
    (pair,) = pairs(comparison)
    assert pair.better == 1
    assert list(pair.exploratory) == [
        (TIME.name, "difference"),
        (TIME.name, "improvement"),
    ]
    assert pair.sooner == 0  # who arrives first is always told by the time
    records = pair_records(comparison, [pair], ["words"])
    assert records["role"].to_list() == ["primary", "primary", "exploratory"]
    assert set(records["better_one"]) == {"B"}
    failing = frame.with_columns(success=(pl.col("scenario") == "A") | (pl.col("seed") > 5))
    (pair,) = pairs(ComparisonResults(failing, (), (), primary="path_ratio"))
    assert pair.test.worst == pytest.approx(1.549)
    assert pair.differences["path_ratio"].mean == pytest.approx(-0.4 + (6 * 0.449 - 0.015) / 50)


def test_tasks_are_strata_so_that_their_means_do_not_count_as_spread() -> None:
    """Two tasks of 10 and 30 s, a gain of 3 and of 9 s: of the tasks together it spreads by 3 s,
    within each by nothing but noise.
    """
    noise = np.random.default_rng(5).normal(0, 0.1, 60)
    a = [10.0 if k < 30 else 30.0 for k in range(60)]
    b = [0.7 * t + e for t, e in zip(a, noise, strict=True)]
    plain = flown([*a], [*b], limit=60.0)
    tasks = plain.table.with_columns(
        task=pl.when(pl.col("seed") < 30).then(pl.lit("near")).otherwise(pl.lit("far"))
    )
    (one,), (two,) = pairs(plain), pairs(ComparisonResults(tasks, (), ("time_to_converge_s",)))
    assert one.test.saved.mean == pytest.approx(two.test.saved.mean)
    assert math.sqrt(one.test.saved.variance) > 3 and math.sqrt(two.test.saved.variance) < 0.12
    assert two.seeds == 60 and two.test.saved.free == 58
    as_flown = two.differences[RESTRICTED.name]
    # of one sample it is 1.6
    assert (
        as_flown.mean == one.differences[RESTRICTED.name].mean
        and as_flown.high - as_flown.low < 0.06
    )


def test_one_seed_and_one_controller_claim_nothing() -> None:
    rows = {"scenario": ["a"] * 20, "seed": range(20), "success": [True] * 18 + [False] * 2}
    assert "a reached the goal in 18 of 20 runs (90 %, 95 % interval 70 to 97 %)." in said(
        ComparisonResults(pl.DataFrame(rows))
    )


@pytest.mark.parametrize(
    ("times", "words"),
    [
        ((4, 5, 6), "a is better than all others."),
        ((5, 5, 5), "No verdict: 60 starts each show none of them better."),
        ((5, 5, 9), "The best is among a and b: each other one is beaten."),
        ((5, 9, 5), "The best is among a and c: each other one is beaten."),
    ],
)
def test_the_answer_for_many(times: tuple[int, ...], words: str) -> None:
    rows = [
        (n, k, True, t + 0.01 * math.sin(9 * k + t), 12.0)
        for n, t in zip("abcdefg", times, strict=False)
        for k in range(60)
    ]
    frame = pl.DataFrame(
        rows, schema=["scenario", "seed", "success", "time_to_converge_s", "limit_s"], orient="row"
    )
    found = findings(
        comparison := ComparisonResults(frame, (), ("time_to_converge_s",)), pairs(comparison)
    )
    assert found.overall == words and found.look == ("good" if "all others" in words else "open")


def test_against_a_reference() -> None:
    rows = [
        (n, k, True, t + 0.01 * math.sin(9 * k + t), 12.0)
        for n, t in zip("abcd", (4, 5, 6, 5), strict=True)
        for k in range(60)
    ]
    frame = pl.DataFrame(
        rows, schema=["scenario", "seed", "success", "time_to_converge_s", "limit_s"], orient="row"
    )
    comparison = ComparisonResults(frame, (), ("time_to_converge_s",), reference="b")
    assert (
        findings(comparison, pairs(comparison)).overall
        == "a is better than b; b is better than c. Of 1 other pair 60 starts each do not tell."
    )


GAINS = {"ibvs": 1.0, "pbvs": 1.1, "slow": 0.5}


@pytest.mark.parametrize(
    ("gains", "seeds", "failing"),
    [
        ({"ibvs": 1.0, "pbvs": 1.1}, 5, 0),
        ({"ibvs": 1.0, "pbvs": 1.1}, 20, 0),
        ({"ibvs": 1.0, "pbvs": 1.1}, 40, 0),
        (GAINS, 1, 0),
        (GAINS, 12, 6),
        (GAINS, 40, 12),
        (GAINS | {"fast, too": 1.5}, 10, 5),
        (GAINS | {"<b>&amp;": 1.5}, 40, 10),
        ({f"law_{k}": 0.5 + 0.1 * k for k in range(8)}, 12, 0),
        ({"percent_%_#": 0.9, "{braces}": 0.8, "under_score": 0.7}, 40, 4),
    ],
)
def test_every_output_prints_the_same_sentences(
    tmp_path: Path, gains: dict[str, float], seeds: int, failing: int
) -> None:
    """The sentences of `verdicts.json` stand as they are in page, Markdown, LaTeX and table; the
    terminal has those that it prints.

    A page escapes what labels have of HTML: its text is what is compared.
    """
    table = build(
        tmp_path,
        gains,
        seeds,
        {(next(reversed(gains)), seed): "timed_out" for seed in range(failing)},
    )
    write_comparison_report(
        tmp_path, ComparisonResults(table.with_columns(limit_s=pl.lit(10.0))), ""
    )
    found = json.loads((tmp_path / "verdicts.json").read_text())
    sentences = [pair["sentence"] for pair in found["pairs"]]
    assert len(sentences) == len(gains) * (len(gains) - 1) // 2
    assert len(set(sentences)) == len(sentences)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    text = page.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&")
    written = [
        text,
        *((tmp_path / name).read_text(encoding="utf-8") for name in ("tables.md", "tables.tex")),
    ]
    assert all(words in output for words in (found["overall"], *sentences) for output in written)
    for read in (pl.read_parquet(tmp_path / "pairs.parquet"), pl.read_csv(tmp_path / "pairs.csv")):
        assert read["sentence"].unique(maintain_order=True).to_list() == sentences
    terminal = statistics_text(tmp_path)
    decided = [
        pair["sentence"]
        for pair in found["pairs"]
        if pair["verdict"] != "none" or len(sentences) <= 3
    ]
    assert found["overall"] in terminal and all(words in terminal for words in decided[:12])
    best = (
        "is better than all others." in found["overall"]
        if len(gains) > 2
        else found["pairs"][0]["verdict"] == "better"
    )
    assert ('class="outcome good"' in page) == best
