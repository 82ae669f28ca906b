"""What one step of each law costs on this machine: `python -m docs.build.law_speed`. Compare the
ratios, not the times.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

import vstestbed as vs
from vstestbed.laws import IBVS, PBVS, QP, Hybrid, Partitioned, Predictive, Switched, Uncalibrated
from vstestbed.laws.switched import Stage, SwitchCondition

LAWS: dict[str, Any] = {
    "ibvs": IBVS(),
    "pbvs": PBVS(),
    "hybrid": Hybrid(),
    "partitioned": Partitioned(),
    "switched": Switched(
        laws=(Stage(law=IBVS(), until=SwitchCondition(retreat_over_m=0.1)), Stage(law=PBVS()))
    ),
    "uncalibrated": Uncalibrated(),
    "qp": QP(),
    "predictive": Predictive(),
    "predictive, horizon 25, 5 blocks": Predictive(horizon=25, blocks=5),
}
ROUNDS = 20


class Frames:
    """Keeps what the law was given."""

    def __init__(self) -> None:
        self.kept: list[vs.Frame] = []

    def frame(self, frame: vs.Frame) -> None:
        """Keep it."""
        self.kept.append(frame)


def step_ms(law: Any) -> float:
    """Median processor time of a step on the frames of a run of the arm [ms]."""
    frames = Frames()
    vs.run(
        replace(vs.load("arm_ibvs", {"detector": "oracle", "stop.duration_s": 3.0}), law=law),
        watch=[frames],
    )
    basis, took = np.eye(6), []
    for _ in range(ROUNDS):
        state = law.init(frames.kept[0].goal)
        began = time.process_time()
        for frame in frames.kept:
            state, _ = law.step(state, frame.observation, frame.goal, basis)
        took.append(1e3 * (time.process_time() - began) / len(frames.kept))
    return float(np.median(took))


if __name__ == "__main__":
    times = {name: step_ms(law) for name, law in LAWS.items()}
    for name, ms in times.items():
        print(f"| `{name}` | {ms:.2f} | {ms / times['ibvs']:.1f} |")
