"""What a run leaves: ticks become rows, rows a log; the log grows on disk as it goes.

The log in memory and `log.part` hold the same numbers. `log.part` is CSV whose numbers read back exactly, so it can be
read at any length (a last line without an end is left out); `log.parquet` is written from it when the run ends.
"""

from __future__ import annotations

import array
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from vstestbed.errors import RunFolderError
from vstestbed.geometry import Array, angles, inverse, quaternion_wxyz, rigid_error
from vstestbed.laws import Command
from vstestbed.metrics import summarise
from vstestbed.observation import Observation
from vstestbed.robots import Allocation
from vstestbed.scenario import Scenario
from vstestbed.sim.base import Truth
from vstestbed.stop import Outcome

if TYPE_CHECKING:
    import polars
    from numpy.typing import NDArray

POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


@dataclass(frozen=True, slots=True)
class Tick:
    """One frame: what was seen, what was ordered, what was true at the time of exposure.

    Attributes:
        frame: number of the frame. lost: too few markers seen. error_px: RMS of goal minus measured over the coordinates
        seen, NaN when lost. image: the servo camera's own picture (it holds until the
        next frame), None where none was taken, or not the whole of it.
    """

    frame: int
    lost: bool
    error_px: float
    observation: Observation
    command: Command
    allocation: Allocation
    truth: Truth
    image: NDArray[np.uint8] | None


class Watcher(Protocol):
    """Somebody who looks on while a run goes: the log on disk, a video, a progress bar."""

    def tick(self, tick: Tick) -> None:
        """One frame has been dealt with."""
        ...


class Layout:
    """The columns of a scenario's log, and how a tick becomes one row of numbers.

    All that was seen and all that was true (act_, q_, ctrl_, ...) is of the exposure at t. The row's command cmd_ is what
    the law made of that picture; it holds from t_cmd = t + latency on. made_ is the twist that the robot's limits and its
    damping near singularities leave of it, and scale is made_ over what the law wanted, its own limits included.
    For a camera without an image plane, theta and phi [rad] are the measured ray's angles from the axis and about it.
    """

    def __init__(self, scenario: Scenario):
        n, joints = len(scenario.target.points), scenario.robot.joints
        self._angles = len(scenario.camera.panels) > 1
        per_marker = ("u", "v", "u_true", "v_true", "u_goal", "v_goal", "depth") + (("theta", "phi") if self._angles else ())
        self.columns: tuple[str, ...] = (
            "t",
            "frame",
            "lost",
            *(f"{name}_{i}" for i in range(n) for name in per_marker),
            "error_px",
            *(f"cam_{name}" for name in POSE),
            *(f"tgt_{name}" for name in POSE),
            "position_error_m",
            "rotation_error_rad",
            "t_cmd",
            *(f"cmd_{name}" for name in TWIST),
            *(f"act_{name}" for name in TWIST),
            *(f"made_{name}" for name in TWIST),
            "scale",
            *(f"{kind}_{joint}" for joint in joints for kind in ("q", "qd", "ctrl")),
        )
        self._camera, self._goal = scenario.camera, scenario.goal_view
        self._latency = scenario.camera.latency_s
        self._goal_uv = self._goal.uv.tolist()
        self._T_target_goal = inverse(self._goal.T_camera_target)
        self._target = self._goal_pose = np.zeros((4, 4))
        self._target_pose: list[float] = []

    def row(self, tick: Tick) -> list[float]:
        """The tick as numbers, in the order of `columns`. (Lists of floats: arrays this short cost five times as much.)"""
        o, truth = tick.observation, tick.truth
        if truth.T_world_target is not self._target:  # a still target is the same array at each frame
            self._target, self._goal_pose = truth.T_world_target, truth.T_world_target @ self._T_target_goal
            self._target_pose = _pose(truth.T_world_target)
        true_uv = self._camera.project(truth.p_camera).tolist()
        directions = angles(self._camera.ray(o.uv)).tolist() if self._angles else [()] * len(true_uv)
        markers = zip(o.uv.tolist(), true_uv, self._goal_uv, o.depth.tolist(), directions, strict=True)
        return [
            o.t,
            float(tick.frame),
            float(tick.lost),
            *(x for uv, true, goal, depth, direction in markers for x in (*uv, *true, *goal, depth, *direction)),
            tick.error_px,
            *_pose(truth.T_world_camera),
            *self._target_pose,
            *rigid_error(truth.T_world_camera, self._goal_pose),
            o.t + self._latency,
            *tick.command.twist.tolist(),
            *truth.twist.tolist(),
            *tick.allocation.twist.tolist(),
            tick.allocation.scale * tick.command.scale,
            *(x for joint in zip(truth.q.tolist(), truth.qd.tolist(), truth.ctrl.tolist(), strict=True) for x in joint),
        ]


def _pose(T: Array) -> list[float]:
    return [*T[:3, 3].tolist(), *quaternion_wxyz(T[:3, :3]).tolist()]


