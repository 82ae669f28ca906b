"""Basins of attraction: outcome of a law over two coordinates of the start pose."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import write_json, write_table
from vstestbed.core.geometry import Array, Pose, inverse, rotation_from_rpy, transform
from vstestbed.core.outcome import Outcome
from vstestbed.laws.base import has_batch
from vstestbed.loop.session import run, uninterrupted
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.batch import (
    Batch,
    BatchSetup,
    ideal,
    left_out,
    simulate_batch,
    simulate_in_parts,
    start_of,
    started_at,
)
from vstestbed.studies.comparison.plan import Comparison, Variant, changed, controllers
from vstestbed.vision import Oracle

if TYPE_CHECKING:
    import polars


COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")
"""Start pose of the camera in the frame of the goal camera: x right, y down, z ahead [m] (z = -1 is
a metre back), and rotations about these axes [deg], R = Rz(yaw) Ry(pitch) Rx(roll).
"""
ON_AXIS_DEG = (12.0, 30.0, 72.0, 113.0)
"""Turns about the optical axis of the frontal, centred starts that every check includes: no random
start is in that degenerate view.
"""


@dataclass(frozen=True)
class Axis:
    """One coordinate of the start with its range, sampled at `n` values, both ends included."""

    name: str
    low: float
    high: float
    n: int

    def __post_init__(self) -> None:
        """Refuse an unknown coordinate, and an empty range."""
        if self.name not in COORDINATES:
            raise ParameterError.choice("axis", COORDINATES, self.name)
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ParameterError.form(
                self.name, "low:high with low < high", f"{self.low:g}:{self.high:g}"
            )
        if self.n < 2:
            raise ParameterError.count("n", "2", "or more places along an axis", self.n)

    @property
    def values(self) -> Array:
        """Its values (n,) [m or deg]."""
        return np.linspace(self.low, self.high, self.n)

    @property
    def unit(self) -> str:
        """Metres or degrees."""
        return unit_of(self.name)


def unit_of(coordinate: str) -> str:
    """Metres or degrees."""
    return "m" if COORDINATES.index(coordinate) < 3 else "deg"


@dataclass(frozen=True)
class Disagreement:
    """A start that `run` (`full`) ended otherwise than the batch: at x, y on the map, or frontal
    and turned by on_axis_deg.
    """

    x: float | None
    y: float | None
    batch: str
    full: str
    on_axis_deg: float | None = None

    def words(self, x: str, y: str) -> str:
        """In words, on a map with axes of these names."""
        place = (
            f"{x} {self.x:g}, {y} {self.y:g}"
            if self.on_axis_deg is None
            else f"frontal, centred, turned by {self.on_axis_deg:g} deg"
        )
        return f"{place}: {self.batch} here, {self.full} there"


@dataclass(frozen=True)
class Basin:
    """The map of one law.

    Attributes:
        label: name of the law. scenario: the ideal scenario that was run.
        x, y: the axes. fixed: the other coordinates of every start [m or deg].
        batch: result of each start, x fastest. processor_s: processor time [s].
        checked: number of starts that were also run singly, in `run`; disagreements: those that
            ended otherwise.
    """

    label: str
    scenario: Scenario
    x: Axis
    y: Axis
    fixed: Mapping[str, float]
    batch: Batch
    processor_s: float
    checked: int = 0
    disagreements: tuple[Disagreement, ...] = ()

    @property
    def interrupted(self) -> bool:
        """Whether it is a part of a map, since Ctrl-C came."""
        return bool((self.batch.outcome == Outcome.interrupted).any())

    @property
    def endings(self) -> Array:
        """Outcomes by name (M,); `target_lost` is split: out of the field of view, or
        `plane_crossed`.
        """
        names = np.array([outcome.name for outcome in self.batch.outcome], dtype=object)
        return np.where(self.batch.crossed, "plane_crossed", names)

    @property
    def time_to_converge_s(self) -> Array:
        """Time from which the error stayed below the threshold (M,) [s]; NaN for starts that did
        not converge.
        """
        return np.where(
            self.batch.near >= 0, self.batch.near / self.scenario.camera.rate_hz, np.nan
        )

    def summary(self) -> dict[str, Any]:
        """The map in numbers, as `basin.json` has it."""
        flown = self.endings.astype(str)[self.batch.outcome != Outcome.interrupted]
        names, counts = np.unique(flown, return_counts=True)
        shares = dict(zip(names.tolist(), (counts / counts.sum()).tolist(), strict=True))
        detector, gain = self.scenario.detector, getattr(self.scenario.law, "gain", None)
        gain = gain if isinstance(gain, float) else getattr(gain, "value", None)
        return {
            "label": self.label,
            "x": vars(self.x) | {"unit": self.x.unit},
            "y": vars(self.y) | {"unit": self.y.unit},
            "fixed": {
                name: {"value": value, "unit": unit_of(name)} for name, value in self.fixed.items()
            },
            "field_of_view": detector.field_of_view if isinstance(detector, Oracle) else None,
            "starts": int(counts.sum()),
            "shares": dict(sorted(shares.items(), key=lambda item: -item[1])),
            "run_steps": self.batch.run_steps,
            "processor_s": self.processor_s,
            "gain_step": None
            if gain is None
            else gain * self.scenario.camera.period,  # the step of the discrete loop
            "checked": self.checked,
            "agreeing": self.checked - len(self.disagreements),
            "disagreements": [
                vars(d) | {"words": d.words(self.x.name, self.y.name)} for d in self.disagreements
            ],
        }


def fixed(scenario: Scenario, x: Axis, y: Axis, at: Mapping[str, float]) -> dict[str, float]:
    """The coordinates that are not on the map, by name [m or deg]: from `at`, else those of the
    scenario's start.
    """
    if x.name == y.name:
        raise ParameterError.twice("--x and --y", y.name)
    others = [name for name in COORDINATES if name not in (x.name, y.name)]
    for name in at:
        if name not in others:
            raise ParameterError.choice("--at", others, name)
    for name, value in at.items():
        if not math.isfinite(value):
            raise ParameterError.infinite(f"--at {name}", value)
    own = Pose.of(scenario.goal_view.T_camera_target @ inverse(start_of(scenario)))
    values = dict(zip(COORDINATES, (*own.xyz, *own.rpy_deg), strict=True)) | dict(at)
    return {name: values[name] for name in others}


def starts(scenario: Scenario, x: Axis, y: Axis, at: Mapping[str, float]) -> Array:
    """Start poses T_camera_target (n_y n_x, 4, 4), x fastest; other coordinates as by `fixed`."""
    place = np.empty((y.n, x.n, 6))
    for name, value in fixed(scenario, x, y, at).items():
        place[..., COORDINATES.index(name)] = value
    place[..., COORDINATES.index(x.name)] = x.values
    place[..., COORDINATES.index(y.name)] = y.values[:, None]
    place = place.reshape(-1, 6)
    T_goal_camera = np.zeros((len(place), 4, 4))
    T_goal_camera[:, :3, :3], T_goal_camera[:, :3, 3], T_goal_camera[:, 3, 3] = (
        rotation_from_rpy(np.radians(place[:, 3:])),
        place[:, :3],
        1,
    )
    return inverse(T_goal_camera) @ scenario.goal_view.T_camera_target


def laws(
    comparison: Comparison, field_of_view: str | None = None, force: bool = False
) -> list[tuple[str, Scenario]]:
    """The laws to be mapped: label and ideal scenario of every scenario with every case and varied
    value.
    Raises ParameterError, ScenarioError: a batch cannot simulate one of them; or two differ only in
    what an ideal camera does not have.
    """
    found: list[tuple[str, Scenario]] = []
    chosen = controllers(changed(comparison, tasks={}, seeds=None), force)
    for variant in chosen:
        label = _label(variant, comparison)
        scenario = ideal(variant.scenario, field_of_view)
        BatchSetup(scenario)  # raises if the law cannot run in a batch
        if same := [other for other, there in found if there == scenario]:
            problem = (
                f"`{label}` would make the same map as `{same[0]}`:"
                " its cameras are ideal, without the arm's dynamics, latency"
            )
            raise ParameterError("scenario", f"{problem} and noise; leave one of the two out")
        found.append((label, scenario))
    omitted = dict.fromkeys(name for variant in chosen for name in left_out(variant.scenario))
    if omitted:
        words = (
            "the maps are of the law behind an ideal camera, and leave out %s;"
            " vstestbed compare runs it all, start by start"
        )
        logging.getLogger("vstestbed").warning(words, ", ".join(omitted))
    return found


def _label(variant: Variant, comparison: Comparison) -> str:
    """The scenario's name where there are several, then the cases and varied values."""
    parts: list[str] = []
    if len(comparison.base) > 1 or not variant.values:
        parts.append(variant.scenario.name)
    for name, value in variant.values.items():
        parts.append(str(value) if name in comparison.cases else f"{name.split('.')[-1]}={value}")
    return ", ".join(parts)


