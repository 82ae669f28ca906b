"""The columns of a log, each beside the function that fills it."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, angles, inverse, quaternion_wxyz, rotation_angle
from vstestbed.core.planar import place_of, relative
from vstestbed.robots.allocation import LIMITS
from vstestbed.scenario.cameras import OtherCamera
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.metrics import TWIST

__all__ = [
    "LOSS",
    "POSE",
    "WORDS",
    "Kept",
    "Layout",
    "check_own",
    "column_texts",
    "kept",
    "text_of",
]

PER_MARKER = ("u", "v", "u_true", "v_true", "u_goal", "v_goal", "depth")
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
# columns of which limit of the robot changed the command; only of runs in which one did
LOSS = ("limit", "turned_rad")
WORDS = tuple(LIMITS)  # of `limit`, by its number
# the numbers and arrays of a frame that enter the log, by name; no picture
Kept = Mapping[str, Any]
Stacked = Mapping[str, Array]  # the same for n frames, stacked along the first axis
Block = tuple[tuple[str, ...], Callable[[Stacked], Array]]


def kept(frame: Frame) -> Kept:
    """The numbers and arrays of a frame from which `Layout.rows` makes a row."""
    seen = frame.observation
    truth = frame.truth
    goal = frame.goal
    numbers: dict[str, Any] = {
        "t": frame.timing.t,
        "frame": frame.timing.number,
        "lost": frame.error.lost,
        "error_px": frame.error.rms_px,
        "t_cmd": frame.timing.t_cmd,
        "scale": frame.allocation.scale * frame.command.scale,
        "uv": seen.uv,
        "depth": seen.depth,
        "p_camera": truth.p_camera,
        "T_camera": truth.T_world_camera,
        "T_target": truth.T_world_target,
        "cmd": frame.command.twist,
        "act": truth.twist,
        "applied": frame.allocation.twist,
        "goal_uv": goal.uv,
        "T_goal": goal.T_camera_target,
        "view": goal.view,
        "own": frame.row,
        "q": truth.q,
        "qd": truth.qd,
        "ctrl": truth.ctrl,
        "mode": frame.command.mode,
        "tau": truth.tau,
        "loss": (WORDS.index(frame.allocation.limit), frame.allocation.turned_rad),
    }
    if frame.command.row:
        numbers["law"] = frame.command.row
    for name, record in frame.cameras.items():
        numbers[f"camera {name}"] = np.concatenate(
            [record.uv, record.p_camera, record.goal_uv, record.depth[:, None]], axis=1
        )
        numbers[f"time {name}"] = record.t
    if frame.timing.own:
        numbers.update(frame.timing.own)
    return numbers


class Layout:
    """The columns of a scenario's log, and how frames become rows of numbers.

    Measurements and truth (act_, q_, ctrl_, ...) are those of the exposure at t. The command cmd_
    was computed from that picture and is in force from t_cmd on. applied_ is the twist after the
    robot's joint limits and singularity damping; scale is the product of the law's scale factor and
    the robot's. Of a camera without an image plane, theta and phi [rad] are the measured ray's
    angles from the axis and about it. The robot's and the task's columns follow, the number of the
    law's mode, time stamps and losses, those of the exposure, and those of further cameras with
    their names before them, of the last picture of each, and `LOSS`.
    """

    def __init__(self, scenario: Scenario):
        self._camera = scenario.camera
        self._believed = scenario.believed_camera
        self._rays = len(scenario.camera.panels) > 1
        self._T_camera_base = inverse(scenario.camera.mount.T)
        self._planar = scenario.robot.base == "planar"
        exact = scenario.calibration.camera_exact and scenario.calibration.depth_exact
        # With a wrong calibration the law's goal is not the true one, from which errors count;
        # along a path it is the one of its time.
        by_law = exact or scenario.goal.by_clock
        self._goal_poses = None if by_law else np.array(scenario.goal_poses)
        self._of_law: tuple[str, ...] = tuple(scenario.law.columns)
        check_own(self._of_law)
        self._eyes = scenario.eyes
        self._blocks = self._laid_out(scenario)
        self.columns: tuple[str, ...] = sum((names for names, _ in self._blocks), ())
        self._check_unique()

    def _check_unique(self) -> None:
        """Refuse a log with two columns of one name, one of which is an effect's or the law's."""
        twice = sorted(name for name, n in Counter(self.columns).items() if n > 1)
        if twice:
            words = (
                f"must have columns of their own: the log has {', '.join(twice)} twice;"
                " works: one effect of a kind, or other names"
            )
            field = "robot.effects" if set(twice).isdisjoint(self._of_law) else "law.columns"
            raise ParameterError(field, words)

    def _laid_out(self, scenario: Scenario) -> list[Block]:
        """All columns in their order, which existing logs fix."""
        robot = scenario.robot
        per_marker = PER_MARKER + (("theta", "phi") if self._rays else ())
        markers = tuple(f"{name}_{i}" for i in range(scenario.rows) for name in per_marker)
        blocks: list[Block] = [
            *_each("t", "frame", "lost"),
            (markers, self._markers),
            *_each("error_px"),
            (
                _named("cam", POSE) + _named("tgt", POSE),
                lambda k: _poses(k["T_camera"], k["T_target"]),
            ),
            (("position_error_m", "rotation_error_rad"), self._pose_errors),
            *_each("t_cmd"),
            (_named("cmd", TWIST), itemgetter("cmd")),
            (_named("act", TWIST), itemgetter("act")),
            (_named("applied", TWIST), itemgetter("applied")),
            *_each("scale"),
            (scenario.own_columns, itemgetter("own")),
            (_named("q", robot.joints), itemgetter("q")),
            (_named("qd", robot.joints), itemgetter("qd")),
            (_named("ctrl", robot.body.actuators if robot.body else ()), itemgetter("ctrl")),
            (_named("tau", robot.joints if robot.body else ()), itemgetter("tau")),
        ]
        if scenario.law.modes:
            blocks.append((("law_mode",), itemgetter("mode")))
        if self._of_law:
            blocks.append((self._of_law, itemgetter("law")))
        blocks += _each(*scenario.timing.columns, *scenario.camera.columns)
        blocks += map(self._of_camera, self._eyes.values())
        blocks.append((LOSS, itemgetter("loss")))
        return blocks

    def _of_camera(self, eye: OtherCamera) -> Block:
        """The columns of a further camera."""
        columns = tuple(
            f"{eye.name}_{name}_{i}" for i in range(len(eye.target.points)) for name in PER_MARKER
        )

        def values(k: Stacked) -> Array:
            uv, p, goal_uv, depth = np.split(k[f"camera {eye.name}"], [2, 5, 7], axis=-1)
            markers = np.concatenate([uv, eye.camera.project(p), goal_uv, depth], axis=-1)
            return np.column_stack([k[f"time {eye.name}"], markers.reshape(len(uv), -1)])

        return (f"{eye.name}_t", *columns), values

    def rows(self, frames: Sequence[Kept]) -> Array:
        """Frames as numbers, shape (len(frames), columns); the same numbers for one at a time and
        for many at once.
        """
        # of a law that gave no row, and of a camera that has not taken a picture yet
        unknown: dict[str, Any] = {"law": np.full(len(self._of_law), np.nan)}
        for name, eye in self._eyes.items():
            unknown[f"camera {name}"] = np.full((len(eye.target.points), 8), np.nan)
            unknown[f"time {name}"] = np.nan
        stacked = {}
        for name in {**frames[0], **unknown}:
            lacking = unknown.get(name)
            stacked[name] = np.array([frame.get(name, lacking) for frame in frames])
        return np.column_stack([values(stacked) for _, values in self._blocks])

    def _markers(self, k: Stacked) -> Array:
        markers = [
            k["uv"],
            self._camera.project(k["p_camera"]),
            k["goal_uv"],
            k["depth"][..., None],
        ]
        if self._rays:
            markers.append(angles(self._believed.ray(k["uv"])))
        return np.concatenate(markers, axis=-1).reshape(len(k["t"]), -1)

    def _pose_errors(self, k: Stacked) -> Array:
        """Distance [m] and angle [rad] of the camera, or of a vehicle on the floor, from the goal
        pose, (n, 2).
        """
        T_camera_target = k["T_goal"]
        if self._goal_poses is not None:
            T_camera_target = self._goal_poses[k["view"].astype(int)]
        T_camera = k["T_camera"]
        T_goal = k["T_target"] @ inverse(T_camera_target)
        if self._planar:
            step = relative(
                place_of(T_goal @ self._T_camera_base), place_of(T_camera @ self._T_camera_base)
            )
            return np.column_stack([np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])])
        angle = rotation_angle(T_camera[:, :3, :3].mT @ T_goal[:, :3, :3])
        return np.column_stack(
            [np.linalg.norm(T_camera[:, :3, 3] - T_goal[:, :3, 3], axis=1), angle]
        )


class ColumnText(NamedTuple):
    """What a column of the log is. name: a regular expression for such columns; shown: how people
    write them.

    whose: who knows it: `clock`, times and counters; `measured`, by camera and robot; `command`,
    what they command; `truth`, the simulator's alone.
    """

    name: str
    shown: str
    unit: str
    whose: str
    words: str


@cache
def column_texts() -> tuple[ColumnText, ...]:
    """All columns of bundled scenarios (`columns.csv`); those of an effect or a law of one's own
    are described there.
    """
    lines = Path(__file__).with_name("columns.csv").read_text(encoding="utf-8").splitlines()[1:]
    return tuple(ColumnText(name, shown or name, *rest) for name, shown, *rest in csv.reader(lines))


def text_of(name: str) -> ColumnText | None:
    """What a column of the log is; None of one that an effect or a law has added."""
    return next((text for text in column_texts() if re.fullmatch(text.name, name)), None)


def check_own(columns: Sequence[str]) -> None:
    """Refuse columns of a law with names that logs have, of whichever robot, since what judges a
    run reads those that are there, and names that are none in a table.
    """
    plain = re.compile(r"[a-z]\w*", re.ASCII | re.IGNORECASE)
    for name in columns:
        if text_of(name) is not None or not plain.fullmatch(name):
            words = (
                "must be names that no log has, of whichever robot, of letters,"
                " digits and _; works: law_NAME"
            )
            raise ParameterError("law.columns", words, name)


def _each(*names: str) -> list[Block]:
    """Columns of one number a frame, which are called as they are kept."""
    return [((name,), itemgetter(name)) for name in names]


def _named(prefix: str, names: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{prefix}_{name}" for name in names)


def _poses(*T: Array) -> Array:
    """Position and quaternion of poses (n, 4, 4) side by side, from one call for all: of few frames
    it is the call that takes the time.
    """
    together = np.concatenate(T)
    rows = np.concatenate([together[:, :3, 3], quaternion_wxyz(together[:, :3, :3])], axis=1)
    return np.concatenate(np.split(rows, len(T)), axis=1)