@dataclass
class Log:
    """Rows in memory, one after the other in one flat block of doubles."""

    columns: tuple[str, ...]
    values: array.array = field(default_factory=lambda: array.array("d"))

    def append(self, row: list[float]) -> None:
        """Add one row of len(columns) numbers."""
        self.values.extend(row)

    def table(self) -> Array:
        """All rows, shape (rows, columns)."""
        return np.frombuffer(self.values, dtype=float).reshape(-1, len(self.columns)) if self.values else np.zeros((0, len(self.columns)))


@dataclass(frozen=True)
class Recording:
    """A finished run: its scenario, how it ended, its log, where wall time went.

    Attributes:
        columns: names of the log's columns; `table` holds them as (frames, columns).
        time_ms: wall time by part, in all [ms]: physics render detect law record video.
        wall_time_s: wall time of the run [s]; loop_s: of its loop alone, without building and closing the scene [s].
        versions: of what made it.
    """

    scenario: Scenario
    outcome: Outcome
    reason: str
    columns: tuple[str, ...]
    table: Array
    wall_time_s: float = math.nan
    loop_s: float = math.nan
    time_ms: dict[str, float] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> Array:
        """One column as a numpy array; KeyError names the column."""
        if name not in self.columns:
            raise KeyError(f"no column {name!r} in the log; columns: {', '.join(self.columns)}")
        return self.table[:, self.columns.index(name)]

    def frame(self) -> polars.DataFrame:
        """The log as a polars table, one row a camera frame."""
        return to_frame(self.columns, self.table)

    def summary(self) -> dict[str, object]:
        """The run in numbers, as `summary.json` has them; `time_ms` is the mean wall time of a frame by part [ms]."""
        figures = summarise(self.scenario, self.outcome, {name: self.table[:, i] for i, name in enumerate(self.columns)})
        sim_time = float(self["t"][-1]) if len(self.table) else 0.0
        frames = max(len(self.table), 1)
        ended = {"outcome": self.outcome.name, "success": self.outcome.success, "reason": self.reason, "seed": self.scenario.seed}
        cost = {
            "wall_time_s": self.wall_time_s,
            "real_time_factor": sim_time / self.wall_time_s if self.wall_time_s > 0 else None,
            "time_ms": {k: v / frames for k, v in self.time_ms.items()},
            "versions": self.versions,
        }
        return {"scenario": self.scenario.name} | ended | figures | cost


def to_frame(columns: tuple[str, ...], table: Array) -> polars.DataFrame:
    """A table of doubles as a polars table with its own types: `frame` whole numbers, `lost` true or false."""
    import polars as pl

    frame = pl.DataFrame({name: np.ascontiguousarray(table[:, i]) for i, name in enumerate(columns)})
    return frame.with_columns(pl.col("frame").cast(pl.Int64), pl.col("lost").cast(pl.Boolean))


class PartWriter:
    """Writes `log.part` row by row; each line is with the operating system before the next frame is looked at."""

    def __init__(self, path: Path, layout: Layout):
        self._layout = layout
        self._file = path.open("w", encoding="ascii", newline="\n", buffering=1)
        self._file.write(",".join(layout.columns) + "\n")

    def append(self, row: list[float]) -> None:
        """Add one row."""
        self._file.write(",".join(map(repr, row)) + "\n")

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def read_log(folder: Path, scenario: Scenario | None = None) -> polars.DataFrame:
    """The log of a run's folder: `log.parquet`, or what there is of `log.part` when the run was cut off.

    Args:
        folder: a run's folder.
        scenario: where given, the log must have the columns of this scenario's runs.

    Raises:
        RunFolderError: neither is there, or neither can be read, or it is the log of another experiment.
    """
    log = _log_of(folder)
    lacking = [name for name in Layout(scenario).columns if name not in log.columns] if scenario else []
    if lacking:
        raise RunFolderError(folder, f"its log has no column {lacking[0]}, which a run of its scenario.yaml has")
    return log


def _log_of(folder: Path) -> polars.DataFrame:
    import polars as pl

    whole, part = folder / "log.parquet", folder / "log.part"
    try:
        if whole.is_file():
            return pl.read_parquet(whole)
        if part.is_file():
            return _read_part(part)
    except (OSError, ValueError, pl.exceptions.PolarsError) as error:
        raise RunFolderError(folder, f"its log cannot be read ({error})") from None
    raise RunFolderError(folder, "no run here" if folder.is_dir() else "no such folder")


def _read_part(part: Path) -> polars.DataFrame:
    lines = part.read_text(encoding="ascii").split("\n")[:-1]  # what follows the last line end was cut off
    if not lines:
        raise ValueError("log.part ends before its first line does")
    columns = tuple(lines[0].split(","))
    table = np.array([[float(v) for v in line.split(",")] for line in lines[1:]], dtype=float).reshape(-1, len(columns))
    return to_frame(columns, table)
