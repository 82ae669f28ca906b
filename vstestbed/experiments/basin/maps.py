"""Basins of attraction: from where a law reaches its goal, over two coordinates of the start, and why not from elsewhere."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import write_whole, writing
from vstestbed.core.geometry import Array, Pose, inverse, rotation_from_rpy
from vstestbed.experiments.basin.batch import Batch, BatchSetup, fly, ideal, start_of, started_at
from vstestbed.experiments.comparison import Comparison, controllers
from vstestbed.loop.run import run
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.stop import Outcome
from vstestbed.vision import Oracle

if TYPE_CHECKING:
    import polars

COORDINATES = ("x", "y", "z", "roll", "pitch", "yaw")
"""Of the start in the frame of the camera at its goal: [m] right, down and ahead (so that -1 is a metre back), and turns about
these axes [deg], R = Rz(yaw) Ry(pitch) Rx(roll)."""
NOW = time.process_time


@dataclass(frozen=True)
class Axis:
    """One coordinate of the start with its range, in `n` places, both ends included."""

    name: str
    low: float
    high: float
    n: int

    def __post_init__(self) -> None:
        """Refuse what is no coordinate, and an empty range."""
        if self.name not in COORDINATES:
            raise ParameterError("axis", f"must be one of {', '.join(COORDINATES)}", self.name)
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise ParameterError(self.name, "must have a range low:high with low < high", f"{self.low:g}:{self.high:g}")
        if self.n < 2:
            raise ParameterError("n", "must be 2 or more places along an axis", self.n)

    @property
    def values(self) -> Array:
        """Its places (n,) [m or deg]."""
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
    """A start whose run in the time loop (`full`) ended otherwise than in the batch; x, y: its coordinates on the map."""

    x: float
    y: float
    batch: str
    full: str


@dataclass(frozen=True)
class Basin:
    """The map of one law.

    Attributes:
        label: what the law is called. scenario: as flown, ideal.
        x, y: the axes. fixed: the other coordinates of every start [m or deg].
        batch: how each start ended, x fastest. processor_s: time of one core that it took [s].
        checked: how many starts were also flown one by one, in the time loop; disagreements: those that ended otherwise.
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
    def endings(self) -> Array:
        """Outcomes by name (M,), the two ways to lose a target apart: `target_lost` from sight, `plane_crossed`."""
        names = np.array([outcome.name for outcome in self.batch.outcome], dtype=object)
        return np.where(self.batch.crossed, "plane_crossed", names)

    @property
    def time_to_converge_s(self) -> Array:
        """Of those that converged, when the error came under the threshold for good (M,) [s]; NaN of the others."""
        return np.where(self.batch.near >= 0, self.batch.near / self.scenario.camera.rate_hz, np.nan)

    def summary(self) -> dict[str, Any]:
        """The map in numbers."""
        names, counts = np.unique(self.endings.astype(str), return_counts=True)
        shares = dict(zip(names.tolist(), (counts / counts.sum()).tolist(), strict=True))
        detector = self.scenario.detector
        return {
            "label": self.label,
            "x": vars(self.x) | {"unit": self.x.unit},
            "y": vars(self.y) | {"unit": self.y.unit},
            "fixed": {name: {"value": value, "unit": unit_of(name)} for name, value in self.fixed.items()},
            "field_of_view": detector.field_of_view if isinstance(detector, Oracle) else None,
            "starts": int(counts.sum()),
            "shares": dict(sorted(shares.items(), key=lambda item: -item[1])),
            "run_steps": self.batch.run_steps,
            "processor_s": self.processor_s,
            "gain_step": _gain_step(self.scenario),
            "checked": self.checked,
            "agreeing": self.checked - len(self.disagreements),
            "disagreements": [vars(d) for d in self.disagreements],
        }


def _gain_step(scenario: Scenario) -> float | None:
    value = getattr(getattr(scenario.law, "gain", None), "value", None)
    return None if value is None else value * scenario.camera.period


def fixed(scenario: Scenario, x: Axis, y: Axis, at: Mapping[str, float]) -> dict[str, float]:
    """The coordinates that are not on the map, by name [m or deg]: `at`'s, else those of the scenario's start.

    Raises:
        ParameterError: both axes are one, or `at` names one of them, or what is no coordinate, or is no number.
    """
    if x.name == y.name:
        raise ParameterError("--y", "must be another coordinate than --x", y.name)
    if unknown := [name for name in at if name not in COORDINATES or name in (x.name, y.name)]:
        raise ParameterError("--at", f"must be one of {', '.join(COORDINATES)} that is not on the map", unknown[0])
    if endless := [name for name, value in at.items() if not math.isfinite(value)]:
        raise ParameterError("--at", f"{endless[0]} must be a finite number", at[endless[0]])
    own = Pose.of(scenario.goal_view.T_camera_target @ inverse(start_of(scenario)))
    values = dict(zip(COORDINATES, (*own.xyz, *own.rpy_deg), strict=True)) | dict(at)
    return {name: values[name] for name in COORDINATES if name not in (x.name, y.name)}


