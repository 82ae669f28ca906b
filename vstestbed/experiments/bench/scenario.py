"""Speed of a run: computing time by part, and the ratio to its floor, the same physics steps and images and nothing else."""

from __future__ import annotations

import statistics
from dataclasses import asdict, dataclass

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.loop.recording import Recording
from vstestbed.loop.run import run, uninterrupted
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.scene.compose import Parts
from vstestbed.sim.speed_baseline import BaselineCost, measure_baseline


@dataclass(frozen=True)
class Bench:
    """Medians over several runs, each measured beside its own floor.

    Attributes:
        scenario, frames, repeats: name of the scenario, frames of a run, counted runs.
        real_time_factor: simulated over wall time of the loop. ratio: wall time of the loop over that of its floor.
        ratio_low, ratio_high: smallest and largest ratio of a pair of run and floor.
        ms_per_frame: wall time by part [ms]; floor_ms: bare physics and bare rendering [ms]. setup_s: building the scene [s].
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

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return asdict(self)

    def as_text(self) -> str:
        """The measurement as a table for the terminal."""
        lines = [
            f"{self.scenario}: {self.frames} frames, {self.repeats} pairs of run and floor, pictures by {self.renderer}",
            f"  {self.ratio:.2f} times the floor ({self.ratio_low:.2f} to {self.ratio_high:.2f})",
            f"  {self.real_time_factor:.1f} times real time, after {self.setup_s:.2f} s to build the scene",
            "",
            f"  {'ms a frame':12}{'run':>8}{'floor':>8}",
        ]
        for part, value in self.ms_per_frame.items():
            floor = self.floor_ms.get(part)
            lines.append(f"  {part:12}{value:8.3f}" + (f"{floor:8.3f}" if floor is not None else ""))
        return "\n".join(lines)


def measure(scenario: Scenario, repeats: int = 5) -> Bench:
    """Measure a scenario and its floor in turn; the first pair warms up and is not counted."""
    pairs = [_pair(scenario) for _ in range(repeats + 1)][1:]  # the first pair warms up
    recordings, floors = [r for r, _ in pairs], [f for _, f in pairs]
    # the ratio of each pair, not of the medians: both share the load of the machine at that time
    ratios = [r.loop_s / f.total_s for r, f in pairs]
    return Bench(
        scenario=scenario.name,
        frames=len(recordings[0].table),
        repeats=repeats,
        real_time_factor=statistics.median(float(r["t"][-1]) / r.loop_s for r in recordings),
        ratio=statistics.median(ratios),
        ratio_low=min(ratios),
        ratio_high=max(ratios),
        ms_per_frame=_ms_per_frame(recordings),
        floor_ms=_floor_ms(floors, len(recordings[0].table)),
        setup_s=statistics.median(r.wall_time_s - r.loop_s for r in recordings),
        renderer=recordings[0].versions["renderer"],
    )


def _pair(scenario: Scenario) -> tuple[Recording, BaselineCost]:
    """A run, and at once its floor, so that both meet the same load of the machine."""
    recording = uninterrupted(run(scenario))
    return recording, _floor(scenario, recording)


def loop_and_floor(scenario: Scenario) -> tuple[float, float]:
    """Wall time [s] of a run's loop, and of its floor."""
    recording, floor = _pair(scenario)
    return recording.loop_s, floor.total_s


def _ms_per_frame(recordings: list[Recording]) -> dict[str, float]:
    """Median wall time of a frame by part, without films; `other` is what no part accounts for."""
    frames = len(recordings[0].table)
    parts = {k: statistics.median(r.time_ms[k] / frames for r in recordings) for k in recordings[0].time_ms if k != "video"}
    whole = statistics.median(1e3 * r.loop_s / frames for r in recordings)
    return parts | {"other": whole - sum(parts.values()), "whole": whole}


def _floor_ms(floors: list[BaselineCost], frames: int) -> dict[str, float]:
    """Median wall time of a frame of bare physics and bare rendering."""
    physics, render = (statistics.median(1e3 * getattr(f, name) / frames for f in floors) for name in ("physics_s", "render_s"))
    return {"physics": physics, "render": render, "whole": physics + render}


def _floor(scenario: Scenario, recording: Recording) -> BaselineCost:
    """The floor of a recorded run: its actuator inputs stepped and its camera poses rendered again, without the loop."""
    step, steps_per_frame = scenario.clock
    parts = Parts(scenario.robot, scenario.camera, scenario.target, scenario.world, step)
    robot = scenario.robot

    def joined(kind: str, names: tuple[str, ...]) -> Array:
        columns = [recording[f"{kind}_{name}"] for name in names]
        return np.column_stack(columns) if columns else np.zeros((len(recording.table), 0))

    T = np.array(recording.camera_poses().A)  # the floor renders the same views
    return measure_baseline(
        parts, steps_per_frame, joined("ctrl", robot.actuators), joined("q", robot.joints), T, scenario.detector.needs_image
    )
