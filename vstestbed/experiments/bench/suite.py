"""Benchmarks of all that a user waits for: robots, a film, a folder, a report, a comparison, the ideal loop, the start."""

from __future__ import annotations

import platform
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from vstestbed.core.geometry import exp
from vstestbed.core.provenance import versions
from vstestbed.experiments.bench.changes import BesideFloor
from vstestbed.experiments.bench.ideal import endless
from vstestbed.experiments.bench.scenario import loop_and_floor
from vstestbed.experiments.comparison import compare
from vstestbed.experiments.run_folder import Films, run_into
from vstestbed.features import Point
from vstestbed.loop.run import run, uninterrupted
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario

ROBOTS = ("arm_ibvs", "omni_ibvs", "car_pbvs", "quadrotor_hover")
SHORT_S = 4.0
"""Simulated time of a benchmark's run [s]."""
IDEAL_STEPS = 2000
IDEAL: dict[str, object] = {"detector": {"kind": "oracle"}, "law.depth": "oracle"}
RUNS, JOBS = 16, 2
"""Runs of the comparison, and processes that share them."""
PROMPT = "import mujoco, cv2, numpy"
"""What any program with physics and pictures must import."""
FIRST = """
import os, vstestbed as vs
class First:
    def frame(self, frame):
        os._exit(0)
vs.run(vs.load("arm_ibvs"), watch=[First()])
"""
"""A process that ends with the first frame of a run."""

Pair = Callable[[], tuple[float, float]]
"""Does something and then its floor; returns the wall time of both [s]."""


@dataclass(frozen=True)
class Suite:
    """Benchmarks that were measured on one machine, by their names.

    Attributes:
        machine: processor, cores, versions.
        timings: wall times of each benchmark and its floor.
    """

    machine: dict[str, str]
    timings: dict[str, BesideFloor]

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return asdict(self)

    def as_text(self) -> str:
        """A table for the terminal."""
        lines = [f"{'':18}{'ms':>10}{'floor':>10}{'ratio':>8}{'lowest':>8}{'highest':>8}  floor is"]
        for name, one in self.timings.items():
            ms, floor = one.medians_ms
            lines.append(f"{name:18}{ms:10.1f}{floor:10.1f}{one.ratio:8.2f}{one.ratios[0]:8.2f}{one.ratios[-1]:8.2f}  {one.floor}")
        return "\n".join(lines)


def measure_all(repeats: int = 5, only: tuple[str, ...] = (), stage: Callable[[str], None] = lambda _: None) -> Suite:
    """Measure every benchmark and its floor in turn, `repeats` times after one turn that warms up.

    Args:
        repeats: counted turns. only: names of the benchmarks; none: all. stage: called with the name of each one that begins.
    """
    timings = {}
    for name, (floor, pair) in _benchmarks().items():
        if only and name not in only:
            continue
        stage(name)
        pairs = [pair() for _ in range(repeats + 1)][1:]
        timings[name] = BesideFloor(floor=floor, seconds=tuple(a for a, _ in pairs), floor_seconds=tuple(b for _, b in pairs))
    machine = {"processor": platform.processor() or platform.machine(), "system": platform.platform()} | versions()
    return Suite(machine, timings)


def _benchmarks() -> dict[str, tuple[str, Pair]]:
    """Every benchmark: what its floor is, and how both are measured."""
    arm = _short("arm_ibvs")
    robots = {name: ("same physics steps, same raw pictures", partial(loop_and_floor, _short(name))) for name in ROBOTS}
    return robots | {
        "ideal loop": ("equations of the law alone", _ideal),
        "run folder": ("the run in memory", partial(_folder, load("ibvs_book", IDEAL))),
        "drafts of films": ("the run without films", partial(_filmed, arm, "both")),
        "report": ("the run", partial(_report, arm)),
        "comparison": (f"its {RUNS} runs without folders, shared by {JOBS} processes", _comparison),
        "first frame": ("import of MuJoCo, OpenCV and NumPy", _first_frame),
    }


def _short(name: str) -> Scenario:
    """A bundled scenario, cut after some seconds."""
    return load(name, {"stop.duration_s": SHORT_S})


def _ideal() -> tuple[float, float]:
    """A single ideal run, and the same number of bare steps: v = -gain pinv(L) e, then the camera moves by exp(v dt)."""
    scenario = endless(IDEAL_STEPS)
    loop_s = uninterrupted(run(scenario)).loop_s
    points, T, feature, gain = scenario.target.points, np.eye(4), Point(), 0.5
    T[2, 3] = 1.5
    goal = points[:, :2] / 1.0
    with _timed() as bare:
        for _ in range(IDEAL_STEPS):
            p = points @ T[:3, :3].T + T[:3, 3]
            xy = p[:, :2] / p[:, 2:]
            velocity = -gain * np.linalg.pinv(feature.interaction(xy, p[:, 2])) @ (xy - goal).ravel()
            T = exp(-velocity * scenario.camera.period) @ T
    return loop_s, bare[0]


def _folder(scenario: Scenario) -> tuple[float, float]:
    """A run with its folder, without films and report; and without a folder."""
    with _folder_of_its_own() as folder, _timed() as whole:
        uninterrupted(run_into(folder, scenario, "none", report=False))
    with _timed() as alone:
        uninterrupted(run(scenario))
    return whole[0], alone[0]


def _filmed(scenario: Scenario, films: Films) -> tuple[float, float]:
    """A run with its films, and without."""
    taken = []
    for which in (films, "none"):
        with _folder_of_its_own() as folder, _timed() as one:
            uninterrupted(run_into(folder, scenario, which, report=False))
        taken += one
    return taken[0], taken[1]


def _report(scenario: Scenario) -> tuple[float, float]:
    """The report of a run, and the run."""
    from vstestbed.report import write_report  # imported for this benchmark alone

    with _folder_of_its_own() as folder:
        with _timed() as alone:
            uninterrupted(run_into(folder, scenario, "none", report=False))
        with _timed() as report:
            write_report(folder)
    return report[0], alone[0]


def _comparison() -> tuple[float, float]:
    """A comparison with all its files but films, and its runs alone, one after another, over the number of processes."""
    name, settings = "ibvs_book", IDEAL
    with _timed() as alone:
        for seed in range(RUNS):
            uninterrupted(run(replace(load(name, settings), seed=seed)))
    with _folder_of_its_own() as folder, _timed() as whole:
        compare([name], set=settings, seeds=RUNS, jobs=JOBS, out=folder / "comparison", film=False)
    return whole[0], alone[0] / JOBS


def _first_frame() -> tuple[float, float]:
    """From the start of Python to the first frame of a run, and to the imports that any such program has."""
    taken = []
    for code in (FIRST, PROMPT):
        with _timed() as one:
            subprocess.run([sys.executable, "-c", code], check=True)
        taken += one
    return taken[0], taken[1]


@contextmanager
def _folder_of_its_own() -> Iterator[Path]:
    with TemporaryDirectory(prefix="vstestbed_bench_") as made:
        yield Path(made)


@contextmanager
def _timed() -> Iterator[list[float]]:
    """The wall time of a block [s], as the only item of a list."""
    taken: list[float] = []
    began = time.perf_counter()
    yield taken
    taken.append(time.perf_counter() - began)
