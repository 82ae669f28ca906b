"""Scores of a suite: successes, means and ranks with intervals, what is beyond chance, profiles,
the page.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from vstestbed.apps.suite.scores import TaskOfSuite, overall, profile, scores, write_scores
from vstestbed.tasks.metrics import Metric


def rows(times: dict[str, list[float]], limit: float = 20.0) -> pl.DataFrame:
    return pl.DataFrame(
        [
            {"task": "t", "law": law, "start": str(i), "success": value < limit, "value": value}
            for law, values in times.items()
            for i, value in enumerate(values)
        ]
    )


def test_scores_are_successes_restricted_means_and_ranks_with_intervals() -> None:
    rng = np.random.default_rng(1)
    hard = rng.uniform(0, 5, 40)  # how hard a start is, the same for all
    found = {
        s.law: s
        for s in scores(
            rows(
                {
                    "slow": list(6 + hard),
                    "fast": list(1 + hard),
                    "fails": [20.0] * 30 + list(1 + hard[30:]),
                }
            )
        )
    }
    assert [found[law].rate[:1] + found[law].rate[3:4] for law in found] == [
        (1.0, 40),
        (1.0, 40),
        (0.25, 40),
    ]
    low, high = found["fails"].rate[1:3]
    # Wilson's of 10 in 40
    assert low == pytest.approx(0.1419, abs=1e-3) and high == pytest.approx(0.4019, abs=1e-3)
    assert found["fast"].value.mean == pytest.approx(1 + hard.mean())
    se = hard.std() / np.sqrt(40)
    np.testing.assert_allclose(
        [found["fast"].value.low, found["fast"].value.high],
        1 + hard.mean() + np.array([-1.96, 1.96]) * se,
        atol=0.15,
    )
    # paired starts: 5 s between them are beyond doubt though times spread as much
    assert {law: s.rank[:3] for law, s in found.items()} == {
        "slow": (2, 2, 2),
        "fast": (1, 1, 1),
        "fails": (3, 3, 3),
    }
    stand = [
        (one.law, one.rank[:3], one.tasks, one.place, one.of)
        for one in overall(list(found.values()))
    ]
    assert stand == [
        ("fast", (1, 1, 1), 1, 1, 3),
        ("slow", (2, 2, 2), 1, 2, 3),
        ("fails", (3, 3, 3), 1, 3, 3),
    ]


def test_a_law_that_declines_tasks_is_placed_over_none_that_flew_them() -> None:
    """`easy` flies the one task in which it is the best; `wide` is the best of all in the other,
    and a little behind in that one.
    """
    first = rows({"wide": [2.0, 3, 4], "easy": [1.0, 2, 3], "slow": [8.0, 9, 10]})
    second = rows({"wide": [2.0, 3, 4], "slow": [8.0, 9, 10]}).with_columns(task=pl.lit("hard"))
    third = rows({"wide": [2.0, 3, 4], "odd": [1.0, 2, 3]}).with_columns(task=pl.lit("third"))
    found = overall(scores(pl.concat([first, second, third])))
    # before: easy (1.0 over 1 task) and odd (1.0 over 1) above wide (5/3 over 3)
    assert [one.law for one in found] == ["wide", "slow", "easy", "odd"]
    places = {one.law: (one.place, one.of) for one in found}
    assert places == {"wide": (1, 1), "slow": (2, 2), "easy": (1, 3), "odd": (1, 2)}


def test_no_place_is_claimed_over_a_law_that_flew_fewer_tasks() -> None:
    """For any laws and tasks: a place counts only laws that flew at least the same tasks, and fewer
    tasks never stand above more.
    """
    rng = np.random.default_rng(5)
    for _ in range(30):
        flown = {
            law: [task for task in "abcd" if rng.random() < 0.6] or ["a"]
            for law in ("p", "q", "r", "s")
        }
        tables = [
            rows(
                {law: list(rng.uniform(1, 9, 3)) for law in flown if task in flown[law]}
            ).with_columns(task=pl.lit(task))
            for task in "abcd"
            if any(task in own for own in flown.values())
        ]
        found = overall(scores(pl.concat(tables)))
        assert [one.tasks for one in found] == sorted((one.tasks for one in found), reverse=True)
        for one in found:
            assert (
                one.of
                == sum(set(flown[one.law]) <= set(other) for other in flown.values())
                >= one.place
                >= 1
            )


def test_a_run_that_crashed_counts_as_the_longest_and_a_start_that_is_missing_for_none() -> None:
    table = rows({"a": [2.0, 4.0, 6.0], "b": [3.0, 5.0, 20.0]})
    crashed = table.with_columns(
        pl.when((pl.col("law") == "a") & (pl.col("start") == "0"))
        .then(None)
        .otherwise("value")
        .alias("value")
    )
    assert [s.value.mean for s in scores(crashed)] == [10.0, pytest.approx(28 / 3)]
    missing = table.filter(~((pl.col("law") == "a") & (pl.col("start") == "2")))
    assert [s.value.mean for s in scores(missing)] == [3.0, 4.0]
    assert [s.rate.n for s in scores(missing)] == [2, 3]


def test_equal_laws_share_their_place_and_close_ones_have_the_ranks_that_tests_leave_open() -> None:
    """Six laws of one distribution, and one that is 5 s behind them all: resampled ranks of the six
    were 1 to 4, 2 to 6, ...
    """
    rng = np.random.default_rng(2)
    hard = rng.uniform(1, 9, 30)  # how hard a start is, the same for all
    laws = {f"p{i}": list(hard + rng.normal(0, 1, 30)) for i in range(5)}
    found = {
        s.law: s
        for s in scores(
            rows(laws | {"same": laws["p0"], "last": list(hard + 5 + rng.normal(0, 1, 30))}, 99)
        )
    }
    assert found["p0"].rank.mean == found["same"].rank.mean
    assert {s.rank[1:3] for law, s in found.items() if law != "last"} == {(1, 6)}
    assert found["last"].rank[:3] == (7, 7, 7)


@pytest.mark.study
def test_the_ranks_in_a_task_hold_all_true_ones_at_once() -> None:
    """Twelve laws a twentieth of their spread apart, of which resampled ranks held all in one of
    two flights.
    """
    rng, held, flights = np.random.default_rng(11), 0, 200
    for _ in range(flights):
        hard = rng.normal(20, 1, 20)
        table = rows(
            {f"law{i}": list(hard + 0.05 * i + rng.normal(0, 1, 20)) for i in range(12)}, 99
        )
        held += all(s.rank.low <= place <= s.rank.high for place, s in enumerate(scores(table), 1))
    # 95 %, less two standard deviations of the number of flights
    assert held >= 0.95 * flights - 2 * (0.95 * 0.05 * flights) ** 0.5


def tasks_of(*means: dict[str, float], starts: int = 30, spread: float = 0.3) -> pl.DataFrame:
    """Tasks `t0`, `t1`, ... in which laws have these means, with noise of their own."""
    rng = np.random.default_rng(7)
    tables = []
    for i, of_task in enumerate(means):
        table = rows(
            {law: list(mean + rng.normal(0, spread, starts)) for law, mean in of_task.items()}, 99
        )
        tables.append(table.with_columns(task=pl.lit(f"t{i}")))
    return pl.concat(tables)


def test_mean_ranks_have_an_interval_on_these_tasks_and_a_wider_one_on_tasks_like_these() -> None:
    """`odd` is 3 s before `even` in two tasks and behind it in two: from other starts nothing
    changes, of other tasks much would.
    """
    good, bad = {"odd": 2.0, "even": 5.0}, {"odd": 5.0, "even": 2.0}
    found = {one.law: one for one in overall(scores(tasks_of(good, bad, good, bad)))}
    assert found["odd"].rank[:3] == (1.5, 1.5, 1.5)
    assert found["odd"].alike[:3] == (1.5, 1.0, 2.0)
    (alone, _) = overall(scores(tasks_of(good)))
    # of one task nothing is known of others
    assert alone.rank[:3] == (1, 1, 1) and np.isnan(alone.alike[1:3]).all()


def test_a_mean_rank_is_among_the_laws_that_flew_all_its_tasks() -> None:
    """`guest` is the first of one task that all flew: the mean ranks of the others, who flew both,
    are without it.
    """
    both = {"a": 3.0, "b": 4.0}
    found = {one.law: one for one in overall(scores(tasks_of(both | {"guest": 1.0}, both)))}
    assert (found["a"].rank.mean, found["b"].rank.mean) == (1, 2)  # before: 1.5 and 2.5
    assert (found["guest"].rank.mean, found["guest"].of) == (1, 3)


def test_behind_beyond_chance_is_said_of_paired_starts_and_corrected_for_the_number_of_laws() -> (
    None
):
    rng = np.random.default_rng(3)
    hard, noise = rng.uniform(0, 5, 20), rng.normal(0, 0.5, (8, 20))
    laws = {
        "best": list(1 + hard),
        "worse": list(2 + hard + noise[0]),
        "close": list(1.01 + hard + noise[1]),
    }
    found = {s.law: s for s in scores(rows(laws))}
    assert {law: s.behind for law, s in found.items()} == {
        "best": False,
        "worse": True,
        "close": False,
    }
    assert found["best"].gap.mean == 0 and np.isnan(found["best"].gap.p)
    assert (
        found["worse"].gap.mean == pytest.approx(1 + noise[0].mean()) and found["worse"].gap.low > 0
    )
    many = scores(rows(laws | {f"c{i}": list(1.3 + hard + 2 * noise[2 + i % 6]) for i in range(6)}))
    of_more = next(s for s in many if s.law == "worse")
    assert of_more.gap.p > found["worse"].gap.p  # the same differences, of more tests


def test_a_profile_is_of_ratios_to_the_best_law_of_each_start() -> None:
    found = profile(rows({"a": [1.0, 4.0, 20.0], "b": [2.0, 2.0, 20.0]}))
    np.testing.assert_allclose(found["a"], [1, 2, np.inf])
    np.testing.assert_allclose(found["b"], [1, 2, np.inf])


def test_page_and_tables_name_units_blanks_and_chances(tmp_path: Path) -> None:
    table = rows({"slow": [6.0, 7, 8, 9, 10, 11, 12], "fast": [1.0, 2, 3, 4, 5, 6, 7]})
    without = {"odd": "it has no wheels"}
    tasks = {"t": TaskOfSuite(Metric.named("tracking_rms_m"), "to follow", without)}
    write_scores(
        tmp_path,
        table,
        tasks,
        "Suite X",
        "About it",
        "vstestbed suite",
    )
    text = (tmp_path / "report.html").read_text()
    assert all(
        words in text
        for words in (
            "Beyond chance",
            "1 of 1",
            "it has no wheels",
            "to follow",
            "Profile",
            "rank 1 (1 to 1)",
            "1.0 of 1 tasks",
            "[1.0, 1.0] on these",
        )
    )
    assert r"fast & 1.0 [1.0, 1.0] & 7/7, 4 m \\" in (tmp_path / "scores.tex").read_text()
    ranks = pl.read_csv(tmp_path / "ranks.csv")
    assert ranks.row(0) == ("fast", 1, 1, 2, 1.0, 1.0, 1.0, None, None)
    scored = pl.read_csv(tmp_path / "scores.csv")
    assert (
        scored["gap_mean"].to_list() == [5.0, 0.0]
        and scored["metric"][0] == "Camera from its goal, RMS [m]"
    )
