"""What a run leaves: ticks become rows, rows a log; on disk (`log_files`) it grows with the same numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np

from vstestbed.core.geometry import Array, angles, inverse, quaternion_wxyz, rotation_angle
from vstestbed.core.planar import place_of, relative
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Command
from vstestbed.loop.flight_columns import flight_columns
from vstestbed.loop.metrics import summarise
from vstestbed.loop.task_error import off
from vstestbed.robots import Allocation
from vstestbed.scenario.goal import KEPT, GoalPath
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.stop import Outcome
from vstestbed.sim.base import Truth

if TYPE_CHECKING:
    import polars
    from numpy.typing import NDArray

ESTIMATE = ("est_position_m", "est_rotation_rad")
PLACE = ("x", "y", "heading")
SLIP = ("slip_mps", "slip_radps")
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


@dataclass(frozen=True, slots=True)
class Tick:
    """One frame: what was seen, what was ordered, what was true at the time of exposure.

    Attributes:
        frame: number of the frame. lost: too few markers seen. all_seen: every marker is. error_px: RMS of goal minus measured
        over the coordinates seen, NaN when lost. image: the servo camera's own picture (it holds until the next frame),
        None where none was taken, or not the whole of it. goal: what the law wanted to see, the scenario's view number `view`.
        slip: how fast a vehicle slid and turned on the floor, unnoticed by its encoders [m/s, rad/s]. estimate: how far the robot thinks
        it is from its goal [m, rad], NaN where that does not count. flight: of a craft that flies, the numbers of `flight_columns`.
        t_cmd: when the command reaches the robot [s].
    """

    frame: int
    lost: bool
    all_seen: bool
    error_px: float
    observation: Observation
    command: Command
    allocation: Allocation
    truth: Truth
    image: NDArray[np.uint8] | None
    goal: Goal
    view: int = 0
    slip: tuple[float, float] = (0.0, 0.0)
    estimate: tuple[float, float] = (math.nan, math.nan)
    flight: Array | None = None
    t_cmd: float = math.nan


class Watcher(Protocol):
    """Somebody who looks on while a run goes: the log on disk, a video, a progress bar."""

    def tick(self, tick: Tick) -> None:
        """One frame has been dealt with."""
        ...


class Layout:
    """The columns of a scenario's log, and how ticks become rows of numbers.

    All that was seen and all that was true (act_, q_, ctrl_, ...) is of the exposure at t. The row's command cmd_ is what
    the law made of that picture; it holds from t_cmd on, when it reaches the robot. made_ is the twist that the robot's limits and its
    damping near singularities leave of it, and scale is made_ over what the law wanted, its own limits included.
    For a camera without an image plane, theta and phi [rad] are the measured ray's angles from the axis and about it.
    Of several goal views, `view` is the one that counted. Of a vehicle: base_ its true place, est_ the one it knows of by
    landmarks, compass and encoders, odo_ the one by encoders alone (x, y [m], heading [rad]), slip_mps and slip_radps how fast
    odometry and truth part (sliding over the floor, turning on it, wheels of another radius than believed).
    Where the goal counts as reached by the robot's own estimate, est_position_m and
    est_rotation_rad are that. Of a task without an end, off_m is its true error. What flies has `flight_columns`.
    """

    def __init__(self, scenario: Scenario):
        n, robot = len(scenario.target.points), scenario.robot
        self._grounded = robot.grounded
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
            *(f"{name}_{part}" for name in ("base", "est", "odo") for part in PLACE if robot.grounded),
            *(SLIP if robot.grounded else ()),
            *(("view",) if len(scenario.goal_views) > 1 else ()),
            *(("off_m",) if isinstance(scenario.goal, KEPT) else ()),
            *(ESTIMATE if scenario.stop.converged.by_estimate else ()),
            *flight_columns(scenario),
            *(f"{kind}_{joint}" for kind in ("q", "qd") for joint in robot.joints),
            *(f"ctrl_{actuator}" for actuator in robot.actuators),
        )
        self._scenario, self._camera, self._believed = scenario, scenario.camera, scenario.believed_camera
        known = (scenario.calibration.camera_exact and scenario.calibration.depth_exact) or isinstance(scenario.goal, GoalPath)
        self._goals = None if known else np.array(scenario.goal_poses)  # what the law wants is not where the goal is
        self._T_camera_base = inverse(scenario.camera.mount.T)
        self._start = robot.configuration() if robot.grounded else np.zeros(3)

    def rows(self, ticks: Sequence[Kept]) -> Array:
        """Ticks as numbers, shape (len(ticks), columns): one at a time on disk, many at once in memory, the same numbers."""
        t, frame, lost, error, t_cmd, scale, *rest = zip(*ticks, strict=True)
        uv, depth, p_camera, T_camera, T_target, ordered, twist, made, goal_uv, T_goal, *more = (np.array(some) for some in rest)
        est, odo, slip, view, estimate, flight, *joints = more
        if self._goals is not None:
            T_goal = self._goals[view]
        seen_at = [angles(self._believed.ray(uv))] if self._angles else []
        markers = [uv, self._camera.project(p_camera), goal_uv, depth[..., None], *seen_at]
        when, n = np.array(t), len(ticks)
        return np.concatenate(
            [
                np.column_stack([when, frame, lost]),
                np.concatenate(markers, axis=-1).reshape(n, -1),
                np.array(error)[:, None],
                _poses(T_camera),
                _poses(T_target),
                np.column_stack([*self._away(T_camera, T_target, T_goal), t_cmd]),
                ordered,
                twist,
                made,
                np.array(scale)[:, None],
                *(self._of_vehicle(T_camera, est, odo, slip) if self._grounded else ()),
                *((view[:, None],) if len(self._scenario.goal_views) > 1 else ()),
                *((self._off(when, T_camera, T_target)[:, None],) if isinstance(self._scenario.goal, KEPT) else ()),
                *((estimate,) if self._scenario.stop.converged.by_estimate else ()),
                flight,
                *joints,
            ],
            axis=1,
        )

    def _away(self, T_camera: Array, T_target: Array, T_camera_target: Array) -> tuple[Array, Array]:
        """Distance [m] and angle [rad] of the camera, or of the vehicle on the floor, from the goal pose, (n,) each."""
        T_goal = T_target @ inverse(T_camera_target)
        if self._grounded:
            step = relative(place_of(T_goal @ self._T_camera_base), place_of(T_camera @ self._T_camera_base))
            return np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
        angle = rotation_angle(T_camera[:, :3, :3].mT @ T_goal[:, :3, :3])
        return np.linalg.norm(T_camera[:, :3, 3] - T_goal[:, :3, 3], axis=1), angle

    def _of_vehicle(self, T_camera: Array, est: Array, odo: Array, slip: Array) -> list[Array]:
        """Its true place, the one that it knows of, the one by odometry from where it really started, and its slip."""
        c, s = np.cos(self._start[2]), np.sin(self._start[2])
        way = np.column_stack([c * odo[:, 0] - s * odo[:, 1], s * odo[:, 0] + c * odo[:, 1], odo[:, 2]]) + self._start
        return [place_of(T_camera @ self._T_camera_base), est, way, slip]

    def _off(self, when: Array, T_camera: Array, T_target: Array) -> Array:
        T_base = T_camera @ self._T_camera_base
        return np.array([off(self._scenario, *these) for these in zip(T_base, T_target, when, strict=True)])


NO_FLIGHT = np.zeros(0)
NOWHERE = np.full(3, np.nan)
"""The place of a robot that has none."""
Kept = tuple[Any, ...]
"""What a log keeps of a tick: numbers and arrays, no picture."""


def kept(tick: Tick) -> Kept:
    """The numbers and arrays of a tick that `Layout.rows` makes rows of."""
    o, truth = tick.observation, tick.truth
    return (
        o.t,
        tick.frame,
        tick.lost,
        tick.error_px,
        tick.t_cmd,
        tick.allocation.scale * tick.command.scale,
        o.uv,
        o.depth,
        truth.p_camera,
        truth.T_world_camera,
        truth.T_world_target,
        tick.command.twist,
        truth.twist,
        tick.allocation.twist,
        tick.goal.uv,
        tick.goal.T_camera_target,
        NOWHERE if o.place is None else o.place,
        NOWHERE if o.odometry is None else o.odometry,
        tick.slip,
        tick.view,
        tick.estimate,
        NO_FLIGHT if tick.flight is None else tick.flight,
        truth.q,
        truth.qd,
        truth.ctrl,
    )


def _poses(T: Array) -> Array:
    return np.concatenate([T[:, :3, 3], quaternion_wxyz(T[:, :3, :3])], axis=1)


class Log:
    """Ticks in memory; every CHUNK of them become rows at once, which costs 3 us a row instead of 170 one at a time."""

    CHUNK: ClassVar[int] = 256

    def __init__(self, layout: Layout):
        self._layout = layout
        self._rows: list[Array] = []
        self._waiting: list[Kept] = []

    def append(self, tick: Tick) -> None:
        """Keep one more tick. Nobody may write again into its arrays."""
        self._waiting.append(kept(tick))
        if len(self._waiting) == self.CHUNK:
            self._turn()

    def _turn(self) -> None:
        if self._waiting:
            self._rows.append(self._layout.rows(self._waiting))
            self._waiting = []

    def table(self) -> Array:
        """All rows, shape (rows, columns)."""
        self._turn()
        return np.concatenate(self._rows) if self._rows else np.zeros((0, len(self._layout.columns)))


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
