"""In what the controllers of a comparison differ, and the sentence where it is a gain alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.report.comparison.comparisons import SCENARIO, build
from tests.report.html import checked
from vstestbed.report.comparison.page import differing, gains_alone, in_words, only_gains, write_comparison_report
from vstestbed.report.comparison.results import DEFAULT_METRICS, ComparisonResults


def comparison(folder: Path, second: str, seeds: int = 2) -> ComparisonResults:
    """Two controllers: the scenario of the tests, seed 1 for the seed 1, and another text."""
    table = build(folder, {"one": 0.8, "two": 1.6}, seeds)
    for seed in range(seeds):
        (folder / f"runs/two/base/{seed}/resolved.yaml").write_text(f"{second}seed: {seed}\n")
    return ComparisonResults(table, (), DEFAULT_METRICS, "")


@pytest.mark.parametrize(
    ("change", "fields"),
    [
        (("gain: 1", "gain: 2"), ("law.gain",)),
        (("kind: ibvs", "kind: pbvs"), ("law.kind",)),
        (("gain: 1", "gain: 2, depth: pnp"), ("law.depth", "law.gain")),
        (("xyz: [0, 0, 1.2]", "xyz: [0, 0, 1.3]"), ("target.pose.xyz.2",)),
        (("gain: 1", "gain: 1"), ()),
        (("robot:", "description: another\nrobot:"), ()),
        (("law: {", "law: {{"), ()),  # cannot be read
    ],
)
def test_the_fields_that_differ(tmp_path: Path, change: tuple[str, str], fields: tuple[str, ...]) -> None:
    two = comparison(tmp_path, SCENARIO.replace(*change))
    assert differing([tmp_path / str(c.runs["folder"][0]) for c in two.controllers]) == fields
    assert gains_alone(tmp_path, two) == ("law.gain" if fields == ("law.gain",) else "")


def test_only_gains() -> None:
    assert only_gains(["law.gain"]) and only_gains(["law.gain.at_zero", "law.gain_z"]) and only_gains(["law.k_rho", "law.k_alpha"])
    assert not only_gains([]) and not only_gains(["law.gain", "law.kind"]) and not only_gains(["robot.attitude_gain"])


def test_a_page_of_two_gains_says_that_a_gain_is_all_that_differs(tmp_path: Path, one_figure: None) -> None:
    two = comparison(tmp_path, SCENARIO.replace("gain: 1", "gain: 2"), seeds=40)
    text = checked(write_comparison_report(tmp_path, ComparisonResults(two.table)).read_text(encoding="utf-8")).text
    assert "Only law.gain differs. two is better than one." in text and "settings of one law" in text


def test_the_gains_in_words() -> None:
    assert in_words(["law.gain.value"]) == "law.gain" and in_words([]) == ""
    assert in_words(["law.k_rho", "law.k_alpha", "law.k_beta"]) == "law.k_alpha, law.k_beta and law.k_rho"
