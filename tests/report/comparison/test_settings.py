"""In what the controllers of a comparison differ, and the sentence where it is a gain alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.report.comparison.comparisons import SCENARIO, build
from tests.report.html import checked
from vstestbed.report.comparison.page import differing, write_comparison_report
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
def test_the_fields_that_differ(
    tmp_path: Path, change: tuple[str, str], fields: tuple[str, ...]
) -> None:
    two = comparison(tmp_path, SCENARIO.replace(*change))
    assert differing([tmp_path / str(c.runs["folder"][0]) for c in two.controllers]) == fields


SETTINGS = "These are settings, not laws: one and two fly with gain 0.5, for which none was tuned."


def test_a_page_of_settings_says_so_first_and_is_never_green(
    tmp_path: Path, one_figure: None
) -> None:
    two = comparison(tmp_path, SCENARIO.replace("gain: 1", "gain: 2"), seeds=40)
    of_laws, of_settings = (
        ComparisonResults(two.table),
        ComparisonResults(two.table, settings=SETTINGS),
    )
    for shown, overall, look in (
        (of_laws, "two is better than one.", "good"),
        (of_settings, f"{SETTINGS} two is better than one.", "open"),
    ):
        page = write_comparison_report(tmp_path, shown).read_text(encoding="utf-8")
        assert overall in checked(page).text and f'class="outcome {look}"' in page
        assert json.loads((tmp_path / "verdicts.json").read_text())["overall"] == overall
