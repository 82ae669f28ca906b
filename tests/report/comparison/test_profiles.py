"""Performance profiles by counting, and the tables of statistics for other programs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.report.comparison.comparisons import build
from vstestbed.report.comparison.figures import STEPS, profile
from vstestbed.report.comparison.pairs import pairs
from vstestbed.report.comparison.records import write_records
from vstestbed.report.comparison.results import ComparisonResults, interquartiles
from vstestbed.report.comparison.sentences import findings
from vstestbed.report.comparison.tables import statistics_text
from vstestbed.tasks.metrics import Metric


@pytest.mark.parametrize("name", ["time_to_converge_s", "min_border_margin_px"])
def test_a_profile_counts_the_runs_that_are_as_good(name: str) -> None:
    rng = np.random.default_rng(0)
    value, success = rng.integers(0, 15, 40).astype(float), rng.random(40) < 0.8
    frame = pl.DataFrame(
        {"scenario": ["a"] * 40, "seed": list(range(40)), "success": success, name: value}
    )
    metric = Metric.named(name)
    tau, share, n = profile(ComparisonResults(frame).controllers[0], metric)
    good = [(success & (value >= t if metric.better > 0 else value <= t)).sum() / 40 for t in tau]
    np.testing.assert_allclose(share, good)
    assert n == 40 and len(tau) == len(set(value[success])) and share[-1] == success.mean()


def test_of_many_runs_a_profile_has_few_steps() -> None:
    frame = pl.DataFrame(
        {
            "scenario": ["a"] * 5000,
            "seed": list(range(5000)),
            "success": [True] * 5000,
            "path_ratio": np.arange(5000.0),
        }
    )
    tau, share, n = profile(ComparisonResults(frame).controllers[0], Metric.named("path_ratio"))
    assert len(tau) == STEPS and n == 5000 and share[-1] == 1 and (tau[0], tau[-1]) == (0, 4999)
    np.testing.assert_allclose(share, (tau + 1) / 5000)


def test_the_tables_and_the_terminal_have_the_statistics(tmp_path: Path) -> None:
    frame = build(
        tmp_path, {"slow": 0.8, "fast": 1.6}, 12, {("slow", k): "timed_out" for k in range(5)}
    )
    comparison = ComparisonResults(frame, (), ("time_to_converge_s", "path_ratio"))
    assert statistics_text(tmp_path) == ""  # no report yet
    means, found = interquartiles(comparison), pairs(comparison)
    write_records(tmp_path, comparison, means, found, findings(comparison, found))
    of, against = (
        pl.read_parquet(tmp_path / f"{name}.parquet") for name in ("controllers", "pairs")
    )
    assert pl.read_csv(tmp_path / "pairs.csv").shape == against.shape == (4, len(against.columns))
    slow, fast = of.filter(pl.col("metric") == "time_to_converge_s").rows(named=True)
    assert (slow["succeeded"], slow["runs"], slow["iqm"]) == (7, 12, math.inf)
    assert fast["iqm"] == means[1]["time_to_converge_s"].mean
    (pair,), rows = found, {row["metric"]: row for row in against.rows(named=True)}
    row = rows["time_to_converge_s"]
    assert (row["difference"], row["pairs"]) == (pair.differences["time_to_converge_s"].mean, 7)
    assert row["improvement"] == 1.0 and row["improvement_p"] == pytest.approx(2 / 2**12)
    assert row["p_holm"] == pair.adjusted["time_to_converge_s", "difference"] >= row["p"]
    assert rows["success"]["difference"] == pytest.approx(5 / 12)
    assert rows["success"]["p"] == pytest.approx(2 / 2**5)
    goal = rows["time_to_goal_s"]
    assert goal["pairs"] == 12 and {row["better_one"] for row in rows.values()} == {"fast"}
    assert (goal["verdict"], goal["by"], goal["limit"], goal["margin"]) == (
        "better",
        "time_to_goal_s",
        10.0,
        0.1,
    )
    assert (
        goal["only_a"],
        goal["only_b"],
        goal["both"],
        goal["neither"],
        goal["wins_a"],
        goal["wins_b"],
    ) == (0, 5, 7, 0, 0, 12)
    assert (
        goal["low"] < goal["seen_low"] < goal["difference"] < goal["seen_high"] < goal["high"] < 0
    )
    text = statistics_text(tmp_path).splitlines()
    assert (
        text[0] == "fast is better than slow."
        and "7 of 12" in "".join(text)
        and goal["sentence"] == text[-1]
    )
