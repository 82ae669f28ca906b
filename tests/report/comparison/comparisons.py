"""Folders of comparisons that never happened: errors that fall exponentially, some of whose runs
fail.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

RATE_HZ, DURATION_S, THRESHOLD_PX = 25.0, 10.0, 0.2
VERSIONS = {"versions.vstestbed": "0.1.0", "versions.mujoco": "3.17.0", "versions.python": "3.11.9"}
SCENARIO = """\
robot: {kind: free, start: {nominal: {xyz: [0.1, -0.05, 0]}}}
camera: {width: 320, height: 240}
target: {kind: square, side: 0.4, pose: {xyz: [0, 0, 1.2]}}
detector: oracle
law: {kind: ibvs, gain: 1}
goal: {T_camera_target: {xyz: [0, 0, 1]}}
"""


def build(
    folder: Path,
    gains: dict[str, float],
    seeds: int,
    failing: dict[tuple[str, int], str] | None = None,
) -> pl.DataFrame:
    """A comparison's folder of scenarios with a gain each, and its table.

    Args:
        folder: where to. gains: gain of each scenario [1/s]. seeds: runs of each.
        failing: outcome of the runs (scenario, seed) that fail; `crashed` leaves no log,
            `target_lost` ends blind at 2 s.
    """
    failing = failing or {}
    rows = [
        _run(folder, name, gain, seed, failing.get((name, seed), "converged"))
        for name, gain in gains.items()
        for seed in range(seeds)
    ]
    return pl.DataFrame(rows, infer_schema_length=None)


def errors(gain: float, seed: int, t: np.ndarray) -> np.ndarray:
    """RMS error over time [px]: the start depends on the seed alone."""
    return start_px(seed) * np.exp(-gain * t)


def start_px(seed: int) -> float:
    """Error at the start [px]."""
    return 100.0 + 40.0 * math.sin(1.7 * seed)


def _run(folder: Path, name: str, gain: float, seed: int, outcome: str) -> dict[str, Any]:
    place = f"runs/{name}/base/{seed}"
    (folder / place).mkdir(parents=True)
    for document in ("scenario.yaml", "resolved.yaml"):
        (folder / place / document).write_text(SCENARIO)
    row = {
        "scenario": name,
        "seed": seed,
        "folder": place,
        "outcome": outcome,
        "success": outcome == "converged",
    }
    if outcome == "crashed":
        (folder / place / "error.txt").write_text("Traceback: <ValueError>: the law broke\n")
        return row | {"reason": "ValueError: the law broke", "attempts": 1}
    sim_time = 2.0 if outcome == "target_lost" else DURATION_S
    t = np.arange(0, sim_time + 1e-9, 1 / RATE_HZ)
    error = errors(gain, seed, t)
    if outcome == "target_lost":
        error[-25:] = np.nan
    log = pl.DataFrame({"t": t, "lost": ~np.isfinite(error), "error_px": error, "u_0": error})
    log.write_parquet(folder / place / "log.parquet")
    time = math.log(start_px(seed) / THRESHOLD_PX) / gain if outcome == "converged" else None
    reasons = {
        "converged": "RMS error under 0.2 px for 0.5 s",
        "timed_out": f"10 s were not enough at {error[-1]:.6g} px",
    }
    return row | {
        "reason": reasons.get(outcome, "too few markers for 1 s"),
        "sim_time_s": float(t[-1]),
        "frames": len(t),
        "time_to_converge_s": time,
        "final_error_px": float(error[-1]) if np.isfinite(error[-1]) else None,
        "final_position_error_m": 1e-3 * (1 + seed) * gain,
        "final_rotation_error_deg": 0.01 * (1 + seed % 3),
        "path_ratio": 1.0 + 0.01 * seed,
        "max_retreat_m": 0.0,
        "max_feature_excursion_px": 10.0 * gain + seed,
        "min_border_margin_px": 40.0 - seed,
        "peak_speed_mps": 0.5 * gain,
        "saturated_fraction": 0.125,
        **VERSIONS,
        "attempts": 1,
    }
