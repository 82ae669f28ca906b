"""The record of a run: its log (`log_file`), how it ended, and its summary."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from pydantic import ConfigDict, TypeAdapter, ValidationError, create_model

from vstestbed.camera import Image
from vstestbed.core.errors import ParameterError, RunFolderError, nearest
from vstestbed.core.files import read_file
from vstestbed.core.geometry import Array, inverse, rotation_from_quaternion
from vstestbed.core.outcome import Outcome
from vstestbed.core.spatial import as_se3, as_twist3
from vstestbed.loop.columns import POSE, TWIST
from vstestbed.loop.log_file import Log
from vstestbed.loop.metrics import summarise
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.metrics import FIGURES, SOME_FIGURES

if TYPE_CHECKING:
    import polars
    from matplotlib.figure import Figure
    from spatialmath import SE3, Twist3

__all__ = ["Recording", "Watcher", "read_summary"]


class Watcher(Protocol):
    """Receives every frame of a run: the log on disk, a video, a progress bar."""

    def frame(self, frame: Frame) -> None:
        """One frame is complete."""
        ...


@dataclass(frozen=True)
class Recording:
    """A finished run: scenario, outcome, log, wall time by part.

    Attributes:
        rows: the log.
        time_ms: wall time by part, in all [ms]. wall_time_s: of the run; loop_s: without building
            and closing the scene [s].
        versions: of the packages and the renderer used.
        ended_s: simulated time of the verdict [s], which is after the last frame where pictures
            stayed away.
        goal_images: taken at the goal views, (H, W, 3) RGB each, where law or detector compared
            with them.
    """

    scenario: Scenario
    outcome: Outcome
    reason: str
    rows: Log
    wall_time_s: float = math.nan
    loop_s: float = math.nan
    time_ms: dict[str, float] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
    ended_s: float = 0.0
    goal_images: tuple[Image, ...] = ()
    shown_by: ClassVar[Callable[[Recording], str | None]] = staticmethod(lambda recording: None)
    """Makes HTML of a recording for notebooks: the package sets the report here, whose room is
    above this one.
    """
    drawn_by: ClassVar[Callable[[Recording, str], Figure]]
    """Draws a figure of the report, by its name; set as `shown_by` is."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the log's columns."""
        return self.rows.columns

    @property
    def table(self) -> Array:
        """The log as one array in memory, shape (frames, columns)."""
        return self.rows.table

    def __getitem__(self, name: str) -> Array:
        if name not in self.columns:
            raise KeyError(
                f"no column {name!r} in the log; {nearest(name, self.columns)};"
                " `vstestbed describe log` explains them"
            )
        return self.rows[name]

    def camera_poses(self) -> SE3:
        """The camera's true pose T_world_camera (x right, y down, z forward) in each of the n
        frames, as one spatialmath SE3 of n.
        """
        return as_se3(self._poses("cam"))

    def target_poses(self) -> SE3:
        """The target's true pose T_world_target in each of the n frames, as one spatialmath SE3 of
        n.
        """
        return as_se3(self._poses("tgt"))

    def goal_pose(self) -> SE3:
        """The pose T_world_camera where the camera was to be in each of the n frames, as one
        spatialmath SE3 of n.

        It is T_world_target inverse(T_camera_target) with the goal in force;
        `camera_poses()[i].inv() * goal_pose()[i]` was left to go in frame i. For a camera in the
        room it is where that would have to stand. Raises ParameterError: the goal is no single pose
        (a gap, a line).
        """
        s = self.scenario
        views = [0] * len(self.rows)
        if "view" in self.columns:
            views = self["view"].astype(int).tolist()
        goals: list[Array] = []
        for t, view in zip(self["t"].tolist(), views, strict=True):
            T = s.goal_pose_at(t, view)
            if T is None:
                words = f"of kind {s.goal.kind} is no single pose of the camera"
                raise ParameterError("goal", words)
            goals.append(T)
        return as_se3(self._poses("tgt") @ inverse(np.array(goals).reshape(-1, 4, 4)))

    def camera_twists(self) -> Twist3:
        """The camera's true velocity in each of the n frames, in its own frame, as one spatialmath
        Twist3 of n: S = (v, w) [m/s, rad/s].
        """
        return as_twist3(np.column_stack([self[f"act_{name}"] for name in TWIST]))

    def _poses(self, stem: str) -> Array:
        columns = [self[f"{stem}_{name}"] for name in POSE]
        T = np.tile(np.eye(4), (len(self.rows), 1, 1))
        T[:, :3, 3] = np.column_stack(columns[:3])
        T[:, :3, :3] = rotation_from_quaternion(np.column_stack(columns[3:]))
        return T

    def frame(self) -> polars.DataFrame:
        """The log as a polars table in memory, one row a camera frame."""
        return self.rows.frame()

    def plot(self, name: str) -> Figure:
        """A figure of the report as a matplotlib figure, which a notebook shows and `savefig`
        writes; its axes can be changed before.

        name: `features`, `error`, `camera_path`, `twist`, `pose_error`, `depth`, `joints`, `rates`,
        ... Raises ParameterError: there is no such figure, or this run has no such data; with those
        that it has.
        """
        return Recording.drawn_by(self, name)

    def plot_features(self) -> Figure:
        """The markers' tracks in the image, from the start to the goal (`plot_p` of the book's
        toolbox).
        """
        return self.plot("features")

    def plot_error(self) -> Figure:
        """The RMS error in the image over time (`plot_error` there)."""
        return self.plot("error")

    def plot_twist(self) -> Figure:
        """The camera's twist over time, commanded and true (`plot_vel` there)."""
        return self.plot("twist")

    def plot_camera(self) -> Figure:
        """The camera's path in space (`plot_pose` there)."""
        return self.plot("camera_path")

    def plot_depth(self) -> Figure:
        """The depth of each marker over time, as the law used it and true (`plot_z` there)."""
        return self.plot("depth")

    def _repr_html_(self) -> str | None:
        return Recording.shown_by(self)

    def summary(self) -> dict[str, object]:
        """The metrics of the run, as in `summary.json`; `time_ms`: mean wall time of a frame by
        part [ms]. With the gains of servos that were made for an arm of one's own
        (`Actuation.gains`).
        """
        figures = summarise(self.scenario, self.outcome, self.rows.by_name())
        last = figures["sim_time_s"]
        assert isinstance(last, float)
        sim_time = figures["sim_time_s"] = max(last, self.ended_s)
        frames = max(len(self.rows), 1)
        summary: dict[str, object] = {
            "scenario": self.scenario.name,
            "outcome": self.outcome.name,
            "success": self.outcome.success,
            "reason": self.reason,
            "seed": self.scenario.seed,
        }
        if names := self.scenario.target.names:
            summary["marker_names"] = {str(i): name for i, name in enumerate(names)}
        summary |= figures
        body = self.scenario.robot.body
        if body and body.actuation:
            summary |= body.actuation.gains()
        return summary | {
            "wall_time_s": self.wall_time_s,
            "real_time_factor": sim_time / self.wall_time_s if self.wall_time_s > 0 else None,
            "time_ms": {part: ms / frames for part, ms in self.time_ms.items()},
            "versions": self.versions,
        }


