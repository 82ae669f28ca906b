"""The grid of effects and controllers: its cells, its changes, and the comparisons of which there
is none.
"""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from matplotlib.text import Text

from vstestbed.report.comparison.figures import Data
from vstestbed.report.comparison.grid import Grid, grid, real
from vstestbed.report.comparison.results import TIME, ComparisonResults
from vstestbed.report.comparison.statistics import holm, paired_difference

SHIFT_S = {"none": 0.0, "late": 0.5, "noisy": -0.25}


def table(effects: tuple[str, ...] = ("none", "late", "noisy")) -> pl.DataFrame:
    """Two laws under effects that shift their times by SHIFT_S; `noisy` lets the second law fail
    from two of eight starts.
    """
    rng = np.random.default_rng(0)
    first = {(law, seed): rng.uniform(5, 9) for law in ("points", "pose") for seed in range(8)}
    rows = [
        {
            "scenario": "s",
            "effect": effect,
            "law": law,
            "seed": seed,
            "success": (effect, law) != ("noisy", "pose") or seed > 1,
        }
        | {"time_to_converge_s": time + SHIFT_S[effect], "final_position_error_m": 1e-3}
        for effect in effects
        for (law, seed), time in first.items()
    ]
    return pl.DataFrame(rows)


def drawn(frame: pl.DataFrame, axes: tuple[str, ...] = ("effect", "law")) -> list[str] | None:
    """The words in the grid's panels."""
    figure = grid(Data(ComparisonResults(frame, axes)), 7.0)
    return (
        None
        if figure is None
        else [t.get_text() for panel in figure.axes for t in panel.findobj(Text)]
    )


def test_changes_are_paired_with_the_first_row() -> None:
    found = Grid.of(ComparisonResults(table(), ("effect", "law")))
    assert (
        found is not None
        and found.rows == ("none", "late", "noisy")
        and found.columns == ("points", "pose")
    )
    changes = found.changes(TIME)
    assert changes[1, 0].mean == pytest.approx(0.5)
    assert changes[2, 1].mean == pytest.approx(-0.25)
    assert changes[2, 1].n == 6  # the starts from which both arrived


def test_the_numbers_stand_in_their_cells() -> None:
    words = drawn(table())
    assert words is not None
    assert {"reached the goal, of 8", "6", "+.50", "\N{MINUS SIGN}.25", "1.0"} <= set(words)
    assert words.count("8") == 5  # of six cells


def test_without_two_axes_or_with_two_values_there_is_none() -> None:
    assert drawn(table().filter(law="pose"), ("effect",)) is None
    assert drawn(table(("none", "late"))) is None


def test_a_change_that_no_start_shows_is_a_dash_without_a_sign() -> None:
    frame = table().with_columns(success=(pl.col("effect") != "late") | (pl.col("law") != "pose"))
    words = drawn(frame)
    assert words is not None and "\N{EN DASH}" in words and "\N{MINUS SIGN}\N{EN DASH}" not in words


def test_of_many_cells_without_an_effect_none_is_marked_and_a_true_one_is() -> None:
    """Of a hundred cells of 12 starts some intervals exclude zero by chance; after Holm's
    correction only the true one is left.
    """
    rng = np.random.default_rng(4)
    changes = {i: paired_difference(rng.normal(0, 1, 12), np.zeros(12)) for i in range(99)}
    changes[99] = paired_difference(rng.normal(4, 1, 12), np.zeros(12))
    assert sum(d.excludes_zero for d in changes.values()) > 1
    assert (
        real(changes)
        == {99}
        == {i for i, p in enumerate(holm([d.p for d in changes.values()])) if p <= 0.05}
    )


def test_equal_changes_of_few_starts_are_not_marked() -> None:
    equal = {n: paired_difference(np.full(n, 0.04), np.zeros(n)) for n in (2, 4, 5)}
    assert equal[2].excludes_zero and real(equal) == {5}


def test_the_mean_over_the_columns_is_taken_start_by_start() -> None:
    found = Grid.of(ComparisonResults(table(), ("effect", "law")))
    assert found is not None
    overall = found.overall(TIME)
    assert overall[1].mean == pytest.approx(0.5) and overall[2].mean == pytest.approx(-0.25)
    assert overall[2].n == 8  # of the two starts that `pose` fails from, `points` has the change
    words = drawn(table())
    assert words is not None and "all" in words and words.count("+.50") == 3


def test_what_differs_between_columns_does_not_hide_what_they_have_in_common() -> None:
    """Each law has noise of its own of 0.4 s, all a change of 0.2 s: the mean over 16 laws shows
    it, no cell does.
    """
    rng = np.random.default_rng(1)
    rows = [
        {"scenario": "s", "effect": effect, "law": f"law {law}", "seed": seed, "success": True}
        | {"time_to_converge_s": 5.0 + 0.2 * (effect == "late") + rng.normal(0, 0.4)}
        for effect in ("none", "same", "late")
        for law in range(16)
        for seed in range(10)
    ]
    found = Grid.of(ComparisonResults(pl.DataFrame(rows), ("effect", "law")))
    assert found is not None
    assert not real(found.changes(TIME)) and real(found.overall(TIME)) == {2}
