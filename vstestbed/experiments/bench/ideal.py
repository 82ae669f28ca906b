"""Speed of the ideal loop on one core: a single run with its recording, and a batch of a thousand runs."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, inverse
from vstestbed.experiments.basin.batch import fly
from vstestbed.loop.run import run, uninterrupted
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.stop import Stop

NEVER_S = 1e9
"""Hold time at the goal that no run completes, so that the duration ends it."""
BATCH_STEPS = 60
"""Steps of a batch: fewer than any of its runs needs to its goal, so that all runs take part in all steps."""


@dataclass(frozen=True)
class IdealBench:
    """Medians over several repeats.

    Attributes:
        repeats: counted measurements, after one that warms up.
        steps, steps_per_s: of the single run, everything included but building the scene; run_low, run_high: extremes of the rate.
        runs, run_steps: of the batch; run_steps_per_s: its rate; batch_low, batch_high: extremes.
        cores: processor time over wall time of all measurements: about 1 on a core that is free, less on a shared one.
    """

    repeats: int
    steps: int
    steps_per_s: float
    run_low: float
    run_high: float
    runs: int
    run_steps: int
    run_steps_per_s: float
    batch_low: float
    batch_high: float
    cores: float

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return asdict(self)

    def as_text(self) -> str:
        """The measurement as a table for the terminal."""
        return "\n".join(
            [
                f"ideal camera, four points, current L, true depth: median of {self.repeats}, on {self.cores:.2f} cores",
                f"  {'':26}{'steps a second':>16}{'lowest':>10}{'highest':>10}",
                f"  {f'one run, {self.steps} steps':26}{self.steps_per_s:16.0f}{self.run_low:10.0f}{self.run_high:10.0f}",
                f"  {f'{self.runs} runs at once':26}{self.run_steps_per_s:16.0f}{self.batch_low:10.0f}{self.batch_high:10.0f}",
            ]
        )


def measure_ideal(repeats: int = 5, steps: int = 3000, runs: int = 1000) -> IdealBench:
    """Measure both loops in turn, `repeats` times.

    Args:
        repeats: counted measurements. steps: of the single run, which stays at its goal to the end. runs: runs in the batch.

    Raises:
        ParameterError: there is nothing to measure.
    """
    if min(repeats, steps, runs) < 1:
        raise ParameterError("repeats, steps and runs", "must be 1 or more", (repeats, steps, runs))
    scenario, start = endless(steps), _starts(runs)
    with _one_core():
        alone, together = _one_run(scenario), _batch(scenario, start)  # warms up
        alone_rates, together_rates = [], []
        wall, busy = time.perf_counter(), time.process_time()  # to see whether the core was shared
        for _ in range(repeats):
            alone_rates.append(_one_run(scenario)[1])
            together_rates.append(_batch(scenario, start)[1])
        cores = (time.process_time() - busy) / (time.perf_counter() - wall)
    return IdealBench(
        repeats=repeats,
        steps=alone[0],
        steps_per_s=statistics.median(alone_rates),
        run_low=min(alone_rates),
        run_high=max(alone_rates),
        runs=runs,
        run_steps=together[0],
        run_steps_per_s=statistics.median(together_rates),
        batch_low=min(together_rates),
        batch_high=max(together_rates),
        cores=cores,
    )


def endless(steps: int) -> Scenario:
    """The scenario `ibvs_book` with true pixels and depths, running for `steps` steps also after it has reached its goal."""
    overrides: dict[str, object] = {
        "detector": {"kind": "oracle", "field_of_view": "unlimited"},
        "law.depth": "oracle",
        "stop.converged.hold_s": NEVER_S,
    }
    period = load("ibvs_book", overrides).camera.period
    return load("ibvs_book", overrides | {"stop.duration_s": steps * period})


def _starts(runs: int) -> Array:
    """Start poses T_camera_target (runs, 4, 4) about 2 m in front of the target, turned by up to 60 deg about the optical axis."""
    rng = np.random.default_rng(0)
    xyz, yaw = rng.uniform(-0.3, 0.3, (runs, 3)), rng.uniform(-60, 60, runs)
    return np.array(
        [inverse(Pose(xyz=(x, y, z - 2), rpy_deg=(0, 0, a)).T) for (x, y, z), a in zip(xyz.tolist(), yaw.tolist(), strict=True)]
    )


def _one_run(scenario: Scenario) -> tuple[int, float]:
    """Steps of a single run, and its steps a second."""
    recording = uninterrupted(run(scenario))
    steps = len(recording.table) - 1  # no motion follows the last frame
    return steps, steps / recording.loop_s


def _batch(scenario: Scenario, start: Array) -> tuple[int, float]:
    """Steps of all runs of a batch together, and its run-steps a second."""
    stop = Stop(duration_s=BATCH_STEPS * scenario.camera.period, converged=scenario.stop.converged)
    began = time.perf_counter()
    run_steps = fly(replace(scenario, stop=stop), start).run_steps
    return run_steps, run_steps / (time.perf_counter() - began)


@contextmanager
def _one_core() -> Iterator[None]:
    """Pin this thread to one core, where the system supports it (Linux)."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(before)})  # 0: the calling thread
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)
