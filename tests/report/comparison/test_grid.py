"""The grid of effects and controllers: its cells, its changes, and the comparisons of which there is none."""

from __future__ import annotations

import numpy as np
import polars as pl
import pytest
from matplotlib.text import Text

from vstestbed.report.comparison.columns import ComparisonResults
from vstestbed.report.comparison.figures import Data
from vstestbed.report.comparison.grid import Grid, grid
from vstestbed.report.comparison.pairs import TIME
from vstestbed.report.comparison.series import Series

SHIFT_S = {"none": 0.0, "late": 0.5, "noisy": -0.25}


def table(effects: tuple[str, ...] = ("none", "late", "noisy")) -> pl.DataFrame:
    """Two laws under effects that shift their times by SHIFT_S; `noisy` lets the second law fail from two of eight starts."""
    rng = np.random.default_rng(0)
    first = {(law, seed): rng.uniform(5, 9) for law in ("points", "pose") for seed in range(8)}
    rows = [
        {"scenario": "s", "effect": effect, "law": law, "seed": seed, "success": (effect, law) != ("noisy", "pose") or seed > 1}
        | {"time_to_converge_s": time + SHIFT_S[effect], "final_position_error_m": 1e-3}
        for effect in effects
        for (law, seed), time in first.items()
    ]
    return pl.DataFrame(rows)


def drawn(frame: pl.DataFrame, axes: tuple[str, ...] = ("effect", "law")) -> list[str] | None:
    """The words in the grid's panels."""
    figure = grid(Data(ComparisonResults(frame, axes), Series(np.zeros(1), []), []), 7.0)
    return None if figure is None else [t.get_text() for panel in figure.axes for t in panel.findobj(Text)]


def test_changes_are_paired_with_the_first_row() -> None:
    found = Grid.of(ComparisonResults(table(), ("effect", "law")))
    assert found is not None and found.rows == ("none", "late", "noisy") and found.columns == ("points", "pose")
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
