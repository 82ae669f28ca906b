"""What environments cost, and what a thousand resets leave behind:
`pytest -s -m study tests/apps/learn/test_environments.py`.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import vstestbed.env

from vstestbed.sim import gl_context

pytestmark = pytest.mark.study

RESETS = 1000
MOST_GROWTH_MB = 10.0
"""Of the resident memory from reset 400 to the last; before, pools fill, and one scene that stays
has 5 to 30 MB.
"""


def resident() -> float:
    """Resident memory [MB]."""
    (found,) = (
        line
        for line in Path("/proc/self/status").read_text().splitlines()
        if line.startswith("VmRSS")
    )
    return int(found.split()[1]) / 1024


def held() -> dict[str, float]:
    """What the process holds: resident memory before and after the heap gives back free pages [MB],
    descriptors, threads, contexts.
    """
    gc.collect()
    before = resident()
    # free pages of the heap go back to the system: those that stay are in use
    ctypes.CDLL("libc.so.6").malloc_trim(0)
    return {
        "untrimmed_mb": before,
        "memory_mb": resident(),
        "descriptors": len(list(Path("/proc/self/fd").iterdir())),
        "threads": len(list(Path("/proc/self/task").iterdir())),
        "contexts": len(gl_context._contexts),
        "rendering_contexts": len(gl_context._kept),
    }


@pytest.mark.parametrize("name", ["arm_ibvs", "quadrotor_hover"])
def test_a_thousand_resets_leave_nothing_behind(name: str) -> None:
    env = vstestbed.env.make(name, observation="both", render_mode="rgb_array")
    marks, began = {}, time.process_time()
    for k in range(RESETS + 1):
        env.reset(seed=0 if k == 0 else None)
        env.step(0.1 * env.action_space.sample())
        if k % 10 == 0:
            env.render()
        if k in (100, 200, 400, RESETS):
            marks[k] = held()
            print(
                f"\n{name} {k} resets,"
                f" {time.process_time() - began:.0f} s of processor time: {marks[k]}"
            )
    env.close()
    first, last = marks[400], marks[RESETS]
    assert last["memory_mb"] - first["memory_mb"] < MOST_GROWTH_MB
    assert last["descriptors"] <= first["descriptors"] and last["threads"] <= first["threads"]
    assert last["contexts"] == 1 and last["rendering_contexts"] <= gl_context.MOST_KEPT


MEASURED = """
import json, sys, time
began = time.process_time()
import gymnasium, numpy, vstestbed.apps.learn
name, mode, steps = sys.argv[1], sys.argv[2], int(sys.argv[3])
env = gymnasium.make(f"vstestbed/{name}-v0", observation=mode, disable_env_checker=True)
made = time.process_time()
env.reset(seed=0)
first = time.process_time()
resets = []
for seed in range(1, 9):
    start = time.process_time()
    env.reset(seed=seed)
    resets.append(time.process_time() - start)
env.reset(seed=0)
rounds, servo = [], env.unwrapped
for _ in range(5):
    env.reset(seed=0)
    start = time.process_time()
    for _ in range(steps):
        env.step(servo.expert())
    rounds.append((time.process_time() - start) / steps)
print(json.dumps([made - began, first - made, float(numpy.median(resets)), min(rounds)]))
"""


def test_what_starts_and_steps_cost(capsys: pytest.CaptureFixture[str]) -> None:
    """Processor time of one core, with software OpenGL on that core too, driven by the scenario's
    own law.
    """
    table = []
    for name in ("arm_ibvs", "omni_ibvs", "car_pbvs", "quadrotor_hover"):
        for mode in ("markers", "pixels"):
            words = [sys.executable, "-c", MEASURED, name, mode, "100"]
            done = subprocess.run(
                words,
                env=os.environ | {"LP_NUM_THREADS": "0"},
                capture_output=True,
                text=True,
                check=True,
            )
            table.append((name, mode, *json.loads(done.stdout)))
    with capsys.disabled():
        print(
            "\nscenario, observation:"
            " import and make [s], first reset [s], reset [ms], step [ms], steps/s"
        )
        for name, mode, made, first, reset, step in table:
            print(
                f"{name:16} {mode:8} {made:6.2f} {first:6.2f} {1e3 * reset:7.1f}"
                f" {1e3 * step:7.2f} {1 / step:6.0f}"
            )
    steps = np.array([row[-1] for row in table])
    assert (steps < 0.2).all()  # faster than five a second, or something is wrong
