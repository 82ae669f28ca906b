"""What became slower: verdicts beyond the noise, and files that are no measurement."""

from __future__ import annotations

from pathlib import Path

import pytest

from vstestbed.apps.bench.bench import (
    BesideFloor,
    SpeedChange,
    changes_text,
    read_saved,
    speed_changes,
)
from vstestbed.core.errors import ScenarioError


def timing(*ratios: float) -> BesideFloor:
    """Pairs with these ratios, on a machine that is twice as slow at every second pair."""
    floors = tuple(1.0 + i % 2 for i in range(len(ratios)))
    return BesideFloor(
        floor="of the test",
        seconds=tuple(r * f for r, f in zip(ratios, floors, strict=True)),
        floor_seconds=floors,
    )


def test_the_ratio_is_that_of_pairs_whatever_the_load():
    one = timing(2.0, 2.2, 2.1)
    assert one.ratios == pytest.approx((2.0, 2.1, 2.2))
    assert one.ratio == pytest.approx(2.1)
    assert one.medians_ms == pytest.approx((2100, 1000))


def test_a_change_is_one_beyond_the_noise():
    for after, verdict in (
        ((2.5, 2.6, 2.4), "slower"),
        ((1.5, 1.6, 1.4), "faster"),
        ((2.15, 2.6, 2.4), ""),  # one pair lies within the noise of before
        ((2.201, 2.202, 2.203), ""),  # beyond the noise, but no more than 4.9 %
    ):
        before = timing(2.0, 2.2, 2.1)
        assert SpeedChange.of(before, timing(*after)).verdict == verdict


def test_only_what_both_measured_is_compared():
    both = speed_changes(
        {"arm": timing(2.0), "old": timing(1.0)}, {"arm": timing(3.0), "new": timing(1.0)}
    )
    assert list(both) == ["arm"]
    assert changes_text(both).splitlines()[1].split() == [
        "arm",
        "2.00",
        "3.00",
        "+50",
        "%",
        "slower",
    ]
    assert changes_text(both).endswith("slower beyond the noise: arm")


def test_a_file_that_is_no_measurement(tmp_path: Path):
    for text, words in (
        ("", "1:1: is empty; `vstestbed bench --all --json` prints one"),
        ('{"machine": {}}', "timings: is missing"),
        (
            (
                '{"machine": {},\n'
                ' "timings": {"a": {"floor": "f", "seconds": [1], "floor_seconds": [0]}}}'
            ),
            "2:68: timings.a.floor_seconds.0: must be > 0",
        ),
        (
            (
                '{"machine": {},\n'
                ' "timings": {"a": {"floor": "f", "seconds": [1, 2], "floor_seconds": [1]}}}'
            ),
            "must be 2 numbers, one for each of seconds",
        ),
    ):
        (tmp_path / "old.json").write_text(text, encoding="utf-8")
        with pytest.raises(ScenarioError) as found:
            read_saved(tmp_path / "old.json")
        assert words in str(found.value)