def basin(
    label: str,
    scenario: Scenario,
    x: Axis,
    y: Axis,
    at: Mapping[str, float] | None = None,
    check: int = 0,
    seed: int = 0,
    jobs: int | None = 1,
    folder: Path | None = None,
) -> Basin:
    """Compute the map of an ideal scenario's law; `check` random starts of it, and frontal, centred
    ones, also run in `run`. jobs, folder: as of `simulate_in_parts`, for a law without equations of
    a batch.
    """
    poses = starts(scenario, x, y, at or {})
    began = sum(os.times()[:4])  # of the worker processes, too
    if folder is not None and not has_batch(scenario.law):
        batch = simulate_in_parts(scenario, poses, jobs, folder)
    else:
        batch = simulate_batch(scenario, poses)
    mapped = Basin(
        label, scenario, x, y, fixed(scenario, x, y, at or {}), batch, sum(os.times()[:4]) - began
    )
    if not check or mapped.interrupted:
        return mapped
    # a seed of its own: the same starts are checked every time
    spots = np.random.default_rng(seed).choice(len(poses), min(check, len(poses)), replace=False)
    different = list[Disagreement]()
    for i, here, full in _different(scenario, poses[spots], batch.outcome[spots].tolist()):
        j, k = divmod(int(spots[i]), x.n)  # x fastest
        different.append(Disagreement(float(x.values[k]), float(y.values[j]), here, full))
    return replace(
        mapped,
        checked=len(spots) + len(ON_AXIS_DEG),
        disagreements=(*different, *_on_axis(scenario)),
    )


