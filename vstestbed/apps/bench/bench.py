"""Benchmarks of all that a user waits for: robots, a film, a folder, a report, a comparison, the
ideal loop, the start.
"""

from __future__ import annotations

import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Container, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

import numpy as np
import polars as pl
from annotated_types import Len

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, exp, inverse
from vstestbed.core.provenance import versions
from vstestbed.core.quantity import PositiveTime
from vstestbed.core.spec import spec
from vstestbed.features import Point
from vstestbed.loop.recording import Recording
from vstestbed.loop.session import run, uninterrupted
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import build, plain_mapping, text_of
from vstestbed.sim.replay import measure_baseline
from vstestbed.studies.batch import simulate_batch
from vstestbed.studies.comparison import compare
from vstestbed.studies.run_folder import run_into
from vstestbed.tasks.stop import Stop

NEVER_S = 1e9  # hold time at the goal that no run completes, so that the duration ends it
# steps of a batch: fewer than any of its runs needs to its goal, so that all runs take part in all
# steps
BATCH_STEPS = 60


@dataclass(frozen=True)
class IdealBench:
    """Medians over several repeats.

    Attributes:
        repeats: counted measurements, after one that warms up.
        steps, steps_per_s: of the single run, everything included but building the scene; run_low,
            run_high: extremes of the rate.
        runs, run_steps: of the batch; run_steps_per_s: its rate; batch_low, batch_high: extremes.
        cores: processor time over wall time of all measurements: about 1 on a core that is free,
            less on a shared one.
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

    def as_text(self) -> str:
        """The measurement as a table for the terminal."""
        one = f"one run, {self.steps} steps"
        many = f"{self.runs} runs at once"
        return (
            f"ideal camera, four points, current L, true depth: median of {self.repeats},"
            f" on {self.cores:.2f} cores\n"
            f"  {'':26}{'steps a second':>16}{'lowest':>10}{'highest':>10}\n"
            f"  {one:26}{self.steps_per_s:16.0f}{self.run_low:10.0f}{self.run_high:10.0f}\n"
            f"  {many:26}{self.run_steps_per_s:16.0f}{self.batch_low:10.0f}{self.batch_high:10.0f}"
        )


def measure_ideal(repeats: int = 5, steps: int = 3000, runs: int = 1000) -> IdealBench:
    """Measure both loops in turn, `repeats` times; steps: of the single run, which stays at its
    goal to the end; runs: in the batch.
    """
    if min(repeats, steps, runs) < 1:
        raise ParameterError.count(
            "repeats, steps and runs", "1", "or more", (repeats, steps, runs)
        )
    scenario = endless(steps)
    start = _starts(runs)
    alone_rates = []
    together_rates = []
    with _one_core():
        alone, _ = _one_run(scenario)  # warms up
        together, _ = _batch(scenario, start)
        wall = (
            time.perf_counter()
        )  # beside the processor's time it tells whether the core was shared
        busy = time.process_time()
        for _ in range(repeats):
            alone_rates.append(_one_run(scenario)[1])
            together_rates.append(_batch(scenario, start)[1])
        cores = (time.process_time() - busy) / (time.perf_counter() - wall)
    return IdealBench(
        repeats=repeats,
        steps=alone,
        steps_per_s=statistics.median(alone_rates),
        run_low=min(alone_rates),
        run_high=max(alone_rates),
        runs=runs,
        run_steps=together,
        run_steps_per_s=statistics.median(together_rates),
        batch_low=min(together_rates),
        batch_high=max(together_rates),
        cores=cores,
    )


def endless(steps: int) -> Scenario:
    """The scenario `ibvs_book` with true pixels and depths, running for `steps` steps also after it
    has reached its goal.
    """
    overrides: dict[str, object] = {
        "detector": {"kind": "oracle", "field_of_view": "unlimited"},
        "law.depth": "oracle",
        "stop.converged.hold_s": NEVER_S,
    }
    period = load("ibvs_book", overrides).camera.period
    return load("ibvs_book", overrides | {"stop.duration_s": steps * period})


def _starts(runs: int) -> Array:
    """Start poses T_camera_target (runs, 4, 4) about 2 m in front of the target, turned by up to 60
    deg about the optical axis.
    """
    rng = np.random.default_rng(0)
    xyz = rng.uniform(-0.3, 0.3, (runs, 3)) - [0, 0, 2]
    yaw = rng.uniform(-60, 60, runs)
    starts = []
    for place, angle in zip(xyz.tolist(), yaw.tolist(), strict=True):
        starts.append(inverse(Pose(xyz=place, rpy_deg=(0, 0, angle)).T))
    return np.array(starts)


def _one_run(scenario: Scenario) -> tuple[int, float]:
    """Steps of a single run, and its steps a second."""
    recording = uninterrupted(run(scenario))
    steps = len(recording.table) - 1  # no motion follows the last frame
    return steps, steps / recording.loop_s


def _batch(scenario: Scenario, start: Array) -> tuple[int, float]:
    """Steps of all runs of a batch together, and its run-steps a second."""
    stop = Stop(duration_s=BATCH_STEPS * scenario.camera.period, converged=scenario.stop.converged)
    began = time.perf_counter()
    run_steps = simulate_batch(replace(scenario, stop=stop), start).run_steps
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


# Speed of a run: computing time by part, and the ratio to its floor, the same physics steps and
# images and nothing else.
@dataclass(frozen=True)
class Bench:
    """Medians over several runs, each measured beside its own floor.

    Attributes:
        scenario, frames, repeats: name of the scenario, frames of a run, counted runs.
        real_time_factor: simulated over wall time of the loop. ratio: wall time of the loop over
            that of its floor.
        ratio_low, ratio_high: smallest and largest ratio of a pair of run and floor.
        ms_per_frame: wall time by part [ms]; floor_ms: bare physics and bare rendering [ms].
            setup_s: building the scene [s].
        renderer: the renderer.
    """

    scenario: str
    frames: int
    repeats: int
    real_time_factor: float
    ratio: float
    ratio_low: float
    ratio_high: float
    ms_per_frame: dict[str, float]
    floor_ms: dict[str, float]
    setup_s: float
    renderer: str

    def as_text(self) -> str:
        """The measurement as a table for the terminal."""
        lines = [
            (
                f"{self.scenario}: {self.frames} frames, {self.repeats} pairs of run and floor,"
                f" pictures by {self.renderer}"
            ),
            f"  {self.ratio:.2f} times the floor ({self.ratio_low:.2f} to {self.ratio_high:.2f})",
            (
                f"  {self.real_time_factor:.1f} times real time,"
                f" after {self.setup_s:.2f} s to build the scene"
            ),
            "",
            f"  {'ms a frame':12}{'run':>8}{'floor':>8}",
        ]
        for part, value in self.ms_per_frame.items():
            lines.append(f"  {part:12}{value:8.3f}")
            if part in self.floor_ms:
                lines[-1] += f"{self.floor_ms[part]:8.3f}"
        return "\n".join(lines)


def measure(scenario: Scenario, repeats: int = 5) -> Bench:
    """Measure a scenario and its floor in turn; the first pair warms up and is not counted."""
    pairs = [_pair(scenario) for _ in range(repeats + 1)][1:]  # the first pair warms up
    recordings = [recording for recording, _ in pairs]
    # the ratio of each pair, not of the medians: both share the load of the machine at that time
    ratios = [recording.loop_s / sum(floor) for recording, floor in pairs]
    first = recordings[0]
    frames = len(first.table)
    # without films; `other` is what no part accounts for
    times = pl.DataFrame([r.time_ms for r in recordings]).drop("video", strict=False).median()
    parts = {part: ms / frames for part, ms in times.row(0, named=True).items()}
    whole = 1e3 * statistics.median(r.loop_s for r in recordings) / frames
    floors = np.array([floor for _, floor in pairs])
    physics, render = (np.median(floors, axis=0) * 1e3 / frames).tolist()
    return Bench(
        scenario=scenario.name,
        frames=frames,
        repeats=repeats,
        real_time_factor=statistics.median(float(r["t"][-1]) / r.loop_s for r in recordings),
        ratio=statistics.median(ratios),
        ratio_low=min(ratios),
        ratio_high=max(ratios),
        ms_per_frame=parts | {"other": whole - sum(parts.values()), "whole": whole},
        floor_ms={"physics": physics, "render": render, "whole": physics + render},
        setup_s=statistics.median(r.wall_time_s - r.loop_s for r in recordings),
        renderer=first.versions["renderer"],
    )


def _pair(scenario: Scenario) -> tuple[Recording, tuple[float, float]]:
    """A run, and at once its floor (physics, pictures) [s], so that both meet the same load of the
    machine.
    """
    recording = uninterrupted(run(scenario))
    return recording, _floor(recording)


def _floor(recording: Recording) -> tuple[float, float]:
    """The floor of a recorded run: its actuator inputs stepped and its camera poses rendered again,
    without the loop.
    """
    scenario = recording.scenario
    body = scenario.robot.body
    controls = [recording[f"ctrl_{name}"] for name in body.actuators] if body else []
    joints = [recording[f"q_{name}"] for name in scenario.robot.joints]
    frames = len(recording.table)
    return measure_baseline(
        scenario.scene,
        scenario.clock[1],
        np.reshape(controls, (len(controls), frames)).T,
        np.reshape(joints, (len(joints), frames)).T,
        np.array(recording.camera_poses().A),  # the floor renders the same views
        scenario.detector.needs_image,
    )


# What became slower or faster between two measurements of the benchmarks, beyond their noise.
LEAST_CHANGE = 0.05  # a smaller change of the median is not called one


@spec
class BesideFloor:
    """Wall times of a benchmark, each measured just before its floor, so that both meet the same
    load of the machine.

    Args:
        floor: what the floor is.
        seconds, floor_seconds: wall times [s], pair by pair.
    """

    floor: str
    seconds: Annotated[tuple[PositiveTime, ...], Len(1)]
    floor_seconds: Annotated[tuple[PositiveTime, ...], Len(1)]

    def __post_init__(self) -> None:
        """Refuse times without their floor."""
        n = len(self.seconds)
        found = len(self.floor_seconds)
        if n != found:
            words = "numbers, one for each of seconds"
            raise ParameterError.count("floor_seconds", n, words, found)

    @property
    def ratios(self) -> tuple[float, ...]:
        """Ratio of each pair, the smallest first."""
        return tuple(sorted(a / b for a, b in zip(self.seconds, self.floor_seconds, strict=True)))

    @property
    def ratio(self) -> float:
        """Median ratio of a pair; not the ratio of the medians, which different loads would
        distort.
        """
        return statistics.median(self.ratios)

    @property
    def medians_ms(self) -> tuple[float, float]:
        """Median wall time of the benchmark and of its floor [ms]."""
        return 1e3 * statistics.median(self.seconds), 1e3 * statistics.median(self.floor_seconds)


def read_saved(path: Path) -> Suite:
    """What an earlier `bench --all --json` printed into a file. Raises ScenarioError: the file is
    not there, or holds something else.
    """
    works = "`vstestbed bench --all --json` prints one"
    plain, marks = plain_mapping(text_of(path), str(path), works)
    return build(Suite, plain, marks, str(path))


@dataclass(frozen=True, slots=True)
class SpeedChange:
    """A benchmark's ratio to its floor, before and after.

    Attributes:
        before, after: median ratios. share: relative change, .1 for a tenth slower.
        verdict: `slower` or `faster` where every pair of one measurement lies beyond every pair of
            the other, which two measurements of 5 pairs of the same thing do once in 126 times, and
            the medians differ by 5 % or more; else empty.
    """

    before: float
    after: float
    share: float
    verdict: str

    @classmethod
    def of(cls, before: BesideFloor, after: BesideFloor) -> SpeedChange:
        """The change of one benchmark."""
        share = after.ratio / before.ratio - 1
        verdict = ""
        if share >= LEAST_CHANGE and after.ratios[0] > before.ratios[-1]:
            verdict = "slower"
        elif share <= -LEAST_CHANGE and after.ratios[-1] < before.ratios[0]:
            verdict = "faster"
        return cls(before.ratio, after.ratio, share, verdict)


def speed_changes(
    before: Mapping[str, BesideFloor], after: Mapping[str, BesideFloor]
) -> dict[str, SpeedChange]:
    """The change of every benchmark that both measurements have, by name."""
    return {
        name: SpeedChange.of(before[name], one) for name, one in after.items() if name in before
    }


def changes_text(changes: Mapping[str, SpeedChange]) -> str:
    """A table for the terminal, and a sentence on what became slower."""
    lines = [f"{'ratio to the floor':18}{'before':>8}{'now':>8}{'change':>9}"]
    lines += [
        f"{name:18}{c.before:8.2f}{c.after:8.2f}{100 * c.share:+7.0f} %  {c.verdict}".rstrip()
        for name, c in changes.items()
    ]
    slower = ", ".join(name for name, c in changes.items() if c.verdict == "slower")
    return "\n".join([*lines, "", f"slower beyond the noise: {slower or 'nothing'}"])


ROBOTS = ("arm_ibvs", "omni_ibvs", "car_pbvs", "quadrotor_hover")
SHORT_S = 4.0  # simulated time of a benchmark's run [s]
IDEAL_STEPS = 2000
IDEAL: dict[str, object] = {"detector": {"kind": "oracle"}, "law.depth": "oracle"}
RUNS, JOBS = 16, 2
PROMPT = "import mujoco, cv2, numpy"  # what any program with physics and pictures must import
FIRST = """
import os, vstestbed as vs
class First:
    def frame(self, frame):
        os._exit(0)