def starts(scenario: Scenario, x: Axis, y: Axis, at: Mapping[str, float]) -> Array:
    """Poses T_camera_target (n_y n_x, 4, 4), x fastest; coordinates not on the map are `at`'s, else those of the scenario's start."""
    T_goal_target = scenario.goal_view.T_camera_target
    place = np.empty((y.n, x.n, 6))
    for name, value in fixed(scenario, x, y, at).items():
        place[..., COORDINATES.index(name)] = value
    place[..., COORDINATES.index(x.name)] = x.values
    place[..., COORDINATES.index(y.name)] = y.values[:, None]
    place = place.reshape(-1, 6)
    T_goal_camera = np.zeros((len(place), 4, 4))
    T_goal_camera[:, :3, :3], T_goal_camera[:, :3, 3], T_goal_camera[:, 3, 3] = rotation_from_rpy(np.radians(place[:, 3:])), place[:, :3], 1
    return inverse(T_goal_camera) @ T_goal_target


def laws(comparison: Comparison, field_of_view: str | None = None) -> list[tuple[str, Scenario]]:
    """What is mapped: every scenario with every case and varied value, ideal, and what each is called; each can fly a batch.

    Raises:
        ParameterError, ScenarioError: one of them cannot; or two differ only in what an ideal camera does without.
    """
    made: list[tuple[str, Scenario]] = []
    for c in controllers(replace(comparison, tasks={}, seeds=None)):
        words = [str(v) if name in comparison.cases else f"{name.split('.')[-1]}={v}" for name, v in c.values.items()]
        label = ", ".join(([c.scenario.name] if len(comparison.base) > 1 or not words else []) + words)
        scenario = ideal(c.scenario, field_of_view)
        BatchSetup(scenario)
        if same := [other for other, s in made if s == scenario]:
            words = (
                f"`{label}` would make the same map as `{same[0]}`: its cameras are ideal, without the arm's dynamics, latency and noise"
            )
            raise ParameterError("scenario", f"{words}; leave one of the two out")
        made.append((label, scenario))
    return made


def basin(label: str, scenario: Scenario, x: Axis, y: Axis, at: Mapping[str, float] | None = None, check: int = 0, seed: int = 0) -> Basin:
    """The map of an ideal scenario's law; `check` random starts of it are flown in the time loop as well.

    Raises:
        ParameterError: the axes or the law will not do.
    """
    poses = starts(scenario, x, y, at or {})
    began = NOW()
    batch = fly(scenario, poses)
    made = Basin(label, scenario, x, y, fixed(scenario, x, y, at or {}), batch, NOW() - began)
    if not check:
        return made
    spots = np.random.default_rng(seed).choice(len(poses), min(check, len(poses)), replace=False)
    return replace(made, checked=len(spots), disagreements=tuple(_disagreements(made, poses, spots)))


def _disagreements(made: Basin, poses: Array, spots: NDArray[np.int_]) -> Iterator[Disagreement]:
    outcomes: list[Outcome] = made.batch.outcome.tolist()
    for i in spots.tolist():
        found, expected = run(started_at(made.scenario, poses[i])).outcome, outcomes[i]
        if found is not expected:
            j, k = divmod(i, made.x.n)
            yield Disagreement(float(made.x.values[k]), float(made.y.values[j]), expected.name, found.name)


def table(made: Sequence[Basin]) -> polars.DataFrame:
    """One row a start: law, its two coordinates, outcome, steps, times, farthest distance, error at the end."""
    import polars as pl

    frames = []
    for b in made:
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
            pl.DataFrame({name: np.asarray(v).tolist() for name, v in columns.items()}).with_columns(pl.col("law").cast(pl.String))
        )
    return pl.concat(frames).fill_nan(None)


def write(folder: Path, made: Sequence[Basin], command: str = "") -> Path:
    """`basin.parquet`, `basin.json`, `basin.png`, `basin.pdf` and `report.html`, each whole or not at all; the page's path.

    Raises:
        OutputError, EnvironmentLackError: a file cannot be written.
    """
    import io
    import json

    from vstestbed.report.studies.basin import BasinMap, write_maps

    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    parquet = io.BytesIO()
    table(made).write_parquet(parquet)
    write_whole(folder / "basin.parquet", parquet.getvalue())
    summaries = [b.summary() for b in made]
    write_whole(folder / "basin.json", json.dumps(summaries, indent=1) + "\n")
    shape = (made[0].y.n, made[0].x.n)
    maps = [BasinMap(b.label, b.endings.reshape(shape), b.time_to_converge_s.reshape(shape)) for b in made]
    x, y = made[0].x, made[0].y
    return write_maps(folder, maps, (x.name, x.unit, x.low, x.high), (y.name, y.unit, y.low, y.high), summaries, command)


def each(
    found: Sequence[tuple[str, Scenario]], x: Axis, y: Axis, at: Mapping[str, float], check: int, told: Callable[[Basin], None]
) -> list[Basin]:
    """The map of each law, told of one by one."""
    made = []
    for label, scenario in found:
        made.append(basin(label, scenario, x, y, at, check))
        told(made[-1])
    return made
