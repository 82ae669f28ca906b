"""The speed of the ideal loop: its rates are steps over seconds, on a clock of the test's own."""

from __future__ import annotations

import itertools
import types

import pytest

from vstestbed.studies import bench


def test_both_rates_are_steps_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    ticks = itertools.count(0, 4)  # every look at the clock is 4 s later
    clock = types.SimpleNamespace(
        perf_counter=lambda: next(ticks), process_time=lambda: next(ticks)
    )
    monkeypatch.setattr(bench, "time", clock)
    result = bench.measure_ideal(repeats=1, steps=3, runs=2)
    assert result.run_steps == 2 * bench.BATCH_STEPS  # no run reaches its goal in so few steps
    assert result.run_steps_per_s == result.batch_low == result.batch_high == result.run_steps / 4
    assert result.steps_per_s == result.run_low == result.run_high > 0
