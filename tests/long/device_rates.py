"""Rates of `--executor warp`: pictures a second by size, and runs of arm_ibvs beside those whose
rays MuJoCo casts on the processor.

Usage: python -m tests.long.device_rates [--runs 1000] [--jobs 16] [--beside 160]. It needs neither
OpenGL nor a screen.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import resource
import subprocess
import time
from collections.abc import Sequence
from typing import Any

from vstestbed.camera import Image
from vstestbed.scenario.load import load, seeded
from vstestbed.scenario.scenario import Scenario

SIZES = (64, 64), (320, 240), (640, 480)


def scenario(renderer: str = "auto") -> Scenario:
    return load("arm_ibvs", {"camera.renderer": renderer})


def pictures(worlds: int, size: tuple[int, int]) -> float:
    """Whole pictures a second of so many arms, with packing and copying."""

    from vstestbed.apps.gpu.together import device
    from vstestbed.apps.gpu.warp import PictureRequest, WarpRenderer
    from vstestbed.sim.scene.scene import Scene

    width, height = size
    s = load("arm_ibvs", {"camera.width": width, "camera.height": height})
    stage = Scene(s.scene)
    stage.place(0.0, s.target.pose.T, *stage.parts.start)
    asked: list[PictureRequest] = []

    class Keeps:
        name = ""

        def draw(self, shot: PictureRequest, /) -> Any:
            asked.append(shot)
            return device().draw([shot])[0]

    WarpRenderer(stage, s.camera, Keeps()).images()
    device().draw(asked * worlds)
    began, rounds = time.perf_counter(), 0
    while time.perf_counter() - began < 3.0:
        device().draw(asked * worlds)
        rounds += 1
    return rounds * worlds / (time.perf_counter() - began)


def fly(given: tuple[str, list[int]]) -> dict[str, Any]:
    """Runs of these seeds, in a worker: outcomes and times to the goal, frames, seconds of the
    processor and of the clock, memory [MB].
    """
    kind, seeds = given
    from vstestbed.loop.session import run

    runs = [seeded(scenario("auto" if kind == "warp" else "rays"), seed) for seed in seeds]
    if kind == "warp":
        from vstestbed.apps.gpu.together import TOGETHER, Together
        from vstestbed.apps.gpu.warp import Device, PictureRequest

        class Timed(Device):
            spent_s = 0.0

            def draw(self, requests: Sequence[PictureRequest]) -> list[list[Image]]:
                began = time.perf_counter()
                drawn = super().draw(requests)
                self.spent_s += time.perf_counter() - began
                return drawn

        timed = Timed()
        together = Together(timed)
        began, cpu = time.perf_counter(), time.process_time()
        done = [
            one.result()
            for i in range(0, len(runs), TOGETHER)
            for one in together.fly([lambda one=one: run(one) for one in runs[i : i + TOGETHER]])
        ]
    else:
        began, cpu = time.perf_counter(), time.process_time()
        done = [run(one) for one in runs]
    figures = [(r.outcome.name, r.summary()["time_to_converge_s"]) for r in done]
    spent = time.perf_counter() - began, time.process_time() - cpu
    return {
        "runs": dict(zip(seeds, figures, strict=True)),
        "frames": sum(len(r.rows) for r in done),
        "wall_s": spent[0],
        "cpu_s": spent[1],
        "draw_s": timed.spent_s if kind == "warp" else 0.0,
        "rss_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }


def flown(kind: str, runs: int, jobs: int) -> dict[int, Any]:
    """All runs by so many processes; says what they cost."""
    shares = [(kind, list(range(i, runs, jobs))) for i in range(jobs)]
    began = time.perf_counter()
    with multiprocessing.get_context("spawn").Pool(jobs) as pool:
        parts = pool.map_async(fly, shares, 1)
        used = ""
        while not parts.ready():
            parts.wait(2.0)
            used = max(used, card(), key=lambda text: (len(text), text))
        found = parts.get()
    wall = time.perf_counter() - began
    told = {
        "kind": kind,
        "runs": runs,
        "jobs": jobs,
        "wall_s": round(wall, 1),
        "flying_s": round(max(part["wall_s"] for part in found), 1),
        "cpu_s_a_run": round(sum(part["cpu_s"] for part in found) / runs, 3),
        "drawing_s": round(max(part["draw_s"] for part in found), 1),
        "frames_a_run": round(sum(part["frames"] for part in found) / runs),
        "rss_mb_a_process": round(max(part["rss_mb"] for part in found)),
        "card": used,
    }
    print(json.dumps(told), flush=True)
    return {seed: figures for part in found for seed, figures in part["runs"].items()}


def card() -> str:
    """Memory that the graphics card has given, and its name; "" without one."""
    query = ["nvidia-smi", "--query-gpu=memory.used,name", "--format=csv,noheader"]
    try:
        return subprocess.run(query, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=16)
    parser.add_argument("--beside", type=int, default=160)
    parser.add_argument("--worlds", type=int, default=64)
    given = parser.parse_args()
    for size in SIZES:
        rate = pictures(given.worlds, size)
        print(json.dumps({"picture": size, "a_second": round(rate)}), flush=True)
    by_rays = flown("rays", given.beside, given.jobs)
    by_warp = flown("warp", given.runs, given.jobs)
    both = [seed for seed in by_rays if seed in by_warp]
    same = sum(by_rays[seed][0] == by_warp[seed][0] for seed in both)
    period = scenario().camera.period
    times = [
        (by_rays[s][1], by_warp[s][1])
        for s in both
        if by_rays[s][1] is not None and by_warp[s][1] is not None
    ]
    near = sum(abs(a - b) <= period + 1e-9 for a, b in times)
    print(
        json.dumps(
            {
                "seeds": len(both),
                "same outcome": same,
                "both reached": len(times),
                "times within one frame": near,
            }
        ),
        flush=True,
    )


if __name__ == "__main__":
    main()