# `summary.json` of a run's folder, checked when it is read: an editor or a broken disk may have
# changed it.
LARGEST = 2**63  # whole numbers from here on fit no table
Scalar = bool | int | float | str | None

_STRICT = ConfigDict(strict=True)
# any other name holds a scalar, or a block of scalars
_OPEN = TypeAdapter(dict[str, Scalar | dict[str, Scalar]], config=_STRICT)
_NUMBERS: dict[str, Any] = dict.fromkeys(
    (*FIGURES, *SOME_FIGURES, "wall_time_s", "real_time_factor"), (float | None, None)
)
_Summary = create_model(
    "_Summary",
    __config__=_STRICT,
    outcome=(str, ...),
    success=(bool, ...),
    reason=(str, ""),
    scenario=(str, ""),
    seed=(int, 0),
    time_ms=(dict[str, float | None], {}),
    versions=(dict[str, str], {}),
    **_NUMBERS,
)


def read_summary(folder: Path, works: str) -> dict[str, Any]:
    """The summary of a run; RunFolderError where it is none. works: what would work where the
    summary is damaged, for the message.
    """
    path = folder / "summary.json"
    content = read_file(path, works)
    try:
        _Summary.model_validate_json(content)
        _OPEN.validate_json(content)
    except ValidationError as error:
        first = error.errors()[0]
        fault = ": ".join([*map(str, first["loc"][:1]), first["msg"]])
    else:
        found = json.loads(content)  # numbers as they are written: a whole one stays whole
        fault = _fault(found)
        if not fault:
            return found
    raise RunFolderError(path, f"is not the summary of a run ({fault})", works)


def _fault(summary: dict[str, Any]) -> str:
    """What is wrong with the values of a summary; "" where nothing is."""
    outcome = summary["outcome"]
    if outcome not in Outcome.__members__:
        return f"outcome: {outcome[:40]!r} is none"
    blocks = [summary, *(block for block in summary.values() if isinstance(block, dict))]
    for block in blocks:
        for name, value in block.items():
            if isinstance(value, int) and abs(value) >= LARGEST:
                return f"{name}: too large a number"
    return ""
