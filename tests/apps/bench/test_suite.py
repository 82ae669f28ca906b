"""The benchmarks run, and what they print is read again."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from vstestbed.apps.bench.bench import read_saved
from vstestbed.studies import bench


def test_what_is_printed_is_read_again(tmp_path: Path):
    measured = bench.Suite.of(
        {"run folder": bench.measure_one(*bench.benchmarks()["run folder"], repeats=2)}
    )
    assert len(measured.timings["run folder"].seconds) == 2
    (tmp_path / "old.json").write_text(json.dumps(asdict(measured)), encoding="utf-8")
    assert read_saved(tmp_path / "old.json").timings == measured.timings


def test_bench_compares_with_an_earlier_one(
    command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(
        bench,
        "benchmarks",
        lambda: {"one": ("a floor", lambda: (3.0, 1.0)), "other": ("a floor", lambda: (1.0, 1.0))},
    )
    old = {
        "machine": {},
        "timings": {
            "one": {"floor": "a floor", "seconds": [2.0, 2.0], "floor_seconds": [1.0, 1.0]}
        },
    }
    (tmp_path / "old.json").write_text(json.dumps(old), encoding="utf-8")
    ended = command("bench", "--compare", tmp_path / "old.json", "--repeats", 2, "--json")
    assert json.loads(ended.out) == {
        "one": {"before": 2.0, "after": 3.0, "share": 0.5, "verdict": "slower"}
    }
    assert command("bench", "--all", "--compare", tmp_path / "old.json").code == 2
    assert "other" in command("bench", "--all", "--repeats", 1).out


def test_an_interrupted_bench_prints_what_was_measured(command, monkeypatch: pytest.MonkeyPatch):
    def interrupted() -> tuple[float, float]:
        raise KeyboardInterrupt

    monkeypatch.setattr(
        bench,
        "benchmarks",
        lambda: {"one": ("a floor", lambda: (3.0, 1.0)), "other": ("a floor", interrupted)},
    )
    ended = command("bench", "--all", "--json", "--repeats", 1)
    assert (ended.code, ended.err) == (130, "interrupted: other not measured\n")
    assert list(json.loads(ended.out)["timings"]) == ["one"]