def _on_axis(scenario: Scenario) -> Iterator[Disagreement]:
    """The frontal, centred starts at the goal's distance whose single runs end otherwise."""
    middle = scenario.target.points.mean(axis=0)
    distance = float(np.linalg.norm(transform(scenario.goal_view.T_camera_target, middle[None])))
    turns = rotation_from_rpy(np.radians([[0.0, 0.0, turn] for turn in ON_AXIS_DEG]))
    poses = np.tile(np.eye(4), (len(turns), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turns, [0.0, 0.0, distance] - turns @ middle
    for i, batch, full in _different(
        scenario, poses, simulate_batch(scenario, poses).outcome.tolist()
    ):
        yield Disagreement(None, None, batch, full, ON_AXIS_DEG[i])


def _different(
    scenario: Scenario, poses: Array, expected: list[Outcome]
) -> Iterator[tuple[int, str, str]]:
    """Indices of the starts (M, 4, 4) whose single runs end otherwise than expected, and both
    outcomes.
    """
    for i, outcome in enumerate(expected):
        found = uninterrupted(run(started_at(scenario, poses[i]))).outcome
        if found is not outcome:
            yield i, outcome.name, found.name


def table(basins: Sequence[Basin]) -> polars.DataFrame:
    """One row per start: law, its two coordinates, outcome, steps, times, largest distance, final
    error.
    """
    import polars as pl

    frames = []
    for b in basins:
        columns = {
            "law": np.full(b.x.n * b.y.n, b.label, dtype=object),
            b.x.name: np.tile(b.x.values, b.y.n),
            b.y.name: np.repeat(b.y.values, b.x.n),
            "outcome": [outcome.name for outcome in b.batch.outcome],
            "plane_crossed": b.batch.crossed,
            "steps": b.batch.steps,
            "time_to_converge_s": b.time_to_converge_s,
            "farthest_m": b.batch.farthest_m,
            "final_error_px": b.batch.error_px,
        }
        frames.append(
            pl.DataFrame(
                {name: np.asarray(v).tolist() for name, v in columns.items()}
            ).with_columns(pl.col("law").cast(pl.String))
        )
    return pl.concat(frames).fill_nan(None)


def write(folder: Path, basins: Sequence[Basin], command: str = "") -> Path:
    """Write `basin.parquet`, `.csv`, `.json`, `.png`, `.pdf` and `report.html`, each complete or
    not at all; returns the page's path.
    """
    from vstestbed.report.studies import write_basin

    write_table(folder / "basin", table(basins))
    summaries = [b.summary() for b in basins]
    write_json(folder / "basin.json", summaries)
    maps = [
        (b.label, b.endings.reshape(b.y.n, b.x.n), b.time_to_converge_s.reshape(b.y.n, b.x.n))
        for b in basins
    ]
    x, y = basins[0].x, basins[0].y
    return write_basin(
        folder,
        maps,
        (x.name, x.unit, x.low, x.high),
        (y.name, y.unit, y.low, y.high),
        summaries,
        command,
    )
