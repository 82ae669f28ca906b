"""The columns of a log, each beside the function that fills it."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
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
    seen, truth, goal = frame.observation, frame.truth, frame.goal
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
    return numbers if frame.timing.own is None else numbers | dict(frame.timing.own)


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
        robot, goal = scenario.robot, scenario.goal
        self._camera, self._believed, self._rays = (
            scenario.camera,
            scenario.believed_camera,
            len(scenario.camera.panels) > 1,
        )
        self._T_camera_base, self._planar = inverse(scenario.camera.mount.T), robot.base == "planar"
        exact = scenario.calibration.camera_exact and scenario.calibration.depth_exact
        # With a wrong calibration the law's goal is not the true one, from which errors count;
        # along a path it is the one of its time.
        self._goal_poses = None if exact or goal.by_clock else np.array(scenario.goal_poses)
        self._of_law: tuple[str, ...] = tuple(scenario.law.columns)
        check_own(self._of_law)
        self._cameras = {name: len(scenario.target.points) for name in scenario.eyes}
        self._blocks = self._laid_out(scenario)
        self.columns: tuple[str, ...] = tuple(name for names, _ in self._blocks for name in names)
        if twice := sorted({name for name in self.columns if self.columns.count(name) > 1}):
            words = (
                f"must have columns of their own: the log has {', '.join(twice)} twice;"
                " works: one effect of a kind, or other names"
            )
            raise ParameterError(
                "law.columns" if set(twice) & set(self._of_law) else "robot.effects", words
            )

    def _laid_out(self, scenario: Scenario) -> tuple[Block, ...]:
        """All columns in their order, which existing logs fix."""
        robot, columns = scenario.robot, scenario.timing.columns + scenario.camera.columns
        per_marker = PER_MARKER + (("theta", "phi") if self._rays else ())
        markers = tuple(f"{name}_{i}" for i in range(scenario.rows) for name in per_marker)
        return (
            (("t", "frame", "lost"), lambda k: np.column_stack([k["t"], k["frame"], k["lost"]])),
            (markers, self._markers),
            (("error_px",), lambda k: k["error_px"][:, None]),
            (
                _named("cam", POSE) + _named("tgt", POSE),
                lambda k: _poses(k["T_camera"], k["T_target"]),
            ),
            (("position_error_m", "rotation_error_rad"), self._pose_errors),
            (("t_cmd",), lambda k: k["t_cmd"][:, None]),
            (_named("cmd", TWIST), lambda k: k["cmd"]),
            (_named("act", TWIST), lambda k: k["act"]),
            (_named("applied", TWIST), lambda k: k["applied"]),
            (("scale",), lambda k: k["scale"][:, None]),
            (scenario.own_columns, lambda k: k["own"]),
            (_named("q", robot.joints), lambda k: k["q"]),
            (_named("qd", robot.joints), lambda k: k["qd"]),
            (_named("ctrl", robot.body.actuators if robot.body else ()), lambda k: k["ctrl"]),
            (_named("tau", robot.joints if robot.body else ()), lambda k: k["tau"]),
            *(((("law_mode",), lambda k: k["mode"][:, None]),) if scenario.law.modes else ()),
            *(((self._of_law, lambda k: k["law"]),) if self._of_law else ()),
            *(
                ((columns, lambda k: np.column_stack([k[name] for name in columns])),)
                if columns
                else ()
            ),
            *(self._of_camera(eye) for eye in scenario.eyes.values()),
            (LOSS, lambda k: k["loss"]),
        )

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
        unknown: dict[str, Any] = {"law": (np.nan,) * len(self._of_law)} if self._of_law else {}
        for name, markers in self._cameras.items():  # one that has not taken a picture yet
            unknown |= {f"camera {name}": np.full((markers, 8), np.nan), f"time {name}": np.nan}
        names = {**frames[0], **unknown}
        stacked = {
            name: np.array([frame[name] if name in frame else unknown[name] for frame in frames])
            for name in names
        }
        return np.concatenate([values(stacked) for _, values in self._blocks], axis=1)

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
        T_camera_target = (
            k["T_goal"] if self._goal_poses is None else self._goal_poses[k["view"].astype(int)]
        )
        T_camera, T_goal = k["T_camera"], k["T_target"] @ inverse(T_camera_target)
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
    if taken := [
        name for name in columns if text_of(name) is not None or not plain.fullmatch(name)
    ]:
        words = (
            "must be names that no log has, of whichever robot, of letters,"
            " digits and _; works: law_NAME"
        )
        raise ParameterError("law.columns", words, taken[0])


def _named(prefix: str, names: Sequence[str]) -> tuple[str, ...]:
    return tuple(f"{prefix}_{name}" for name in names)


def _poses(*T: Array) -> Array:
    """Position and quaternion of poses (n, 4, 4) side by side, from one call for all: of few frames
    it is the call that takes the time.
    """
    together = np.concatenate(T)
    rows = np.concatenate([together[:, :3, 3], quaternion_wxyz(together[:, :3, :3])], axis=1)
    return np.concatenate(np.split(rows, len(T)), axis=1)