vs.run(vs.load("arm_ibvs"), watch=[First()])
"""
"""A process that ends with the first frame of a run."""

# does something and then its floor; returns the wall time of both [s]
Pair = Callable[[], tuple[float, float]]


@spec
class Suite:
    """Benchmarks that were measured on one machine, by their names; what `bench --all --json`
    prints.

    Args:
        machine: processor, cores, versions. timings: wall times of each benchmark and its floor.
    """

    machine: dict[str, str]
    timings: dict[str, BesideFloor]

    @classmethod
    def of(cls, timings: dict[str, BesideFloor]) -> Suite:
        """What was measured on this machine."""
        processor = platform.processor() or platform.machine()
        machine = {"processor": processor, "system": platform.platform()} | versions()
        return cls(machine=machine, timings=timings)

    def as_text(self) -> str:
        """A table for the terminal."""
        lines = [f"{'':18}{'ms':>10}{'floor':>10}{'ratio':>8}{'lowest':>8}{'highest':>8}  floor is"]
        for name, one in self.timings.items():
            ms, floor = one.medians_ms
            lines.append(
                f"{name:18}{ms:10.1f}{floor:10.1f}{one.ratio:8.2f}{one.ratios[0]:8.2f}{one.ratios[-1]:8.2f}"
                f"  {one.floor}"
            )
        return "\n".join(lines)


def measure_one(floor: str, pair: Pair, repeats: int = 5) -> BesideFloor:
    """Measure a benchmark and its floor in turn, `repeats` times after one turn that warms up."""
    pairs = [pair() for _ in range(repeats + 1)][1:]
    seconds, floor_seconds = zip(*pairs, strict=True)
    return BesideFloor(floor=floor, seconds=seconds, floor_seconds=floor_seconds)


def measured(
    repeats: int, only: Container[str], say: Callable[[str], None]
) -> tuple[Suite, list[str]]:
    """What was measured, of all benchmarks or some, and the names of those that an interrupt has
    left out.
    """
    chosen = {name: one for name, one in benchmarks().items() if not only or name in only}
    timings: dict[str, BesideFloor] = {}
    try:
        for name, (floor, pair) in chosen.items():
            say(name)
            timings[name] = measure_one(floor, pair, repeats)
    except KeyboardInterrupt:
        if not timings:
            raise
    return Suite.of(timings), [name for name in chosen if name not in timings]


def benchmarks() -> dict[str, tuple[str, Pair]]:
    """Every benchmark: what its floor is, and how both are measured."""
    arm = _short("arm_ibvs")
    robots = {
        name: ("same physics steps, same raw pictures", partial(_of_robot, name)) for name in ROBOTS
    }
    return robots | {
        "ideal loop": ("equations of the law alone", _ideal),
        "run folder": ("the run in memory", partial(_folder, load("ibvs_book", IDEAL))),
        "drafts of films": ("the run without films", partial(_filmed, arm)),
        "report": ("the run", partial(_report, arm)),
        "comparison": (f"its {RUNS} runs without folders, shared by {JOBS} processes", _comparison),
        "first frame": ("import of MuJoCo, OpenCV and NumPy", _first_frame),
    }


def _of_robot(name: str) -> tuple[float, float]:
    recording, floor = _pair(_short(name))
    return recording.loop_s, sum(floor)


def _short(name: str) -> Scenario:
    """A bundled scenario, cut after some seconds."""
    return load(name, {"stop.duration_s": SHORT_S})


def _ideal() -> tuple[float, float]:
    """A single ideal run, and the same number of bare steps: v = -gain pinv(L) e, then the camera
    moves by exp(v dt).
    """
    scenario = endless(IDEAL_STEPS)
    loop_s = uninterrupted(run(scenario)).loop_s
    points = scenario.target.points
    feature = Point()
    gain = 0.5
    T = np.eye(4)
    T[2, 3] = 1.5
    goal = points[:, :2] / 1.0
    began = time.perf_counter()
    for _ in range(IDEAL_STEPS):
        p = points @ T[:3, :3].T + T[:3, 3]
        xy = p[:, :2] / p[:, 2:]
        L = feature.interaction(xy, p[:, 2])
        velocity = -gain * np.linalg.pinv(L) @ (xy - goal).ravel()
        T = exp(-velocity * scenario.camera.period) @ T
    return loop_s, time.perf_counter() - began


def _folder(scenario: Scenario) -> tuple[float, float]:
    """A run with its folder, without films and report; and without a folder."""
    whole_s = _filed_s(scenario, "none")
    return whole_s, _seconds(lambda: uninterrupted(run(scenario)))


def _filmed(scenario: Scenario) -> tuple[float, float]:
    filmed_s = _filed_s(scenario, "both")
    return filmed_s, _filed_s(scenario, "none")


def _report(scenario: Scenario) -> tuple[float, float]:
    from vstestbed.report import write_report  # imported for this benchmark alone

    with _new_folder() as folder:
        run_s = _run_into_s(folder, scenario, "none")
        return _seconds(lambda: write_report(Path(folder))), run_s


def _comparison() -> tuple[float, float]:
    """A comparison with all its files but films, and its runs alone, one after another, over the
    number of processes.
    """

    def alone() -> None:
        for seed in range(RUNS):
            uninterrupted(run(replace(load("ibvs_book", IDEAL), seed=seed)))

    alone_s = _seconds(alone)
    with _new_folder() as folder:
        out = Path(folder) / "comparison"
        whole_s = _seconds(
            lambda: compare(["ibvs_book"], set=IDEAL, seeds=RUNS, jobs=JOBS, out=out, film=False)
        )
    return whole_s, alone_s / JOBS


def _first_frame() -> tuple[float, float]:
    """From the start of Python to the first frame of a run, and to the imports that any such
    program has.
    """
    first_s = _python_s(FIRST)
    return first_s, _python_s(PROMPT)


def _python_s(code: str) -> float:
    return _seconds(lambda: subprocess.run([sys.executable, "-c", code], check=True))


def _new_folder() -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix="vstestbed_bench_")


def _filed_s(scenario: Scenario, films: Literal["both", "none"]) -> float:
    """The wall time of a run with a folder, without its report [s]."""
    with _new_folder() as folder:
        return _run_into_s(folder, scenario, films)


def _run_into_s(folder: str, scenario: Scenario, films: Literal["both", "none"]) -> float:
    return _seconds(lambda: uninterrupted(run_into(folder, scenario, films, report=False)))


def _seconds(do: Callable[[], object]) -> float:
    """The wall time of what is done [s]."""
    began = time.perf_counter()
    do()
    return time.perf_counter() - began
